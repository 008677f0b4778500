#include "core/codec/block_head.h"

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_format.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/codec/compression.h"

namespace mapsieve::core {
namespace {

constexpr uint32_t kMagic = 0x4250534d;  // "MSPB"
constexpr uint16_t kVersion = 2;
// Bytes of the fields before the column entries, of an entry without its name
// and of the checksum that ends the head.
constexpr uint32_t kFixedBytes = 104;
constexpr uint32_t kEntryBytes = 22;
constexpr uint32_t kChecksumBytes = 8;
constexpr uint32_t kMinHeadBytes = kFixedBytes + kEntryBytes + kChecksumBytes;
constexpr uint32_t kMaxHeadBytes =
    kFixedBytes + kChecksumBytes +
    static_cast<uint32_t>(kMaxBlockColumns) *
        (kEntryBytes + static_cast<uint32_t>(kMaxColumnNameBytes));
constexpr uint64_t kMaxBlockBytes = uint64_t{1} << 32;
constexpr uint8_t kMissingFlag = 1;

absl::Status RangeError(absl::string_view what, int64_t least, int64_t most,
                        int64_t actual) {
  return absl::DataLossError(absl::StrCat("point block, ", what, ": expected ",
                                          least, " to ", most, ", have ",
                                          actual));
}

absl::Status CheckRange(absl::string_view what, int64_t least, int64_t most,
                        int64_t actual) {
  if (least <= actual && actual <= most) return absl::OkStatus();
  return RangeError(what, least, most, actual);
}

void PutPoint(ByteWriter& writer, const LatticePoint& q) {
  writer.Put(q.x);
  writer.Put(q.y);
  writer.Put(q.z);
}

absl::StatusOr<LatticePoint> TakePoint(ByteReader& reader, const char* field) {
  LatticePoint q;
  for (int64_t* v : {&q.x, &q.y, &q.z}) {
    MAPSIEVE_ASSIGN_OR_RETURN(*v, reader.Take<int64_t>(field));
    // The corner may lie on the limit itself: that is where a cell begins.
    MAPSIEVE_RETURN_IF_ERROR(
        CheckRange(absl::StrCat(field, " before offset ", reader.offset()),
                   -kLatticeLimit, kLatticeLimit - 1, *v));
  }
  return q;
}

absl::Status CheckBounds(const BlockHead& head) {
  if (head.point_count == 0) {
    if (head.min == LatticePoint{} && head.max == LatticePoint{}) {
      return absl::OkStatus();
    }
    return absl::DataLossError(
        "point block, min and max: expected zeros in an "
        "empty block");
  }
  for (const auto axis :
       {&LatticePoint::x, &LatticePoint::y, &LatticePoint::z}) {
    MAPSIEVE_RETURN_IF_ERROR(CheckRange("min", 1 - kLatticeLimit,
                                        kLatticeLimit - 1, head.min.*axis));
    MAPSIEVE_RETURN_IF_ERROR(
        CheckRange("max", head.min.*axis, kLatticeLimit - 1, head.max.*axis));
  }
  return absl::OkStatus();
}

/// The largest number of a transform in blocks of `version`.
Transform LastTransform(uint16_t version) {
  return version == 1 ? Transform::kAscendingPacked : kTransforms.back();
}

absl::Status CheckEntry(const ColumnEntry& entry, uint16_t version,
                        uint32_t point_count) {
  const size_t width = ScalarSize(entry.spec.type);
  if (width == 0) {
    return absl::DataLossError(absl::StrCat("expected a type of 1 to 10, have ",
                                            static_cast<int>(entry.spec.type)));
  }
  if (entry.transform > LastTransform(version)) {
    return absl::DataLossError(
        absl::StrCat("expected a transform of 0 to ",
                     static_cast<int>(LastTransform(version)), " in version ",
                     version, ", have ", static_cast<int>(entry.transform)));
  }
  if (!SuitsWidth(entry.transform, width)) {
    return absl::DataLossError(
        absl::StrCat("expected a type of at least 2 bytes for transform ",
                     static_cast<int>(entry.transform)));
  }
  if (CompressionName(entry.compression).empty()) {
    return absl::DataLossError(
        absl::StrCat("expected a compression of 0 to 2, have ",
                     static_cast<int>(entry.compression)));
  }
  const uint64_t bitmap =
      entry.has_missing ? MissingBitmapBytes(point_count) : 0;
  const CodedSizeRange values = CodedSizes(entry.transform, point_count, width);
  if (entry.coded_bytes < bitmap + values.min ||
      entry.coded_bytes > bitmap + values.max) {
    return absl::DataLossError(
        absl::StrCat(point_count, " values of ", width, " bytes: expected ",
                     bitmap + values.min, " to ", bitmap + values.max,
                     " bytes before compression, have ", entry.coded_bytes));
  }
  const bool compressed = entry.compression != Compression::kNone;
  if (compressed ? entry.stored_bytes >= entry.coded_bytes
                 : entry.stored_bytes != entry.coded_bytes) {
    return absl::DataLossError(absl::StrCat(
        "expected ", compressed ? "less than " : "", entry.coded_bytes,
        " stored bytes, have ", entry.stored_bytes,
        compressed ? "; store what does not get smaller uncompressed" : ""));
  }
  return absl::OkStatus();
}

absl::StatusOr<ColumnEntry> TakeEntry(ByteReader& reader, uint16_t version,
                                      uint32_t point_count) {
  ColumnEntry entry;
  MAPSIEVE_ASSIGN_OR_RETURN(entry.spec.type, reader.Take<ScalarType>("type"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.transform,
                            reader.Take<Transform>("transform"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.compression,
                            reader.Take<Compression>("compression"));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto flags, reader.Take<uint8_t>("flags"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.coded_bytes,
                            reader.Take<uint32_t>("coded bytes"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.stored_bytes,
                            reader.Take<uint32_t>("stored bytes"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.checksum,
                            reader.Take<uint64_t>("column checksum"));
  MAPSIEVE_ASSIGN_OR_RETURN(entry.spec.name,
                            reader.TakeShortText("column name"));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange(
      "length of a column name", 1, static_cast<int64_t>(kMaxColumnNameBytes),
      static_cast<int64_t>(entry.spec.name.size())));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("flags", 0, kMissingFlag, flags));
  entry.has_missing = flags == kMissingFlag;
  const absl::Status status = CheckEntry(entry, version, point_count);
  if (!status.ok()) {
    return Annotate(status, absl::StrCat("point block, column ",
                                         QuotedName(entry.spec.name)));
  }
  return entry;
}

absl::Status CheckPositionColumns(const std::vector<ColumnEntry>& columns) {
  const auto is = [&](size_t i, std::string_view name, ScalarType type) {
    return i < columns.size() && columns[i].spec.name == name &&
           columns[i].spec.type == type && !columns[i].has_missing;
  };
  if (is(0, kMortonName, ScalarType::kUint64)) return absl::OkStatus();
  for (const ScalarType type : {ScalarType::kInt32, ScalarType::kInt64}) {
    if (is(0, kAxisNames[0], type) && is(1, kAxisNames[1], type) &&
        is(2, kAxisNames[2], type)) {
      return absl::OkStatus();
    }
  }
  return absl::DataLossError(
      "point block: expected to begin with the columns x, y, z (all int32 or "
      "all int64) or morton (uint64), none with missing values");
}

absl::Status CheckNamesDiffer(std::span<const ColumnEntry> attributes) {
  std::vector<std::string_view> names;
  names.reserve(attributes.size());
  for (const ColumnEntry& entry : attributes) names.push_back(entry.spec.name);
  std::sort(names.begin(), names.end());
  const auto twice = std::adjacent_find(names.begin(), names.end());
  if (twice == names.end()) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("point block: two attributes are named ",
                   QuotedName(std::string(*twice))));
}

absl::Status CheckLengths(const BlockHead& head) {
  uint64_t sum = head.head_bytes;
  for (const ColumnEntry& entry : head.columns) sum += entry.stored_bytes;
  if (sum == head.block_bytes) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrCat("point block: expected ", head.block_bytes,
                   " bytes, head and columns have ", sum));
}

}  // namespace

PointBounds BoundsOf(std::span<const LatticePoint> positions) {
  if (positions.empty()) return {};
  PointBounds bounds{positions.front(), positions.front()};
  for (const LatticePoint& q : positions) {
    bounds.min = {std::min(bounds.min.x, q.x), std::min(bounds.min.y, q.y),
                  std::min(bounds.min.z, q.z)};
    bounds.max = {std::max(bounds.max.x, q.x), std::max(bounds.max.y, q.y),
                  std::max(bounds.max.z, q.z)};
  }
  return bounds;
}

int64_t DecodedBytes(uint64_t point_count, std::span<const ColumnSpec> specs,
                     size_t columns_with_missing) {
  uint64_t bytes_per_point = sizeof(LatticePoint) + columns_with_missing;
  for (const ColumnSpec& spec : specs) bytes_per_point += ScalarSize(spec.type);
  return static_cast<int64_t>(point_count * bytes_per_point);
}

std::string QuotedName(const std::string& name) {
  return absl::StrCat("\"", absl::CEscape(name), "\"");
}

std::vector<std::byte> FormatBlockHead(const BlockHead& head) {
  size_t head_bytes = kFixedBytes + kChecksumBytes;
  uint64_t block_bytes = 0;
  for (const ColumnEntry& entry : head.columns) {
    head_bytes += kEntryBytes + entry.spec.name.size();
    block_bytes += entry.stored_bytes;
  }
  block_bytes += head_bytes;

  ByteWriter writer;
  writer.bytes().reserve(head_bytes);
  writer.Put(kMagic);
  writer.Put(kVersion);
  writer.Put(static_cast<uint16_t>(head.columns.size()));
  writer.Put(block_bytes);
  writer.Put(static_cast<uint32_t>(head_bytes));
  writer.Put(head.point_count);
  writer.Put(head.step_nm);
  PutPoint(writer, head.corner);
  PutPoint(writer, head.min);
  PutPoint(writer, head.max);
  for (const ColumnEntry& entry : head.columns) {
    writer.Put(entry.spec.type);
    writer.Put(entry.transform);
    writer.Put(entry.compression);
    writer.Put(entry.has_missing ? kMissingFlag : uint8_t{0});
    writer.Put(entry.coded_bytes);
    writer.Put(entry.stored_bytes);
    writer.Put(entry.checksum);
    writer.PutShortText(entry.spec.name);
  }
  writer.Put(Hash64(writer.bytes()));
  return std::move(writer.bytes());
}

absl::StatusOr<int64_t> ReadBlockLength(std::span<const std::byte> prefix) {
  ByteReader reader(prefix);
  MAPSIEVE_ASSIGN_OR_RETURN(const auto magic, reader.Take<uint32_t>("magic"));
  if (magic != kMagic) {
    return absl::DataLossError(absl::StrFormat(
        "point block, offset 0: expected the magic bytes MSPB (%08x), have "
        "%08x",
        kMagic, magic));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto version,
                            reader.Take<uint16_t>("version"));
  if (version < 1 || version > kVersion) {
    return absl::DataLossError(
        absl::StrCat("point block, offset 4: expected version 1 to ", kVersion,
                     ", have ", version, "; a newer mapsieve may read it"));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto columns,
                            reader.Take<uint16_t>("column count"));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange(
      "offset 6, columns", 1, static_cast<int64_t>(kMaxBlockColumns), columns));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto bytes,
                            reader.Take<uint64_t>("block bytes"));
  if (bytes < kMinHeadBytes || bytes > kMaxBlockBytes) {
    return absl::DataLossError(
        absl::StrCat("point block, offset 8, bytes of the block: expected ",
                     kMinHeadBytes, " to ", kMaxBlockBytes, ", have ", bytes));
  }
  return static_cast<int64_t>(bytes);
}

absl::StatusOr<BlockHead> ReadBlockHead(std::span<const std::byte> bytes) {
  const auto need = [&](uint64_t size) {
    if (bytes.size() >= size) return absl::OkStatus();
    return absl::OutOfRangeError(absl::StrCat(
        "head of a point block: need ", size, " bytes, have ", bytes.size()));
  };
  MAPSIEVE_RETURN_IF_ERROR(need(kBlockPrefixBytes));
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t block_bytes, ReadBlockLength(bytes));
  MAPSIEVE_RETURN_IF_ERROR(need(kFixedBytes));
  BlockHead head;
  head.block_bytes = static_cast<uint64_t>(block_bytes);
  const auto version = LoadLittleEndian<uint16_t>(bytes.data() + 4);
  const auto column_count = LoadLittleEndian<uint16_t>(bytes.data() + 6);
  head.head_bytes = LoadLittleEndian<uint32_t>(bytes.data() + 16);
  MAPSIEVE_RETURN_IF_ERROR(CheckRange(
      "offset 16, bytes of the head", kMinHeadBytes,
      std::min(int64_t{kMaxHeadBytes}, block_bytes), head.head_bytes));
  MAPSIEVE_RETURN_IF_ERROR(need(head.head_bytes));
  const uint32_t checked_bytes = head.head_bytes - kChecksumBytes;
  const uint64_t actual = Hash64(bytes.first(checked_bytes));
  const auto expected =
      LoadLittleEndian<uint64_t>(bytes.data() + checked_bytes);
  if (actual != expected) {
    return absl::DataLossError(absl::StrFormat(
        "head of a point block: expected the checksum %016x at offset %d, have "
        "%016x",
        expected, checked_bytes, actual));
  }

  ByteReader reader(bytes.first(checked_bytes));
  MAPSIEVE_RETURN_IF_ERROR(reader.TakeBytes(20, "prefix").status());
  MAPSIEVE_ASSIGN_OR_RETURN(head.point_count,
                            reader.Take<uint32_t>("point count"));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("offset 20, points", 0, kMaxBlockPoints,
                                      int64_t{head.point_count}));
  MAPSIEVE_ASSIGN_OR_RETURN(head.step_nm, reader.Take<int64_t>("step"));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("offset 24, step in nm", 1, kMaxStepNm, head.step_nm));
  MAPSIEVE_ASSIGN_OR_RETURN(head.corner, TakePoint(reader, "corner"));
  MAPSIEVE_ASSIGN_OR_RETURN(head.min, TakePoint(reader, "min"));
  MAPSIEVE_ASSIGN_OR_RETURN(head.max, TakePoint(reader, "max"));
  MAPSIEVE_RETURN_IF_ERROR(CheckBounds(head));
  head.columns.reserve(column_count);
  for (size_t i = 0; i < column_count; ++i) {
    MAPSIEVE_ASSIGN_OR_RETURN(ColumnEntry entry,
                              TakeEntry(reader, version, head.point_count));
    head.columns.push_back(std::move(entry));
  }
  if (reader.remaining() != 0) {
    return absl::DataLossError(
        absl::StrCat("head of a point block: expected ", column_count,
                     " columns to end at offset ", checked_bytes, ", have ",
                     reader.offset()));
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckPositionColumns(head.columns));
  MAPSIEVE_RETURN_IF_ERROR(CheckNamesDiffer(head.attributes()));
  MAPSIEVE_RETURN_IF_ERROR(CheckLengths(head));
  return head;
}

}  // namespace mapsieve::core
