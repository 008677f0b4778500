// Prints, as markdown, how a running server answers queries of one map, beside
// what gRPC itself does on this machine in the same run.
//   query_bench HOST:PORT MAP [--rounds N] [--clients N] [--seconds S]
//               [--process PID]
// A child process streams messages of 1 MB of nothing by gRPC: the yardstick.
// Whole answers are read as bytes, by the same code as the yardstick's, and by
// the client library, which decodes them. PID is the server's, for its memory.
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <memory>
#include <random>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/api/map_client.h"
#include "core/base/heap.h"
#include "grpcpp/create_channel.h"
#include "grpcpp/generic/generic_stub.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/security/server_credentials.h"
#include "grpcpp/server.h"
#include "grpcpp/server_builder.h"
#include "mapsieve/v1/map_service.grpc.pb.h"
#include "mapsieve/v1/query_service.grpc.pb.h"
#include "tests/bench/bench_util.h"

namespace mapsieve::bench {
namespace {

constexpr char kQueryMethod[] = "/mapsieve.v1.QueryService/QueryRegion";
constexpr size_t kYardstickMessageBytes = 1'000'000;

struct BenchOptions {
  std::string server;
  std::string map_id;
  int rounds = 5;
  int clients = 64;
  double seconds = 20;
  int server_process = 0;
};

// Streams as many bytes as the request says, in equal messages.
class ByteStream final
    : public grpc::ServerWriteReactor<v1::QueryRegionResponse> {
 public:
  explicit ByteStream(int64_t bytes)
      : left_(bytes / static_cast<int64_t>(kYardstickMessageBytes)),
        block_(kYardstickMessageBytes, 'x') {
    Advance();
  }
  void OnWriteDone(bool ok) override {
    if (!ok) left_ = 0;
    Advance();
  }
  void OnDone() override { delete this; }

 private:
  void Advance() {
    if (left_-- > 0) {
      message_.mutable_batch()->set_block(block_);
      StartWrite(&message_);
    } else {
      Finish(grpc::Status::OK);
    }
  }

  int64_t left_;
  const std::string block_;
  v1::QueryRegionResponse message_;
};

class YardstickService final : public v1::QueryService::CallbackService {
 public:
  grpc::ServerWriteReactor<v1::QueryRegionResponse>* QueryRegion(
      grpc::CallbackServerContext* /*context*/,
      const v1::QueryRegionRequest* request) override {
    return new ByteStream(request->max_bytes());
  }
};

// A server in a process of its own.
class Yardstick {
 public:
  Yardstick() {
    int ends[2];
    if (pipe(ends) != 0) Fail("pipe");
    child_ = fork();
    if (child_ == 0) Serve(ends[1]);
    close(ends[1]);
    int port = 0;
    if (read(ends[0], &port, sizeof(port)) != sizeof(port)) Fail("read");
    close(ends[0]);
    address_ = absl::StrCat("127.0.0.1:", port);
  }
  ~Yardstick() {
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
  }
  Yardstick(const Yardstick&) = delete;
  Yardstick& operator=(const Yardstick&) = delete;

  const std::string& address() const { return address_; }

 private:
  [[noreturn]] static void Serve(int end) {
    YardstickService service;
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(),
                             &port);
    builder.RegisterService(&service);
    const std::unique_ptr<grpc::Server> server = builder.BuildAndStart();
    if (write(end, &port, sizeof(port)) != sizeof(port)) std::exit(1);
    server->Wait();
    std::exit(0);
  }

  pid_t child_ = 0;
  std::string address_;
};

/// With a connection of its own.
std::shared_ptr<grpc::Channel> Connect(const std::string& address) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(),
                                   arguments);
}

void Wait(grpc::CompletionQueue& queue, bool& ok) {
  void* tag = nullptr;
  if (!queue.Next(&tag, &ok)) Fail("the queue of calls has ended");
}

/// Bytes of all messages of an answer, none of which is looked into.
int64_t ReadAsBytes(const std::shared_ptr<grpc::Channel>& channel,
                    const v1::QueryRegionRequest& request) {
  grpc::ByteBuffer sent;
  bool own = false;
  grpc::SerializationTraits<v1::QueryRegionRequest>::Serialize(request, &sent,
                                                               &own);
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  grpc::CompletionQueue queue;
  const auto call = stub.PrepareCall(&context, kQueryMethod, &queue);
  bool ok = false;
  call->StartCall(nullptr);
  Wait(queue, ok);
  call->WriteLast(sent, grpc::WriteOptions(), nullptr);
  Wait(queue, ok);
  int64_t bytes = 0;
  while (true) {
    grpc::ByteBuffer message;
    call->Read(&message, nullptr);
    Wait(queue, ok);
    if (!ok) break;
    bytes += static_cast<int64_t>(message.Length());
  }
  grpc::Status status;
  call->Finish(&status, nullptr);
  Wait(queue, ok);
  if (!status.ok()) Fail(status.error_message());
  return bytes;
}

/// Points of an answer that the client library decodes.
int64_t ReadAsPoints(client::MapClient& client,
                     const client::QuerySpec& query) {
  const auto stream = ValueOrDie(client.Query(query));
  int64_t count = 0;
  while (true) {
    const core::LatticeCloud batch = ValueOrDie(stream->Next());
    if (batch.size() == 0) return count;
    count += static_cast<int64_t>(batch.size());
  }
}

// Whole answers by turns with the yardstick.
void PrintStreams(const BenchOptions& options, const std::string& yardstick) {
  using client::FilterColumn;
  struct Row {
    std::string name;
    client::ColumnSelection columns;
    bool raw = false;
  };
  const std::vector<Row> rows = {
      {"position, label", {.filter_columns = {FilterColumn::kLabel}}},
      {"position, label, confidence, normal",
       {.filter_columns = {FilterColumn::kLabel, FilterColumn::kConfidence,
                           FilterColumn::kNormal}}},
      {"these and the attributes",
       {.filter_columns = {FilterColumn::kLabel, FilterColumn::kConfidence,
                           FilterColumn::kNormal},
        .all_attributes = true}},
      {"raw points, attributes", {.all_attributes = true}, true},
  };
  std::printf(
      "| columns | blocks | bytes a point | MB/s | of a byte stream | "
      "M points/s | decoded, M points/s |\n|---|---|--:|--:|--:|--:|--:|\n");
  const auto channel = Connect(options.server);
  const auto bare = Connect(yardstick);
  client::MapClient client(options.server);
  for (const bool plain : {false, true}) {
    for (const Row& row : rows) {
      v1::QueryRegionRequest request;
      request.set_name("maps/" + options.map_id);
      request.set_plain_blocks(plain);
      // As the client library asks.
      request.set_packed_columns(true);
      request.set_raw(row.raw);
      v1::ColumnSelection& columns = *request.mutable_columns();
      for (const FilterColumn column : row.columns.filter_columns) {
        columns.add_filter_columns(static_cast<v1::FilterColumn>(column));
      }
      columns.set_all_attributes(row.columns.all_attributes);
      const client::QuerySpec query = {.map_id = options.map_id,
                                       .columns = row.columns,
                                       .raw = row.raw,
                                       .plain_blocks = plain};
      int64_t bytes = 0;
      int64_t points = 0;
      std::vector<double> stream_s, bare_s, decoded_s;
      for (int round = 0; round < options.rounds; ++round) {
        stream_s.push_back(
            Seconds([&] { bytes = ReadAsBytes(channel, request); }));
        v1::QueryRegionRequest as_many;
        as_many.set_max_bytes(bytes);
        bare_s.push_back(Seconds([&] { ReadAsBytes(bare, as_many); }));
        decoded_s.push_back(
            Seconds([&] { points = ReadAsPoints(client, query); }));
      }
      const auto b = static_cast<double>(bytes);
      const auto p = static_cast<double>(points);
      std::printf("| %s | %s | %.1f | %.0f | %.2f | %.1f | %.1f |\n",
                  row.name.c_str(), plain ? "plain" : "coded", b / p,
                  b / Median(stream_s) / 1e6, Median(bare_s) / Median(stream_s),
                  p / Median(stream_s) / 1e6, p / Median(decoded_s) / 1e6);
    }
  }
}

/// Median milliseconds of `work`.
double Milliseconds(int repeats, const std::function<void()>& work) {
  std::vector<double> seconds;
  for (int i = 0; i < repeats; ++i) seconds.push_back(Seconds(work));
  return Median(seconds) * 1e3;
}

/// Points of the map, as centres of queries.
std::vector<core::LatticePoint> Places(client::MapClient& client,
                                       const BenchOptions& options) {
  const core::LatticeCloud cloud =
      ValueOrDie(client.QueryAll({.map_id = options.map_id, .depth = 6}));
  if (cloud.size() == 0) Fail("the map has no processed points");
  return cloud.positions;
}

/// A sphere around a point of the map.
void SetSphere(const core::LatticePoint& center, int64_t step_nm, double radius,
               v1::QueryRegionRequest& request) {
  const core::Point3 at = core::Lattice(step_nm).Position(center);
  v1::Sphere& sphere = *request.mutable_sphere();
  sphere.mutable_center()->set_x(at.x);
  sphere.mutable_center()->set_y(at.y);
  sphere.mutable_center()->set_z(at.z);
  sphere.set_radius(radius);
}

// How long the first points of a region of 80 m take, beside an empty call.
void PrintFirstBatch(const BenchOptions& options,
                     const std::vector<core::LatticePoint>& places,
                     int64_t step_nm) {
  const auto channel = Connect(options.server);
  const auto maps = v1::MapService::NewStub(channel);
  const auto queries = v1::QueryService::NewStub(channel);
  const double call_ms = Milliseconds(201, [&] {
    grpc::ClientContext context;
    v1::ListMapsResponse response;
    v1::ListMapsRequest request;
    request.set_page_size(1);
    if (!maps->ListMaps(&context, request, &response).ok()) Fail("ListMaps");
  });
  std::printf("\n| first batch of 80 m | ms |\n|---|--:|\n");
  std::printf("| an empty call | %.2f |\n", call_ms);
  for (const int64_t budget : {0, 30'000}) {
    size_t next = 0;
    const double first_ms = Milliseconds(51, [&] {
      grpc::ClientContext context;
      v1::QueryRegionRequest request;
      request.set_name("maps/" + options.map_id);
      request.set_max_point_count(budget);
      SetSphere(places[next++ % 10], step_nm, 80, request);
      const auto stream = queries->QueryRegion(&context, request);
      v1::QueryRegionResponse response;
      while (stream->Read(&response)) {
        if (response.has_batch()) break;
      }
      if (!response.has_batch()) Fail(stream->Finish().error_message());
      context.TryCancel();
    });
    std::printf("| %s | %.2f |\n",
                budget == 0 ? "all points" : "at most 30 000 points", first_ms);
  }
}

/// One of the questions that robots ask.
v1::QueryRegionRequest RandomQuery(const BenchOptions& options,
                                   const core::LatticePoint& place,
                                   int64_t step_nm, std::mt19937& random) {
  v1::QueryRegionRequest request;
  request.set_name("maps/" + options.map_id);
  switch (random() % 5) {
    case 0:
      SetSphere(place, step_nm, 80, request);
      request.set_max_point_count(30'000);
      break;
    case 1:
      SetSphere(place, step_nm, 30, request);
      request.add_labels(v1::LABEL_CURVE);
      request.add_labels(v1::LABEL_JUNCTION);
      break;
    case 2:
      SetSphere(place, step_nm, 20, request);
      request.mutable_columns()->add_filter_columns(
          v1::FILTER_COLUMN_COVARIANCE);
      break;
    case 3:
      SetSphere(place, step_nm, 150, request);
      request.set_depth(4);
      break;
    default:
      SetSphere(place, step_nm, 40, request);
      request.set_max_bytes(200'000);
  }
  return request;
}

/// The largest resident set of a process so far, in MiB.
double PeakMib(int process) {
  std::ifstream file(absl::StrCat("/proc/", process, "/status"));
  std::string word;
  while (file >> word) {
    double kib = 0;
    if (word == "VmHWM:" && file >> kib) return kib / 1024;
  }
  return 0;
}

// Many clients, each with a connection of its own, one question after another.
void PrintClients(const BenchOptions& options,
                  const std::vector<core::LatticePoint>& places,
                  int64_t step_nm) {
  std::vector<std::vector<double>> latencies(
      static_cast<size_t>(options.clients));
  std::atomic<int64_t> points = 0;
  std::atomic<int> errors = 0;
  std::vector<std::thread> threads;
  const auto end = std::chrono::steady_clock::now() +
                   std::chrono::duration<double>(options.seconds);
  for (size_t c = 0; c < latencies.size(); ++c) {
    threads.emplace_back([&, c] {
      std::mt19937 random(static_cast<uint32_t>(c));
      const auto queries = v1::QueryService::NewStub(Connect(options.server));
      while (std::chrono::steady_clock::now() < end) {
        const v1::QueryRegionRequest request = RandomQuery(
            options, places[random() % places.size()], step_nm, random);
        latencies[c].push_back(Seconds([&] {
          grpc::ClientContext context;
          const auto stream = queries->QueryRegion(&context, request);
          v1::QueryRegionResponse response;
          while (stream->Read(&response)) {
            points += response.summary().point_count();
          }
          const grpc::Status status = stream->Finish();
          if (status.ok()) return;
          if (errors++ == 0)
            std::printf("%s\n", status.error_message().c_str());
        }));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  std::vector<double> all;
  for (const auto& of_client : latencies) {
    all.insert(all.end(), of_client.begin(), of_client.end());
  }
  std::sort(all.begin(), all.end());
  std::printf("\n| %d clients | |\n|---|--:|\n", options.clients);
  std::printf("| answers, failed | %zu, %d |\n", all.size(), errors.load());
  std::printf("| answers/s, M points/s | %.0f, %.1f |\n",
              static_cast<double>(all.size()) / options.seconds,
              static_cast<double>(points) / options.seconds / 1e6);
  std::printf("| p50, p99, longest | %.2f s, %.2f s, %.2f s |\n",
              all[all.size() / 2], all[all.size() * 99 / 100], all.back());
  if (options.server_process > 0) {
    std::printf("| server's peak memory | %.0f MiB |\n",
                PeakMib(options.server_process));
  }
}

}  // namespace

int Main(const BenchOptions& options) {
  // As the programs do: without it fresh pages cost a client more than what it
  // reads, now and then.
  ReturnFreedBlocks();
  // Before gRPC starts a thread here.
  const Yardstick yardstick;
  client::MapClient client(options.server);
  const int64_t step_nm = ValueOrDie(client.GetMap(options.map_id)).step_nm;
  const std::vector<core::LatticePoint> places = Places(client, options);
  PrintStreams(options, yardstick.address());
  PrintFirstBatch(options, places, step_nm);
  PrintClients(options, places, step_nm);
  return 0;
}

}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  constexpr char kUsage[] =
      "usage: query_bench HOST:PORT MAP [--rounds N] [--clients N] "
      "[--seconds S] [--process PID]";
  if (argc < 3 || argc % 2 == 0) mapsieve::bench::Fail(kUsage);
  mapsieve::bench::BenchOptions options;
  options.server = argv[1];
  options.map_id = argv[2];
  for (int i = 3; i < argc; i += 2) {
    const std::string_view name = argv[i];
    const int value = std::atoi(argv[i + 1]);
    if (value <= 0) mapsieve::bench::Fail(kUsage);
    if (name == "--rounds") {
      options.rounds = value;
    } else if (name == "--clients") {
      options.clients = value;
    } else if (name == "--seconds") {
      options.seconds = value;
    } else if (name == "--process") {
      options.server_process = value;
    } else {
      mapsieve::bench::Fail(kUsage);
    }
  }
  return mapsieve::bench::Main(options);
}
