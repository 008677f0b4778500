#ifndef MAPSIEVE_SERVER_SERVER_H_
#define MAPSIEVE_SERVER_SERVER_H_

#include <memory>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/server_options.h"

namespace spdlog {
class logger;
}  // namespace spdlog

namespace mapsieve::storage {
class FileSystem;
}  // namespace mapsieve::storage

namespace mapsieve::rpc {

/// A server that serves: the services of mapsieve.v1, health and reflection on
/// one port, over the maps of one data directory. While the disk has no space
/// for uploads, health has UploadService and ProcessingService NOT_SERVING, and
/// the rest SERVING, the server as a whole ("") too. Thread-safe.
class Server {
 public:
  /// Opens the data directory and begins to serve. `logger` outlives the
  /// server; it hears of failed calls, of a disk that is full or is not any
  /// more, and at level debug of all calls. `file_system`: where the data
  /// directory is, outlives the server; null: that of the operating system.
  /// kInvalidArgument: `options`; kUnavailable: the address cannot be listened
  /// on; the errors of engine::Engine::Open.
  static absl::StatusOr<std::unique_ptr<Server>> Start(
      const ServerOptions& options, spdlog::logger& logger,
      storage::FileSystem* file_system = nullptr);

  /// Shutdown without grace.
  virtual ~Server() = default;

  /// Where it serves, with the real port.
  virtual const ListenAddress& address() const = 0;

  /// Drains: health says NOT_SERVING and new calls get UNAVAILABLE; running
  /// operations stop, to go on after the next start; then calls in flight have
  /// `grace` to end before they are cancelled. Returns when nothing is going
  /// on. A repeat does nothing.
  virtual void Shutdown(absl::Duration grace) = 0;
};

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_SERVER_H_
