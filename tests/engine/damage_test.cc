// A small data directory with one byte flipped or cut off, in every file: the
// service answers as before or tells what is damaged.

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/engine/engine_testing.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::engine::testing {
namespace {

using core::LatticeCloud;
using ::testing::AnyOf;
using ::testing::HasSubstr;
using ::testing::MatchesRegex;

// Of so many bytes of a file one is damaged, unless all are asked for.
constexpr size_t kBlobStride = 211;
constexpr size_t kCatalogueStride = 2003;

class DamageTest : public ::testing::Test {
 protected:
  void SetUp() override {
    scene_ = Split(MakeScene(61), 80)[0];
    MAPSIEVE_ASSERT_OK(service_->CreateMap({.map_id = "map", .tile_edge = 64}));
    MAPSIEVE_ASSERT_OK(service_.Upload("map", "one", scene_));
    MAPSIEVE_ASSERT_OK(service_.Process("map", options_));
    MAPSIEVE_ASSERT_OK(
        service_.Stage("map", "two", MakeUpload(Split(MakeScene(62), 80)[0])));
    product_ = *service_.Query({.map_id = "map"});
    raw_ = *service_.Query({.map_id = "map", .raw = true});
    service_.Close();
    for (const auto& entry :
         std::filesystem::recursive_directory_iterator(service_.path())) {
      if (entry.is_regular_file()) {
        files_[entry.path()] = storage::ReadWholeFile(entry.path());
      }
    }
    service_.Reopen();
    MAPSIEVE_ASSERT_OK(service_.Finalize("map", "two"));
    both_ = *service_.Query({.map_id = "map", .raw = true});
    service_.Close();
  }

  /// The files whose path has `part` in it.
  std::vector<std::string> PathsOf(const std::string& part) const {
    std::vector<std::string> paths;
    for (const auto& [path, bytes] : files_) {
      if (path.find(part) != std::string::npos) paths.push_back(path);
    }
    return paths;
  }

  /// Calls `check` with every file of `paths` damaged at every `stride`th byte,
  /// flipped and cut off there.
  template <typename Check>
  void ForEveryDamage(const std::vector<std::string>& paths, size_t stride,
                      const Check& check) {
    if (std::getenv("MAPSIEVE_EVERY_FAULT") != nullptr) stride = 1;
    for (const std::string& path : paths) {
      const std::string& whole = files_.at(path);
      for (size_t at = 0; at < whole.size(); at += stride) {
        for (const bool is_cut : {false, true}) {
          SCOPED_TRACE(
              absl::StrCat(path, is_cut ? " cut at " : " flipped at ", at));
          std::filesystem::remove_all(service_.options().data_dir);
          for (const auto& [name, bytes] : files_) {
            std::filesystem::create_directories(
                std::filesystem::path(name).parent_path());
            storage::WriteWholeFile(name, bytes);
          }
          std::string damaged = is_cut ? whole.substr(0, at) : whole;
          if (!is_cut) damaged[at] = static_cast<char>(damaged[at] ^ 0x10);
          storage::WriteWholeFile(path, damaged);
          check(path);
          service_.Close();
          if (HasFailure()) return;
        }
      }
    }
  }

  /// The answer is the expected one, or tells of damage of `what`.
  static void ExpectSameOrLoss(const absl::StatusOr<Answer>& answer,
                               const Answer& expected, const std::string& what,
                               int& loss_count) {
    if (answer.ok()) {
      ExpectSameCloud(answer->points, expected.points);
      return;
    }
    ++loss_count;
    EXPECT_THAT(answer.status(),
                mapsieve::testing::StatusIs(absl::StatusCode::kDataLoss,
                                            HasSubstr(what)));
  }

  Service service_{1};
  const core::SpdfOptions options_ = SceneOptions(core::DensityRule::kQuota);
  LatticeCloud scene_;
  Answer raw_;
  Answer product_;
  Answer both_;
  std::map<std::string, std::string> files_;
};

TEST_F(DamageTest, OfABlobIsDataLossThatNamesItsPlace) {
  const auto blobs = PathsOf("/blobs/");
  ASSERT_GE(blobs.size(), 3u);
  int loss_count = 0;
  ForEveryDamage(blobs, kBlobStride, [&](const std::string& path) {
    const std::string id = std::filesystem::path(path).filename();
    service_.Reopen();
    const int before = loss_count;
    for (const bool raw : {false, true}) {
      const auto answer = service_.Query({.map_id = "map", .raw = raw});
      ExpectSameOrLoss(answer, raw ? raw_ : product_, id, loss_count);
      if (answer.ok()) continue;
      EXPECT_THAT(
          std::string(answer.status().message()),
          MatchesRegex("map map, revision [23], tile [-0-9]+, "
                       "(raw|product) chunk [0-9]+: " +
                       path +
                       "(, bytes 0 to [0-9]+: expected content of hash " + id +
                       ", found [0-9a-f]+|: expected [0-9]+ bytes, found the "
                       "end of the file at offset [0-9]+)"));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(
          const Answer rest,
          service_.Query({.map_id = "map", .raw = raw, .allow_partial = true}));
      ASSERT_EQ(rest.summary.missing_chunks.size(), 1U);
      EXPECT_EQ(rest.summary.missing_chunks[0].blob_id, id);
      EXPECT_EQ(rest.summary.missing_chunks[0].problem,
                std::string(answer.status().message()));
    }
    EXPECT_LE(loss_count, before + 1);
  });
  EXPECT_GT(loss_count, 50);
}

TEST_F(DamageTest, OfAStagedUploadIsDataLossAndTheMapAsBefore) {
  const auto spools = PathsOf("/uploads/");
  ASSERT_EQ(spools.size(), 1u);
  int loss_count = 0;
  ForEveryDamage(spools, kBlobStride, [&](const std::string&) {
    service_.Reopen();
    const auto operation = service_.Finalize("map", "two");
    MAPSIEVE_ASSERT_OK(operation);
    EXPECT_THAT(operation->error,
                mapsieve::testing::StatusIs(
                    absl::StatusCode::kDataLoss,
                    AnyOf(HasSubstr("two"), HasSubstr("/uploads/"))));
    ++loss_count;
    const auto answer = service_.Query({.map_id = "map", .raw = true});
    MAPSIEVE_ASSERT_OK(answer);
    ExpectSameCloud(answer->points, raw_.points);
  });
  EXPECT_GT(loss_count, 30);
}

TEST_F(DamageTest, OfTheCatalogueIsDataLossOrNoMatter) {
  const auto catalogue = PathsOf("/catalogue.db");
  ASSERT_EQ(catalogue.size(), 1u);
  int loss_count = 0;
  ForEveryDamage(catalogue, kCatalogueStride, [&](const std::string& path) {
    const absl::Status status = service_.Open();
    if (!status.ok()) {
      ++loss_count;
      EXPECT_THAT(status, mapsieve::testing::StatusIs(
                              absl::StatusCode::kDataLoss, HasSubstr(path)));
      return;
    }
    for (const bool raw : {false, true}) {
      ExpectSameOrLoss(service_.Query({.map_id = "map", .raw = raw}),
                       raw ? raw_ : product_, path, loss_count);
    }
  });
  EXPECT_GT(loss_count, 10);
}

}  // namespace
}  // namespace mapsieve::engine::testing
