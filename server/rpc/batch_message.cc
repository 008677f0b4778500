#include "server/rpc/batch_message.h"

#include <cstdint>
#include <memory>
#include <utility>

#include "google/protobuf/io/coded_stream.h"
#include "google/protobuf/io/zero_copy_stream_impl_lite.h"
#include "google/protobuf/wire_format_lite.h"
#include "grpcpp/support/slice.h"
#include "mapsieve/v1/query_service.pb.h"

namespace mapsieve::rpc {
namespace {

using google::protobuf::internal::WireFormatLite;

/// Tag and length of a field of `size` bytes.
std::string FieldHead(int number, size_t size) {
  std::string bytes;
  google::protobuf::io::StringOutputStream stream(&bytes);
  google::protobuf::io::CodedOutputStream out(&stream);
  out.WriteTag(WireFormatLite::MakeTag(
      number, WireFormatLite::WIRETYPE_LENGTH_DELIMITED));
  out.WriteVarint64(size);
  return bytes;
}

grpc::Slice SliceOf(std::vector<std::byte> block) {
  auto owner = std::make_unique<std::vector<std::byte>>(std::move(block));
  void* const data = owner->data();
  const size_t size = owner->size();
  return {data, size,
          [](void* held) { delete static_cast<std::vector<std::byte>*>(held); },
          owner.release()};
}

}  // namespace

grpc::ByteBuffer MakeBatchMessage(std::vector<std::vector<std::byte>> blocks,
                                  const std::string& resume_token) {
  size_t block_bytes = 0;
  for (const auto& block : blocks) block_bytes += block.size();
  const std::string block_head =
      FieldHead(v1::PointBatch::kBlockFieldNumber, block_bytes);
  const std::string token =
      FieldHead(v1::PointBatch::kResumeTokenFieldNumber, resume_token.size()) +
      resume_token;
  const std::string batch_head =
      FieldHead(v1::QueryRegionResponse::kBatchFieldNumber,
                block_head.size() + block_bytes + token.size());
  std::vector<grpc::Slice> slices;
  slices.emplace_back(batch_head + block_head);
  for (auto& block : blocks) slices.push_back(SliceOf(std::move(block)));
  slices.emplace_back(token);
  return {slices.data(), slices.size()};
}

}  // namespace mapsieve::rpc
