#ifndef MAPSIEVE_CLIENT_API_MAP_TYPES_H_
#define MAPSIEVE_CLIENT_API_MAP_TYPES_H_

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/time/time.h"
#include "core/cloud/column.h"
#include "core/cloud/label.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/lattice.h"

/// What the client library's calls take and return. Lengths are in map units,
/// metres unless the map's coordinate reference system says otherwise.
namespace mapsieve::client {

/// A map to create.
struct MapSpec {
  /// [a-z]([a-z0-9-]{0,61}[a-z0-9])?
  std::string id;
  /// Edge of a lattice cell in nanometres of the map unit.
  int64_t step_nm = core::kDefaultStepNm;
  /// Edge of a processing tile; rounded up to a power of two of steps. 0: the
  /// server's default, 2^15 steps.
  double tile_edge = 0;
  std::string display_name;
  /// WKT, "EPSG:n", or "EPSG:n+m" with m for heights; empty: that of the first
  /// upload that names one.
  std::string crs_wkt;
  /// What robots call the map's frame; empty: as crs_wkt.
  std::string frame_id;
};

struct MapInfo {
  std::string id;
  /// Never used again, even for a map of the same id.
  std::string uid;
  std::string display_name;
  int64_t step_nm = 0;
  int tile_level = 0;
  /// Empty in lists.
  std::string crs_wkt;
  std::string frame_id;
  int64_t revision = 0;
  /// Newest revision that the filter has processed; 0: none.
  int64_t processed_revision = 0;
};

/// Closed box of positions.
struct Bounds {
  core::Point3 min;
  core::Point3 max;
};

/// Parameters of the filter; an unset one takes its default. See
/// proto/mapsieve/v1/types.proto for their ranges.
struct ProcessOptions {
  std::optional<double> vote_scale_m2;
  std::optional<double> density_radius_m;
  std::optional<int> neighbor_count;
  std::optional<int> label_neighbor_count;
  std::optional<double> reach_m;
  std::optional<int> max_round_count;
  /// Rule quota instead of paper.
  std::optional<bool> quota_rule;
  std::optional<int64_t> seed;
  std::optional<double> outlier_share;

  friend bool operator==(const ProcessOptions&,
                         const ProcessOptions&) = default;
};

/// Counts and sizes of a map's newest revision.
struct MapStats {
  int64_t revision = 0;
  int64_t processed_revision = 0;
  int64_t raw_point_count = 0;
  /// Points that a query of the whole map returns.
  int64_t point_count = 0;
  core::LabelCounts label_counts{};
  /// The same of each level of detail, from label_counts on.
  std::vector<core::LabelCounts> level_counts;
  int64_t outlier_count = 0;
  int64_t stored_bytes = 0;
  /// What is freed once all older revisions, but the processed one, expired.
  int64_t reclaimable_bytes = 0;
  /// The oldest revision that has not expired.
  int64_t oldest_revision = 0;
  int64_t tile_count = 0;
  int64_t stale_tile_count = 0;
  std::optional<Bounds> bounds;
  std::vector<core::ColumnSpec> attributes;
  std::optional<ProcessOptions> options;
};

/// What is known of the file or sensor that points come from.
struct UploadSource {
  std::string crs_wkt;
  std::string frame_id;
  /// Of the horizontal coordinates: "metre", "foot", "US survey foot",
  /// "degree" or another name.
  std::string unit;
  /// In that unit; 0: none.
  double coordinate_step = 0;
};

/// How the points of an upload lie among each other and in the map before.
struct PointCensus {
  /// Added points beyond the first of their lattice cell.
  int64_t duplicate_point_count = 0;
  /// Lattice cells that got points and had some before; nothing: not counted.
  std::optional<int64_t> overlapping_point_count;
  /// log2 of the edge of the cells of the histogram in steps.
  int density_cell_level = 0;
  /// Element i: cells that got 2^i to 2^(i+1) - 1 points.
  std::vector<int64_t> density_histogram;
};

/// What may be wrong with an upload.
struct UploadWarning {
  /// proto/mapsieve/v1/upload_service.proto lists them.
  std::string code;
  std::string message;
};

/// What became of an upload.
struct UploadReport {
  int64_t revision = 0;
  int64_t added_point_count = 0;
  int64_t refused_non_finite_count = 0;
  int64_t refused_out_of_lattice_count = 0;
  /// Raw points of the region that was replaced.
  int64_t removed_point_count = 0;
  int64_t tile_count = 0;
  std::optional<Bounds> bounds;
  /// Nothing: of an earlier version of the server.
  std::optional<PointCensus> census;
  std::vector<UploadWarning> warnings;
  /// The same points had been uploaded before: nothing was added now.
  bool already_there = false;
  /// Bytes of the upload, and how many of them were sent by this call.
  int64_t upload_bytes = 0;
  int64_t sent_bytes = 0;
};

struct ProcessReport {
  int64_t revision = 0;
  int64_t distinct_point_count = 0;
  int64_t point_count = 0;
  core::LabelCounts label_counts{};
  int64_t outlier_count = 0;
  int round_count = 0;
  /// Tiles that the run filtered anew.
  int64_t updated_tile_count = 0;
};

/// Axis-aligned box, min <= p < max.
struct BoxRegion {
  core::Point3 min;
  core::Point3 max;
};

/// Closed ball.
struct SphereRegion {
  core::Point3 center;
  double radius = 0;
};

/// A part of a map, or nothing.
using Region = std::variant<std::monostate, BoxRegion, SphereRegion>;

/// A rotation as a unit quaternion, from a shape's own frame to the map's.
struct Quaternion {
  double x = 0;
  double y = 0;
  double z = 0;
  double w = 1;
};

/// Rotated box, closed.
struct OrientedBoxRegion {
  core::Point3 center;
  Quaternion orientation;
  core::Point3 half_size;
};

/// Upright cylinder, closed; unset limits of z: none.
struct CylinderRegion {
  double center_x = 0;
  double center_y = 0;
  double radius = 0;
  std::optional<double> min_z;
  std::optional<double> max_z;
};

/// Upright prism over a simple polygon of 3 to 1000 vertices, min_z <= z <
/// max_z; its edge is inside on the sides of smaller x and y.
struct PolygonRegion {
  struct Vertex {
    double x = 0;
    double y = 0;
  };
  std::vector<Vertex> vertices;
  std::optional<double> min_z;
  std::optional<double> max_z;
};

/// What a camera (x right, y down, z forward) sees from `near` to `far`,
/// closed. `half_width` and `half_height` are tangents of half the angles of
/// view.
struct FrustumRegion {
  core::Point3 position;
  Quaternion orientation;
  double half_width = 0;
  double half_height = 0;
  double near = 0;
  double far = 0;
};

/// Everything within `radius` of a path of 2 to 1000 points, closed.
struct CorridorRegion {
  std::vector<core::Point3> path;
  double radius = 0;
};

/// What a query may ask for: a part of a map, or all of it.
using QueryRegion =
    std::variant<std::monostate, BoxRegion, SphereRegion, OrientedBoxRegion,
                 CylinderRegion, PolygonRegion, FrustumRegion, CorridorRegion>;

/// What deleting a region did.
struct DeleteReport {
  /// The revision without the points; the newest one if there were none.
  int64_t revision = 0;
  /// 0: no revision was made.
  int64_t removed_point_count = 0;
  /// Tiles that lost points.
  int64_t tile_count = 0;
};

enum class RevisionKind {
  /// Of a newer server.
  kUnknown,
  kCreate,
  kUpload,
  kProcess,
  kDeleteRegion,
  kReplaceRegion,
  kRollback,
};

/// A committed state of a map, and what made it.
struct RevisionInfo {
  int64_t number = 0;
  RevisionKind kind = RevisionKind::kUnknown;
  absl::Time create_time;
  /// It cannot be queried, compared or rolled back to any more.
  bool is_expired = false;
  /// Of kUpload and kReplaceRegion.
  std::string upload_id;
  /// Of kDeleteRegion and kReplaceRegion.
  Region region;
  /// Of kProcess.
  std::optional<ProcessOptions> options;
  /// Of kRollback: the revision that it equals.
  int64_t restored_revision = 0;
  /// Of kRollback the difference of the counts.
  int64_t added_point_count = 0;
  int64_t removed_point_count = 0;
  int64_t raw_point_count = 0;
  /// That queries of this one answer from; 0: none.
  int64_t processed_revision = 0;
  /// Points that a query of the whole revision returns.
  int64_t point_count = 0;
  core::LabelCounts label_counts{};
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
  kChanged,
};

/// How a tile differs between two revisions.
struct TileChange {
  /// It holds the lattice points q with q >> MapInfo::tile_level equal to this.
  core::LatticePoint tile;
  TileChangeKind raw = TileChangeKind::kNone;
  TileChangeKind product = TileChangeKind::kNone;
  int64_t base_raw_point_count = 0;
  int64_t target_raw_point_count = 0;
  /// Outliers included.
  core::LabelCounts base_label_counts{};
  core::LabelCounts target_label_counts{};
};

/// Two revisions compared.
struct ComparedRevisions {
  RevisionInfo base;
  RevisionInfo target;
};

/// A stored chunk that is missing, or not what was stored.
struct DamagedChunk {
  /// "raw", "product" or "history".
  std::string content;
  /// As in TileChange.
  core::LatticePoint tile;
  /// Names the stored object.
  std::string blob_id;
  /// Map, revision, tile, chunk, file, offset, what was expected and what was
  /// found.
  std::string problem;
};

/// A tile whose product is not what the filter makes of its points.
struct DifferingTile {
  core::LatticePoint tile;
  /// What differs first.
  std::string difference;
};

/// What MapClient::Verify found.
struct VerifyReport {
  /// Chunks read, of all revisions, and their bytes.
  int64_t chunk_count = 0;
  int64_t stored_bytes = 0;
  std::vector<DamagedChunk> damaged_chunks;
  int64_t compared_tile_count = 0;
  /// Survivors of the filter in the tiles compared.
  int64_t compared_point_count = 0;
  std::vector<DifferingTile> differing_tiles;
  /// Tiles that were not compared: too many points for the server's memory, or
  /// damaged ones.
  int64_t skipped_tile_count = 0;
};

/// What MapClient::Repair did.
struct RepairReport {
  /// Chunks, of all revisions, that were missing or not what was stored.
  int64_t damaged_chunk_count = 0;
  /// Of these, chunks that are there again, byte for byte.
  int64_t repaired_chunk_count = 0;
  /// Of these, chunks of raw points, which nothing makes again.
  int64_t raw_chunk_count = 0;
  /// Why one of the others could not be made again; empty if all were.
  std::string obstacle;
};

/// What the filter says of a point; the answer's columns for each are named in
/// proto/mapsieve/v1/query_service.proto.
enum class FilterColumn {
  kLabel = 1,
  kConfidence = 2,
  kNormal = 3,
  kTangent = 4,
  kEigenvalues = 5,
  kSaliencies = 6,
  kCovariance = 7,
};

struct ColumnSelection {
  std::vector<FilterColumn> filter_columns;
  std::vector<std::string> attributes;
  bool all_attributes = false;
};

/// A closed range; points without a value are in none.
struct ValueRange {
  std::optional<double> min;
  std::optional<double> max;
};

/// Points whose attribute `name` is in `range`.
struct AttributeRange {
  std::string name;
  ValueRange range;
};

/// Shares of a budget by label, in proportion; each above 0.
struct LabelWeights {
  double junction = 1;
  double curve = 1;
  double surface = 1;
};

/// Points wanted of a map.
struct QuerySpec {
  std::string map_id;
  /// 0: the newest processed one, or with `raw` the newest one.
  int64_t revision = 0;
  /// Nothing: the whole map.
  QueryRegion region;
  /// Empty: all.
  std::vector<core::Label> labels;
  /// Nothing: any. Not with `raw`.
  std::optional<ValueRange> confidence;
  /// A point must be in all of them; at most 16.
  std::vector<AttributeRange> attribute_ranges;
  /// A level of detail, 0 (all points) to 10. Not with `raw`.
  int depth = 0;
  /// If above 0, the coarsest level of detail with at most this mean spacing
  /// on surfaces, in map units. Not with `depth` or `raw`.
  double spacing_m = 0;
  /// At most this many points, spread evenly over each label; 0: no limit.
  int64_t max_point_count = 0;
  /// At most this many bytes of point blocks, and at least 95 % of it where
  /// there are as many points; at least 65536, or 0: no limit.
  int64_t max_bytes = 0;
  /// Nothing: shares by the labels' numbers of points. Only with a budget.
  std::optional<LabelWeights> label_weights;
  /// Nothing: label, confidence, normal and all attributes.
  std::optional<ColumnSelection> columns;
  /// The points as they were uploaded.
  bool raw = false;
  /// Centroids instead of the points nearest to them, under a budget.
  bool centroids = false;
  /// Damaged chunks are left out and told of in the summary; else they are
  /// kDataLoss.
  bool allow_partial = false;
  /// Larger point blocks, which are quicker to make and to read: for a fast
  /// network.
  bool plain_blocks = false;
};

/// What to bring of a map: see Chunk.
struct SyncSpec {
  /// The region chooses tiles, whose chunks hold all their points that the
  /// other members ask for, in the region or not. Without a budget and
  /// allow_partial.
  QuerySpec query;
  /// Of whatever query and revision; at most 65 536.
  std::vector<std::string> held_chunk_ids;
};

/// What a query gives of one tile of a map.
struct SyncChunk {
  /// 32 hexadecimal digits; it changes with anything that the points depend on.
  std::string id;
  core::CellKey tile;
  /// Perhaps none.
  core::LatticeCloud points;
};

struct SyncSummary {
  /// Revision that all chunks are of, those held included.
  int64_t revision = 0;
  /// Chunks of the region, those held included.
  int64_t chunk_count = 0;
  /// Held chunks that are not the region's, or not any more.
  std::vector<std::string> dropped_chunk_ids;
};

/// What the answer to a query has in common.
struct QueryHeader {
  int64_t revision = 0;
  int64_t step_nm = 0;
  std::vector<core::ColumnSpec> columns;
  /// Points to come at most.
  int64_t candidate_point_count = 0;
};

/// The end of a complete answer.
struct QuerySummary {
  int64_t point_count = 0;
  core::LabelCounts label_counts{};
  /// Bytes of the point blocks.
  int64_t block_bytes = 0;
  /// What region and filters leave, before a budget; and by label.
  int64_t available_point_count = 0;
  core::LabelCounts available_label_counts{};
  /// With allow_partial: chunks left out that may hold points asked for, and
  /// all their points with the labels asked for.
  int64_t missing_chunk_count = 0;
  int64_t missing_point_count = 0;
  /// The first 1000 of these chunks.
  std::vector<DamagedChunk> missing_chunks;
};

/// Work that goes on in the server.
struct OperationInfo {
  std::string id;
  /// "maps/{map}" or the name of an upload.
  std::string target;
  /// "ProcessMap", "FinalizeUpload", "DeleteRegion" or "RepairMap".
  std::string verb;
  bool done = false;
  int64_t done_work = 0;
  /// 0 until known.
  int64_t total_work = 0;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_API_MAP_TYPES_H_
