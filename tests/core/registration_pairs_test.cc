// Recorded pairs of scans with known poses: cut down to a budget by the filter,
// as a client gets them, and registered from a disturbed pose.
#include <array>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <string>
#include <vector>

#include "client/formats/point_file.h"
#include "core/geometry/octahedral.h"
#include "core/registration/icp.h"
#include "core/registration/label_covariance.h"
#include "core/registration/transform_error.h"
#include "core/sampling/spatial_budget.h"
#include "core/spdf/cloud_filter.h"
#include "tests/testing/status_matchers.h"

#ifdef MAPSIEVE_TEST_DATA

namespace mapsieve::core {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
const std::filesystem::path kData =
    std::filesystem::path(MAPSIEVE_TEST_DATA) / "registration";

struct Scan {
  std::vector<Point3> positions;
  std::vector<Vector3> normals;
  std::vector<Covariance> covariances;

  IcpCloud view() const { return {positions, normals, covariances}; }
};

/// 5000 points of a scan at the uniform density of rho 0.2, with normals and
/// covariances of the votes.
Scan ReadScan(const std::string& name) {
  absl::StatusOr<PointCloud> file = client::ReadPointFile(kData / name);
  EXPECT_THAT(file, testing::IsOk());
  file->attributes = {};
  RefusedCounts refused;
  const LatticeCloud cloud = Quantize(*std::move(file), Lattice(), refused);
  const auto filtered = FilterCloud(
      cloud, {.density_radius_m = 0.2, .rule = DensityRule::kQuota});
  EXPECT_THAT(filtered, testing::IsOk());
  std::vector<LatticePoint> positions;
  for (const uint32_t row : filtered->rows) {
    positions.push_back(cloud.positions[row]);
  }
  const auto sample =
      SampleUnderBudget(positions, filtered->columns.label, 5000);
  EXPECT_THAT(sample, testing::IsOk());
  Scan scan;
  for (const uint32_t row : sample->rows) {
    const Label label = filtered->columns.label[row];
    if (label == Label::kNone) continue;
    const std::array<float, 3> n =
        DecodeOctahedral(filtered->columns.normal[row]);
    scan.positions.push_back(cloud.lattice.Position(positions[row]));
    scan.normals.push_back({n[0], n[1], n[2]});
    scan.covariances.push_back(LabelCovariance(label, n));
  }
  return scan;
}

/// A 4 x 4 matrix by rows, of rounded numbers.
RigidTransform FromRows(const std::array<double, 16>& rows) {
  RigidTransform transform;
  for (size_t r = 0; r < 3; ++r) {
    for (size_t c = 0; c < 3; ++c) transform.rotation[r][c] = rows[4 * r + c];
    transform.translation[r] = rows[4 * r + 3];
  }
  return Orthonormalized(transform).value();
}

/// The pose of a scan of the `norlab` trajectory, by its row.
RigidTransform TrajectoryPose(int row) {
  std::ifstream file(kData / "norlab" / "trajectory.csv");
  std::string line;
  for (int i = 0; i <= row + 1; ++i) std::getline(file, line);
  // seconds, nanoseconds, frame, child frame, position, orientation x y z w.
  std::array<double, 7> values{};
  size_t start = 0;
  for (size_t field = 0; field < 11; ++field) {
    const size_t end = line.find(',', start);
    if (field >= 4)
      values[field - 4] = std::stod(line.substr(start, end - start));
    start = end + 1;
  }
  const auto& [px, py, pz, x, y, z, w] = values;
  return FromRows({1 - 2 * (y * y + z * z), 2 * (x * y - z * w),
                   2 * (x * z + y * w), px, 2 * (x * y + z * w),
                   1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py,
                   2 * (x * z - y * w), 2 * (y * z + x * w),
                   1 - 2 * (x * x + y * y), pz, 0, 0, 0, 1});
}

/// Largest errors of one method.
struct Limits {
  double translation_m = 0;
  double rotation_degrees = 0;
};

/// Registers two scans from `disturbed` poses by both methods.
void ExpectPose(const Scan& reading, const Scan& reference,
                const RigidTransform& truth,
                const std::vector<RigidTransform>& disturbed,
                const Limits& to_plane, const Limits& planes) {
  for (const IcpMethod method :
       {IcpMethod::kPointToPlane, IcpMethod::kPlaneToPlane}) {
    const Limits& limits =
        method == IcpMethod::kPointToPlane ? to_plane : planes;
    for (size_t i = 0; i < disturbed.size(); ++i) {
      SCOPED_TRACE("method " + std::to_string(static_cast<int>(method)) +
                   ", start " + std::to_string(i));
      MAPSIEVE_ASSERT_OK_AND_ASSIGN(const IcpResult result,
                                    RunIcp(reading.view(), reference.view(),
                                           disturbed[i], {.method = method}));
      EXPECT_EQ(result.information.degenerate_count, 0);
      const TransformError error =
          CompareTransforms(result.T_reference_reading, truth);
      EXPECT_LE(error.translation_m, limits.translation_m);
      EXPECT_LE(error.rotation_rad / kDegree, limits.rotation_degrees);
    }
  }
}

/// Half a metre and 20 degrees from `truth`, the largest disturbance of the
/// paper, in two directions.
std::vector<RigidTransform> Disturbed(const RigidTransform& truth) {
  const Vector3 turns[] = {{0, 12 * kDegree, 16 * kDegree},
                           {-12 * kDegree, 0, -16 * kDegree}};
  const Vector3 shifts[] = {{0.3, -0.4, 0}, {-0.3, 0, 0.4}};
  std::vector<RigidTransform> poses;
  for (size_t i = 0; i < 2; ++i) {
    poses.push_back(truth *
                    RigidTransform{.rotation = RotationFromVector(turns[i]),
                                   .translation = shifts[i]});
  }
  return poses;
}

// The poses given are known to about 1 cm and 0.3 degrees, that of the car to
// 3 cm. Limits of point-to-plane are the errors of another implementation on
// the whole scans; those of plane-to-plane stay in the precision of the poses.

TEST(RegistrationPairs, SmallGicp) {
  std::ifstream file(kData / "small_gicp" / "T_target_source.txt");
  std::array<double, 16> rows;
  for (double& value : rows) file >> value;
  const RigidTransform truth = FromRows(rows);
  std::vector<RigidTransform> starts = Disturbed(truth);
  starts.emplace_back();
  ExpectPose(ReadScan("small_gicp/source.ply"),
             ReadScan("small_gicp/target.ply"), truth, starts, {0.009, 0.28},
             {0.012, 0.28});
}

TEST(RegistrationPairs, Car) {
  // carCloudList.csv of the same folder, gT of car_cloud401.
  const RigidTransform truth =
      FromRows({0.981715, 0.169605, -0.0864239, 0.0614127,  //
                -0.152902, 0.973034, 0.172703, 0.191433,    //
                0.113385, -0.15633, 0.981175, -0.0338571,   //
                0, 0, 0, 1});
  ExpectPose(ReadScan("libpointmatcher/car_cloud401.csv"),
             ReadScan("libpointmatcher/car_cloud400.csv"), truth,
             Disturbed(truth), {0.011, 0.07}, {0.035, 0.15});
}

TEST(RegistrationPairs, Apartment) {
  // What libpointmatcher gives, as its introduction to ICP prints it: no truth.
  const RigidTransform published =
      FromRows({0.993552, -0.113149, 0.00713103, 0.60831,      //
                0.113181, 0.993565, -0.00425984, -0.00387758,  //
                -0.00660312, 0.00503951, 0.999965, 0.0107267,  //
                0, 0, 0, 1});
  std::vector<RigidTransform> starts = Disturbed(published);
  starts.emplace_back();
  ExpectPose(ReadScan("libpointmatcher/cloud_1.vtk"),
             ReadScan("libpointmatcher/cloud_0.vtk"), published, starts,
             {0.012, 0.45}, {0.012, 0.45});
}

TEST(RegistrationPairs, Norlab) {
  const Scan reference = ReadScan("norlab/cloud_1690309709_285305600.vtk");
  const struct {
    std::string stamp;
    int row;
  } readings[] = {{"1690309709_485205504", 2},
                  {"1690309709_785777664", 5},
                  {"1690309710_85582848", 8}};
  for (const auto& [stamp, row] : readings) {
    SCOPED_TRACE(stamp);
    const RigidTransform truth =
        TrajectoryPose(0).Inverse() * TrajectoryPose(row);
    ExpectPose(ReadScan("norlab/cloud_" + stamp + ".vtk"), reference, truth,
               Disturbed(truth), {0.019, 0.026}, {0.019, 0.026});
  }
}

}  // namespace
}  // namespace mapsieve::core

#endif  // MAPSIEVE_TEST_DATA
