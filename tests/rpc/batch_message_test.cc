#include "server/rpc/batch_message.h"

#include <cstddef>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "mapsieve/v1/query_service.pb.h"

namespace mapsieve::rpc {
namespace {

std::string Joined(const grpc::ByteBuffer& bytes) {
  std::vector<grpc::Slice> slices;
  EXPECT_TRUE(bytes.Dump(&slices).ok());
  std::string joined;
  for (const grpc::Slice& slice : slices) {
    joined.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  }
  return joined;
}

TEST(MakeBatchMessage, IsWhatTheMessageSerializesTo) {
  for (const size_t size : {0, 1, 127, 128, 300'000}) {
    for (const std::string& token : {std::string(), std::string(200, 't')}) {
      const std::vector<std::vector<std::byte>> blocks = {
          std::vector(size, std::byte{1}), std::vector(5, std::byte{2})};
      v1::QueryRegionResponse expected;
      expected.mutable_batch()->set_block(std::string(size, '\1') +
                                          "\2\2\2\2\2");
      expected.mutable_batch()->set_resume_token(token);
      v1::QueryRegionResponse parsed;
      ASSERT_TRUE(
          parsed.ParseFromString(Joined(MakeBatchMessage(blocks, token))));
      EXPECT_EQ(parsed.SerializeAsString(), expected.SerializeAsString());
    }
  }
}

}  // namespace
}  // namespace mapsieve::rpc
