#ifndef MAPSIEVE_TESTS_RPC_SERVICE_FIXTURE_H_
#define MAPSIEVE_TESTS_RPC_SERVICE_FIXTURE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "gtest/gtest.h"
#include "server/server.h"
#include "spdlog/logger.h"
#include "tests/rpc/test_client.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::rpc {

// A server over a folder of its own, and a client of it.
class ServiceTest : public ::testing::Test {
 protected:
  void SetUp() override { StartServer(); }

  void StartServer() {
    auto server = Server::Start(Options(), logger_);
    MAPSIEVE_ASSERT_OK(server);
    server_ = *std::move(server);
    client_ = std::make_unique<TestClient>(server_->address().ToString());
  }

  ServerOptions Options() const {
    ServerOptions options;
    options.data_dir = folder_.path() + "/data";
    options.listen.port = 0;
    options.memory_bytes = int64_t{512} << 20;
    options.thread_count = 2;
    return options;
  }

  // An active upload of `bytes` to a new map.
  void StartUpload(std::span<const std::byte> bytes) {
    MAPSIEVE_ASSERT_OK(client_->CreateMap("campus"));
    MAPSIEVE_ASSERT_OK(client_->CreateUpload("campus", "u", bytes));
  }

  static constexpr char kUpload[] = "maps/campus/uploads/u";

  testing::TemporaryDirectory folder_;
  spdlog::logger logger_{"test"};
  std::unique_ptr<Server> server_;
  std::unique_ptr<TestClient> client_;
};

inline v1::QueryRegionRequest QueryOf(const std::string& map_id) {
  v1::QueryRegionRequest request;
  request.set_name("maps/" + map_id);
  return request;
}

inline std::vector<std::byte> SomeBytes(size_t size) {
  std::vector<std::byte> bytes(size);
  for (size_t i = 0; i < size; ++i) {
    bytes[i] = static_cast<std::byte>(i * 2654435761U >> 13);
  }
  return bytes;
}

}  // namespace mapsieve::rpc

#endif  // MAPSIEVE_TESTS_RPC_SERVICE_FIXTURE_H_
