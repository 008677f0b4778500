#ifndef MAPSIEVE_CLIENT_CLI_PROGRESS_BAR_H_
#define MAPSIEVE_CLIENT_CLI_PROGRESS_BAR_H_

#include <chrono>
#include <cstdint>
#include <string>

#include "core/base/executor.h"

namespace mapsieve::client {

/// Shows the progress of one task on stderr: a bar with rate and remaining time
/// on a terminal, a plain line every few seconds otherwise, nothing if the task
/// is over before. Ends its line when it is destroyed.
class ProgressBar final : public ProgressSink {
 public:
  /// `what`: a word for the task; `unit`: a word for what is counted, or "B"
  /// for bytes.
  ProgressBar(std::string what, std::string unit);
  ~ProgressBar() override;

  /// A total of 0 is not known yet.
  void Report(int64_t done, int64_t total) override;

 private:
  using Clock = std::chrono::steady_clock;

  std::string Line(int64_t done, int64_t total) const;

  const std::string what_;
  const std::string unit_;
  const bool is_terminal_;
  const Clock::time_point start_ = Clock::now();
  Clock::time_point last_shown_ = start_;
  int64_t first_done_ = -1;
  bool shown_ = false;
};

/// "1.2 M", "37 k", "812": a count for people.
std::string ShortCount(double count);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_PROGRESS_BAR_H_
