#ifndef MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_
#define MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_

#include "absl/status/status.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"

namespace mapsieve::client {

/// How a stream that breaks goes on by new calls: six in a row at most, with a
/// pause before each, twice as long as the one before: 6 s together.
class ResumePauses {
 public:
  /// After a call that ended with `status`: false if no new one is to be made,
  /// for it would not help, or enough failed; else true, after the pause.
  bool Wait(const absl::Status& status) {
    if (!absl::IsUnavailable(status) || count_ == kMaxCount) return false;
    absl::SleepFor(kFirstPause * (1 << count_++));
    return true;
  }
  /// A call succeeded: the next break is the first one.
  void Reset() { count_ = 0; }

 private:
  static constexpr int kMaxCount = 6;
  static constexpr absl::Duration kFirstPause = absl::Milliseconds(100);

  int count_ = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_RESUME_PAUSES_H_
