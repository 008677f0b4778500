#ifndef MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_
#define MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_

#include <memory>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace grpc {
class Channel;
}  // namespace grpc

namespace mapsieve::client {

/// How work that breaks goes on by new calls: with a pause before each, the
/// first of 0.1 s, each twice as long as the one before up to 5 s, until those
/// in a row took `patience` together.
class ResumePauses {
 public:
  /// Of a stream, which someone waits for.
  static constexpr absl::Duration kStreamPatience = absl::Milliseconds(6300);

  /// `channel`: what the calls are made over. A pause ends with the attempt to
  /// connect, on which nothing works while no call waits.
  ResumePauses(absl::Duration patience, std::shared_ptr<grpc::Channel> channel);

  /// False if the pauses are over; else true, after the next one.
  bool Pause();
  /// Pause after a call that ended with `status`; false too if no new one
  /// would help.
  bool Wait(const absl::Status& status) {
    return absl::IsUnavailable(status) && Pause();
  }
  /// A call brought the work on: the next break is the first one.
  void Reset() {
    spent_ = absl::ZeroDuration();
    next_ = kFirstPause;
  }

 private:
  static constexpr absl::Duration kFirstPause = absl::Milliseconds(100);

  absl::Duration patience_;
  std::shared_ptr<grpc::Channel> channel_;
  absl::Duration spent_;
  absl::Duration next_ = kFirstPause;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_
