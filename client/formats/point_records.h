#ifndef MAPSIEVE_CLIENT_FORMATS_POINT_RECORDS_H_
#define MAPSIEVE_CLIENT_FORMATS_POINT_RECORDS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/formats/file_input.h"
#include "client/formats/point_file.h"
#include "core/cloud/column.h"
#include "core/cloud/point_cloud.h"

/// What PCD and PLY share: a text header that names the values of a point, then
/// a declared number of points, in text or in binary records.
namespace mapsieve::client {

/// Headers beyond this many bytes are refused.
inline constexpr int64_t kMaxHeaderBytes = int64_t{1} << 20;

/// One value of a point and where it lies.
struct PointValue {
  std::string name;
  core::ScalarType type = core::ScalarType::kFloat32;
  /// Binary: offset of the first point's value. Text: index of its word.
  size_t at = 0;
  /// Binary: bytes from one point's value to the next one's.
  size_t stride = 0;
};

/// Which values are the position and which are attributes, and the way from
/// the bytes or words of a file to the columns of a batch. Thread-safe once
/// created.
class PointLayout {
 public:
  /// `values` in file order. Positions are the values x, y, z of any type, or
  /// X, Y, Z where there is no such lower-case name; all others are attributes.
  /// kInvalidArgument, naming `file_name`: no x, y or z, or attributes that
  /// CheckAttributes refuses.
  static absl::StatusOr<PointLayout> Create(std::vector<PointValue> values,
                                            std::string_view file_name);

  std::vector<core::ColumnSpec> attributes() const;

  /// `size` points at the origin, all attributes zero.
  core::PointCloud MakeBatch(size_t size) const;

  /// Copies points [first, first + count) of `data` to the rows of `batch` from
  /// `row` on; the caller guarantees the sizes. `swap`: the bytes are
  /// big-endian. Bit patterns of attributes are kept.
  void Decode(const std::byte* data, size_t first, size_t count, bool swap,
              size_t row, core::PointCloud& batch) const;

  /// Parses the words of one point to `row` of `batch`, positions as double
  /// whatever their type. The value whose word is no number of its type, or
  /// nullptr.
  const PointValue* Parse(std::span<const std::string_view> words, size_t row,
                          core::PointCloud& batch) const;

 private:
  std::array<PointValue, 3> position_;
  std::vector<PointValue> attributes_;
};

/// Reads as many points as the header declares.
class RecordReader : public PointReader {
 public:
  const PointFileInfo& info() const final { return info_; }
  absl::StatusOr<core::PointCloud> ReadBatch(size_t max_points) final;

 protected:
  /// `info` lacks what the others tell; `count` >= 0.
  RecordReader(PointFileInfo info, PointLayout layout, int64_t count);

  const PointLayout& layout() const { return layout_; }
  /// Fills `batch`, which has `count` rows, with the points from `first` on.
  virtual absl::Status ReadRows(size_t first, size_t count,
                                core::PointCloud& batch) = 0;

 private:
  PointFileInfo info_;
  PointLayout layout_;
  size_t count_;
  size_t done_ = 0;
};

/// The words of a point in a text file: one line a point, blank lines skipped.
struct TextRecord {
  /// One entry a declared value: whether it is a list, that is a word saying
  /// how many words follow. PointValue::at does not count lists. A line may end
  /// where a list would begin: the list is empty then.
  std::vector<bool> is_list;
  /// Commas separate words as blanks do.
  bool commas = false;
};

/// `info` as for RecordReader; `cursor` stands at the first point. kDataLoss if
/// the rest of the file is too short for `count` points.
absl::StatusOr<std::unique_ptr<PointReader>> MakeTextReader(PointFileInfo info,
                                                            PointLayout layout,
                                                            int64_t count,
                                                            InputCursor cursor,
                                                            TextRecord record);

/// `info` as for RecordReader; `cursor` stands at the first point; every one
/// has `record_bytes` (> 0), big-endian if `swap`. kDataLoss if the file is too
/// short.
absl::StatusOr<std::unique_ptr<PointReader>> MakeBinaryReader(
    PointFileInfo info, PointLayout layout, int64_t count, InputCursor cursor,
    size_t record_bytes, bool swap);

/// kDataLoss if fewer than `count` times `bytes` (> 0) follow.
absl::Status CheckPointsFit(const InputCursor& cursor, int64_t count,
                            size_t bytes);

/// An attribute and its place in a written file.
struct WrittenValue {
  core::ColumnSpec spec;
  /// Name in the file: one word.
  std::string name;
  /// The spec's type, or float64 for a 64-bit integer.
  core::ScalarType type = core::ScalarType::kFloat32;
};

/// `attributes` with names that are one word each: blanks and control
/// characters become "_". kInvalidArgument: CheckAttributes refuses these
/// names.
absl::StatusOr<std::vector<WrittenValue>> NameWrittenValues(
    const std::filesystem::path& path,
    const std::vector<core::ColumnSpec>& attributes);

/// Type of x, y and z in a file of records.
inline core::ScalarType TypeOfPositions(const WriteOptions& options) {
  return options.float_positions ? core::ScalarType::kFloat32
                                 : core::ScalarType::kFloat64;
}

/// Blanks that bring any non-negative number to the length of the longest.
std::string CountPadding(int64_t count);

/// Writes `header` of the number of points, then little-endian records: x, y, z
/// of type `position` (kFloat32 or kFloat64), then `values`. `header` gives
/// texts of one length. Missing values become NaN where the type in the file is
/// floating, else 0. Write refuses with kInvalidArgument, and writes nothing
/// of, a batch that MatchColumns refuses or that holds a 64-bit integer which
/// float64 cannot.
absl::StatusOr<std::unique_ptr<PointWriter>> MakeRecordWriter(
    const std::filesystem::path& path, core::ScalarType position,
    std::vector<WrittenValue> values,
    std::function<std::string(int64_t)> header);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_POINT_RECORDS_H_
