#include "server/engine/resume_token.h"

#include <cstddef>
#include <span>

#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "server/engine/field_error.h"

namespace mapsieve::engine {
namespace {

constexpr uint32_t kMagic = 0x3152534D;  // "MSR1"
constexpr size_t kTokenBytes = 4 + 6 * 8;

}  // namespace

std::string WriteResumeToken(const ResumePoint& point) {
  ByteWriter writer;
  writer.Put(kMagic);
  writer.Put(point.key);
  writer.Put(point.revision);
  writer.Put(point.point_count);
  writer.Put(point.block_bytes);
  writer.Put(point.missing_chunk_count);
  writer.Put(Hash64(writer.bytes()));
  return {reinterpret_cast<const char*>(writer.bytes().data()), writer.size()};
}

absl::StatusOr<ResumePoint> ReadResumeToken(const std::string& token,
                                            uint64_t key) {
  constexpr char kField[] = "resume_token";
  const std::span<const std::byte> bytes = TextBytes(token);
  constexpr size_t kContentBytes = kTokenBytes - sizeof(uint64_t);
  if (bytes.size() != kTokenBytes ||
      LoadLittleEndian<uint32_t>(bytes.data()) != kMagic ||
      LoadLittleEndian<uint64_t>(bytes.data() + kContentBytes) !=
          Hash64(bytes.first(kContentBytes))) {
    return FieldError(kField,
                      "not what a batch gave; send one unchanged, or none");
  }
  const auto field = [&]<typename T>(T& value, size_t index) {
    value = LoadLittleEndian<T>(bytes.data() + sizeof(kMagic) + 8 * index);
  };
  ResumePoint point;
  field(point.key, 0);
  field(point.revision, 1);
  field(point.point_count, 2);
  field(point.block_bytes, 3);
  field(point.missing_chunk_count, 4);
  if (point.key != key || point.revision <= 0) {
    return FieldError(kField,
                      "it belongs to another query or map; repeat all other "
                      "fields of the query that gave it");
  }
  return point;
}

}  // namespace mapsieve::engine
