#include "tests/storage/catalogue_dump.h"

#include <optional>
#include <set>
#include <vector>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"

namespace mapsieve::storage {
namespace {

constexpr int64_t kAll = 1'000'000;

// A line of values with a space behind each.
class Line {
 public:
  template <typename... Values>
  explicit Line(const Values&... values) {
    Add(values...);
  }
  template <typename... Values>
  Line& Add(const Values&... values) {
    (absl::StrAppend(&text_, values, " "), ...);
    return *this;
  }
  template <typename Range>
  Line& AddEach(const Range& range) {
    for (const auto& value : range) Add(value);
    return *this;
  }
  Line& Add(const core::LatticeBox& box) {
    for (const auto& corner : {box.min, box.max}) {
      Add(corner.x, corner.y, corner.z);
    }
    return *this;
  }
  Line& AddIdentity(Identities identities, const std::string& uid,
                    absl::Time create, absl::Time update) {
    if (identities == Identities::kLeftOut) return *this;
    return Add(uid, absl::ToUnixMicros(create), absl::ToUnixMicros(update));
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

template <typename Enum>
int Number(Enum value) {
  return static_cast<int>(value);
}

// What is read by a map's uid, of deleted maps too.
absl::Status DumpMap(const Catalogue& catalogue, const std::string& uid,
                     Identities identities, std::string& out) {
  const auto add = [&](const std::string& line) {
    absl::StrAppend(&out, line, "\n");
  };
  MAPSIEVE_ASSIGN_OR_RETURN(const auto revisions,
                            catalogue.ListRevisions(uid, 0, kAll));
  for (const RevisionRecord& revision : revisions) {
    add(Describe(revision, identities));
    for (const ChunkKind kind :
         {ChunkKind::kRaw, ChunkKind::kProduct, ChunkKind::kHistory}) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto chunks,
          catalogue.ListChunks(uid, revision.number, kind, std::nullopt,
                               std::nullopt, kAll));
      for (const ChunkRef& chunk : chunks) add(Describe(chunk));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto tiles,
          catalogue.ListTiles(uid, revision.number, kind, std::nullopt,
                              std::nullopt, kAll));
      for (const TileSummary& tile : tiles) add(Describe(tile));
      MAPSIEVE_ASSIGN_OR_RETURN(
          const auto changed,
          catalogue.ListChangedTiles(uid, revision.number,
                                     revisions.front().number, kind,
                                     std::nullopt, kAll));
      for (const core::CellKey& tile : changed) {
        add(absl::StrCat("changed ", tile.ToString()));
      }
    }
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const auto chunks,
                            catalogue.ListAllChunks(uid, 0, kAll));
  std::vector<BlobId> blobs;
  for (const ChunkRef& chunk : chunks) {
    add(Describe(chunk));
    blobs.push_back(chunk.blob_id);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const int64_t count, catalogue.CountAllChunks(uid));
  MAPSIEVE_ASSIGN_OR_RETURN(const auto referenced,
                            catalogue.AreBlobsReferenced(blobs));
  add(Line(count).AddEach(referenced).text());
  MAPSIEVE_ASSIGN_OR_RETURN(const auto uploads,
                            catalogue.ListUploads(uid, "", kAll));
  for (const UploadRecord& upload : uploads) add(Describe(upload, identities));
  return absl::OkStatus();
}

}  // namespace

std::string Describe(const MapRecord& map, Identities identities) {
  return Line("map", map.spec.id, map.spec.display_name, map.spec.step_nm,
              map.spec.tile_level, map.spec.crs_wkt, map.spec.frame_id,
              map.newest_revision, map.process_options)
      .AddIdentity(identities, map.uid, map.create_time, map.update_time)
      .text();
}

std::string Describe(const RevisionRecord& revision, Identities identities) {
  const RevisionSpec& spec = revision.spec;
  const RevisionTotals& totals = revision.totals;
  Line line("revision", revision.number, revision.parent, Number(spec.kind),
            spec.description, spec.refused.non_finite,
            spec.refused.out_of_lattice, revision.processed_revision,
            revision.restored_revision, totals.raw_point_count,
            totals.raw_chunk_count, totals.product_point_count,
            totals.product_chunk_count, totals.stored_bytes, totals.tile_count,
            totals.stale_tile_count);
  line.AddEach(totals.label_counts).Add(totals.bounds);
  for (const core::ColumnSpec& attribute : spec.attributes) {
    line.Add(attribute.name, Number(attribute.type));
  }
  if (spec.product.has_value()) {
    line.Add(spec.product->options, spec.product->distinct_point_count)
        .AddEach(spec.product->kept_counts)
        .AddEach(spec.product->max_confidence);
  }
  return line
      .AddIdentity(identities, "", revision.create_time, revision.create_time)
      .text();
}

std::string Describe(const ChunkRef& chunk) {
  return Line("chunk", chunk.number, Number(chunk.kind), chunk.tile.ToString(),
              chunk.blob_id, chunk.point_count, chunk.stored_bytes,
              chunk.min_depth, chunk.max_depth)
      .AddEach(chunk.label_counts)
      .Add(chunk.bounds)
      .text();
}

std::string Describe(const TileSummary& tile) {
  return Line("tile", tile.tile.ToString(), tile.chunk_count, tile.point_count,
              tile.stored_bytes)
      .AddEach(tile.label_counts)
      .Add(tile.bounds)
      .text();
}

std::string Describe(const UploadRecord& upload, Identities identities) {
  return Line("upload", upload.spec.id, upload.spec.expected_bytes.value_or(-1),
              upload.spec.content_hash, Number(upload.state),
              upload.committed_bytes, upload.revision, upload.report)
      .AddIdentity(identities, upload.uid, upload.create_time,
                   upload.update_time)
      .text();
}

std::string Describe(const OperationRecord& operation, Identities identities) {
  return Line("operation", operation.id, operation.number, operation.target,
              operation.verb, operation.request, Number(operation.state),
              operation.cancel_requested, operation.done_count,
              operation.total_count, operation.error_code,
              operation.error_message, operation.response)
      .AddIdentity(identities, "", operation.create_time, operation.update_time)
      .text();
}

absl::StatusOr<std::string> Dump(const Catalogue& catalogue,
                                 Identities identities) {
  std::string out;
  MAPSIEVE_ASSIGN_OR_RETURN(const auto maps, catalogue.ListMaps("", kAll));
  for (const MapRecord& map : maps) {
    absl::StrAppend(&out, Describe(map, identities), "\n");
    MAPSIEVE_RETURN_IF_ERROR(DumpMap(catalogue, map.uid, identities, out));
  }
  // They are listed by uid.
  std::set<std::string> deleted;
  MAPSIEVE_ASSIGN_OR_RETURN(const auto uids,
                            catalogue.ListDeletedMaps("", kAll));
  for (const std::string& uid : uids) {
    std::string map = "deleted map\n";
    MAPSIEVE_RETURN_IF_ERROR(DumpMap(catalogue, uid, identities, map));
    deleted.insert(map);
  }
  for (const std::string& map : deleted) absl::StrAppend(&out, map);
  for (const bool unfinished_only : {false, true}) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto operations,
        catalogue.ListOperations("", unfinished_only, 0, kAll));
    for (const OperationRecord& operation : operations) {
      absl::StrAppend(&out, Describe(operation, identities), "\n");
    }
  }
  return out;
}

}  // namespace mapsieve::storage
