#ifndef MAPSIEVE_SERVER_SERVER_OPTIONS_H_
#define MAPSIEVE_SERVER_SERVER_OPTIONS_H_

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace mapsieve::rpc {

/// Where a server listens.
struct ListenAddress {
  /// A name or an address; one of IPv6 is in brackets.
  std::string host = "127.0.0.1";
  /// 0: any free one.
  int port = 7070;

  /// Reads "HOST:PORT". kInvalidArgument.
  static absl::StatusOr<ListenAddress> Parse(std::string_view text);

  /// Whether only this machine can connect: 127.x.x.x, [::1], localhost.
  bool IsLoopback() const;
  std::string ToString() const;
};

/// Everything about a server that can be chosen.
struct ServerOptions {
  /// Directory of all maps; made if absent.
  std::string data_dir;
  ListenAddress listen;
  /// Limit for points in memory; at least 256 MiB.
  int64_t memory_bytes = int64_t{2} << 30;
  /// Threads of the filter, 1 to 1024. 0: one for each processor.
  int thread_count = 0;
  /// Newest revisions of each map that are kept; 0: all.
  int64_t kept_revision_count = 0;
  /// Serve other machines, although the service neither encrypts nor asks who
  /// calls.
  bool insecure = false;
  /// What is logged: "debug" (every call), "info", "warn" or "error".
  std::string log_level = "info";

  /// kInvalidArgument, naming the setting and what to do.
  absl::Status Validate() const;
};

/// One of the settings, as it is named on the command line (--NAME VALUE), in a
/// configuration file (NAME = VALUE) and in the environment (MAPSIEVED_NAME, in
/// capitals, '_' for '-').
struct ServerSetting {
  const char* name;
  /// What VALUE stands for; null for a switch, whose values are true and false.
  const char* value_name;
  const char* help;
  /// kInvalidArgument: what is wrong with the text, without the name.
  absl::Status (*set)(std::string_view text, ServerOptions& options);
};

/// All of them.
std::span<const ServerSetting> ServerSettings();

/// MAPSIEVED_NAME.
std::string EnvironmentName(std::string_view setting_name);

/// Sets one by name. kInvalidArgument: the name or the value; the message names
/// both.
absl::Status ApplySetting(std::string_view name, std::string_view text,
                          ServerOptions& options);

/// Applies a configuration file: lines NAME = VALUE, empty lines, and lines
/// that begin with '#'. kInvalidArgument with file and line; kNotFound: no such
/// file.
absl::Status ApplyConfigFile(const std::string& path, ServerOptions& options);

/// Applies every variable that `get` (std::getenv) finds.
absl::Status ApplyEnvironment(
    const std::function<const char*(const char*)>& get, ServerOptions& options);

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_SERVER_SERVER_OPTIONS_H_
