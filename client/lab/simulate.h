#ifndef MAPSIEVE_CLIENT_LAB_SIMULATE_H_
#define MAPSIEVE_CLIENT_LAB_SIMULATE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/formats/point_file.h"
#include "client/lab/spinning_scanner.h"
#include "core/base/executor.h"
#include "core/cloud/point_cloud.h"

/// A survey of a campus that does not exist: a lidar on a car that drives
/// through a Campus in a growing spiral, so that a larger survey is a larger
/// map of about the same density. 4.65 million points are about 260 x 200 m.
namespace mapsieve::client {

struct SimulateOptions {
  /// 0 to kMaxPointCount.
  int64_t point_count = 1'000'000;
  /// Another seed is another campus and another noise.
  uint64_t seed = 1;
  /// Standard deviation of ranges, 0 to 1.
  double range_noise_m = 0.012;
  /// Share of returns that come from nothing, 0 to 1; class 7.
  double spurious_share = 0.002;
  /// 5 to 300.
  double max_range_m = 100;
  /// The scanner turns all the time, and of the drive one rotation is kept
  /// every so many metres, kMinRotationSpacing to 1000: more is a sparser map
  /// of more ground.
  double rotation_spacing_m = 3.5;

  static constexpr int64_t kMaxPointCount = 1'000'000'000'000;
  /// The way of one rotation.
  static constexpr double kMinRotationSpacing = 0.5;

  /// kInvalidArgument naming the field, its value and its limits.
  absl::Status Validate() const;

  friend bool operator==(const SimulateOptions&,
                         const SimulateOptions&) = default;
};

/// Takes a survey in batches. The points of given options are always the same,
/// in the same order, however large the batches; memory depends on the range
/// and the batch alone.
///
/// Positions are metres around (331000, 5183000, 90), as in a UTM zone, with
/// the streets at an angle to the axes. Attributes of a point:
/// * `classification`, uint8: an ObjectClass. 2 ground, 5 trees, 6 buildings,
///   7 spurious returns, and of the codes left to users 64 poles, 65 cars.
/// * `gps_time`, float64: seconds since the start of the drive; never
///   decreases.
/// * `intensity`, uint16: 65535 for a white surface at normal incidence.
/// * `point_source_id`, uint16: number of the rotation, modulo 65536.
/// * `truth`, uint8: the core::Label that the geometry deserves.
///
/// Not thread-safe.
class CampusScanner {
 public:
  /// kInvalidArgument as in SimulateOptions::Validate.
  static absl::StatusOr<CampusScanner> Create(const SimulateOptions& options);

  CampusScanner(CampusScanner&& other) noexcept;
  CampusScanner& operator=(CampusScanner&& other) noexcept;
  ~CampusScanner();

  static std::vector<core::ColumnSpec> AttributeSpecs();

  /// The next points, at most `max_points`; none once point_count of them were
  /// given. kInvalidArgument: max_points is 0.
  absl::StatusOr<core::PointCloud> NextBatch(size_t max_points);

  /// Way and time of rotation `index` (>= 0), in the frame of the points: the
  /// exact trajectory.
  ScannerRotation Rotation(int64_t index) const;

 private:
  struct State;
  explicit CampusScanner(std::unique_ptr<State> state);

  std::unique_ptr<State> state_;
};

/// No points, with the columns of CampusScanner::AttributeSpecs.
core::PointCloud EmptySurvey();

/// Appends a return at `position` to a survey that EmptySurvey began.
void AppendReturn(const ScannerReturn& echo, const core::Point3& position,
                  const ScannerRotation& rotation, core::PointCloud& survey);

/// What a writer of a simulated survey is to be created with.
WriteOptions SimulatedWriteOptions();

/// Writes the survey to `writer`, created with SimulatedWriteOptions, and
/// finishes it. Reports progress in points. kInvalidArgument as in
/// SimulateOptions::Validate; kCancelled; the writer's errors.
absl::Status Simulate(const SimulateOptions& options, PointWriter& writer,
                      const ExecutionContext& context = {});

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SIMULATE_H_
