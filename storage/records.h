#ifndef MAPSIEVE_STORAGE_RECORDS_H_
#define MAPSIEVE_STORAGE_RECORDS_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "core/cloud/column.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/labels.h"
#include "storage/blob_store.h"

/// What the catalogue remembers. Numbers of enumerations are part of the
/// format. Opaque strings may hold any bytes: storage never looks into them.
namespace mapsieve::storage {

/// What a map is created with. All of it is fixed but where a commit names
/// another crs_wkt or frame_id.
struct MapSpec {
  /// [a-z]([a-z0-9-]{0,61}[a-z0-9])?
  std::string id;
  /// Free text for people, at most 128 bytes.
  std::string display_name;
  /// Lattice step, 1 to core::kMaxStepNm.
  int64_t step_nm = core::kDefaultStepNm;
  /// A tile is a cell of this level, 0 to core::kMaxTileLevel.
  int tile_level = 15;
  /// Coordinate reference system as WKT, at most 64 KiB; empty if unknown.
  std::string crs_wkt;
  /// What robots call the map's frame, at most 255 bytes; empty if unknown.
  std::string frame_id;

  friend bool operator==(const MapSpec&, const MapSpec&) = default;
};

struct MapRecord {
  MapSpec spec;
  /// 32 random hexadecimal digits; never used again, even for a map of the
  /// same id.
  std::string uid;
  /// Grows by one with every commit; 1 is the empty map of the creation.
  int64_t newest_revision = 0;
  /// The oldest one that is not expired.
  int64_t oldest_revision = 0;
  absl::Time create_time;
  /// Of the newest revision.
  absl::Time update_time;
  /// ProductSummary::options of the newest revision's product; empty if it has
  /// none.
  std::string process_options;
};

/// What made a revision.
enum class RevisionKind : uint8_t {
  kCreate = 1,
  kUpload = 2,
  kProcess = 3,
  kDeleteRegion = 4,
  kReplaceRegion = 5,
  kRollback = 6,
};

/// What a complete product of the filter is told by besides its chunks.
struct ProductSummary {
  /// The engine's serialised options; opaque.
  std::string options;
  /// Distinct points that the filter saw.
  int64_t distinct_point_count = 0;
  /// Points of each label that pass the outlier test. The counts before it are
  /// RevisionTotals::label_counts.
  core::LabelCounts kept_counts{};
  /// Largest confidence of each label in the map: the outlier test compares
  /// with it when points are read.
  core::MaxConfidence max_confidence{};

  friend bool operator==(const ProductSummary&,
                         const ProductSummary&) = default;
};

/// Sums over the chunks of a revision, kept by the catalogue.
struct RevisionTotals {
  int64_t raw_point_count = 0;
  int64_t raw_chunk_count = 0;
  /// Outliers included.
  int64_t product_point_count = 0;
  int64_t product_chunk_count = 0;
  /// Product points of each label, outliers included.
  core::LabelCounts label_counts{};
  /// Bytes of all blobs, raw and product.
  int64_t stored_bytes = 0;
  /// Tiles that hold raw points.
  int64_t tile_count = 0;
  /// Tiles whose raw points changed after the product was made, or all if
  /// there is no product.
  int64_t stale_tile_count = 0;
  /// Tight box of the raw points; default (empty) if there are none.
  core::LatticeBox bounds;

  friend bool operator==(const RevisionTotals&,
                         const RevisionTotals&) = default;
};

/// What the committer says of a revision.
struct RevisionSpec {
  RevisionKind kind = RevisionKind::kUpload;
  /// For people and reports; opaque.
  std::string description;
  /// Attributes of the raw points, whole and by name: at most 1024, names of 1
  /// to 255 bytes, no name twice.
  std::vector<core::ColumnSpec> attributes;
  /// Points that ingest refused on the way to this revision.
  core::RefusedCounts refused;
  /// Set if the product chunks of this revision are complete: made from all of
  /// its parent's raw points.
  std::optional<ProductSummary> product;

  friend bool operator==(const RevisionSpec&, const RevisionSpec&) = default;
};

struct RevisionRecord {
  int64_t number = 0;
  /// The revision before it; 0 for the first.
  int64_t parent = 0;
  absl::Time create_time;
  RevisionSpec spec;
  RevisionTotals totals;
  /// The revision that made the product that this one has, which queries read:
  /// the newest one up to this one, after a rollback that of the restored one.
  /// 0 if there is none.
  int64_t processed_revision = 0;
  /// Of a rollback, the revision that it equals; else 0.
  int64_t restored_revision = 0;
  /// Its chunks are given up: nobody can begin to read it any more.
  bool is_expired = false;
};

enum class ChunkKind : uint8_t {
  /// Points as they were uploaded.
  kRaw = 1,
  /// What the filter made of a tile.
  kProduct = 2,
  /// What the filter remembers of a tile, to update the product when points
  /// change; goes with the product.
  kHistory = 3,
};

/// A reference to a blob that holds points of one tile (a block of
/// core/codec), or what the filter remembers of them.
struct ChunkRef {
  /// Assigned at commit, grows, never used again in this store; 0 before.
  int64_t number = 0;
  ChunkKind kind = ChunkKind::kRaw;
  /// A cell of the map's tile level.
  core::CellKey tile;
  BlobId blob_id;
  int64_t point_count = 0;
  /// Bytes of the blob.
  int64_t stored_bytes = 0;
  /// Smallest and largest depth of the points (core/spdf/levels.h); zero but
  /// in product chunks.
  int min_depth = 0;
  int max_depth = 0;
  /// Points of each label; zero in chunks that are no product.
  core::LabelCounts label_counts{};
  /// Tight half-open box of the points, inside the tile.
  core::LatticeBox bounds;

  friend bool operator==(const ChunkRef&, const ChunkRef&) = default;
};

/// Sums over the chunks of one kind in one tile.
struct TileSummary {
  core::CellKey tile;
  int64_t chunk_count = 0;
  int64_t point_count = 0;
  int64_t stored_bytes = 0;
  core::LabelCounts label_counts{};
  core::LatticeBox bounds;

  friend bool operator==(const TileSummary&, const TileSummary&) = default;
};

enum class UploadState : uint8_t {
  /// Takes bytes.
  kActive = 1,
  /// Its bytes are complete and become points.
  kFinalizing = 2,
  /// Its points were added to the map; its bytes are gone.
  kFinalized = 3,
  /// It did not become points; the report says why.
  kFailed = 4,
};

/// What is fixed when an upload is created.
struct UploadSpec {
  /// Unique in its map: [a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?
  std::string id;
  /// Bytes that it will have; nothing if unknown.
  std::optional<int64_t> expected_bytes;
  /// ContentHash that its bytes will have; empty if unknown.
  std::string content_hash;

  friend bool operator==(const UploadSpec&, const UploadSpec&) = default;
};

struct UploadRecord {
  UploadSpec spec;
  /// 32 random hexadecimal digits; names its staged bytes.
  std::string uid;
  std::string map_uid;
  UploadState state = UploadState::kActive;
  /// The durable prefix: never decreases, survives any crash.
  int64_t committed_bytes = 0;
  absl::Time create_time;
  /// Of the last commit of bytes or change of state; the idle time of an
  /// upload counts from it.
  absl::Time update_time;
  /// The revision that brought its points in; 0 before.
  int64_t revision = 0;
  /// Outcome for the client; opaque.
  std::string report;
};

enum class OperationState : uint8_t {
  kQueued = 1,
  kRunning = 2,
  kSucceeded = 3,
  kFailed = 4,
  kCancelled = 5,
};

/// Whether an operation in `state` has ended; it never changes again.
inline bool IsDone(OperationState state) {
  return state == OperationState::kSucceeded ||
         state == OperationState::kFailed ||
         state == OperationState::kCancelled;
}

/// A long-running job, remembered across restarts.
struct OperationRecord {
  /// [a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?
  std::string id;
  /// Position in the order of creation; assigned by the catalogue.
  int64_t number = 0;
  /// Resource worked on, for example "maps/campus".
  std::string target;
  /// What is done to it, for example "process".
  std::string verb;
  /// What it was asked; opaque.
  std::string request;

  OperationState state = OperationState::kQueued;
  bool cancel_requested = false;
  /// Units of work; total is 0 until known.
  int64_t done_count = 0;
  int64_t total_count = 0;
  /// absl::StatusCode of a failed operation; 0 otherwise.
  int error_code = 0;
  std::string error_message;
  /// What a succeeded operation answers; opaque.
  std::string response;

  /// Kept by the catalogue.
  absl::Time create_time;
  absl::Time update_time;
};

}  // namespace mapsieve::storage

#endif  // MAPSIEVE_STORAGE_RECORDS_H_
