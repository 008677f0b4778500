#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/api/api_comments.h"
#include "tests/api/api_files.h"
#include "tests/api/api_reference.h"
#include "tests/api/wire_listing.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::testing {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr char kRoot[] = PROJECT_ROOT;
constexpr char kRemedy[] =
    "If only new things came: build record_api, run `build/release/bin/"
    "record_api .` in the root and commit what it wrote.";

std::vector<std::string> RecordedListing() {
  return absl::StrSplit(ReadText(absl::StrCat(kRoot, "/", kWireListingPath)),
                        '\n', absl::SkipEmpty());
}

TEST(Api, WireFormIsWhatWasRecorded) {
  const auto api = ReadApi(kRoot);
  ASSERT_EQ(api->errors(), "");
  const std::vector<std::string> recorded = RecordedListing();
  const std::vector<std::string> current = WireListing(api->files());
  EXPECT_THAT(BrokenLines(recorded, current), IsEmpty())
      << "these lines of " << kWireListingPath
      << " are gone or different, which breaks every program that was compiled "
         "before: bring them back and add new fields instead";
  EXPECT_THAT(BrokenLines(current, recorded), IsEmpty()) << kRemedy;
}

TEST(Api, ReferenceIsWhatTheCommentsSay) {
  const auto api = ReadApi(kRoot);
  ASSERT_EQ(api->errors(), "");
  EXPECT_TRUE(ReadText(absl::StrCat(kRoot, "/", kReferencePath)) ==
              ApiReference(api->files()))
      << kReferencePath << " is out of date. " << kRemedy;
}

TEST(Api, EverythingHasAComment) {
  const auto api = ReadApi(kRoot);
  ASSERT_EQ(api->errors(), "");
  EXPECT_THAT(Undocumented(api->files()), IsEmpty());
}

// Parses one file that a test writes.
class ApiToolsTest : public ::testing::Test {
 protected:
  static constexpr char kProto[] = R"(syntax = "proto3";
package a.v1;
// A service.
service S {
  // Does it.
  // Errors: NOT_FOUND; DATA_LOSS (a; b. c).
  // Errors of the operation: CANCELLED. The map
  // is as before.
  rpc Do(M) returns (stream M);
}
// A message.
message M {
  // A kind.
  enum Kind {
    // None.
    KIND_NONE = 0;
    // One.
    KIND_ONE = 1;
  }
  // A | number.
  int64 number = 1;
  // Kinds.
  repeated Kind kinds = 2;
}
)";

  std::unique_ptr<ApiFiles> Parse(const std::string& text) {
    const TemporaryDirectory folder;
    std::ofstream(folder / "a.proto") << text;
    return std::make_unique<ApiFiles>(folder.path(),
                                      std::vector<std::string>{"a.proto"});
  }

  // Lines that a program compiled before misses once `from` is `to`.
  std::vector<std::string> BrokenBy(const char* from, const char* to) {
    const auto before = Parse(kProto);
    const auto after = Parse(absl::StrReplaceAll(kProto, {{from, to}}));
    EXPECT_EQ(before->errors() + after->errors(), "");
    return BrokenLines(WireListing(before->files()),
                       WireListing(after->files()));
  }
};

TEST_F(ApiToolsTest, WhateverBreaksAProgramIsSeen) {
  EXPECT_THAT(BrokenBy("number = 1", "number = 3"),
              ElementsAre("a.v1.M 1: int64 number"));
  EXPECT_THAT(BrokenBy("int64 number", "sint64 number"),
              ElementsAre("a.v1.M 1: int64 number"));
  EXPECT_THAT(BrokenBy("int64 number", "optional int64 number"),
              ElementsAre("a.v1.M 1: int64 number"));
  EXPECT_THAT(BrokenBy("int64 number", "int64 count"),
              ElementsAre("a.v1.M 1: int64 number"));
  EXPECT_THAT(BrokenBy("repeated Kind", "Kind"),
              ElementsAre("a.v1.M 2: repeated a.v1.M.Kind kinds"));
  EXPECT_THAT(BrokenBy("repeated Kind", "repeated int32"),
              ElementsAre("a.v1.M 2: repeated a.v1.M.Kind kinds"));
  EXPECT_THAT(BrokenBy("KIND_ONE = 1", "KIND_ONE = 2"),
              ElementsAre("a.v1.M.Kind 1: KIND_ONE"));
  EXPECT_THAT(BrokenBy("rpc Do", "rpc Did"),
              ElementsAre("a.v1.S.Do: a.v1.M returns stream a.v1.M"));
  EXPECT_THAT(BrokenBy("returns (stream M)", "returns (M)"),
              ElementsAre("a.v1.S.Do: a.v1.M returns stream a.v1.M"));
}

TEST_F(ApiToolsTest, NewThingsBreakNothing) {
  EXPECT_THAT(BrokenBy("int64 number = 1;", "int64 number = 1; bool b = 3;"),
              IsEmpty());
}

TEST_F(ApiToolsTest, ACommentOfAMethodIsReadInItsParts) {
  const auto api = Parse(kProto);
  const MethodComment comment =
      CommentOfMethod(*api->files()[0]->service(0)->method(0));
  EXPECT_EQ(comment.text, "Does it.");
  EXPECT_THAT(comment.errors,
              ElementsAre(DocumentedError{"NOT_FOUND", ""},
                          DocumentedError{"DATA_LOSS", "a; b. c"}));
  EXPECT_THAT(comment.operation_errors,
              ElementsAre(DocumentedError{"CANCELLED", ""}));
  EXPECT_EQ(comment.after, "The map is as before.");
}

TEST_F(ApiToolsTest, MissingCommentsAndErrorsAreNamed) {
  EXPECT_THAT(Undocumented(Parse(kProto)->files()), IsEmpty());
  const auto without = [&](const char* text, const char* instead = "") {
    const auto api = Parse(absl::StrReplaceAll(kProto, {{text, instead}}));
    return Undocumented(api->files());
  };
  EXPECT_THAT(without("// Kinds."), ElementsAre("a.v1.M.kinds has no comment"));
  EXPECT_THAT(without("// One."),
              ElementsAre("a.v1.M.KIND_ONE has no comment"));
  EXPECT_THAT(without("// A message."), ElementsAre("a.v1.M has no comment"));
  EXPECT_THAT(without("Errors: ", "No: "),
              ElementsAre("a.v1.S.Do names no errors"));
  EXPECT_THAT(without("NOT_FOUND", "NOT_FUOND"),
              ElementsAre("a.v1.S.Do: \"NOT_FUOND\" is not a code"));
}

TEST_F(ApiToolsTest, TheReferenceHoldsEveryPart) {
  const std::string page = ApiReference(Parse(kProto)->files());
  for (const char* part :
       {"| [S](#s) | [Do](#do) |", "Takes [M](#m), returns stream of [M](#m).",
        "| `DATA_LOSS` | a; b. c |", "| Error of the operation | When |",
        "The map is as before.", "| 1 | `number` | int64 | A \\| number. |",
        "| 2 | `kinds` | repeated [M.Kind](#mkind) | Kinds. |",
        "### M.Kind\n\nA kind.", "| 1 | `KIND_ONE` | One. |"}) {
    EXPECT_THAT(page, HasSubstr(part));
  }
}

}  // namespace
}  // namespace mapsieve::testing
