#ifndef MAPSIEVE_TESTS_RPC_FAILING_CALLS_H_
#define MAPSIEVE_TESTS_RPC_FAILING_CALLS_H_

#include <compare>
#include <ostream>
#include <string>
#include <vector>

#include "absl/status/status.h"

/// How to get every error that a call documents.
namespace mapsieve::rpc {

/// A call that fails.
struct FailingCall {
  /// "MapService.GetMap".
  const char* method;
  absl::StatusCode code;
  /// In text format, one but for calls that take a stream. $SUM stands for the
  /// checksum of the data "a".
  std::vector<std::string> requests;
};
using FailingCalls = std::vector<FailingCall>;

/// maps/campus is processed and its upload u finalized; maps/empty has an
/// upload u of 10 bytes that has none yet.
const FailingCalls& AtRest();
/// The same maps, and the disk is as full as it may be.
const FailingCalls& OnAFullDisk();
/// maps/campus is being processed, a repair of it waits, and its upload whole
/// waits to be finalized.
const FailingCalls& WhileOperationsGoOn();

/// An error of a call or, with `of_operation`, of the operation that it starts.
struct Place {
  std::string method;
  bool of_operation = false;
  std::string code;

  auto operator<=>(const Place&) const = default;
};
void PrintTo(const Place& place, std::ostream* out);

/// An error that no table above provokes, and the test that does.
struct ElsewherePlace {
  Place place;
  const char* test;
};
const std::vector<ElsewherePlace>& Elsewhere();

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_TESTS_RPC_FAILING_CALLS_H_
