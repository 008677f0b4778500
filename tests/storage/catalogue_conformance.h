#ifndef MAPSIEVE_TESTS_STORAGE_CATALOGUE_CONFORMANCE_H_
#define MAPSIEVE_TESTS_STORAGE_CATALOGUE_CONFORMANCE_H_

#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "storage/catalogue.h"
#include "tests/storage/storage_test_util.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::storage {

/// An implementation of Catalogue under test.
struct CatalogueImplementation {
  std::string name;
  /// Opens the catalogue that lives in a directory, or makes it.
  std::function<absl::StatusOr<std::unique_ptr<Catalogue>>(const std::string&)>
      open;
  /// Whether it is there again when it was closed.
  bool lasts = true;
};

/// What every implementation of Catalogue does: catalogue_test.cc instantiates
/// the tests of all files of this fixture.
class CatalogueTest : public ::testing::TestWithParam<CatalogueImplementation> {
 protected:
  void SetUp() override { Reopen(); }

  void Reopen() {
    if (catalogue_ != nullptr && !GetParam().lasts) return;
    catalogue_.reset();
    auto opened = GetParam().open(directory_.path());
    ASSERT_THAT(opened, testing::IsOk());
    catalogue_ = *std::move(opened);
  }
  MapRecord MakeMap(const std::string& id) {
    const auto map = catalogue_->CreateMap(TestMap(id));
    EXPECT_THAT(map, testing::IsOk());
    return map.value_or(MapRecord());
  }
  RevisionRecord Commit(const MapRecord& map, int64_t parent,
                        const RevisionChange& change) {
    const auto revision = catalogue_->CommitRevision(map.uid, parent, change);
    EXPECT_THAT(revision, testing::IsOk());
    return revision.value_or(RevisionRecord());
  }
  std::vector<ChunkRef> Chunks(
      const MapRecord& map, int64_t revision, ChunkKind kind = ChunkKind::kRaw,
      const std::optional<core::LatticeBox>& region = std::nullopt) {
    const auto chunks = catalogue_->ListChunks(map.uid, revision, kind, region,
                                               std::nullopt, 1'000'000);
    EXPECT_THAT(chunks, testing::IsOk());
    return chunks.value_or(std::vector<ChunkRef>());
  }
  /// What ForgetExpired gives until nothing is left.
  std::vector<BlobId> ForgetAll(const MapRecord& map,
                                const std::set<int64_t>& pinned) {
    std::vector<BlobId> all;
    while (true) {
      const auto blobs = catalogue_->ForgetExpired(map.uid, pinned);
      EXPECT_THAT(blobs, testing::IsOk());
      if (!blobs.ok() || blobs->empty()) return all;
      all.insert(all.end(), blobs->begin(), blobs->end());
    }
  }
  UploadRecord MakeUpload(const MapRecord& map, const std::string& id) {
    const auto upload = catalogue_->CreateUpload(map.uid, {.id = id});
    EXPECT_THAT(upload, testing::IsOk());
    return upload.value_or(UploadRecord());
  }
  /// Commits `change` as what the points of an active upload bring.
  void Finalize(const MapRecord& map, int64_t parent,
                const UploadRecord& upload, RevisionChange change = {}) {
    EXPECT_THAT(catalogue_->SetUploadState(upload.uid, UploadState::kActive,
                                           UploadState::kFinalizing, ""),
                testing::IsOk());
    change.finalized_upload_uid = upload.uid;
    Commit(map, parent, change);
  }

  TemporaryDirectory directory_;
  std::unique_ptr<Catalogue> catalogue_;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_TESTS_STORAGE_CATALOGUE_CONFORMANCE_H_
