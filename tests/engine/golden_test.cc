// Data directories as earlier programs left them; golden/README.md.

#include <cstdlib>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/hash.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

namespace fs = std::filesystem;

using core::DensityRule;
using core::LatticeCloud;
using ::testing::HasSubstr;

/// Small, of all labels and attributes.
LatticeCloud SmallScene(uint32_t seed) { return Split(MakeScene(seed), 60)[0]; }

/// Directions are left out: versions differ in how finely they store them.
std::string Digest(const LatticeCloud& cloud) {
  const LatticeCloud sorted = InCanonicalOrder(cloud);
  ContentHasher hasher;
  const auto add_text = [&](const std::string& text) {
    hasher.Update(std::as_bytes(std::span(text)));
  };
  for (const core::LatticePoint& q : sorted.positions) {
    add_text(absl::StrCat(q.x, ",", q.y, ",", q.z, ";"));
  }
  for (const core::Column& column : sorted.attributes.columns()) {
    const std::string& name = column.name();
    if (name == "nx" || name == "ny" || name == "nz") continue;
    add_text(name);
    for (size_t i = 0; i < column.size(); ++i) {
      add_text(column.IsMissing(i) ? "missing;" : "there;");
    }
    hasher.Update(column.bytes());
  }
  return hasher.HexDigest();
}

void DescribeAnswer(Service& service, const QuerySpec& spec,
                    const std::string& name, std::string& text) {
  const auto answer = service.Query(spec);
  absl::StrAppend(&text, "  ", name, ": ");
  if (answer.ok()) {
    absl::StrAppend(&text, answer->points.size(), " points ",
                    Digest(answer->points), "\n");
  } else {
    absl::StrAppend(&text, absl::StatusCodeToString(answer.status().code()),
                    "\n");
  }
}

/// What the service tells of all maps, as lines of text.
std::string Describe(Service& service) {
  std::string text;
  const auto maps = service->ListMaps({});
  EXPECT_TRUE(maps.ok()) << maps.status();
  for (const MapInfo& map : maps->items) {
    absl::StrAppend(&text, "map ", map.map_id, " step ", map.step_nm,
                    " tile level ", map.tile_level, " revision ", map.revision,
                    " processed ", map.processed_revision, "\n");
    const auto revisions = service->ListRevisions(map.map_id, {});
    EXPECT_TRUE(revisions.ok()) << revisions.status();
    for (const RevisionInfo& r : revisions->items) {
      absl::StrAppend(
          &text, " revision ", r.number, " kind ", static_cast<int>(r.kind),
          " restores ", r.restored_revision, " raw ", r.raw_point_count,
          " added ", r.added_point_count, " removed ", r.removed_point_count,
          " points ", r.point_count, " tiles ", r.tile_count, " stale ",
          r.stale_tile_count, "\n");
      DescribeAnswer(service,
                     {.map_id = map.map_id, .revision = r.number, .raw = true},
                     "raw", text);
      DescribeAnswer(service, {.map_id = map.map_id, .revision = r.number},
                     "product", text);
      DescribeAnswer(service,
                     {.map_id = map.map_id, .revision = r.number, .depth = 2},
                     "level 2", text);
    }
    const auto uploads = service->ListUploads(map.map_id, {});
    EXPECT_TRUE(uploads.ok()) << uploads.status();
    for (const UploadInfo& upload : uploads->items) {
      absl::StrAppend(&text, " upload ", upload.spec.upload_id, " state ",
                      static_cast<int>(upload.state), " bytes ",
                      upload.committed_bytes, " of ",
                      upload.spec.expected_bytes, "\n");
    }
    const auto operations = service->ListOperations(map.map_id, {});
    EXPECT_TRUE(operations.ok()) << operations.status();
    for (const Operation& operation : operations->items) {
      absl::StrAppend(&text, " operation verb ",
                      static_cast<int>(operation.verb), " state ",
                      static_cast<int>(operation.state), "\n");
    }
  }
  return text;
}

/// Goes on with what the store holds unfinished, and tells all again.
std::string GoOn(Service& service) {
  const auto finalized = service.Finalize("yard", "staged");
  EXPECT_TRUE(finalized.ok() && finalized->error.ok());
  const auto processed = service.Process("yard");
  EXPECT_TRUE(processed.ok()) << processed.status();
  return Describe(service);
}

/// A store with a bit of everything.
void MakeStore(Service& service) {
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "empty"}));
  MAPSIEVE_ASSERT_OK(service->CreateMap({.map_id = "yard", .tile_edge = 32}));
  MAPSIEVE_ASSERT_OK(service.Upload("yard", "one", SmallScene(1)));
  MAPSIEVE_ASSERT_OK(
      service.Process("yard", SceneOptions(DensityRule::kPaper)));
  MAPSIEVE_ASSERT_OK(service.Upload("yard", "two", SmallScene(2)));
  MAPSIEVE_ASSERT_OK(service.Process("yard"));
  MAPSIEVE_ASSERT_OK(service.Delete("yard", Box{{-8, -8, -1}, {-2, -2, 1}}));
  MAPSIEVE_ASSERT_OK(
      service.Process("yard", SceneOptions(DensityRule::kQuota)));
  MAPSIEVE_ASSERT_OK(service->RollBack("yard", 5));
  MAPSIEVE_ASSERT_OK(
      service.Stage("yard", "staged", MakeUpload(SmallScene(3))));
  // Half of an upload.
  const std::vector<std::byte> bytes = MakeUpload(SmallScene(4));
  MAPSIEVE_ASSERT_OK(service->CreateUpload(
      "yard", {.upload_id = "half",
               .expected_bytes = static_cast<int64_t>(bytes.size()),
               .content_hash = ContentHash(bytes)}));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto writer,
                                service->OpenUploadWriter("yard", "half"));
  MAPSIEVE_ASSERT_OK(
      writer->Append(0, std::span(bytes).first(bytes.size() / 2)));
  MAPSIEVE_ASSERT_OK(writer->Commit());
}

std::string Expected(const std::string& told, const std::string& after) {
  return told + "After the upload \"staged\" and a run of the filter:\n" +
         after;
}

/// A service of the store that was left in `folder`.
void OpenGolden(const fs::path& folder, Service& service) {
  service.Close();
  fs::remove_all(service.options().data_dir);
  fs::copy(folder / "data", service.options().data_dir,
           fs::copy_options::recursive);
  service.Reopen();
}

// Version 3 kept no report for an upload that a rollback brings back.
TEST(GoldenStore, AnUploadOfItComesBackByARollback) {
  Service service(1);
  OpenGolden(fs::path(MAPSIEVE_GOLDEN_STORES) / "v3", service);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo two,
                                service->GetUpload("yard", "two"));
  MAPSIEVE_ASSERT_OK(service->RollBack("yard", 3));
  EXPECT_EQ(service->CreateUpload("yard", two.spec)->state,
            UploadState::kActive);
  MAPSIEVE_ASSERT_OK(service->RollBack("yard", 5));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const UploadInfo back,
                                service->CreateUpload("yard", two.spec));
  EXPECT_EQ(back.state, UploadState::kFinalized);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Operation told,
                                service.Finalize("yard", "two"));
  EXPECT_EQ(told.state, OperationState::kSucceeded);
}

TEST(GoldenStore, OfEveryVersionIsReadAsItWasWritten) {
  int version_count = 0;
  for (const auto& entry : fs::directory_iterator(MAPSIEVE_GOLDEN_STORES)) {
    if (!entry.is_directory()) continue;
    SCOPED_TRACE(entry.path().string());
    ++version_count;
    Service service(1);
    OpenGolden(entry.path(), service);
    const std::string told = Describe(service);
    EXPECT_EQ(Expected(told, GoOn(service)),
              storage::ReadWholeFile(entry.path() / "expected.txt"));
  }
  EXPECT_GT(version_count, 0);
}

// With MAPSIEVE_MAKE_GOLDEN=DIR it leaves the store and its description there.
TEST(GoldenStore, TellsTheSameAfterItWasCopied) {
  Service service(1);
  MakeStore(service);
  const std::string told = Describe(service);
  EXPECT_THAT(told, HasSubstr("kind 5 restores 5"));
  service.Close();

  Service copy(1);
  copy.Close();
  fs::remove_all(copy.options().data_dir);
  fs::copy(service.options().data_dir, copy.options().data_dir,
           fs::copy_options::recursive);
  copy.Reopen();
  EXPECT_EQ(Describe(copy), told);
  // What was staged comes in, half an upload does not.
  const std::string after = GoOn(copy);
  EXPECT_THAT(after, HasSubstr("upload staged state 2"));
  EXPECT_THAT(after, HasSubstr("upload half state 0"));
  if (const char* folder = std::getenv("MAPSIEVE_MAKE_GOLDEN")) {
    fs::create_directories(folder);
    fs::copy(service.options().data_dir, fs::path(folder) / "data",
             fs::copy_options::recursive);
    storage::WriteWholeFile(fs::path(folder) / "expected.txt",
                            Expected(told, after));
  }
}

}  // namespace
}  // namespace mapsieve::engine::testing
