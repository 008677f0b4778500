#include "storage/record_checks.h"

#include <algorithm>
#include <numeric>
#include <set>

#include "absl/strings/str_cat.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/codec/points_codec.h"
#include "core/spdf/labels.h"
#include "storage/names.h"
#include "storage/tile_order.h"

namespace mapsieve::storage {
namespace {

constexpr size_t kMaxDisplayNameBytes = 128;
constexpr size_t kMaxCrsBytes = size_t{64} << 10;
constexpr size_t kMaxFrameIdBytes = 255;

absl::Status CheckSize(const char* field, size_t size, size_t limit) {
  if (size <= limit) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, ": expected at most ", limit, " bytes, got ", size));
}

absl::Status CheckRange(const char* field, int64_t value, int64_t lowest,
                        int64_t highest) {
  if (value >= lowest && value <= highest) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      field, ": expected ", lowest, " to ", highest, ", got ", value));
}

absl::Status CheckAttributes(const std::vector<core::ColumnSpec>& attributes) {
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("attribute count",
                                      static_cast<int64_t>(attributes.size()),
                                      0, int64_t{core::kMaxBlockColumns}));
  std::set<std::string_view> names;
  for (const core::ColumnSpec& attribute : attributes) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckRange("bytes of an attribute's name",
                   static_cast<int64_t>(attribute.name.size()), 1,
                   int64_t{core::kMaxColumnNameBytes}));
    if (core::ScalarSize(attribute.type) == 0) {
      return absl::InvalidArgumentError(
          absl::StrCat("attribute ", Quoted(attribute.name), ": unknown type ",
                       static_cast<int>(attribute.type)));
    }
    if (!names.insert(attribute.name).second) {
      return absl::InvalidArgumentError(absl::StrCat(
          "attribute ", Quoted(attribute.name), " is given twice"));
    }
  }
  return absl::OkStatus();
}

// Where a map lies.
absl::Status CheckPlace(const std::string& crs_wkt,
                        const std::string& frame_id) {
  MAPSIEVE_RETURN_IF_ERROR(CheckSize("crs_wkt", crs_wkt.size(), kMaxCrsBytes));
  return CheckSize("frame_id", frame_id.size(), kMaxFrameIdBytes);
}

bool Holds(const core::LatticeBox& outer, const core::LatticeBox& inner) {
  const auto axis = [](int64_t outer_min, int64_t outer_max, int64_t inner_min,
                       int64_t inner_max) {
    return outer_min <= inner_min && inner_min < inner_max &&
           inner_max <= outer_max;
  };
  return axis(outer.min.x, outer.max.x, inner.min.x, inner.max.x) &&
         axis(outer.min.y, outer.max.y, inner.min.y, inner.max.y) &&
         axis(outer.min.z, outer.max.z, inner.min.z, inner.max.z);
}

}  // namespace

absl::Status CheckMapSpec(const MapSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(CheckMapId(spec.id));
  MAPSIEVE_RETURN_IF_ERROR(CheckSize("display_name", spec.display_name.size(),
                                     kMaxDisplayNameBytes));
  MAPSIEVE_RETURN_IF_ERROR(CheckPlace(spec.crs_wkt, spec.frame_id));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("step_nm", spec.step_nm, 1, core::kMaxStepNm));
  return CheckRange("tile_level", spec.tile_level, 0, core::kMaxTileLevel);
}

absl::Status CheckUploadSpec(const UploadSpec& spec) {
  MAPSIEVE_RETURN_IF_ERROR(CheckResourceId(spec.id));
  if (spec.expected_bytes.has_value() && *spec.expected_bytes < 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "expected_bytes: expected at least 0, got ", *spec.expected_bytes));
  }
  if (!spec.content_hash.empty() && !IsHexId(spec.content_hash)) {
    return absl::InvalidArgumentError(
        absl::StrCat("content_hash ", Quoted(spec.content_hash),
                     ": expected 32 lower-case hexadecimal digits"));
  }
  return absl::OkStatus();
}

absl::Status CheckOperation(const OperationRecord& operation) {
  MAPSIEVE_RETURN_IF_ERROR(CheckResourceId(operation.id));
  if (operation.done_count < 0 ||
      (operation.total_count > 0 &&
       operation.done_count > operation.total_count)) {
    return absl::InvalidArgumentError(
        absl::StrCat("operation ", operation.id, ": ", operation.done_count,
                     " units done of ", operation.total_count));
  }
  return CheckRange("state", static_cast<int64_t>(operation.state),
                    static_cast<int64_t>(OperationState::kQueued),
                    static_cast<int64_t>(OperationState::kCancelled));
}

absl::Status CheckChunk(const ChunkRef& chunk, int tile_level) {
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("kind", static_cast<int64_t>(chunk.kind),
                 static_cast<int64_t>(ChunkKind::kRaw),
                 static_cast<int64_t>(ChunkKind::kHistory)));
  if (chunk.tile.level != tile_level || !IsValidCell(chunk.tile)) {
    return absl::InvalidArgumentError(
        absl::StrCat("no tile of level ", tile_level, " inside the lattice"));
  }
  if (!IsHexId(chunk.blob_id)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "blob id ", Quoted(chunk.blob_id), ": expected 32 hexadecimal digits"));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("point_count", chunk.point_count, 1, core::kMaxBlockPoints));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("stored_bytes", chunk.stored_bytes, 1, kMaxBlobBytes));
  for (const int64_t count : chunk.label_counts) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckRange("label count", count, 0, chunk.point_count));
  }
  const int64_t labeled = std::accumulate(chunk.label_counts.begin(),
                                          chunk.label_counts.end(), int64_t{0});
  const int64_t expected =
      chunk.kind == ChunkKind::kProduct ? chunk.point_count : 0;
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("sum of label_counts", labeled, expected, expected));
  const int deepest = chunk.kind == ChunkKind::kProduct ? core::kMaxDepth : 0;
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("max_depth", chunk.max_depth, 0, deepest));
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("min_depth", chunk.min_depth, 0, chunk.max_depth));
  if (!Holds(chunk.tile.box(), chunk.bounds)) {
    return absl::InvalidArgumentError(
        "bounds are empty or not inside the tile");
  }
  return absl::OkStatus();
}

absl::Status CheckRevisionChange(const RevisionChange& change, int tile_level) {
  // Only CreateMap creates, and only RollBack rolls back.
  MAPSIEVE_RETURN_IF_ERROR(
      CheckRange("kind", static_cast<int64_t>(change.spec.kind),
                 static_cast<int64_t>(RevisionKind::kUpload),
                 static_cast<int64_t>(RevisionKind::kReplaceRegion)));
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(change.spec.attributes));
  MAPSIEVE_RETURN_IF_ERROR(CheckPlace(change.crs_wkt, change.frame_id));
  for (size_t i = 0; i < change.added.size(); ++i) {
    MAPSIEVE_RETURN_IF_ERROR(
        Annotate(CheckChunk(change.added[i], tile_level),
                 absl::StrCat("added chunk ", i, " in tile ",
                              change.added[i].tile.ToString())));
  }
  return absl::OkStatus();
}

absl::Status CheckPageSize(int64_t max_count) {
  if (max_count >= 1) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("page size: expected at least 1, got ", max_count));
}

std::string EncodeAttributes(const std::vector<core::ColumnSpec>& attributes) {
  ByteWriter writer;
  for (const core::ColumnSpec& attribute : attributes) {
    writer.PutShortText(attribute.name);
    writer.Put(attribute.type);
  }
  return {reinterpret_cast<const char*>(writer.bytes().data()), writer.size()};
}

absl::StatusOr<std::vector<core::ColumnSpec>> DecodeAttributes(
    std::string_view bytes) {
  ByteReader reader(TextBytes(bytes));
  std::vector<core::ColumnSpec> attributes;
  while (reader.remaining() > 0) {
    core::ColumnSpec attribute;
    MAPSIEVE_ASSIGN_OR_RETURN(attribute.name,
                              reader.TakeShortText("attribute name"));
    MAPSIEVE_ASSIGN_OR_RETURN(attribute.type,
                              reader.Take<core::ScalarType>("attribute type"));
    attributes.push_back(std::move(attribute));
  }
  if (const absl::Status status = CheckAttributes(attributes); !status.ok()) {
    return absl::DataLossError(status.message());
  }
  return attributes;
}

}  // namespace mapsieve::storage
