#include "server/engine/query.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/time/clock.h"
#include "client/api/map_client.h"
#include "core/base/bytes.h"
#include "core/cloud/packed_columns.h"
#include "core/codec/points_codec.h"
#include "gtest/gtest.h"
#include "server/engine/region.h"
#include "spdlog/sinks/base_sink.h"
#include "tests/rpc/service_fixture.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::rpc {
namespace {

using ::mapsieve::testing::StatusIs;
using ::testing::HasSubstr;

using Code = absl::StatusCode;

// Counts the calls of QueryRegion that ended, from the server's log.
class EndedQueries final : public spdlog::sinks::base_sink<std::mutex> {
 public:
  int count() const { return count_; }

 private:
  void sink_it_(const spdlog::details::log_msg& message) override {
    const std::string_view text(message.payload.data(), message.payload.size());
    if (text.find("QueryRegion") != std::string_view::npos) ++count_;
  }
  void flush_() override {}

  std::atomic<int> count_ = 0;
};

class QueryServiceTest : public ServiceTest {
 protected:
  void SetUp() override {
    logger_.set_level(spdlog::level::debug);
    logger_.sinks().push_back(ended_);
    StartServer();
  }

  // A processed map "campus".
  void MakeCampus(int point_count) {
    MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
    MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(point_count)));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto run, client_->Process("campus"));
    MAPSIEVE_ASSERT_OK(client_->Wait(run.name()));
  }

  std::shared_ptr<EndedQueries> ended_ = std::make_shared<EndedQueries>();
};

// All messages of a call.
std::vector<v1::SyncRegionResponse> Sync(TestClient& client,
                                         const v1::SyncRegionRequest& request) {
  std::vector<v1::SyncRegionResponse> responses;
  const auto context = client.NewContext();
  const auto stream = client.queries->SyncRegion(context.get(), request);
  for (v1::SyncRegionResponse response; stream->Read(&response);) {
    responses.push_back(response);
  }
  MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
  return responses;
}

// Appends what a stream still gives to `got`.
void AppendRest(client::QueryStream& stream, core::LatticeCloud& got) {
  while (true) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto batch, stream.Next());
    if (batch.size() == 0) return;
    MAPSIEVE_ASSERT_OK(
        got.attributes.AppendAll(got.size(), batch.attributes, batch.size()));
    got.positions.insert(got.positions.end(), batch.positions.begin(),
                         batch.positions.end());
  }
}

TEST_F(QueryServiceTest, AnswersWaitForTheMemoryOfOthers) {
  server_.reset();
  ServerOptions options = Options();
  options.memory_bytes = int64_t{256} << 20;
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_, Server::Start(options, logger_));
  client_ = std::make_unique<TestClient>(server_->address().ToString());
  MAPSIEVE_ASSERT_OK(client_->CreateMap("waiting"));
  MAPSIEVE_ASSERT_OK(client_->Upload("waiting", "u", TestScene(60'000)));
  v1::QueryRegionRequest request = QueryOf("waiting");
  request.set_raw(true);
  request.set_plain_blocks(true);
  // Each takes some MB of the 64 MiB for answers, and keeps it until its client
  // reads.
  constexpr int kAnswers = 60;
  std::vector<std::unique_ptr<grpc::ClientContext>> contexts;
  std::vector<std::unique_ptr<grpc::ClientReader<v1::QueryRegionResponse>>>
      streams;
  for (int i = 0; i < kAnswers; ++i) {
    contexts.push_back(client_->NewContext());
    streams.push_back(
        client_->queries->QueryRegion(contexts.back().get(), request));
  }
  for (const auto& stream : streams) {
    v1::QueryRegionResponse response;
    while (stream->Read(&response)) {
    }
    EXPECT_EQ(response.summary().point_count(), 60'000);
    MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
  }
}

TEST_F(QueryServiceTest, WhoHoldsEveryChunkGetsOneShortMessage) {
  MakeCampus(20'000);
  v1::SyncRegionRequest request;
  request.mutable_query()->set_name("maps/campus");
  const auto whole = Sync(*client_, request);
  ASSERT_GE(whole.size(), 3U);
  EXPECT_TRUE(whole.front().has_header());
  const v1::SyncSummary& summary = whole.back().summary();
  int64_t chunk_count = 0;
  for (const v1::SyncRegionResponse& response : whole) {
    if (!response.part().is_last()) continue;
    ++chunk_count;
    request.add_held_chunk_ids(response.part().chunk_id());
  }
  EXPECT_EQ(summary.chunk_count(), chunk_count);
  EXPECT_EQ(summary.sent_chunk_count(), chunk_count);

  auto again = Sync(*client_, request);
  ASSERT_EQ(again.size(), 1U);
  EXPECT_LT(again[0].ByteSizeLong(), 1000U);
  EXPECT_EQ(again[0].summary().chunk_count(), chunk_count);
  EXPECT_EQ(again[0].summary().sent_chunk_count(), 0);
  EXPECT_EQ(again[0].summary().dropped_chunk_ids_size(), 0);

  // Ids that are none of the region's are named, each once.
  request.add_held_chunk_ids("stale");
  request.add_held_chunk_ids("stale");
  again = Sync(*client_, request);
  ASSERT_EQ(again.size(), 1U);
  ASSERT_EQ(again[0].summary().dropped_chunk_ids_size(), 1);
  EXPECT_EQ(again[0].summary().dropped_chunk_ids(0), "stale");

  // Another query has other chunks.
  request.mutable_query()->add_labels(v1::LABEL_SURFACE);
  again = Sync(*client_, request);
  EXPECT_EQ(again.back().summary().sent_chunk_count(), chunk_count);
  EXPECT_EQ(again.back().summary().dropped_chunk_ids_size(), chunk_count + 1);
}

TEST_F(QueryServiceTest, EveryRegionTravelsFromTheClientToTheEngine) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(20'000)));
  client::MapClient client(server_->address().ToString());
  client::QuerySpec spec = {.map_id = "campus", .raw = true};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto all, client.QueryAll(spec));
  const client::Quaternion turn = {0, 0, 0.6, 0.8};
  const std::pair<client::QueryRegion, engine::QueryShape> regions[] = {
      {client::BoxRegion{{-3, -2, 0}, {3, 2, 1}},
       engine::Box{{-3, -2, 0}, {3, 2, 1}}},
      {client::SphereRegion{{1, 0, 0}, 3}, engine::Sphere{{1, 0, 0}, 3}},
      {client::OrientedBoxRegion{{1, 0, 0}, turn, {4, 1, 2}},
       engine::OrientedBox{{1, 0, 0}, {0, 0, 0.6, 0.8}, {4, 1, 2}}},
      {client::CylinderRegion{1, 2, 3, -1, 2},
       engine::VerticalCylinder{1, 2, 3, -1, 2}},
      {client::CylinderRegion{.center_x = 1, .radius = 3},
       engine::VerticalCylinder{.center_x = 1, .radius = 3}},
      {client::PolygonRegion{{{-3, -3}, {3, -2}, {0, 4}}, -1, 1.5},
       engine::PolygonPrism{{{-3, -3}, {3, -2}, {0, 4}}, -1, 1.5}},
      {client::FrustumRegion{
           {-5, 0, 1}, {-0.5, 0.5, -0.5, 0.5}, 0.6, 0.4, 0.5, 9},
       engine::Frustum{{-5, 0, 1}, {-0.5, 0.5, -0.5, 0.5}, 0.6, 0.4, 0.5, 9}},
      {client::CorridorRegion{{{-5, 0, 0}, {0, 0, 0}, {0, 5, 1}}, 1.2},
       engine::Corridor{{{-5, 0, 0}, {0, 0, 0}, {0, 5, 1}}, 1.2}}};
  for (const auto& [asked, shape] : regions) {
    SCOPED_TRACE(shape.index());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const engine::Region region,
                                  engine::Region::Make(shape, all.lattice));
    std::vector<uint32_t> rows;
    for (uint32_t row = 0; row < all.size(); ++row) {
      if (region.Contains(all.positions[row])) rows.push_back(row);
    }
    ASSERT_GT(rows.size(), 50U);
    ASSERT_LT(rows.size(), all.size());
    spec.region = asked;
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto answer, client.QueryAll(spec));
    EXPECT_TRUE(answer.positions == all.Select(rows).positions);
  }
}

TEST_F(QueryServiceTest, FiltersBudgetsAndColumnsTravelFromTheClient) {
  MakeCampus(20'000);
  client::MapClient client(server_->address().ToString());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto all,
                                client.QueryAll({.map_id = "campus"}));
  double largest = 0;
  for (size_t i = 0; i < all.size(); ++i) {
    largest =
        std::max(largest, all.attributes.Find("confidence")->GetAsDouble(i));
  }
  const double least = 0.2 * largest;
  const double most = 0.9 * largest;
  client::QuerySpec spec = {
      .map_id = "campus",
      .confidence = client::ValueRange{.min = least, .max = most},
      .attribute_ranges = {{"intensity", {.max = 30'000}}},
      .max_point_count = 60,
      .max_bytes = 1 << 20,
      .label_weights = client::LabelWeights{1, 1, 4},
      .columns = client::ColumnSelection{
          .filter_columns = {client::FilterColumn::kLabel,
                             client::FilterColumn::kConfidence,
                             client::FilterColumn::kSaliencies,
                             client::FilterColumn::kCovariance},
          .all_attributes = true}};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto stream, client.Query(spec));
  int64_t count = 0;
  while (true) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto batch, stream->Next());
    if (batch.size() == 0) break;
    for (size_t i = 0; i < batch.size(); ++i) {
      const auto value = [&](const char* name) {
        return batch.attributes.Find(name)->GetAsDouble(i);
      };
      EXPECT_GE(value("confidence"), least);
      EXPECT_LE(value("confidence"), most);
      EXPECT_LE(value("intensity"), 30'000);
      EXPECT_NEAR(value("confidence"),
                  std::max({value("saliency_surface"), value("saliency_curve"),
                            value("saliency_junction")}),
                  2e-5);
      EXPECT_GE(value("cov_xx") + value("cov_yy") + value("cov_zz"), 1);
    }
    count += static_cast<int64_t>(batch.size());
  }
  const client::QuerySummary& summary = stream->summary();
  EXPECT_EQ(count, 60);
  EXPECT_EQ(summary.point_count, 60);
  EXPECT_GT(summary.block_bytes, 60);
  EXPECT_LE(summary.block_bytes, 1 << 20);
  EXPECT_GT(summary.available_point_count, 60);
  int64_t available = 0;
  for (const int64_t n : summary.available_label_counts) available += n;
  EXPECT_EQ(available, summary.available_point_count);
  const auto share = [&](size_t label, int64_t weight) {
    return std::min(summary.available_label_counts[label], 10 * weight);
  };
  EXPECT_GE(summary.label_counts[1], share(1, 1));
  EXPECT_GE(summary.label_counts[2], share(2, 1));
  EXPECT_GE(summary.label_counts[3], share(3, 4));
}

TEST_F(QueryServiceTest, AWrongFieldIsNamedInTheDetails) {
  MakeCampus(2000);
  const auto field_of = [&](const v1::QueryRegionRequest& request) {
    const auto context = client_->NewContext();
    const auto stream = client_->queries->QueryRegion(context.get(), request);
    for (v1::QueryRegionResponse response; stream->Read(&response);) {
    }
    const grpc::Status status = stream->Finish();
    EXPECT_EQ(status.error_code(), grpc::StatusCode::INVALID_ARGUMENT)
        << status.error_message();
    v1::RpcStatus details;
    EXPECT_TRUE(details.ParseFromString(status.error_details()));
    v1::ErrorInfo info;
    if (details.details_size() == 1) details.details(0).UnpackTo(&info);
    EXPECT_EQ(info.reason(), "INVALID_FIELD");
    return info.metadata().at("field");
  };
  v1::QueryRegionRequest request = QueryOf("campus");
  request.mutable_frustum();
  EXPECT_EQ(field_of(request), "frustum.position");
  request.mutable_frustum()->mutable_position();
  EXPECT_EQ(field_of(request), "frustum.orientation");
  request.mutable_frustum()->mutable_orientation();
  EXPECT_EQ(field_of(request), "frustum.orientation");
  request.mutable_oriented_box()->mutable_center();
  EXPECT_EQ(field_of(request), "oriented_box.orientation");
  request.mutable_polygon();
  EXPECT_EQ(field_of(request), "polygon.vertices");
  request.mutable_corridor()->set_radius(1);
  EXPECT_EQ(field_of(request), "corridor.path");
  request.mutable_cylinder();
  EXPECT_EQ(field_of(request), "cylinder.radius");
  request = QueryOf("campus");
  request.add_attribute_ranges();
  EXPECT_EQ(field_of(request), "attribute_ranges[0].range");
  request.mutable_attribute_ranges(0)->mutable_range();
  request.mutable_attribute_ranges(0)->set_name("gps");
  EXPECT_EQ(field_of(request), "attribute_ranges[0].name");
  request = QueryOf("campus");
  request.set_max_bytes(3);
  EXPECT_EQ(field_of(request), "max_bytes");
  request = QueryOf("campus");
  request.set_resume_token("x");
  EXPECT_EQ(field_of(request), "resume_token");
}

TEST_F(QueryServiceTest, ATokenFitsItsOwnRequestAlone) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(20'000)));
  v1::QueryRegionRequest request = QueryOf("campus");
  request.set_raw(true);
  const auto context = client_->NewContext();
  const auto stream = client_->queries->QueryRegion(context.get(), request);
  v1::QueryRegionResponse response;
  ASSERT_TRUE(stream->Read(&response));
  ASSERT_TRUE(stream->Read(&response));
  const std::string token = response.batch().resume_token();
  EXPECT_GT(token.size(), 8U);
  context->TryCancel();
  for (v1::QueryRegionResponse rest; stream->Read(&rest);) {
  }
  stream->Finish();

  request.set_resume_token(token);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer rest, client_->Query(request));
  EXPECT_EQ(rest.summary.point_count(), 20'000);
  EXPECT_LT(rest.cloud.size(), 20'000U);
  // The revision stays, whatever comes after.
  const int64_t revision = rest.header.revision();
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "v", TestScene(500)));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer later, client_->Query(request));
  EXPECT_EQ(later.header.revision(), revision);
  EXPECT_TRUE(later.cloud.positions == rest.cloud.positions);

  request.mutable_sphere()->mutable_center();
  request.mutable_sphere()->set_radius(1);
  EXPECT_THAT(client_->Query(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("another query")));
  // Another map, of the same name too.
  MAPSIEVE_ASSERT_OK(client_->CreateMap("other"));
  MAPSIEVE_ASSERT_OK(client_->Upload("other", "u", TestScene(20'000)));
  request = QueryOf("other");
  request.set_raw(true);
  request.set_resume_token(token);
  EXPECT_THAT(client_->Query(request),
              StatusIs(Code::kInvalidArgument, HasSubstr("another query")));
}

TEST_F(QueryServiceTest, TheClientGoesOnWhenTheServerComesBack) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(300'000)));
  client::MapClient client(server_->address().ToString());
  // Far more than the connection holds.
  const client::QuerySpec spec = {
      .map_id = "campus", .raw = true, .plain_blocks = true};
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto whole, client.QueryAll(spec));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto stream, client.Query(spec));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(core::LatticeCloud got, stream->Next());

  ServerOptions options = Options();
  options.listen.port = server_->address().port;
  server_->Shutdown(absl::ZeroDuration());
  server_.reset();
  const int before = ended_->count();
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(server_, Server::Start(options, logger_));
  AppendRest(*stream, got);
  EXPECT_TRUE(got.positions == whole.positions);
  EXPECT_EQ(got.attributes, whole.attributes);
  EXPECT_EQ(stream->summary().point_count, 300'000);
  // The new server gave the rest.
  EXPECT_EQ(ended_->count(), before + 1);
}

TEST_F(QueryServiceTest, BlocksTravelTogetherAndATokenIsBehindThemAll) {
  MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
  MAPSIEVE_ASSERT_OK(client_->Upload("campus", "u", TestScene(200'000)));
  v1::QueryRegionRequest request;
  request.set_name("maps/campus");
  request.set_raw(true);
  const auto read = [&] {
    std::vector<v1::PointBatch> batches;
    const auto context = client_->NewContext();
    const auto stream = client_->queries->QueryRegion(context.get(), request);
    for (v1::QueryRegionResponse response; stream->Read(&response);) {
      if (response.has_batch()) batches.push_back(response.batch());
    }
    MAPSIEVE_EXPECT_OK(FromGrpc(stream->Finish()));
    return batches;
  };
  const std::vector<v1::PointBatch> batches = read();
  ASSERT_GE(batches.size(), 3u);
  size_t most = 0;
  size_t largest = 0;
  for (const v1::PointBatch& batch : batches) {
    // Of a batch stored chunks leave room for one that waits.
    EXPECT_LE(batch.block().size(), engine::kMaxBatchBytes / 8 * 7);
    largest = std::max(largest, batch.block().size());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto blocks,
                                  core::SplitBlocks(TextBytes(batch.block())));
    most = std::max(most, blocks.size());
  }
  EXPECT_GT(most, 1u);
  EXPECT_GT(largest, engine::kMaxBatchBytes / 2);
  // The first points do not wait for others.
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto first, core::SplitBlocks(TextBytes(batches.front().block())));
  EXPECT_EQ(first.size(), 1u);

  std::string whole;
  for (const v1::PointBatch& batch : batches) whole += batch.block();
  std::string begun;
  for (const v1::PointBatch& batch : batches) {
    begun += batch.block();
    request.set_resume_token(batch.resume_token());
    std::string resumed = begun;
    for (const v1::PointBatch& rest : read()) resumed += rest.block();
    EXPECT_TRUE(resumed == whole);
  }

  request.clear_resume_token();
  request.set_plain_blocks(true);
  for (const v1::PointBatch& batch : read()) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const auto blocks,
                                  core::SplitBlocks(TextBytes(batch.block())));
    EXPECT_EQ(blocks.size(), 1u);
  }
}

TEST_F(QueryServiceTest, PackedColumnsAreThePlainOnesInFewerBytes) {
  MakeCampus(20'000);
  v1::QueryRegionRequest request;
  request.set_name("maps/campus");
  for (const v1::FilterColumn column :
       {v1::FILTER_COLUMN_LABEL, v1::FILTER_COLUMN_CONFIDENCE,
        v1::FILTER_COLUMN_NORMAL, v1::FILTER_COLUMN_TANGENT,
        v1::FILTER_COLUMN_COVARIANCE}) {
    request.mutable_columns()->add_filter_columns(column);
  }
  request.mutable_columns()->set_all_attributes(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer plain, client_->Query(request));
  request.set_packed_columns(true);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Answer packed, client_->Query(request));
  EXPECT_LT(packed.summary.block_bytes(), plain.summary.block_bytes() * 3 / 4);
  EXPECT_TRUE(packed.cloud.positions == plain.cloud.positions);
  std::vector<core::Column> unpacked;
  for (const core::Column& column : packed.cloud.attributes.columns()) {
    core::Unpack(column, unpacked);
  }
  EXPECT_EQ(unpacked, plain.cloud.attributes.columns());

  // What the client library asks for, and gives.
  client::MapClient client(server_->address().ToString());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const auto stream,
      client.Query({.map_id = "campus",
                    .columns = client::ColumnSelection{
                        .filter_columns = {client::FilterColumn::kLabel,
                                           client::FilterColumn::kConfidence,
                                           client::FilterColumn::kNormal,
                                           client::FilterColumn::kTangent,
                                           client::FilterColumn::kCovariance},
                        .all_attributes = true}}));
  std::vector<core::ColumnSpec> specs;
  for (const core::Column& column : plain.cloud.attributes.columns()) {
    specs.push_back(column.spec());
  }
  EXPECT_EQ(stream->header().columns, specs);
  core::LatticeCloud got;
  AppendRest(*stream, got);
  EXPECT_TRUE(got.positions == plain.cloud.positions);
  EXPECT_EQ(got.attributes, plain.cloud.attributes);
  EXPECT_EQ(stream->summary().block_bytes, packed.summary.block_bytes());
}

// The work of the largest query, cancelled at many moments.
TEST_F(QueryServiceTest, TheServerStopsSoonAfterTheClientLeaves) {
  MakeCampus(60'000);
  v1::QueryRegionRequest request = QueryOf("campus");
  request.set_max_bytes(100'000);
  absl::Duration longest;
  for (int i = 0; i < 40; ++i) {
    const int before = ended_->count();
    grpc::ClientContext context;
    const bool by_deadline = i % 2 == 0;
    absl::Time end = absl::Now() + absl::Milliseconds(100 + 2 * i);
    if (by_deadline) context.set_deadline(absl::ToChronoTime(end));
    const auto stream = client_->queries->QueryRegion(&context, request);
    // The header tells that the call has come to the server.
    v1::QueryRegionResponse header;
    if (!stream->Read(&header)) {
      stream->Finish();
      continue;
    }
    if (!by_deadline) end = absl::Now() + absl::Milliseconds(2 * i);
    absl::SleepFor(end - absl::Now());
    if (!by_deadline) context.TryCancel();
    while (ended_->count() == before) absl::SleepFor(absl::Microseconds(100));
    longest = std::max(longest, absl::Now() - end);
    for (v1::QueryRegionResponse response; stream->Read(&response);) {
    }
    stream->Finish();
  }
  RecordProperty("longest_ms",
                 static_cast<int>(absl::ToInt64Milliseconds(longest)));
  // 50 ms on a machine that does nothing else.
  EXPECT_LT(longest, absl::Milliseconds(500));
}

}  // namespace
}  // namespace mapsieve::rpc
