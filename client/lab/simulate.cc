#include "client/lab/simulate.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lab/campus.h"
#include "client/lab/scene.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

using core::Point3;

constexpr double kDriveSpeed = 5;
constexpr double kScannerHeight = 1.8;
constexpr size_t kWriteBatch = 1 << 16;
/// The campus' origin on the map, and the angle of its streets.
constexpr Point3 kMapOrigin = {331000, 5183000, 90};
constexpr double kStreetAngle = 0.3;

static_assert(kDriveSpeed * SpinningScanner::kRotationTime <=
              SimulateOptions::kMinRotationSpacing);

absl::Status CheckRange(absl::string_view field, double value, double low,
                        double high) {
  // Written so that NaN fails.
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, "; expected ", low, " to ", high));
}

}  // namespace

absl::Status SimulateOptions::Validate() const {
  if (point_count < 0 || point_count > kMaxPointCount) {
    return absl::InvalidArgumentError(absl::StrCat(
        "point_count is ", point_count, "; expected 0 to ", kMaxPointCount));
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("range_noise_m", range_noise_m, 0, 1));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("spurious_share", spurious_share, 0, 1));
  MAPSIEVE_RETURN_IF_ERROR(CheckRange("max_range_m", max_range_m, 5, 300));
  return CheckRange("rotation_spacing_m", rotation_spacing_m,
                    kMinRotationSpacing, 1000);
}

struct CampusScanner::State {
  explicit State(const SimulateOptions& o)
      : options(o),
        campus(o.seed),
        scanner({.seed = o.seed,
                 .max_range_m = o.max_range_m,
                 .range_noise_m = o.range_noise_m,
                 .spurious_share = o.spurious_share}) {
    StartRotation(0);
  }

  /// In the frame of the campus.
  Point3 ScannerPosition(double distance) const {
    Point3 p = SpiralDrive(distance);
    p.z = campus.TerrainHeight(p.x, p.y) + kScannerHeight;
    return p;
  }

  ScannerRotation CampusRotation(int64_t index) const {
    const double distance =
        static_cast<double>(index) * options.rotation_spacing_m;
    ScannerRotation result;
    result.index = index;
    result.start = ScannerPosition(distance);
    const Point3 end = ScannerPosition(
        distance + kDriveSpeed * SpinningScanner::kRotationTime);
    result.velocity = {
        (end.x - result.start.x) / SpinningScanner::kRotationTime,
        (end.y - result.start.y) / SpinningScanner::kRotationTime,
        (end.z - result.start.z) / SpinningScanner::kRotationTime};
    result.start_time_s = distance / kDriveSpeed;
    return result;
  }

  /// Turns to rotation `index` and makes the world around it.
  void StartRotation(int64_t index) {
    rotation = CampusRotation(index);
    next_pulse = 0;
    const auto x =
        static_cast<int64_t>(std::floor(rotation.start.x / Campus::kBlockX));
    const auto y =
        static_cast<int64_t>(std::floor(rotation.start.y / Campus::kBlockY));
    if (scene && x == block_x && y == block_y) return;
    block_x = x;
    block_y = y;
    scene.emplace(campus.Surroundings(x, y, options.max_range_m));
  }

  core::Vector3 ToMapDirection(const core::Vector3& v) const {
    return {street_cos * v[0] - street_sin * v[1],
            street_sin * v[0] + street_cos * v[1], v[2]};
  }
  Point3 ToMap(const Point3& p) const {
    const core::Vector3 v = ToMapDirection({p.x, p.y, p.z});
    return {kMapOrigin.x + v[0], kMapOrigin.y + v[1], kMapOrigin.z + v[2]};
  }

  const SimulateOptions options;
  const Campus campus;
  const SpinningScanner scanner;
  const double street_cos = std::cos(kStreetAngle);
  const double street_sin = std::sin(kStreetAngle);
  int64_t given_count = 0;
  ScannerRotation rotation;
  int next_pulse = 0;
  std::optional<Scene> scene;
  int64_t block_x = 0;
  int64_t block_y = 0;
};

CampusScanner::CampusScanner(std::unique_ptr<State> state)
    : state_(std::move(state)) {}
CampusScanner::CampusScanner(CampusScanner&& other) noexcept = default;
CampusScanner& CampusScanner::operator=(CampusScanner&& other) noexcept =
    default;
CampusScanner::~CampusScanner() = default;

absl::StatusOr<CampusScanner> CampusScanner::Create(
    const SimulateOptions& options) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  return CampusScanner(std::make_unique<State>(options));
}

std::vector<core::ColumnSpec> CampusScanner::AttributeSpecs() {
  return {{"intensity", core::ScalarType::kUint16},
          {"classification", core::ScalarType::kUint8},
          {"point_source_id", core::ScalarType::kUint16},
          {"gps_time", core::ScalarType::kFloat64},
          {"truth", core::ScalarType::kUint8}};
}

absl::StatusOr<core::PointCloud> CampusScanner::NextBatch(size_t max_points) {
  if (max_points == 0) {
    return absl::InvalidArgumentError("max_points is 0; expected at least 1");
  }
  State& s = *state_;
  const auto rest =
      static_cast<uint64_t>(s.options.point_count - s.given_count);
  const uint64_t count = std::min<uint64_t>(max_points, rest);
  core::PointCloud batch = EmptySurvey();
  while (batch.size() < count) {
    if (s.next_pulse == SpinningScanner::kPulseCount) {
      s.StartRotation(s.rotation.index + 1);
    }
    const auto echo = s.scanner.Fire(*s.scene, s.rotation, s.next_pulse++);
    if (!echo) continue;
    AppendReturn(*echo, s.ToMap(echo->position), s.rotation, batch);
  }
  s.given_count += static_cast<int64_t>(count);
  return batch;
}

ScannerRotation CampusScanner::Rotation(int64_t index) const {
  ScannerRotation rotation = state_->CampusRotation(index);
  rotation.start = state_->ToMap(rotation.start);
  rotation.velocity = state_->ToMapDirection(rotation.velocity);
  return rotation;
}

core::PointCloud EmptySurvey() {
  core::PointCloud survey;
  for (const core::ColumnSpec& spec : CampusScanner::AttributeSpecs()) {
    survey.attributes.columns().push_back(core::Column(spec));
  }
  return survey;
}

void AppendReturn(const ScannerReturn& echo, const core::Point3& position,
                  const ScannerRotation& rotation, core::PointCloud& survey) {
  auto& columns = survey.attributes.columns();
  survey.positions.push_back(position);
  columns[0].Append(static_cast<uint16_t>(std::lround(echo.intensity * 65535)));
  columns[1].Append(static_cast<uint8_t>(echo.object));
  columns[2].Append(static_cast<uint16_t>(rotation.index & 0xffff));
  columns[3].Append(echo.time_s);
  columns[4].Append(static_cast<uint8_t>(echo.truth));
}

WriteOptions SimulatedWriteOptions() {
  WriteOptions options;
  options.attributes = CampusScanner::AttributeSpecs();
  options.origin = kMapOrigin;
  return options;
}

absl::Status Simulate(const SimulateOptions& options, PointWriter& writer,
                      const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(CampusScanner scanner,
                            CampusScanner::Create(options));
  int64_t done = 0;
  while (done < options.point_count) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud batch,
                              scanner.NextBatch(kWriteBatch));
    MAPSIEVE_RETURN_IF_ERROR(writer.Write(batch));
    done += static_cast<int64_t>(batch.size());
    context.ReportProgress(done, options.point_count);
  }
  return writer.Finish();
}

}  // namespace mapsieve::client
