#include <algorithm>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/codec/block_head.h"
#include "core/codec/compression.h"
#include "core/codec/points_codec.h"
#include "core/codec/transforms.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

/// Modulo 2^64: no offset that a block claims can overflow.
constexpr int64_t Plus(int64_t a, int64_t b) {
  return static_cast<int64_t>(static_cast<uint64_t>(a) +
                              static_cast<uint64_t>(b));
}

/// Memory that is not set before it is filled.
class Buffer {
 public:
  explicit Buffer(size_t size)
      : data_(std::make_unique_for_overwrite<std::byte[]>(size)), size_(size) {}
  std::span<std::byte> span() { return {data_.get(), size_}; }

 private:
  std::unique_ptr<std::byte[]> data_;
  size_t size_;
};

/// Marks the rows of `column` that `bitmap` names.
absl::Status DecodeMissing(std::span<const std::byte> bitmap, Column& column) {
  const size_t count = column.size();
  if (count % 8 != 0 &&
      (static_cast<unsigned>(bitmap.back()) >> (count % 8)) != 0) {
    return absl::DataLossError(
        "bitmap of missing values: bits beyond the last point");
  }
  for (size_t i = 0; i < count; ++i) {
    const auto bits = static_cast<unsigned>(bitmap[i / 8]) >> (i % 8);
    if ((bits & 1) != 0) column.SetMissing(i);
  }
  return absl::OkStatus();
}

/// Decodes a column into `values`; its bitmap, if it has one, into `column`,
/// whose values these are then.
absl::Status DecodeColumnValues(const ColumnEntry& entry,
                                std::span<const std::byte> stored,
                                std::span<std::byte> values, Column* column) {
  if (Hash64(stored) != entry.checksum) {
    return absl::DataLossError(
        absl::StrCat("checksum: expected ", absl::Hex(entry.checksum),
                     ", have ", absl::Hex(Hash64(stored))));
  }
  std::span<const std::byte> coded = stored;
  std::optional<Buffer> decompressed;
  if (entry.compression != Compression::kNone) {
    decompressed.emplace(entry.coded_bytes);
    coded = decompressed->span();
    MAPSIEVE_RETURN_IF_ERROR(
        Decompress(entry.compression, stored, decompressed->span()));
  }
  const size_t width = ScalarSize(entry.spec.type);
  std::span<const std::byte> bitmap;
  if (entry.has_missing) {
    bitmap = coded.first(MissingBitmapBytes(values.size() / width));
    coded = coded.subspan(bitmap.size());
  }
  MAPSIEVE_RETURN_IF_ERROR(
      InvertTransform(entry.transform, coded, width, values));
  if (!entry.has_missing) return absl::OkStatus();
  return DecodeMissing(bitmap, *column);
}

/// DecodeColumnValues, with errors that say where.
absl::Status DecodeColumn(const ColumnEntry& entry,
                          std::span<const std::byte> block, size_t offset,
                          std::span<std::byte> values, Column* column) {
  const absl::Status status = DecodeColumnValues(
      entry, block.subspan(offset, entry.stored_bytes), values, column);
  if (status.ok()) return status;
  return Annotate(
      status,
      absl::StrCat("point block, column ", QuotedName(entry.spec.name), " of ",
                   entry.stored_bytes, " bytes at offset ", offset));
}

absl::Status DecodeMorton(const BlockHead& head,
                          std::span<const std::byte> block,
                          std::vector<LatticePoint>& positions) {
  Buffer codes(size_t{head.point_count} * sizeof(uint64_t));
  MAPSIEVE_RETURN_IF_ERROR(DecodeColumn(head.columns[0], block, head.head_bytes,
                                        codes.span(), nullptr));
  positions.resize(head.point_count);
  uint64_t all_bits = 0;
  for (size_t i = 0; i < positions.size(); ++i) {
    const auto code =
        LoadLittleEndian<uint64_t>(codes.span().data() + i * sizeof(uint64_t));
    all_bits |= code;
    positions[i] = {
        head.corner.x + static_cast<int64_t>(GatherBits3(code)),
        head.corner.y + static_cast<int64_t>(GatherBits3(code >> 1)),
        head.corner.z + static_cast<int64_t>(GatherBits3(code >> 2))};
  }
  if (all_bits >> (3 * kMortonAxisBits) != 0) {
    return absl::DataLossError(
        "point block, column \"morton\": expected codes of at most 63 bits");
  }
  return absl::OkStatus();
}

template <typename T>
absl::Status DecodeAxes(const BlockHead& head, std::span<const std::byte> block,
                        std::vector<LatticePoint>& positions) {
  Buffer offsets(size_t{head.point_count} * sizeof(T));
  positions.resize(head.point_count);
  size_t at = head.head_bytes;
  for (size_t axis = 0; axis < 3; ++axis) {
    MAPSIEVE_RETURN_IF_ERROR(
        DecodeColumn(head.columns[axis], block, at, offsets.span(), nullptr));
    at += head.columns[axis].stored_bytes;
    const auto coordinate = kAxes[axis];
    const int64_t corner = head.corner.*coordinate;
    for (size_t i = 0; i < positions.size(); ++i) {
      const auto offset =
          LoadLittleEndian<T>(offsets.span().data() + i * sizeof(T));
      positions[i].*coordinate = Plus(corner, offset);
    }
  }
  return absl::OkStatus();
}

absl::Status DecodePositions(const BlockHead& head,
                             std::span<const std::byte> block,
                             std::vector<LatticePoint>& positions) {
  if (head.position_column_count() == 1) {
    MAPSIEVE_RETURN_IF_ERROR(DecodeMorton(head, block, positions));
  } else if (head.columns[0].spec.type == ScalarType::kInt32) {
    MAPSIEVE_RETURN_IF_ERROR(DecodeAxes<int32_t>(head, block, positions));
  } else {
    MAPSIEVE_RETURN_IF_ERROR(DecodeAxes<int64_t>(head, block, positions));
  }
  const auto [min, max] = BoundsOf(positions);
  if (min == head.min && max == head.max) return absl::OkStatus();
  const auto text = [](const LatticePoint& q) {
    return absl::StrCat("(", q.x, ", ", q.y, ", ", q.z, ")");
  };
  return absl::DataLossError(
      absl::StrCat("point block: expected points from ", text(head.min), " to ",
                   text(head.max), ", have ", text(min), " to ", text(max)));
}

bool IsWanted(const ColumnEntry& entry, const DecodeOptions& options) {
  return !options.attributes.has_value() ||
         std::find(options.attributes->begin(), options.attributes->end(),
                   entry.spec.name) != options.attributes->end();
}

/// The head of the block that fills `bytes`; kDataLoss if it does not, or is
/// damaged; kResourceExhausted: the attributes wanted and the positions need
/// more memory than they may.
absl::StatusOr<BlockHead> OpenBlock(std::span<const std::byte> bytes,
                                    const DecodeOptions& options) {
  if (bytes.size() < kBlockPrefixBytes) {
    return absl::DataLossError(absl::StrCat("point block: expected at least ",
                                            kBlockPrefixBytes, " bytes, have ",
                                            bytes.size()));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t block_bytes, ReadBlockLength(bytes));
  if (static_cast<uint64_t>(block_bytes) != bytes.size()) {
    return absl::DataLossError(absl::StrCat(
        "point block: expected ", block_bytes, " bytes, have ", bytes.size()));
  }
  MAPSIEVE_ASSIGN_OR_RETURN(BlockHead head, ReadBlockHead(bytes));
  std::vector<ColumnSpec> specs;
  size_t with_missing = 0;
  for (const ColumnEntry& entry : head.attributes()) {
    if (!IsWanted(entry, options)) continue;
    specs.push_back(entry.spec);
    with_missing += entry.has_missing ? 1 : 0;
  }
  const int64_t decoded_bytes =
      DecodedBytes(head.point_count, specs, with_missing);
  if (decoded_bytes > options.max_decoded_bytes) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "point block of ", head.point_count, " points: needs ", decoded_bytes,
        " bytes decoded, the limit is ", options.max_decoded_bytes,
        "; make smaller blocks or ask for fewer attributes"));
  }
  return head;
}

/// The attributes wanted.
absl::StatusOr<ColumnSet> DecodeAttributes(const BlockHead& head,
                                           std::span<const std::byte> bytes,
                                           const DecodeOptions& options) {
  ColumnSet attributes;
  size_t offset = head.head_bytes;
  for (size_t i = 0; i < head.columns.size(); ++i) {
    const ColumnEntry& entry = head.columns[i];
    if (i >= head.position_column_count() && IsWanted(entry, options)) {
      Column column(entry.spec, head.point_count);
      MAPSIEVE_RETURN_IF_ERROR(
          DecodeColumn(entry, bytes, offset, column.mutable_bytes(), &column));
      MAPSIEVE_RETURN_IF_ERROR(attributes.Add(std::move(column)));
    }
    offset += entry.stored_bytes;
  }
  return attributes;
}

}  // namespace

absl::StatusOr<BlockHeader> ReadBlockHeader(std::span<const std::byte> bytes) {
  MAPSIEVE_ASSIGN_OR_RETURN(const BlockHead head, ReadBlockHead(bytes));
  BlockHeader header;
  header.step_nm = head.step_nm;
  header.point_count = head.point_count;
  header.block_bytes = static_cast<int64_t>(head.block_bytes);
  header.min = head.min;
  header.max = head.max;
  size_t with_missing = 0;
  for (const ColumnEntry& entry : head.attributes()) {
    header.columns.push_back(entry.spec);
    with_missing += entry.has_missing ? 1 : 0;
  }
  header.decoded_bytes =
      DecodedBytes(head.point_count, header.columns, with_missing);
  return header;
}

absl::StatusOr<std::vector<std::span<const std::byte>>> SplitBlocks(
    std::span<const std::byte> bytes) {
  std::vector<std::span<const std::byte>> blocks;
  size_t offset = 0;
  while (offset < bytes.size()) {
    const auto rest = bytes.subspan(offset);
    const auto misfit = [&](int64_t expected) {
      return absl::DataLossError(absl::StrCat("point block at offset ", offset,
                                              ": expected ", expected,
                                              " bytes, have ", rest.size()));
    };
    if (rest.size() < kBlockPrefixBytes) return misfit(kBlockPrefixBytes);
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t block_bytes, ReadBlockLength(rest));
    if (static_cast<uint64_t>(block_bytes) > rest.size()) {
      return misfit(block_bytes);
    }
    blocks.push_back(rest.first(static_cast<size_t>(block_bytes)));
    offset += blocks.back().size();
  }
  return blocks;
}

absl::StatusOr<LatticeCloud> DecodePoints(std::span<const std::byte> bytes,
                                          const DecodeOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(const BlockHead head, OpenBlock(bytes, options));
  LatticeCloud cloud;
  cloud.lattice = Lattice(head.step_nm);
  MAPSIEVE_RETURN_IF_ERROR(DecodePositions(head, bytes, cloud.positions));
  MAPSIEVE_ASSIGN_OR_RETURN(cloud.attributes,
                            DecodeAttributes(head, bytes, options));
  return cloud;
}

absl::StatusOr<ColumnSet> DecodeColumns(std::span<const std::byte> bytes,
                                        const std::vector<std::string>& names) {
  const DecodeOptions options = {.attributes = names};
  MAPSIEVE_ASSIGN_OR_RETURN(const BlockHead head, OpenBlock(bytes, options));
  return DecodeAttributes(head, bytes, options);
}

}  // namespace mapsieve::core
