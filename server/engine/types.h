#ifndef MAPSIEVE_SERVER_ENGINE_TYPES_H_
#define MAPSIEVE_SERVER_ENGINE_TYPES_H_

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "core/cloud/column.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/lattice.h"
#include "core/spdf/labels.h"
#include "core/spdf/levels.h"
#include "core/spdf/spdf_options.h"
#include "server/engine/shapes.h"

/// What the engine takes and gives besides queries (region_query.h). Fields
/// that come from outside are validated by the engine, with the errors that
/// its methods name.
namespace mapsieve::engine {

/// Part of a list.
template <typename T>
struct Page {
  std::vector<T> items;
  /// Where the next page begins; empty on the last page, and only there.
  std::string next_page_token;
};

/// Which part of a list is wanted.
struct PageRequest {
  /// Items at most. 0: kDefaultPageSize; above kMaxPageSize: that many;
  /// negative: kInvalidArgument.
  int64_t page_size = 0;
  /// next_page_token of the page before; empty: from the first.
  std::string page_token;
};
inline constexpr int64_t kDefaultPageSize = 50;
inline constexpr int64_t kMaxPageSize = 1000;

/// Coordinates of the outermost points, both inclusive, in map units.
struct Bounds {
  core::Point3 min;
  core::Point3 max;

  friend bool operator==(const Bounds&, const Bounds&) = default;
};

// Maps.

/// Edges of tiles, log2 in lattice steps; above it core::kMaxTileLevel.
inline constexpr int kMinTileLevel = 4;
inline constexpr int kDefaultTileLevel = 15;
inline constexpr size_t kMaxDisplayNameBytes = 128;
inline constexpr size_t kMaxCrsWktBytes = 64 * 1024;
inline constexpr size_t kMaxFrameIdBytes = 255;

/// A map to be created.
struct MapSpec {
  /// [a-z]([a-z0-9-]{0,61}[a-z0-9])?.
  std::string map_id;
  /// Edge of a lattice cell in nanometres, 1 to core::kMaxStepNm.
  int64_t step_nm = core::kDefaultStepNm;
  /// Edge of a tile in map units, rounded up to a power of two of steps from
  /// 2^kMinTileLevel to 2^core::kMaxTileLevel; larger is refused. 0:
  /// 2^kDefaultTileLevel steps.
  double tile_edge = 0;
  /// Free text of at most kMaxDisplayNameBytes.
  std::string display_name;
  /// Coordinate reference system, only ever looked into for warnings; at most
  /// kMaxCrsWktBytes. Empty: that of the first upload that names one.
  std::string crs_wkt;
  /// What robots call the map's frame: at most kMaxFrameIdBytes and no control
  /// characters. Empty: as crs_wkt.
  std::string frame_id;
};

struct MapInfo {
  std::string map_id;
  /// Hexadecimal; never used again, even for a map of this name.
  std::string uid;
  std::string display_name;
  int64_t step_nm = 0;
  int tile_level = 0;
  std::string crs_wkt;
  std::string frame_id;
  /// The newest revision; 1 is the empty map.
  int64_t revision = 0;
  /// The newest revision whose product is a result of the filter; 0: none.
  int64_t processed_revision = 0;
  absl::Time create_time;
  /// When the newest revision was committed.
  absl::Time update_time;
};

/// Counts by level of detail and label.
using LevelCounts = std::array<core::LabelCounts, core::kMaxDepth + 1>;

/// Counts and sizes of a map. Raw points, tiles and bytes are those of
/// `revision`, the rest those of `processed_revision`.
struct MapStats {
  int64_t revision = 0;
  /// 0: never processed, and the label counts are 0.
  int64_t processed_revision = 0;
  /// Points uploaded, duplicates included.
  int64_t raw_point_count = 0;
  /// What a query of the whole map returns: survivors of the filter without
  /// outliers.
  int64_t point_count = 0;
  /// point_count by label.
  core::LabelCounts label_counts{};
  /// The same of each level of detail; level 0 is label_counts.
  LevelCounts level_counts{};
  /// Survivors of the filter that are outliers.
  int64_t outlier_count = 0;
  /// The oldest revision that is not expired.
  int64_t oldest_revision = 0;
  /// Bytes of all blobs of the revision.
  int64_t stored_bytes = 0;
  /// Bytes of the blobs that only other revisions of the map refer to, the one
  /// of the product that queries read excepted.
  int64_t reclaimable_bytes = 0;
  /// Tiles that hold points.
  int64_t tile_count = 0;
  /// Tiles whose points changed since they were processed.
  int64_t stale_tile_count = 0;
  /// Nothing while there are no points.
  std::optional<Bounds> bounds;
  /// Attributes of the raw points, by name.
  std::vector<core::ColumnSpec> attributes;
  /// What the processed revision was made with.
  std::optional<core::SpdfOptions> options;
};

/// What made a revision.
enum class RevisionKind {
  kCreate,
  kUpload,
  kProcess,
  kDeleteRegion,
  kReplaceRegion,
  kRollback
};

struct RevisionInfo {
  int64_t number = 0;
  RevisionKind kind = RevisionKind::kCreate;
  absl::Time create_time;
  /// Its points are given up: it can only be listed.
  bool is_expired = false;
  /// Of kUpload and kReplaceRegion, else empty.
  std::string upload_id;
  /// Of kDeleteRegion and kReplaceRegion: what lost its points.
  std::optional<RegionShape> region;
  /// Of kProcess.
  std::optional<core::SpdfOptions> options;
  /// Of kRollback: the revision that it equals; else 0.
  int64_t restored_revision = 0;
  /// Raw points that it has and the revision before has not, and the other way
  /// round; of kRollback the difference of the two counts.
  int64_t added_point_count = 0;
  int64_t removed_point_count = 0;
  int64_t raw_point_count = 0;
  /// The processed revision that queries of this one answer from; 0: none.
  int64_t processed_revision = 0;
  /// What a query of the whole revision returns, and that by label.
  int64_t point_count = 0;
  core::LabelCounts label_counts{};
  /// Bytes of all blobs; most are shared with other revisions.
  int64_t stored_bytes = 0;
  int64_t tile_count = 0;
  int64_t stale_tile_count = 0;
};

/// What happened to the points of one kind in a tile.
enum class TileChangeKind {
  /// The same points, or none before and after.
  kNone,
  kAdded,
  kRemoved,
  kChanged
};

/// How a tile differs between two revisions.
struct TileChange {
  core::CellKey tile;
  TileChangeKind raw = TileChangeKind::kNone;
  /// Of what the filter made.
  TileChangeKind product = TileChangeKind::kNone;
  int64_t base_raw_point_count = 0;
  int64_t target_raw_point_count = 0;
  /// Survivors of the filter by label, outliers included.
  core::LabelCounts base_label_counts{};
  core::LabelCounts target_label_counts{};

  friend bool operator==(const TileChange&, const TileChange&) = default;
};

struct RevisionComparison {
  RevisionInfo base;
  RevisionInfo target;
  /// In Morton order. A page may hold fewer than asked for, even none.
  Page<TileChange> tiles;
};

// Uploads.

/// Largest block of an upload, encoded as well as decoded; a 32nd of
/// EngineOptions::memory_bytes if that is less.
inline constexpr int64_t kMaxUploadBlockBytes = int64_t{64} << 20;
/// Distinct attributes of a map.
inline constexpr size_t kMaxMapAttributes = 1000;
/// Names that begin so are the engine's own; no attribute may have one.
inline constexpr std::string_view kReservedAttributePrefix = "spdf.";

inline constexpr size_t kMaxUnitBytes = 64;

/// What is known of the file or sensor that the points of an upload come from.
struct UploadSource {
  /// Its CRS; as MapSpec::crs_wkt.
  std::string crs_wkt;
  /// Of its points; as MapSpec::frame_id.
  std::string frame_id;
  /// Unit of its horizontal coordinates: "metre", "foot", "degree", …; at most
  /// kMaxUnitBytes, no control characters. Empty: unknown.
  std::string unit;
  /// Step of its coordinates in its unit; 0: none or unknown.
  double coordinate_step = 0;

  friend bool operator==(const UploadSource&, const UploadSource&) = default;
};

/// An upload to be opened. Its bytes are point blocks of core/codec back to
/// back.
struct UploadSpec {
  /// [a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?.
  std::string upload_id;
  /// Bytes of the whole upload.
  int64_t expected_bytes = 0;
  /// ContentHash of all bytes.
  std::string content_hash;
  /// Points that the client left out, kept for the report.
  core::RefusedCounts refused;
  UploadSource source;

  friend bool operator==(const UploadSpec&, const UploadSpec&) = default;
};

/// How the points of an upload lie among each other and beside those that the
/// map had before: their sets, not how they were divided into uploads, blocks
/// and chunks, determine it.
struct PointCensus {
  /// Added points beyond the first of their lattice cell, which the filter
  /// takes for one.
  int64_t duplicate_point_count = 0;
  /// Lattice cells with added points that had a point before: by
  /// added_point_count less these two the distinct points of the map grow.
  /// Nothing: the map has more than kMaxComparedShare points in these tiles for
  /// each added one (point_census.h), or damaged chunks among them.
  std::optional<int64_t> overlapping_point_count;
  /// Octree level of the cells of the histogram.
  int density_cell_level = 0;
  /// Element i: cells that got 2^i to 2^(i+1) - 1 points, duplicates included;
  /// the last one is above 0.
  std::vector<int64_t> density_histogram;

  friend bool operator==(const PointCensus&, const PointCensus&) = default;
};

/// What may be wrong with an upload that was added nevertheless.
struct UploadWarning {
  /// A word for programs; upload_warnings.h lists them.
  std::string code;
  /// For people.
  std::string message;

  friend bool operator==(const UploadWarning&, const UploadWarning&) = default;
};

/// What finalizing an upload did.
struct UploadReport {
  /// The revision that added the points.
  int64_t revision = 0;
  int64_t added_point_count = 0;
  core::RefusedCounts refused;
  /// Raw points of the region that the upload replaced.
  int64_t removed_point_count = 0;
  /// Point blocks in the upload.
  int64_t block_count = 0;
  /// Tiles that got points.
  int64_t tile_count = 0;
  /// Of the added points; nothing if there were none.
  std::optional<Bounds> bounds;
  /// Nothing: a program that took none added the points.
  std::optional<PointCensus> census;
  /// In the order of upload_warnings.h.
  std::vector<UploadWarning> warnings;

  friend bool operator==(const UploadReport&, const UploadReport&) = default;
};

enum class UploadState {
  /// Takes bytes.
  kActive,
  /// Its points are being added.
  kFinalizing,
  /// Its points were added to the map.
  kFinalized,
  /// Its bytes cannot become points of the map.
  kFailed,
};

struct UploadInfo {
  UploadSpec spec;
  UploadState state = UploadState::kActive;
  /// Durable bytes; never decreases.
  int64_t committed_bytes = 0;
  absl::Time create_time;
  /// Once it is finalized.
  std::optional<UploadReport> report;
};

// Operations.

enum class OperationVerb {
  kFinalizeUpload,
  kProcessMap,
  kDeleteRegion,
  kRepairMap
};
enum class OperationState {
  kQueued,
  kRunning,
  kSucceeded,
  kFailed,
  kCancelled
};

/// What a run of the filter did.
struct ProcessReport {
  /// The revision that holds the result; that of the run before if nothing had
  /// to be done.
  int64_t revision = 0;
  /// Distinct lattice points of the map.
  int64_t distinct_point_count = 0;
  /// Survivors of the filter without outliers.
  int64_t point_count = 0;
  /// point_count by label.
  core::LabelCounts label_counts{};
  /// What a query of each level of detail returns, by label; level 0 is
  /// label_counts.
  LevelCounts level_counts{};
  /// Survivors of the filter that are outliers.
  int64_t outlier_count = 0;
  /// Of the runs that made the result, the most rounds.
  int round_count = 0;
  /// Tiles that this run filtered anew.
  int64_t updated_tile_count = 0;

  friend bool operator==(const ProcessReport&, const ProcessReport&) = default;
};

/// What deleting a region did.
struct DeleteReport {
  /// The revision without the points; the newest one if there were none.
  int64_t revision = 0;
  /// Raw points taken out; 0: no revision was made.
  int64_t removed_point_count = 0;
  /// Tiles that lost points.
  int64_t tile_count = 0;

  friend bool operator==(const DeleteReport&, const DeleteReport&) = default;
};

/// What repairing a map did.
struct RepairReport {
  /// Chunks, of all revisions, that were missing or not what was stored.
  int64_t damaged_chunk_count = 0;
  /// Of these, chunks that are there again, byte for byte.
  int64_t repaired_chunk_count = 0;
  /// Of these, chunks of raw points, which nothing makes again.
  int64_t raw_chunk_count = 0;
  /// Why one of the others could not be made again; empty if all were.
  std::string obstacle;

  friend bool operator==(const RepairReport&, const RepairReport&) = default;
};

/// Work that outlasts a call and a restart.
struct Operation {
  std::string operation_id;
  OperationVerb verb = OperationVerb::kProcessMap;
  std::string map_id;
  /// Of kFinalizeUpload, else empty.
  std::string upload_id;
  OperationState state = OperationState::kQueued;
  absl::Time create_time;
  std::optional<absl::Time> start_time;
  std::optional<absl::Time> end_time;
  /// Units of work finished and in all; done never decreases and never exceeds
  /// the total, which is 0 until it is known.
  int64_t done_work = 0;
  int64_t total_work = 0;
  bool cancel_requested = false;
  /// Not OK for kFailed and kCancelled.
  absl::Status error;
  /// Once it succeeded, the one of its verb.
  std::optional<UploadReport> upload_report;
  std::optional<ProcessReport> process_report;
  std::optional<DeleteReport> delete_report;
  std::optional<RepairReport> repair_report;

  bool done() const {
    return state != OperationState::kQueued &&
           state != OperationState::kRunning;
  }
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_TYPES_H_
