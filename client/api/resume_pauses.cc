#include "client/api/resume_pauses.h"

#include <algorithm>
#include <utility>

#include "absl/time/clock.h"
#include "grpcpp/channel.h"

namespace mapsieve::client {

ResumePauses::ResumePauses(absl::Duration patience,
                           std::shared_ptr<grpc::Channel> channel)
    : patience_(patience), channel_(std::move(channel)) {}

bool ResumePauses::Pause() {
  constexpr absl::Duration kLongestPause = absl::Seconds(5);
  const absl::Duration pause = std::min(next_, patience_ - spent_);
  if (pause <= absl::ZeroDuration()) return false;
  const absl::Time begin = absl::Now();
  absl::SleepFor(pause);
  channel_->WaitForConnected(absl::ToChronoTime(absl::Now() + pause));
  spent_ += std::max(pause, absl::Now() - begin);
  next_ = std::min(2 * next_, kLongestPause);
  return true;
}

}  // namespace mapsieve::client
