#include "server/rpc/admission.h"

#include <algorithm>
#include <condition_variable>
#include <string>

#include "absl/strings/str_cat.h"
#include "server/rpc/status_adapter.h"

namespace mapsieve::rpc {
namespace {

constexpr const char* kKindNames[] = {"short calls", "WaitOperation calls",
                                      "WriteUpload calls", "QueryRegion calls",
                                      "WatchMap calls"};

}  // namespace

Admission::Admission(const AdmissionLimits& limits)
    : limits_{limits.unary, limits.wait, limits.upload, limits.query,
              limits.watch} {}

absl::StatusOr<Admission::Ticket> Admission::Admit(CallKind kind) {
  const auto i = static_cast<size_t>(kind);
  if (draining_.stop_requested()) return DrainingError();
  MutexLock lock(mutex_);
  if (count_[i] >= limits_[i]) {
    return WithReason(absl::ResourceExhaustedError(absl::StrCat(
                          "the server already has ", count_[i], " ",
                          kKindNames[i], " going on; try again later")),
                      "TOO_MANY_CALLS",
                      {{"limit", std::to_string(limits_[i])}});
  }
  ++count_[i];
  return Ticket(this, kind);
}

void Admission::Drain() { draining_.request_stop(); }

void Admission::WaitUntilIdle(absl::Time deadline) {
  const auto until = absl::ToChronoTime(deadline);
  MutexLock lock(mutex_);
  while (!IsIdle()) {
    if (left_.wait_until(mutex_, until) == std::cv_status::timeout) return;
  }
}

void Admission::Leave(CallKind kind) {
  MutexLock lock(mutex_);
  --count_[static_cast<size_t>(kind)];
  if (IsIdle()) left_.notify_all();
}

bool Admission::IsIdle() const {
  return std::all_of(count_.begin(), count_.end(),
                     [](int count) { return count == 0; });
}

absl::Status DrainingError() {
  return WithReason(
      absl::UnavailableError("the server is shutting down; try again later"),
      "SHUTTING_DOWN");
}

}  // namespace mapsieve::rpc
