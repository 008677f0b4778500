#include "client/cli/progress_bar.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace mapsieve::client {
namespace {

constexpr auto kTerminalInterval = std::chrono::milliseconds(100);
constexpr auto kPlainInterval = std::chrono::seconds(5);
constexpr int kBarWidth = 24;

}  // namespace

std::string ShortCount(double count) {
  constexpr struct {
    double from;
    const char* suffix;
  } kSteps[] = {{1e9, " G"}, {1e6, " M"}, {1e3, " k"}};
  for (const auto& step : kSteps) {
    if (count >= step.from) {
      return absl::StrFormat("%.3g%s", count / step.from, step.suffix);
    }
  }
  return absl::StrFormat("%.0f", count);
}

ProgressBar::ProgressBar(std::string what, std::string unit)
    : what_(std::move(what)),
      unit_(std::move(unit)),
      is_terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() {
  if (shown_ && is_terminal_) std::fputs("\n", stderr);
}

std::string ProgressBar::Line(int64_t done, int64_t total) const {
  const double seconds =
      std::chrono::duration<double>(Clock::now() - start_).count();
  const double rate =
      seconds > 0 ? static_cast<double>(done - first_done_) / seconds : 0;
  std::string line = what_ + " ";
  if (total > 0) {
    const double share = std::clamp(
        static_cast<double>(done) / static_cast<double>(total), 0.0, 1.0);
    if (is_terminal_) {
      const auto filled = static_cast<size_t>(share * kBarWidth);
      absl::StrAppend(&line, "[", std::string(filled, '#'),
                      std::string(kBarWidth - filled, '.'), "] ");
    }
    line += absl::StrFormat("%3.0f %% ", share * 100);
  }
  line +=
      absl::StrFormat("%s %s, %s %s/s", ShortCount(static_cast<double>(done)),
                      unit_, ShortCount(rate), unit_);
  if (total > done && rate > 0) {
    const auto left =
        static_cast<int64_t>(static_cast<double>(total - done) / rate);
    line += absl::StrFormat(", %d:%02d left", left / 60, left % 60);
  }
  return line;
}

void ProgressBar::Report(int64_t done, int64_t total) {
  if (first_done_ < 0) first_done_ = done;
  const Clock::time_point now = Clock::now();
  const bool last = total > 0 && done >= total && shown_;
  if (!last &&
      now - last_shown_ < (is_terminal_ ? Clock::duration(kTerminalInterval)
                                        : Clock::duration(kPlainInterval))) {
    return;
  }
  last_shown_ = now;
  shown_ = true;
  const std::string line = Line(done, total);
  // "\033[K" clears what a longer line left behind.
  std::fprintf(stderr, is_terminal_ ? "\r%s\033[K" : "%s\n", line.c_str());
  std::fflush(stderr);
}

}  // namespace mapsieve::client
