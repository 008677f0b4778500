#include "server/space_watch.h"

#include <chrono>
#include <utility>

namespace mapsieve::rpc {
namespace {

constexpr std::chrono::seconds kInterval(1);

}  // namespace

SpaceWatch::SpaceWatch(std::function<absl::Status()> check,
                       std::function<void(const absl::Status&)> report)
    : check_(std::move(check)), report_(std::move(report)) {
  Look();
  thread_ = std::thread([this] { Run(); });
}

SpaceWatch::~SpaceWatch() {
  {
    MutexLock lock(mutex_);
    is_stopped_ = true;
  }
  stopped_.notify_all();
  thread_.join();
}

void SpaceWatch::Look() {
  const absl::Status status = check_();
  if (std::exchange(has_space_, status.ok()) != status.ok()) report_(status);
}

void SpaceWatch::Run() {
  while (true) {
    {
      MutexLock lock(mutex_);
      const auto wake = std::chrono::steady_clock::now() + kInterval;
      while (!is_stopped_ &&
             stopped_.wait_until(mutex_, wake) != std::cv_status::timeout) {
      }
      if (is_stopped_) return;
    }
    Look();
  }
}

}  // namespace mapsieve::rpc
