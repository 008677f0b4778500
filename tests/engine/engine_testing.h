#ifndef MAPSIEVE_TESTS_ENGINE_ENGINE_TESTING_H_
#define MAPSIEVE_TESTS_ENGINE_ENGINE_TESTING_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/spdf_options.h"
#include "gtest/gtest.h"
#include "server/engine/edit_map.h"
#include "server/engine/engine.h"
#include "server/engine/ingest.h"
#include "server/engine/memory_pool.h"
#include "server/engine/process_map.h"
#include "server/engine/query.h"
#include "storage/store.h"
#include "tests/storage/storage_test_util.h"

namespace mapsieve::engine::testing {

/// About 16 000 points within 8 m of the origin on a 1 mm lattice: ground lying
/// on the face z = 0 of tiles of every level, a wall, a pole, a volume, points
/// on corners of tiles, several points in one place. Attributes: intensity
/// (uint16), time (float64), ring (uint8, missing at times), label (int32, a
/// name that the filter uses too).
core::LatticeCloud MakeScene(uint32_t seed);

/// MakeScene with attributes of random bits, so that few points make a block.
core::LatticeCloud WideScene(uint32_t seed, int column_count);

/// Options under which the filter drops many points of MakeScene and keeps
/// many.
core::SpdfOptions SceneOptions(core::DensityRule rule);

/// `count` parts of `cloud` in its order.
std::vector<core::LatticeCloud> Split(const core::LatticeCloud& cloud,
                                      size_t count);

/// `cloud` as the bytes of an upload: blocks of at most `block_points`.
std::vector<std::byte> MakeUpload(const core::LatticeCloud& cloud,
                                  size_t block_points = 3000);

/// For uploads of MakeScene, in several chunks a tile.
inline constexpr IngestLimits kSmallChunks = {.block_bytes = 1 << 26,
                                              .bucket_bytes = 1 << 28,
                                              .chunk_bytes = 50'000,
                                              .chunk_count = 100'000};

/// What the service answers to a query of the whole map, in its order: the
/// filter and the levels of detail in memory.
core::LatticeCloud FilterLocally(const core::LatticeCloud& cloud,
                                 const core::SpdfOptions& options,
                                 int depth = 0);

/// An answer, its batches put together.
struct Answer {
  QueryHeader header;
  core::LatticeCloud points;
  QuerySummary summary;
  int batch_count = 0;
};
absl::StatusOr<Answer> ReadAll(QueryCursor& cursor);
absl::StatusOr<Answer> ReadAll(
    absl::StatusOr<std::unique_ptr<QueryCursor>> cursor);

/// An answer batch by batch, with the resume token of each.
struct Batches {
  std::vector<std::vector<std::byte>> blocks;
  std::vector<std::string> tokens;
  QuerySummary summary;
};
absl::StatusOr<Batches> ReadBatches(
    absl::StatusOr<std::unique_ptr<QueryCursor>> cursor);

/// Fails the test where the clouds differ: points in order, columns by name.
void ExpectSameCloud(const core::LatticeCloud& actual,
                     const core::LatticeCloud& expected);

/// `cloud` in an order that depends on the set of its points alone.
core::LatticeCloud InCanonicalOrder(const core::LatticeCloud& cloud);

/// The parts of the engine over a store, where tests choose limits that no
/// EngineOptions gives. Map "map". What `parts` lacks is on the disk.
class Workshop {
 public:
  explicit Workshop(int tile_level, int worker_count = 1,
                    storage::StoreParts parts = {});

  storage::Store& store() { return *store_; }
  const std::string& path() const { return dir_.path(); }
  storage::MapRecord map();
  /// Stages and adds one upload.
  absl::StatusOr<UploadReport> Add(
      const core::LatticeCloud& cloud, const IngestLimits& limits,
      const std::optional<RegionShape>& region = std::nullopt);
  absl::StatusOr<DeleteReport> Delete(const RegionShape& region,
                                      const IngestLimits& limits,
                                      const ExecutionContext& context = {});
  absl::StatusOr<ProcessReport> Process(const core::SpdfOptions& options,
                                        const ProcessLimits& limits,
                                        const ExecutionContext& context = {});
  absl::StatusOr<Answer> Query(QuerySpec spec);
  /// All chunks of the newest revision.
  std::vector<storage::ChunkRef> Chunks(storage::ChunkKind kind);
  /// Flips a bit in the middle of a blob's file.
  void DamageBlob(const storage::BlobId& id);

 private:
  storage::TemporaryDirectory dir_;
  std::unique_ptr<Executor> workers_;
  std::unique_ptr<storage::Store> store_;
  MemoryPool memory_{int64_t{1} << 30};
  int upload_count_ = 0;
};

/// Asks for a stop once `visits` units of work are done.
class StopAfter final : public ProgressSink {
 public:
  explicit StopAfter(int64_t visits) : visits_(visits) {}
  void Report(int64_t done, int64_t total) override {
    EXPECT_GE(done, done_);
    EXPECT_LE(done, total);
    done_ = done;
    if (done >= visits_) stop_.request_stop();
  }
  ExecutionContext Context() {
    return {.stop = stop_.get_token(), .progress = this};
  }
  bool is_asked() const { return stop_.stop_requested(); }

 private:
  const int64_t visits_;
  int64_t done_ = 0;
  std::stop_source stop_;
};

/// An engine in a directory of its own, and the steps of a client.
class Service {
 public:
  explicit Service(int worker_count = 2);

  Engine& operator*() { return *engine_; }
  Engine* operator->() { return engine_.get(); }
  const std::string& path() const { return dir_.path(); }
  EngineOptions& options() { return options_; }
  const EngineOptions& options() const { return options_; }
  /// Closes the engine, if it is open, and opens it.
  absl::Status Open();
  /// Open, which succeeds.
  void Reopen();
  void Close() { engine_.reset(); }

  /// Opens an upload and writes and commits its bytes.
  absl::Status Stage(const std::string& map_id, const std::string& upload_id,
                     std::span<const std::byte> bytes,
                     const core::RefusedCounts& refused = {},
                     const UploadSource& source = {});
  /// Stage and finalize, to the end of the operation.
  absl::StatusOr<Operation> Upload(const std::string& map_id,
                                   const std::string& upload_id,
                                   const core::LatticeCloud& cloud);
  absl::StatusOr<Operation> Finalize(
      const std::string& map_id, const std::string& upload_id,
      const std::optional<RegionShape>& region = std::nullopt);
  absl::StatusOr<Operation> Process(
      const std::string& map_id,
      const std::optional<core::SpdfOptions>& options = std::nullopt);
  /// Deletes a region, to the end of the operation.
  absl::StatusOr<Operation> Delete(const std::string& map_id,
                                   const RegionShape& region);
  absl::StatusOr<Answer> Query(const QuerySpec& spec);

 private:
  storage::TemporaryDirectory dir_;
  EngineOptions options_;
  std::unique_ptr<Engine> engine_;
};

}  // namespace mapsieve::engine::testing

#endif  // MAPSIEVE_TESTS_ENGINE_ENGINE_TESTING_H_
