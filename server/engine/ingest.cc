#include "server/engine/ingest.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/row_runs.h"
#include "core/codec/points_codec.h"
#include "core/geometry/cell_key.h"
#include "server/engine/attribute_schema.h"
#include "server/engine/chunk_writer.h"
#include "server/engine/edit_map.h"
#include "server/engine/point_census.h"
#include "server/engine/upload_warnings.h"

namespace mapsieve::engine {
namespace {

using core::CellKey;
using core::LatticeCloud;
using core::LatticePoint;

/// The points of one tile, by the blocks that brought them.
struct TileParts {
  CellKey tile;
  std::vector<LatticeCloud> parts;
};

/// The points of all parts, which it empties, one part after the other.
absl::StatusOr<LatticeCloud> Concatenate(std::vector<LatticeCloud> parts) {
  size_t size = 0;
  for (const LatticeCloud& part : parts) size += part.size();
  LatticeCloud all = std::move(parts.front());
  all.positions.reserve(size);
  for (core::Column& column : all.attributes.columns()) column.Reserve(size);
  for (size_t i = 1; i < parts.size(); ++i) {
    const LatticeCloud part = std::move(parts[i]);
    MAPSIEVE_RETURN_IF_ERROR(
        all.attributes.AppendAll(all.size(), part.attributes, part.size()));
    all.positions.insert(all.positions.end(), part.positions.begin(),
                         part.positions.end());
  }
  return all;
}

/// Points by tile until they are written.
class TileBuckets {
 public:
  /// Estimated memory of all buckets, and of what they take as one cloud each.
  int64_t bytes() const { return bytes_; }

  /// Adds the points of `part`, all of them in its tile.
  void Add(TileCloud part) {
    Bucket& bucket = buckets_[part.tile];
    int64_t bytes = BytesOf(part.points);
    // A point gets the attributes of the other parts too.
    if (!bucket.parts.empty() && bucket.parts.front().attributes.specs() !=
                                     part.points.attributes.specs()) {
      bytes *= 2;
    }
    bucket.bytes += bytes;
    bytes_ += bytes;
    bucket.parts.push_back(std::move(part.points));
  }

  /// Takes the fullest buckets until at most `target_bytes` are left.
  std::vector<TileParts> TakeFullest(int64_t target_bytes) {
    std::vector<std::pair<int64_t, CellKey>> by_size;
    by_size.reserve(buckets_.size());
    for (const auto& [key, bucket] : buckets_) {
      by_size.emplace_back(bucket.bytes, key);
    }
    // Ties by key: the same upload makes the same chunks.
    std::sort(by_size.begin(), by_size.end(), [](const auto& a, const auto& b) {
      if (a.first != b.first) return a.first > b.first;
      return core::CellKeyLess()(a.second, b.second);
    });
    std::vector<TileParts> taken;
    for (const auto& [size, key] : by_size) {
      if (bytes_ <= target_bytes) break;
      const auto bucket = buckets_.find(key);
      taken.push_back({key, std::move(bucket->second.parts)});
      buckets_.erase(bucket);
      bytes_ -= size;
    }
    return taken;
  }

 private:
  struct Bucket {
    std::vector<LatticeCloud> parts;
    int64_t bytes = 0;
  };

  /// Nodes and columns cost something of their own, and so do the numbers of
  /// rows when a tile is divided.
  static int64_t BytesOf(const LatticeCloud& part) {
    constexpr auto kRowBytes = static_cast<int64_t>(sizeof(uint32_t));
    return 256 +
           static_cast<int64_t>(part.size()) *
               (DecodedPointBytes(part) + kRowBytes) +
           128 * static_cast<int64_t>(part.attributes.columns().size());
  }

  std::unordered_map<CellKey, Bucket, core::CellKeyHash> buckets_;
  int64_t bytes_ = 0;
};

/// Turns the bytes of one upload into chunks.
class Ingest {
 public:
  Ingest(storage::Store& store, const storage::MapRecord& map,
         const storage::UploadRecord& upload, const IngestLimits& limits,
         const ExecutionContext& context)
      : map_(map),
        upload_(upload),
        limits_(limits),
        context_(context),
        chunks_(store, storage::ChunkKind::kRaw, limits.chunk_bytes,
                *context.executor) {}

  /// Reads all blocks and stores their points. `schema`: the attributes of the
  /// map, to which those of the upload are added.
  absl::Status Run(const storage::UploadReader& reader,
                   AttributeSchema& schema) {
    ContentHasher hasher;
    std::vector<Block> blocks;
    int64_t decoded_bytes = 0;
    for (int64_t offset = 0; offset < reader.size();) {
      MAPSIEVE_RETURN_IF_ERROR(context_.CheckStop());
      context_.ReportProgress(offset, reader.size());
      Block block = {.number = block_count_, .offset = offset};
      MAPSIEVE_RETURN_IF_ERROR(
          AtBlock(ReadBlock(reader, schema, block), block));
      hasher.Update(block.bytes);
      offset += static_cast<int64_t>(block.bytes.size());
      ++block_count_;
      // As many at a time as there are workers, in the memory of the largest.
      if (decoded_bytes + block.decoded_bytes > limits_.block_bytes) {
        MAPSIEVE_RETURN_IF_ERROR(AddBlocks(std::exchange(blocks, {})));
        decoded_bytes = 0;
      }
      decoded_bytes += block.decoded_bytes;
      blocks.push_back(std::move(block));
      if (blocks.size() ==
          static_cast<size_t>(context_.executor->worker_count())) {
        MAPSIEVE_RETURN_IF_ERROR(AddBlocks(std::exchange(blocks, {})));
        decoded_bytes = 0;
      }
    }
    MAPSIEVE_RETURN_IF_ERROR(AddBlocks(std::move(blocks)));
    if (hasher.HexDigest() != upload_.spec.content_hash) {
      return absl::DataLossError(absl::StrCat(
          "upload ", upload_.spec.id, ": its ", reader.size(),
          " bytes have the hash ", hasher.HexDigest(), ", expected ",
          upload_.spec.content_hash, "; delete it and upload again"));
    }
    MAPSIEVE_RETURN_IF_ERROR(Flush(0));
    context_.ReportProgress(reader.size(), reader.size());
    return absl::OkStatus();
  }

  const std::vector<storage::ChunkRef>& chunks() const {
    return chunks_.chunks();
  }

  UploadReport Report() const {
    const core::Lattice lattice(map_.spec.step_nm);
    UploadReport report = {.block_count = block_count_};
    std::set<CellKey, core::CellKeyLess> tiles;
    core::LatticeBox box;
    for (const storage::ChunkRef& chunk : chunks()) {
      tiles.insert(chunk.tile);
      const core::LatticeBox& b = chunk.bounds;
      if (report.added_point_count == 0) box = b;
      box = {{std::min(box.min.x, b.min.x), std::min(box.min.y, b.min.y),
              std::min(box.min.z, b.min.z)},
             {std::max(box.max.x, b.max.x), std::max(box.max.y, b.max.y),
              std::max(box.max.z, b.max.z)}};
      report.added_point_count += chunk.point_count;
    }
    report.tile_count = static_cast<int64_t>(tiles.size());
    if (report.added_point_count > 0) {
      report.bounds = Bounds{
          lattice.Position(box.min),
          lattice.Position({box.max.x - 1, box.max.y - 1, box.max.z - 1})};
    }
    return report;
  }

 private:
  /// One block of the upload.
  struct Block {
    int64_t number = 0;
    int64_t offset = 0;
    std::vector<std::byte> bytes;
    int64_t decoded_bytes = 0;
  };

  absl::Status AtBlock(const absl::Status& status, const Block& block) const {
    if (status.ok()) return status;
    return Annotate(status, absl::StrCat("upload ", upload_.spec.id, ", block ",
                                         block.number, " at ", block.offset));
  }

  /// Reads the block at block.offset and checks its head.
  absl::Status ReadBlock(const storage::UploadReader& reader,
                         AttributeSchema& schema, Block& block) const {
    const int64_t left = reader.size() - block.offset;
    constexpr auto kPrefix = static_cast<int64_t>(core::kBlockPrefixBytes);
    MAPSIEVE_ASSIGN_OR_RETURN(
        const std::vector<std::byte> prefix,
        reader.Read(block.offset, std::min(left, kPrefix)));
    if (left < kPrefix) {
      return absl::DataLossError(
          absl::StrCat("the upload ends inside a block: expected at least ",
                       kPrefix, " bytes, have ", left));
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const int64_t length,
                              core::ReadBlockLength(prefix));
    if (length > left) {
      return absl::DataLossError(
          absl::StrCat("the upload ends inside a block: expected ", length,
                       " bytes, have ", left));
    }
    if (length > limits_.block_bytes) return TooLarge("", length);
    MAPSIEVE_ASSIGN_OR_RETURN(block.bytes, reader.Read(block.offset, length));
    return CheckHead(schema, block);
  }

  absl::Status TooLarge(std::string_view decoded, int64_t bytes) const {
    return absl::InvalidArgumentError(absl::StrCat(
        "the block has ", bytes, ToAbsl(decoded), " bytes, this server takes ",
        limits_.block_bytes, "; send smaller blocks"));
  }

  absl::Status CheckHead(AttributeSchema& schema, Block& block) const {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::BlockHeader header,
                              core::ReadBlockHeader(block.bytes));
    if (header.step_nm != map_.spec.step_nm) {
      return absl::InvalidArgumentError(
          absl::StrCat("the block has a lattice step of ", header.step_nm,
                       " nm, map ", map_.spec.id, " of ", map_.spec.step_nm,
                       " nm; quantise the points with the map's step"));
    }
    if (header.decoded_bytes > limits_.block_bytes) {
      return TooLarge(" decoded", header.decoded_bytes);
    }
    block.decoded_bytes = header.decoded_bytes;
    return schema.Add(header.columns);
  }

  absl::Status AddBlocks(std::vector<Block> blocks) {
    std::vector<std::vector<TileCloud>> parts(blocks.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        *context_.executor, static_cast<int64_t>(blocks.size()),
        [&](int64_t i) -> absl::Status {
          const Block& block = blocks[static_cast<size_t>(i)];
          const auto points = core::DecodePoints(
              block.bytes, {.max_decoded_bytes = limits_.block_bytes});
          MAPSIEVE_RETURN_IF_ERROR(AtBlock(points.status(), block));
          parts[static_cast<size_t>(i)] = SplitByTile(*points);
          return absl::OkStatus();
        }));
    for (std::vector<TileCloud>& of_block : parts) {
      for (TileCloud& part : of_block) {
        buckets_.Add(std::move(part));
        if (buckets_.bytes() > limits_.bucket_bytes) {
          MAPSIEVE_RETURN_IF_ERROR(Flush(limits_.bucket_bytes / 2));
        }
      }
    }
    return absl::OkStatus();
  }

  /// The points of each tile in the order given, tiles in Morton order.
  std::vector<TileCloud> SplitByTile(const LatticeCloud& points) const {
    std::unordered_map<CellKey, std::vector<core::RowRun>, core::CellKeyHash>
        runs_of;
    const auto size = static_cast<uint32_t>(points.size());
    for (uint32_t row = 0; row < size;) {
      const uint32_t begin = row;
      const CellKey tile =
          CellKey::Of(points.positions[row], map_.spec.tile_level);
      while (++row < size &&
             CellKey::Of(points.positions[row], map_.spec.tile_level) == tile) {
      }
      runs_of[tile].push_back({begin, row - begin});
    }
    std::vector<TileCloud> parts;
    parts.reserve(runs_of.size());
    for (const auto& [tile, runs] : runs_of) {
      parts.push_back({tile, core::SelectRuns(points, runs)});
    }
    std::sort(parts.begin(), parts.end(),
              [](const TileCloud& a, const TileCloud& b) {
                return core::CellKeyLess()(a.tile, b.tile);
              });
    return parts;
  }

  absl::Status Flush(int64_t target_bytes) {
    std::vector<TileParts> tiles = buckets_.TakeFullest(target_bytes);
    if (static_cast<int64_t>(chunks().size() + tiles.size()) >
        limits_.chunk_count) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the points lie in so many tiles of 2^", map_.spec.tile_level,
          " steps that they make more than ", limits_.chunk_count,
          " chunks; upload them in parts, or to a map with larger tiles"));
    }
    std::vector<TileCloud> clouds(tiles.size());
    MAPSIEVE_RETURN_IF_ERROR(TryParallelFor(
        *context_.executor, static_cast<int64_t>(tiles.size()),
        [&](int64_t n) -> absl::Status {
          const auto i = static_cast<size_t>(n);
          clouds[i].tile = tiles[i].tile;
          MAPSIEVE_ASSIGN_OR_RETURN(clouds[i].points,
                                    Concatenate(std::move(tiles[i].parts)));
          return absl::OkStatus();
        }));
    return chunks_.Write(std::move(clouds), context_.stop);
  }

  const storage::MapRecord& map_;
  const storage::UploadRecord& upload_;
  const IngestLimits limits_;
  const ExecutionContext& context_;
  TileBuckets buckets_;
  ChunkWriter chunks_;
  int64_t block_count_ = 0;
};

/// The newest revision of `map`. kAborted: it expired, so a newer one is there.
absl::StatusOr<std::shared_ptr<const storage::ReadSnapshot>> OpenNewest(
    storage::Store& store, const storage::MapRecord& map) {
  auto opened = store.OpenSnapshot(map.spec.id, map.newest_revision);
  if (absl::IsOutOfRange(opened.status())) {
    return absl::AbortedError(opened.status().message());
  }
  MAPSIEVE_RETURN_IF_ERROR(opened.status());
  if ((*opened)->map().uid != map.uid) {
    return absl::NotFoundError(
        absl::StrCat("map ", map.spec.id, " was deleted meanwhile"));
  }
  return opened;
}

/// Whether an error of the bytes of an upload stays, however often they are
/// read.
bool IsFinal(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsDataLoss(status);
}

/// `is_final`: set if the bytes of the upload are to blame for the error, so
/// that they can never become points of this map. Damage of the map is no such.
absl::StatusOr<UploadReport> AddPoints(storage::Store& store,
                                       const std::string& map_id,
                                       const storage::UploadRecord& upload,
                                       const std::optional<RegionShape>& region,
                                       const IngestLimits& limits,
                                       const ExecutionContext& context,
                                       bool& is_final) {
  const auto of_bytes = [&is_final](const absl::Status& status) {
    is_final = IsFinal(status);
    return status;
  };
  MAPSIEVE_ASSIGN_OR_RETURN(storage::MapRecord map,
                            store.catalogue().GetMap(map_id));
  if (map.uid != upload.map_uid) {
    return absl::NotFoundError(
        absl::StrCat("map ", map_id, " is another one than at the upload"));
  }
  if (upload.committed_bytes != upload.spec.expected_bytes) {
    return absl::FailedPreconditionError(absl::StrCat(
        "upload ", upload.spec.id, " has ", upload.committed_bytes, " of ",
        upload.spec.expected_bytes.value_or(0), " bytes; send the rest"));
  }
  const auto reader = store.uploads().OpenReader(upload.uid);
  MAPSIEVE_RETURN_IF_ERROR(of_bytes(reader.status()));
  MAPSIEVE_ASSIGN_OR_RETURN(UploadNotes notes, NotesOf(upload));
  const core::RefusedCounts refused = notes.report.refused;
  // The bytes of the upload are the progress.
  ExecutionContext silent = context;
  silent.progress = nullptr;
  Ingest ingest(store, map, upload, limits, context);
  MAPSIEVE_ASSIGN_OR_RETURN(AttributeSchema schema,
                            AttributeSchema::Of(store.catalogue(), map));
  MAPSIEVE_RETURN_IF_ERROR(of_bytes(ingest.Run(**reader, schema)));
  for (bool is_first = true;; is_first = false) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    if (!is_first) {
      // Another revision came first; these points can follow any.
      MAPSIEVE_ASSIGN_OR_RETURN(map, store.catalogue().GetMap(map_id));
      MAPSIEVE_ASSIGN_OR_RETURN(AttributeSchema newer,
                                AttributeSchema::Of(store.catalogue(), map));
      MAPSIEVE_RETURN_IF_ERROR(of_bytes(newer.Add(schema.columns())));
      schema = std::move(newer);
    }
    const auto opened = OpenNewest(store, map);
    if (absl::IsAborted(opened.status())) continue;
    MAPSIEVE_ASSIGN_OR_RETURN(const auto base, opened);
    UploadReport& report = notes.report;
    report = ingest.Report();
    report.refused = refused;
    report.revision = map.newest_revision + 1;
    ChunkWriter rest(store, storage::ChunkKind::kRaw, limits.chunk_bytes,
                     *context.executor);
    RegionCut cut;
    if (region.has_value()) {
      MAPSIEVE_ASSIGN_OR_RETURN(
          const Region place,
          Region::OfEdit(*region, core::Lattice(map.spec.step_nm)));
      MAPSIEVE_ASSIGN_OR_RETURN(cut,
                                CutRegion(*base, place, limits, silent, rest));
    }
    report.removed_point_count = cut.removed_point_count;
    MAPSIEVE_ASSIGN_OR_RETURN(
        report.census,
        TakeCensus(*base, ingest.chunks(), cut, rest.chunks(), limits, silent));
    const bool had_points = base->revision().totals.raw_point_count > 0;
    report.warnings = WarningsOf(notes.source, map.spec, had_points);
    storage::RevisionChange change = {
        .spec = {.kind = region.has_value()
                             ? storage::RevisionKind::kReplaceRegion
                             : storage::RevisionKind::kUpload,
                 .description = FormatEditRecord(
                     {.upload_id = upload.spec.id,
                      .region = region,
                      .added_point_count = report.added_point_count,
                      .removed_point_count = cut.removed_point_count,
                      .tile_count = cut.tile_count}),
                 .attributes = schema.columns(),
                 .refused = refused},
        .added = rest.chunks(),
        .removed = std::move(cut.removed_chunks),
        .finalized_upload_uid = upload.uid,
        .upload_report = FormatUploadNotes(notes)};
    if (!had_points && report.added_point_count > 0) {
      if (map.spec.crs_wkt.empty()) change.crs_wkt = notes.source.crs_wkt;
      if (map.spec.frame_id.empty()) change.frame_id = notes.source.frame_id;
    }
    change.added.insert(change.added.end(), ingest.chunks().begin(),
                        ingest.chunks().end());
    const auto committed =
        store.CommitRevision(map.uid, map.newest_revision, change);
    if (committed.ok()) return report;
    if (!absl::IsAborted(committed.status())) return committed.status();
  }
}

}  // namespace

IngestLimits IngestLimits::Of(int64_t memory_bytes) {
  return {.block_bytes = std::min(memory_bytes / 4, kMaxUploadBlockBytes),
          .bucket_bytes = memory_bytes / 2,
          .chunk_bytes = std::min(memory_bytes / 32, int64_t{16} << 20),
          .chunk_count = memory_bytes / 512};
}

absl::StatusOr<UploadNotes> NotesOf(const storage::UploadRecord& upload) {
  if (upload.report.empty()) return UploadNotes();
  return ParseUploadNotes(upload.report);
}

absl::StatusOr<UploadReport> AddUpload(storage::Store& store,
                                       const std::string& map_id,
                                       const std::string& upload_uid,
                                       const std::optional<RegionShape>& region,
                                       const IngestLimits& limits,
                                       const ExecutionContext& context) {
  storage::Catalogue& catalogue = store.catalogue();
  MAPSIEVE_ASSIGN_OR_RETURN(storage::UploadRecord upload,
                            catalogue.GetUploadByUid(upload_uid));
  using storage::UploadState;
  switch (upload.state) {
    case UploadState::kFinalized: {
      MAPSIEVE_ASSIGN_OR_RETURN(UploadNotes notes, NotesOf(upload));
      return std::move(notes.report);
    }
    case UploadState::kFailed:
      return absl::FailedPreconditionError(
          absl::StrCat("upload ", upload.spec.id,
                       " failed before; delete it and upload again"));
    case UploadState::kActive: {
      MAPSIEVE_ASSIGN_OR_RETURN(
          upload,
          catalogue.SetUploadState(upload_uid, UploadState::kActive,
                                   UploadState::kFinalizing, upload.report));
      break;
    }
    case UploadState::kFinalizing:
      break;
  }
  bool is_final = false;
  absl::StatusOr<UploadReport> report =
      AddPoints(store, map_id, upload, region, limits, context, is_final);
  if (report.ok()) {
    // What stays behind is collected as garbage.
    store.uploads().Remove(upload_uid).IgnoreError();
    return report;
  }
  const UploadState outcome =
      is_final ? UploadState::kFailed : UploadState::kActive;
  // The first error counts; a state that could not be set is finalizing, from
  // which another attempt starts too.
  catalogue
      .SetUploadState(upload_uid, UploadState::kFinalizing, outcome,
                      upload.report)
      .status()
      .IgnoreError();
  return report;
}

}  // namespace mapsieve::engine
