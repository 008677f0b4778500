#ifndef MAPSIEVE_CLIENT_FORMATS_POINT_FILE_H_
#define MAPSIEVE_CLIENT_FORMATS_POINT_FILE_H_

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"

/// Files of points: LAS, PCD, PLY, CSV/XYZ and legacy ASCII VTK read, LAS, PCD,
/// PLY and CSV written, all streaming: memory is bounded by the batch, never by
/// the file.
namespace mapsieve::client {

/// What a file tells about itself before its points.
struct PointFileInfo {
  /// "LAS 1.2", "PCD binary", … for people.
  std::string format;
  /// Points that the file declares; nothing if only reading tells (CSV).
  std::optional<int64_t> point_count;
  /// Attributes of every batch, in file order; x, y, z are not among them.
  std::vector<core::ColumnSpec> attributes;
  /// Coordinate reference system as WKT, or "EPSG:n" or "EPSG:n+m" (m: heights)
  /// where the file gives only codes; empty if it names none.
  std::string crs_wkt;
  /// What the file tells of its CRS and crs_wkt does not, and why, for people;
  /// empty: nothing.
  std::string crs_problem;
  /// What robots call the frame of the points; PLY and PCD may name it.
  std::string frame_id;
  /// Of the horizontal coordinates where the file tells it: a name of
  /// core/geometry/crs.h or another one; else empty.
  std::string unit;
  /// Smallest coordinate step that the file can hold (LAS scale), in map
  /// units; 0 if it holds floating point.
  double coordinate_step = 0;
};

/// Reads a file front to back. Not thread-safe.
class PointReader {
 public:
  virtual ~PointReader() = default;
  virtual const PointFileInfo& info() const = 0;

  /// The next points, at most `max_points` (> 0) of them, in file order; an
  /// empty batch at the end. The batches of a file have the same attribute
  /// columns. kDataLoss where the file is damaged or ends early, naming file,
  /// offset or line, expected and actual.
  virtual absl::StatusOr<core::PointCloud> ReadBatch(size_t max_points) = 0;
};

struct ReadOptions {
  /// Column names of a CSV or XYZ file, also in place of its header line;
  /// empty: those of the file, or x, y, z, then c3, c4, ….
  std::vector<std::string> column_names;
};

/// Opens `path`, judging by its first bytes and then by its extension.
/// kNotFound, kPermissionDenied: the file; kUnimplemented: a format that is
/// known and not read (LAZ, E57, PTS, PTX), with a hint; kInvalidArgument: a
/// file of a known format without what is needed (no z, x y z in one field);
/// kDataLoss: a damaged header, an empty file. The other functions of this
/// header return these errors too.
absl::StatusOr<std::unique_ptr<PointReader>> OpenPointFile(
    const std::filesystem::path& path, const ReadOptions& options = {});

/// Writes a file front to back. A file appears under its name only when
/// Finish succeeded; without Finish nothing is left. Not thread-safe.
class PointWriter {
 public:
  virtual ~PointWriter() = default;
  /// Appends points whose attributes have the specs given at creation, in any
  /// order. Missing values are written as the format's "no value" (NaN, empty
  /// field) where it has one, else as 0. kInvalidArgument: other attributes, or
  /// a value that the format cannot hold; the batch is not written then.
  /// kResourceExhausted: the disk is full.
  virtual absl::Status Write(const core::PointCloud& batch) = 0;
  /// Completes the file and gives it its name. Call it once, last.
  virtual absl::Status Finish() = 0;
};

struct WriteOptions {
  std::vector<core::ColumnSpec> attributes;
  /// Step of the coordinates in map units: LAS scale, CSV decimals.
  double coordinate_step = 0.001;
  /// A point near the data, for the offset of LAS; (0, 0, 0): it is taken from
  /// the first batch. No format shifts the points by it.
  core::Point3 origin;
  /// As in PointFileInfo. LAS keeps any CRS, as WKT, and no frame; PLY and PCD
  /// keep the frame, and a CRS that has at most 900 bytes or bears codes of
  /// EPSG, in comments.
  std::string crs_wkt;
  std::string frame_id;
  /// PCD and PLY: coordinates as float32, which many readers insist on. At a
  /// kilometre from zero that is 0.06 mm, at a thousand kilometres 6 cm.
  bool float_positions = false;
};

/// Creates the writer that the extension asks for: .las, .pcd (binary), .ply
/// (binary little-endian, positions as double), .csv, .xyz or .txt.
/// kInvalidArgument: another extension; kUnimplemented: .laz and other formats
/// that are known and not written.
absl::StatusOr<std::unique_ptr<PointWriter>> CreatePointFile(
    const std::filesystem::path& path, const WriteOptions& options);

/// The whole file in memory, for data that is known to fit.
absl::StatusOr<core::PointCloud> ReadPointFile(
    const std::filesystem::path& path, const ReadOptions& options = {});

/// Writes `cloud` as one file; options.attributes are those of `cloud`,
/// whatever is given.
absl::Status WritePointFile(const std::filesystem::path& path,
                            const core::PointCloud& cloud,
                            WriteOptions options = {});

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_POINT_FILE_H_
