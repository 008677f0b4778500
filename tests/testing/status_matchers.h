#ifndef MAPSIEVE_TESTS_TESTING_STATUS_MATCHERS_H_
#define MAPSIEVE_TESTS_TESTING_STATUS_MATCHERS_H_

#include <ostream>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace mapsieve::testing {

inline const absl::Status& ToStatus(const absl::Status& status) {
  return status;
}
template <typename T>
const absl::Status& ToStatus(const absl::StatusOr<T>& result) {
  return result.status();
}

/// Matches an OK Status or StatusOr.
MATCHER(IsOk, "is OK") {
  *result_listener << ToStatus(arg).ToString();
  return ToStatus(arg).ok();
}

/// Matches a Status or StatusOr of code `code` whose message matches `message`.
MATCHER_P2(StatusIs, code, message, "has the status") {
  *result_listener << ToStatus(arg).ToString();
  return ToStatus(arg).code() == code &&
         ::testing::Matches(message)(std::string(ToStatus(arg).message()));
}

}  // namespace mapsieve::testing

#define MAPSIEVE_EXPECT_OK(expression) \
  EXPECT_THAT(expression, ::mapsieve::testing::IsOk())
#define MAPSIEVE_ASSERT_OK(expression) \
  ASSERT_THAT(expression, ::mapsieve::testing::IsOk())
/// Declares or assigns `target` from a StatusOr or fails the test.
#define MAPSIEVE_ASSERT_OK_AND_ASSIGN(target, expression)             \
  MAPSIEVE_ASSERT_OK_AND_ASSIGN_IMPL_(                                \
      MAPSIEVE_TEST_CONCAT_(mapsieve_test_result_, __LINE__), target, \
      expression)
#define MAPSIEVE_TEST_CONCAT_INNER_(a, b) a##b
#define MAPSIEVE_TEST_CONCAT_(a, b) MAPSIEVE_TEST_CONCAT_INNER_(a, b)
#define MAPSIEVE_ASSERT_OK_AND_ASSIGN_IMPL_(result, target, expression) \
  auto result = (expression);                                           \
  ASSERT_THAT(result, ::mapsieve::testing::IsOk());                     \
  target = std::move(result).value()

#endif  // MAPSIEVE_TESTS_TESTING_STATUS_MATCHERS_H_
