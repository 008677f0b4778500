#include "tests/engine/engine_testing.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <random>
#include <utility>

#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/points_codec.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/levels.h"
#include "gtest/gtest.h"
#include "server/engine/job_manager.h"
#include "server/engine/product_chunk.h"
#include "server/engine/region_query.h"
#include "tests/testing/clouds.h"

namespace mapsieve::engine::testing {

using core::Column;
using core::LatticeCloud;
using core::LatticePoint;
using core::ScalarType;

LatticeCloud MakeScene(uint32_t seed) {
  std::mt19937 random(seed);
  const auto uniform = [&](int64_t low, int64_t high) {
    return std::uniform_int_distribution<int64_t>(low, high)(random);
  };
  std::vector<LatticePoint> points;
  for (int i = 0; i < 9000; ++i) {  // Ground on both sides of a tile face.
    points.push_back(
        {uniform(-8000, 8000), uniform(-8000, 8000), uniform(-2, 1)});
  }
  for (int i = 0; i < 3000; ++i) {  // A wall along a tile face.
    points.push_back({uniform(-1, 0), uniform(-6000, 2000), uniform(0, 4000)});
  }
  for (int i = 0; i < 1000; ++i) {  // A pole.
    points.push_back(
        {4096 + uniform(-5, 5), 4096 + uniform(-5, 5), uniform(0, 5000)});
  }
  for (int i = 0; i < 2500; ++i) {  // Foliage.
    points.push_back(
        {uniform(-5500, -3500), uniform(3500, 5500), uniform(1000, 3000)});
  }
  for (int64_t x = -8192; x <= 8192; x += 1024) {  // Corners of tiles.
    for (int64_t y = -8192; y <= 8192; y += 1024) points.push_back({x, y, 0});
  }
  for (int i = 0; i < 20; ++i) {  // Alone.
    points.push_back(
        {uniform(-8000, 8000), uniform(-8000, 8000), uniform(20000, 90000)});
  }
  for (int i = 0; i < 400; ++i) {  // Several in one place.
    points.push_back(points[static_cast<size_t>(uniform(0, 9000))]);
  }
  LatticeCloud cloud;
  cloud.positions = std::move(points);
  Column intensity({"intensity", ScalarType::kUint16}, cloud.size());
  Column time({"time", ScalarType::kFloat64}, cloud.size());
  Column ring({"ring", ScalarType::kUint8}, cloud.size());
  Column label({"label", ScalarType::kInt32}, cloud.size());
  for (size_t i = 0; i < cloud.size(); ++i) {
    intensity.Set(i, static_cast<uint16_t>(uniform(0, 65535)));
    time.Set(i, static_cast<double>(i) * 1e-4);
    ring.Set(i, static_cast<uint8_t>(uniform(0, 63)));
    label.Set(i, static_cast<int32_t>(uniform(-5, 5)));
    if (i % 7 == 0) ring.SetMissing(i);
  }
  cloud.attributes.columns() = {intensity, time, ring, label};
  return mapsieve::testing::Shuffled(cloud, seed);
}

LatticeCloud WideScene(uint32_t seed, int column_count) {
  LatticeCloud cloud = MakeScene(seed);
  uint64_t state = 1;
  for (int c = 0; c < column_count; ++c) {
    core::Column column(
        {"wide-" + std::to_string(c), core::ScalarType::kUint64}, cloud.size());
    for (size_t i = 0; i < cloud.size(); ++i) {
      state = state * 6364136223846793005 + 1442695040888963407;
      column.Set(i, state ^ state >> 31);
    }
    cloud.attributes.columns().push_back(std::move(column));
  }
  return cloud;
}

core::SpdfOptions SceneOptions(core::DensityRule rule) {
  return {.neighbor_count = 20,
          .vote_scale_m2 = 0.08,
          .density_radius_m = 0.5,
          .rule = rule,
          .seed = 7,
          .outlier_share = 0.05};
}

std::vector<LatticeCloud> Split(const LatticeCloud& cloud, size_t count) {
  std::vector<LatticeCloud> parts;
  for (size_t part = 0; part < count; ++part) {
    const size_t begin = cloud.size() * part / count;
    const size_t end = cloud.size() * (part + 1) / count;
    std::vector<uint32_t> rows(end - begin);
    std::iota(rows.begin(), rows.end(), static_cast<uint32_t>(begin));
    parts.push_back(cloud.Select(rows));
  }
  return parts;
}

std::vector<std::byte> MakeUpload(const LatticeCloud& cloud,
                                  size_t block_points) {
  std::vector<std::byte> bytes;
  const size_t count = (cloud.size() + block_points - 1) / block_points;
  for (const LatticeCloud& part : Split(cloud, count)) {
    const auto block = core::EncodePoints(part);
    EXPECT_TRUE(block.ok()) << block.status();
    bytes.insert(bytes.end(), block->begin(), block->end());
  }
  return bytes;
}

LatticeCloud FilterLocally(const LatticeCloud& cloud,
                           const core::SpdfOptions& options, int depth) {
  const auto filtered = core::FilterCloud(cloud, options);
  EXPECT_TRUE(filtered.ok()) << filtered.status();
  const auto depths = core::ComputeDepths(
      cloud.Select(filtered->rows).positions, cloud.lattice, options);
  EXPECT_TRUE(depths.ok()) << depths.status();
  std::vector<uint32_t> order;
  std::vector<uint32_t> rows;
  for (const DepthRange& group : kDepthGroups) {
    for (const uint32_t i : filtered->Inliers(options.outlier_share)) {
      const int own = (*depths)[i];
      if (own < depth || own < group.min || own > group.max) continue;
      order.push_back(i);
      rows.push_back(filtered->rows[i]);
    }
  }
  return core::MakeLabeledCloud(cloud, rows, filtered->columns.Select(order));
}

absl::StatusOr<Answer> ReadAll(QueryCursor& cursor) {
  Answer answer;
  answer.header = cursor.header();
  answer.points.lattice = core::Lattice(answer.header.step_nm);
  for (const core::ColumnSpec& spec : answer.header.columns) {
    answer.points.attributes.columns().emplace_back(spec);
  }
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto block, cursor.NextBatch());
    if (!block.has_value()) break;
    EXPECT_LE(static_cast<int64_t>(block->size()), kMaxBatchBytes);
    ++answer.batch_count;
    MAPSIEVE_ASSIGN_OR_RETURN(const LatticeCloud batch,
                              core::DecodePoints(*block));
    EXPECT_GT(batch.size(), 0U);
    EXPECT_EQ(batch.lattice.step_nm(), answer.header.step_nm);
    const std::vector<core::ColumnSpec>& known = answer.header.columns;
    for (const core::ColumnSpec& column : batch.attributes.specs()) {
      EXPECT_TRUE(std::find(known.begin(), known.end(), column) != known.end())
          << column.name;
    }
    MAPSIEVE_RETURN_IF_ERROR(answer.points.attributes.AppendAll(
        answer.points.size(), batch.attributes, batch.size()));
    answer.points.positions.insert(answer.points.positions.end(),
                                   batch.positions.begin(),
                                   batch.positions.end());
  }
  answer.summary = cursor.summary();
  EXPECT_EQ(answer.summary.point_count,
            static_cast<int64_t>(answer.points.size()));
  EXPECT_LE(answer.summary.point_count, answer.header.candidate_point_count);
  return answer;
}

absl::StatusOr<Answer> ReadAll(
    absl::StatusOr<std::unique_ptr<QueryCursor>> cursor) {
  MAPSIEVE_RETURN_IF_ERROR(cursor.status());
  return ReadAll(**cursor);
}

absl::StatusOr<Batches> ReadBatches(
    absl::StatusOr<std::unique_ptr<QueryCursor>> cursor) {
  MAPSIEVE_RETURN_IF_ERROR(cursor.status());
  Batches result;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(auto block, (*cursor)->NextBatch());
    if (!block.has_value()) break;
    result.blocks.push_back(*std::move(block));
    result.tokens.push_back((*cursor)->resume_token());
  }
  result.summary = (*cursor)->summary();
  return result;
}

void ExpectSameCloud(const LatticeCloud& actual, const LatticeCloud& expected) {
  ASSERT_EQ(actual.size(), expected.size());
  EXPECT_EQ(actual.lattice, expected.lattice);
  EXPECT_TRUE(actual.positions == expected.positions);
  ASSERT_EQ(actual.attributes.columns().size(),
            expected.attributes.columns().size());
  for (const Column& want : expected.attributes.columns()) {
    const Column* have = actual.attributes.Find(want.name());
    ASSERT_NE(have, nullptr) << want.name();
    ASSERT_EQ(have->type(), want.type()) << want.name();
    for (size_t i = 0; i < want.size(); ++i) {
      ASSERT_EQ(have->IsMissing(i), want.IsMissing(i)) << want.name() << i;
    }
    EXPECT_TRUE(std::equal(have->bytes().begin(), have->bytes().end(),
                           want.bytes().begin(), want.bytes().end()))
        << want.name();
  }
}

LatticeCloud InCanonicalOrder(const LatticeCloud& cloud) {
  LatticeCloud sorted = cloud;
  sorted.attributes.SortByName();
  std::vector<std::pair<std::string, uint32_t>> keys;
  for (uint32_t row = 0; row < cloud.size(); ++row) {
    const LatticePoint& q = cloud.positions[row];
    std::string key = std::to_string(q.x) + "," + std::to_string(q.y) + "," +
                      std::to_string(q.z);
    for (const Column& column : sorted.attributes.columns()) {
      key += column.IsMissing(row) ? "|m" : "|p";
      key.append(reinterpret_cast<const char*>(column.bytes().data()) +
                     row * column.value_size(),
                 column.value_size());
    }
    keys.emplace_back(std::move(key), row);
  }
  std::sort(keys.begin(), keys.end());
  std::vector<uint32_t> rows;
  for (const auto& [key, row] : keys) rows.push_back(row);
  return sorted.Select(rows);
}

Workshop::Workshop(int tile_level, int worker_count, storage::StoreParts parts)
    : workers_(MakeWorkerPool(worker_count)) {
  auto store = storage::Store::Open(
      storage::PosixFileSystem(), dir_.path() + "/data", {}, std::move(parts));
  EXPECT_TRUE(store.ok()) << store.status();
  store_ = *std::move(store);
  const auto map =
      store_->catalogue().CreateMap({.id = "map", .tile_level = tile_level});
  EXPECT_TRUE(map.ok()) << map.status();
}

storage::MapRecord Workshop::map() {
  const auto map = store_->catalogue().GetMap("map");
  EXPECT_TRUE(map.ok()) << map.status();
  return *map;
}

absl::StatusOr<UploadReport> Workshop::Add(
    const LatticeCloud& cloud, const IngestLimits& limits,
    const std::optional<RegionShape>& region) {
  const std::vector<std::byte> bytes = MakeUpload(cloud);
  MAPSIEVE_ASSIGN_OR_RETURN(
      storage::UploadRecord upload,
      store_->catalogue().CreateUpload(
          map().uid, {.id = "upload-" + std::to_string(upload_count_++),
                      .expected_bytes = static_cast<int64_t>(bytes.size()),
                      .content_hash = ContentHash(bytes)}));
  {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto writer,
                              store_->uploads().OpenWriter(upload.uid));
    MAPSIEVE_RETURN_IF_ERROR(writer->Append(0, bytes));
    MAPSIEVE_RETURN_IF_ERROR(writer->Commit().status());
  }
  return AddUpload(*store_, "map", upload.uid, region, limits,
                   {.executor = workers_.get()});
}

absl::StatusOr<ProcessReport> Workshop::Process(
    const core::SpdfOptions& options, const ProcessLimits& limits,
    const ExecutionContext& context) {
  ExecutionContext own = context;
  own.executor = workers_.get();
  return ProcessStoredMap(*store_, "map", map().uid, options, limits, *workers_,
                          own);
}

absl::StatusOr<DeleteReport> Workshop::Delete(const RegionShape& region,
                                              const IngestLimits& limits,
                                              const ExecutionContext& context) {
  ExecutionContext own = context;
  own.executor = workers_.get();
  const storage::MapRecord now = map();
  return DeleteStoredRegion(*store_, "map",
                            {.verb = OperationVerb::kDeleteRegion,
                             .map_uid = now.uid,
                             .region = region,
                             .edit_uid = NewRandomId(),
                             .base_revision = now.newest_revision},
                            limits, own);
}

absl::StatusOr<Answer> Workshop::Query(QuerySpec spec) {
  spec.map_id = "map";
  return ReadAll(OpenQuery(*store_, memory_, spec, {}));
}

std::vector<storage::ChunkRef> Workshop::Chunks(storage::ChunkKind kind) {
  const auto snapshot = store_->OpenSnapshot("map");
  EXPECT_TRUE(snapshot.ok()) << snapshot.status();
  const auto chunks =
      (*snapshot)->ListChunks(kind, std::nullopt, std::nullopt, 100'000);
  EXPECT_TRUE(chunks.ok()) << chunks.status();
  return *chunks;
}

void Workshop::DamageBlob(const storage::BlobId& id) {
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(dir_.path())) {
    if (entry.path().filename().string().starts_with(id)) {
      std::string bytes = storage::ReadWholeFile(entry.path());
      bytes[bytes.size() / 2] ^= 1;
      storage::WriteWholeFile(entry.path(), bytes);
      return;
    }
  }
  ADD_FAILURE() << "no file of blob " << id;
}

Service::Service(int worker_count)
    : options_({.data_dir = dir_.path() + "/data",
                .memory_bytes = kMinMemoryBytes,
                .worker_count = worker_count}) {
  Reopen();
}

absl::Status Service::Open() {
  Close();
  MAPSIEVE_ASSIGN_OR_RETURN(engine_, Engine::Open(options_));
  return absl::OkStatus();
}

void Service::Reopen() {
  const absl::Status status = Open();
  EXPECT_TRUE(status.ok()) << status;
}

absl::Status Service::Stage(const std::string& map_id,
                            const std::string& upload_id,
                            std::span<const std::byte> bytes,
                            const core::RefusedCounts& refused,
                            const UploadSource& source) {
  MAPSIEVE_RETURN_IF_ERROR(
      engine_
          ->CreateUpload(map_id,
                         {.upload_id = upload_id,
                          .expected_bytes = static_cast<int64_t>(bytes.size()),
                          .content_hash = ContentHash(bytes),
                          .refused = refused,
                          .source = source})
          .status());
  MAPSIEVE_ASSIGN_OR_RETURN(const auto writer,
                            engine_->OpenUploadWriter(map_id, upload_id));
  MAPSIEVE_RETURN_IF_ERROR(writer->Append(0, bytes));
  return writer->Commit().status();
}

absl::StatusOr<Operation> Service::Finalize(
    const std::string& map_id, const std::string& upload_id,
    const std::optional<RegionShape>& region) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Operation operation,
                            engine_->FinalizeUpload(map_id, upload_id, region));
  return engine_->WaitOperation(operation.operation_id, absl::Minutes(2));
}

absl::StatusOr<Operation> Service::Upload(const std::string& map_id,
                                          const std::string& upload_id,
                                          const LatticeCloud& cloud) {
  MAPSIEVE_RETURN_IF_ERROR(Stage(map_id, upload_id, MakeUpload(cloud)));
  MAPSIEVE_ASSIGN_OR_RETURN(Operation operation, Finalize(map_id, upload_id));
  MAPSIEVE_RETURN_IF_ERROR(operation.error);
  return operation;
}

absl::StatusOr<Operation> Service::Process(
    const std::string& map_id,
    const std::optional<core::SpdfOptions>& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Operation started,
                            engine_->ProcessMap(map_id, options));
  MAPSIEVE_ASSIGN_OR_RETURN(
      Operation operation,
      engine_->WaitOperation(started.operation_id, absl::Minutes(2)));
  MAPSIEVE_RETURN_IF_ERROR(operation.error);
  return operation;
}

absl::StatusOr<Operation> Service::Delete(const std::string& map_id,
                                          const RegionShape& region) {
  MAPSIEVE_ASSIGN_OR_RETURN(const Operation started,
                            engine_->DeleteRegion(map_id, region));
  MAPSIEVE_ASSIGN_OR_RETURN(
      Operation operation,
      engine_->WaitOperation(started.operation_id, absl::Minutes(2)));
  MAPSIEVE_RETURN_IF_ERROR(operation.error);
  return operation;
}

absl::StatusOr<Answer> Service::Query(const QuerySpec& spec) {
  return ReadAll(engine_->Query(spec, {}));
}

}  // namespace mapsieve::engine::testing
