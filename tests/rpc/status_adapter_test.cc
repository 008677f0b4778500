#include "server/rpc/status_adapter.h"

#include <new>
#include <stdexcept>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::_;
using ::testing::HasSubstr;

v1::ErrorInfo InfoOf(const v1::RpcStatus& status) {
  v1::ErrorInfo info;
  EXPECT_EQ(status.details_size(), 1);
  EXPECT_TRUE(status.details(0).UnpackTo(&info));
  return info;
}

TEST(ToGrpcStatus, KeepsEveryCode) {
  EXPECT_TRUE(ToGrpcStatus(absl::OkStatus()).ok());
  for (int code = 1; code <= 16; ++code) {
    const grpc::Status status = ToGrpcStatus(
        absl::Status(static_cast<absl::StatusCode>(code), "because"));
    EXPECT_EQ(static_cast<int>(status.error_code()), code);
    EXPECT_EQ(status.error_message(), "because");
    v1::RpcStatus details;
    ASSERT_TRUE(details.ParseFromString(status.error_details()));
    EXPECT_EQ(details.code(), code);
    EXPECT_EQ(details.message(), "because");
  }
}

TEST(ToRpcStatus, AlwaysHasOneCause) {
  const v1::ErrorInfo info =
      InfoOf(ToRpcStatus(absl::NotFoundError("no map \"x\"")));
  EXPECT_EQ(info.reason(), "NOT_FOUND");
  EXPECT_EQ(info.domain(), "mapsieve");
}

TEST(InvalidField, TellsThePathToPeopleAndPrograms) {
  const v1::RpcStatus status = ToRpcStatus(InvalidField("box.min", "missing"));
  EXPECT_EQ(status.code(), 3);
  EXPECT_EQ(status.message(), "box.min: missing");
  const v1::ErrorInfo info = InfoOf(status);
  EXPECT_EQ(info.reason(), "INVALID_FIELD");
  EXPECT_EQ(info.metadata().at("field"), "box.min");
}

TEST(WithReason, KeepsTheFirstCauseAndOk) {
  EXPECT_TRUE(WithReason(absl::OkStatus(), "REASON") == absl::OkStatus());
  const absl::Status first =
      WithReason(absl::AbortedError("m"), "FIRST", {{"limit", "3"}});
  EXPECT_EQ(InfoOf(ToRpcStatus(WithReason(first, "SECOND"))).reason(), "FIRST");
}

TEST(ToRpcStatus, MessageIsShortValidText) {
  const std::string message = std::string(5000, 'x') + "\xff";
  EXPECT_EQ(ToRpcStatus(absl::InternalError(message)).message(),
            std::string(1000, 'x'));
}

TEST(CleanText, KeepsTextAndReplacesTheRest) {
  EXPECT_EQ(CleanText("höhe ß €  𝄞", 100), "höhe ß €  𝄞");
  EXPECT_EQ(CleanText("a\nb\x7f", 100), "a?b?");
  EXPECT_EQ(CleanText("H\xf6he", 100), "H?he");
  // Overlong, surrogate, beyond Unicode, cut short.
  EXPECT_EQ(CleanText("\xc0\x80", 100), "??");
  EXPECT_EQ(CleanText("\xe0\x80\x80", 100), "???");
  EXPECT_EQ(CleanText("\xed\xa0\x80", 100), "???");
  EXPECT_EQ(CleanText("\xf4\x90\x80\x80", 100), "????");
  EXPECT_EQ(CleanText("\xe2\x82", 100), "??");
  // A character is not cut in two.
  EXPECT_EQ(CleanText("aß", 2), "a");
}

TEST(Guarded, TurnsExceptionsIntoErrors) {
  MAPSIEVE_EXPECT_OK(Guarded([] { return absl::OkStatus(); }));
  EXPECT_THAT(Guarded([]() -> absl::Status { throw std::bad_alloc(); }),
              StatusIs(absl::StatusCode::kResourceExhausted, _));
  EXPECT_THAT(
      Guarded([]() -> absl::Status { throw std::runtime_error("oops"); }),
      StatusIs(absl::StatusCode::kInternal, HasSubstr("oops")));
  EXPECT_THAT(Guarded([]() -> absl::Status { throw 7; }),
              StatusIs(absl::StatusCode::kInternal, _));
}

}  // namespace
}  // namespace mapsieve::rpc
