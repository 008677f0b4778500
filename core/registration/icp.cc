#include "core/registration/icp.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <string_view>
#include <vector>

#include "core/base/status.h"
#include "core/registration/kd_tree.h"
#include "core/registration/normal_equations.h"

namespace mapsieve::core {
namespace {

constexpr int kMaxNeighborCount = 16;
static_assert(kMaxNeighborCount <= KdTree::kMaxNeighborCount);
constexpr int kMaxIterationCount = 10000;
constexpr double kMinDegenerateEigenvalue = 1e-12;
/// How far the squared length of a unit vector may be from 1.
constexpr double kUnitTolerance = 0.01;
constexpr size_t kPointsPerPart = 512;

absl::Status OutOfRange(std::string_view field, double value,
                        std::string_view limits) {
  return absl::InvalidArgumentError(absl::StrCat(
      ToAbsl(field), " is ", value, "; it must be ", ToAbsl(limits)));
}

bool IsPosition(const Point3& p) {
  // False for NaN.
  return std::abs(p.x) <= kMaxIcpCoordinate &&
         std::abs(p.y) <= kMaxIcpCoordinate &&
         std::abs(p.z) <= kMaxIcpCoordinate;
}

bool IsUnit(const Vector3& v) {
  return std::abs(Dot(v, v) - 1) <= kUnitTolerance;
}

/// By the leading minors (Sylvester's criterion).
bool IsPositiveDefinite(const Covariance& c) {
  const double xx = c[0];
  const double xy = c[1];
  const double xz = c[2];
  const double yy = c[3];
  const double yz = c[4];
  const double zz = c[5];
  const double determinant = xx * (yy * zz - yz * yz) -
                             xy * (xy * zz - yz * xz) +
                             xz * (xy * yz - yy * xz);
  return xx > 0 && xx * yy - xy * xy > 0 && determinant > 0 &&
         std::isfinite(determinant);
}

/// Checks a column of `cloud` that may be absent unless it is `needed`.
template <typename T>
absl::Status CheckColumn(std::string_view cloud, std::string_view column,
                         std::span<const T> values, size_t size, bool needed,
                         bool (*is_valid)(const T&), std::string_view valid) {
  if (values.empty() && !needed) return absl::OkStatus();
  if (values.size() != size) {
    return absl::InvalidArgumentError(
        absl::StrCat("the ", ToAbsl(cloud), " has ", values.size(), " ",
                     ToAbsl(column), " for ", size, " points"));
  }
  const auto bad =
      std::find_if(values.begin(), values.end(),
                   [&](const T& value) { return !is_valid(value); });
  if (bad == values.end()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("the ", ToAbsl(cloud), "'s ", ToAbsl(column), ": number ",
                   bad - values.begin(), " is not ", ToAbsl(valid)));
}

absl::Status CheckCloud(std::string_view name, const IcpCloud& cloud,
                        size_t min_size, bool needs_normals,
                        bool needs_covariances) {
  const size_t size = cloud.positions.size();
  if (size < min_size) {
    return absl::InvalidArgumentError(
        absl::StrCat("the ", ToAbsl(name), " has ", size,
                     " points; registration needs ", min_size));
  }
  MAPSIEVE_RETURN_IF_ERROR(
      CheckColumn(name, "positions", cloud.positions, size, true, IsPosition,
                  "a position: a coordinate is not finite or above 1e13 m"));
  MAPSIEVE_RETURN_IF_ERROR(CheckColumn(name, "normals", cloud.normals, size,
                                       needs_normals, IsUnit, "of length 1"));
  return CheckColumn(name, "covariances", cloud.covariances, size,
                     needs_covariances, IsPositiveDefinite,
                     "positive definite");
}

Vector3 CenterOf(std::span<const Point3> positions) {
  Point3 low = positions[0];
  Point3 high = positions[0];
  for (const Point3& p : positions) {
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y),
            std::max(high.z, p.z)};
  }
  return {0.5 * (low.x + high.x), 0.5 * (low.y + high.y),
          0.5 * (low.z + high.z)};
}

/// `cloud` about `center`, in an order that is a function of its set of points:
/// sums and ties then do not depend on the order given.
IcpPoints Prepare(const IcpCloud& cloud, const Vector3& center) {
  std::vector<uint32_t> order(cloud.positions.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) {
    const Point3& p = cloud.positions[a];
    const Point3& q = cloud.positions[b];
    if (p.x != q.x) return p.x < q.x;
    if (p.y != q.y) return p.y < q.y;
    if (p.z != q.z) return p.z < q.z;
    if (!cloud.normals.empty() && cloud.normals[a] != cloud.normals[b]) {
      return cloud.normals[a] < cloud.normals[b];
    }
    return !cloud.covariances.empty() &&
           cloud.covariances[a] < cloud.covariances[b];
  });
  IcpPoints points;
  points.positions.reserve(order.size());
  for (const uint32_t row : order) {
    const Point3& p = cloud.positions[row];
    points.positions.push_back(
        {p.x - center[0], p.y - center[1], p.z - center[2]});
    if (!cloud.normals.empty()) points.normals.push_back(cloud.normals[row]);
    if (!cloud.covariances.empty()) {
      points.covariances.push_back(cloud.covariances[row]);
    }
  }
  return points;
}

/// The iteration, between clouds that are centred.
class Icp {
 public:
  Icp(const IcpPoints& reading, const IcpPoints& reference,
      const IcpOptions& options, Executor& executor)
      : reading_(reading),
        reference_(reference),
        options_(options),
        executor_(executor),
        tree_(reference.positions),
        moved_(reading.positions.size()),
        candidates_(reading.positions.size() *
                    static_cast<size_t>(options.neighbor_count)) {}

  absl::StatusOr<IcpResult> Run(const RigidTransform& start,
                                const ExecutionContext& context) {
    IcpResult result{.T_reference_reading = start};
    RigidTransform& pose = result.T_reference_reading;
    int settled_count = 0;
    while (true) {
      MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
      context.ReportProgress(result.iteration_count,
                             options_.max_iteration_count);
      FindPairs(pose);
      result.pair_count = static_cast<int64_t>(pairs_.size());
      result.pair_ratio = static_cast<double>(pairs_.size()) /
                          static_cast<double>(candidates_.size());
      if (pairs_.size() < kMinIcpPointCount) {
        result.stop = IcpStop::kTooFewPairs;
        result.information = {};
        result.rms_residual_m = 0;
        return result;
      }
      const IcpSolution solution =
          SolvePairs(moved_, pose.rotation, reading_, reference_, pairs_,
                     options_, executor_);
      result.information = solution.information;
      result.rms_residual_m = solution.rms_residual_m;
      if (settled_count == options_.settled_step_count) {
        result.stop = IcpStop::kConverged;
        return result;
      }
      if (result.iteration_count == options_.max_iteration_count) {
        result.stop = IcpStop::kIterationLimit;
        return result;
      }
      pose = StepOf(solution) * pose;
      ++result.iteration_count;
      settled_count = IsSmall(solution) ? settled_count + 1 : 0;
    }
  }

 private:
  struct Candidate {
    uint32_t reference = 0;
    double squared_distance = 0;
  };

  /// Moves the reading to `pose` and pairs it.
  void FindPairs(const RigidTransform& pose) {
    const auto k = static_cast<size_t>(options_.neighbor_count);
    constexpr double kNever = std::numeric_limits<double>::infinity();
    const double max_squared =
        options_.max_distance_m * options_.max_distance_m;
    ForEachPart(executor_, moved_.size(), kPointsPerPart,
                [&](size_t, size_t begin, size_t end) {
                  std::array<KdTree::Neighbor, kMaxNeighborCount> nearest;
                  for (size_t i = begin; i < end; ++i) {
                    Vector3& point = moved_[i];
                    point = pose.Rotate(reading_.positions[i]);
                    for (size_t a = 0; a < 3; ++a)
                      point[a] += pose.translation[a];
                    tree_.FindNearest(point, std::span(nearest).first(k));
                    for (size_t j = 0; j < k; ++j) {
                      const auto [row, squared] = nearest[j];
                      const bool counts =
                          squared <= max_squared && NormalsAgree(pose, i, row);
                      candidates_[i * k + j] = {row, counts ? squared : kNever};
                    }
                  }
                });
    distances_.clear();
    for (const Candidate& candidate : candidates_) {
      if (candidate.squared_distance < kNever) {
        distances_.push_back(candidate.squared_distance);
      }
    }
    pairs_.clear();
    if (distances_.empty()) return;
    const auto kept = static_cast<ptrdiff_t>(std::ceil(
        options_.trim_ratio * static_cast<double>(distances_.size())));
    std::nth_element(distances_.begin(), distances_.begin() + kept - 1,
                     distances_.end());
    const double limit = distances_[static_cast<size_t>(kept) - 1];
    for (size_t c = 0; c < candidates_.size(); ++c) {
      if (candidates_[c].squared_distance <= limit) {
        pairs_.push_back(
            {static_cast<uint32_t>(c / k), candidates_[c].reference});
      }
    }
  }

  bool NormalsAgree(const RigidTransform& pose, size_t reading,
                    uint32_t reference) const {
    if (options_.min_normal_cosine <= 0) return true;
    const Vector3 a = pose.Rotate(reading_.normals[reading]);
    const Vector3& b = reference_.normals[reference];
    return std::abs(Dot(a, b)) >= options_.min_normal_cosine;
  }

  static RigidTransform StepOf(const IcpSolution& solution) {
    RigidTransform step{.rotation = RotationFromVector(solution.step.rotation)};
    const Point3& center = solution.information.center;
    const Vector3 c = {center.x, center.y, center.z};
    const Vector3 turned = step.Rotate(c);
    for (size_t a = 0; a < 3; ++a) {
      step.translation[a] = c[a] - turned[a] + solution.step.translation[a];
    }
    return step;
  }

  bool IsSmall(const IcpSolution& solution) const {
    const Vector3& w = solution.step.rotation;
    const Vector3& t = solution.step.translation;
    return std::hypot(t[0], t[1], t[2]) <= options_.translation_tolerance_m &&
           std::hypot(w[0], w[1], w[2]) <= options_.rotation_tolerance_rad;
  }

  const IcpPoints& reading_;
  const IcpPoints& reference_;
  const IcpOptions& options_;
  Executor& executor_;
  const KdTree tree_;
  std::vector<Vector3> moved_;
  // Pairs before trimming, neighbor_count a point of the reading; at an
  // infinite distance those that do not count.
  std::vector<Candidate> candidates_;
  std::vector<double> distances_;
  std::vector<IcpPair> pairs_;
};

}  // namespace

absl::Status IcpOptions::Validate() const {
  if (method != IcpMethod::kPointToPlane &&
      method != IcpMethod::kPlaneToPlane) {
    return OutOfRange("method", static_cast<int>(method),
                      "point-to-plane or plane-to-plane");
  }
  if (neighbor_count < 1 || neighbor_count > kMaxNeighborCount) {
    return OutOfRange("neighbor_count", neighbor_count, "1 to 16");
  }
  // Negated comparisons refuse NaN too.
  if (!(trim_ratio > 0 && trim_ratio <= 1)) {
    return OutOfRange("trim_ratio", trim_ratio, "above 0, at most 1");
  }
  if (!(max_distance_m > 0)) {
    return OutOfRange("max_distance_m", max_distance_m, "above 0");
  }
  if (!(min_normal_cosine >= 0 && min_normal_cosine <= 1)) {
    return OutOfRange("min_normal_cosine", min_normal_cosine, "0 to 1");
  }
  if (max_iteration_count < 0 || max_iteration_count > kMaxIterationCount) {
    return OutOfRange("max_iteration_count", max_iteration_count, "0 to 10000");
  }
  if (settled_step_count < 1) {
    return OutOfRange("settled_step_count", settled_step_count, "at least 1");
  }
  if (!(translation_tolerance_m >= 0)) {
    return OutOfRange("translation_tolerance_m", translation_tolerance_m,
                      "0 or above");
  }
  if (!(rotation_tolerance_rad >= 0)) {
    return OutOfRange("rotation_tolerance_rad", rotation_tolerance_rad,
                      "0 or above");
  }
  if (!(degenerate_eigenvalue >= kMinDegenerateEigenvalue &&
        degenerate_eigenvalue <= 1)) {
    return OutOfRange("degenerate_eigenvalue", degenerate_eigenvalue,
                      "1e-12 to 1");
  }
  return absl::OkStatus();
}

absl::StatusOr<IcpResult> RunIcp(const IcpCloud& reading,
                                 const IcpCloud& reference,
                                 const RigidTransform& T_reference_reading,
                                 const IcpOptions& options,
                                 const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  const bool to_plane = options.method == IcpMethod::kPointToPlane;
  const bool gated = options.min_normal_cosine > 0;
  MAPSIEVE_RETURN_IF_ERROR(
      CheckCloud("reading", reading, kMinIcpPointCount, gated, !to_plane));
  MAPSIEVE_RETURN_IF_ERROR(CheckCloud(
      "reference", reference,
      std::max(kMinIcpPointCount, static_cast<size_t>(options.neighbor_count)),
      gated || to_plane, !to_plane));
  MAPSIEVE_ASSIGN_OR_RETURN(const RigidTransform start,
                            Orthonormalized(T_reference_reading));

  const RigidTransform reading_frame{.translation =
                                         CenterOf(reading.positions)};
  const RigidTransform reference_frame{.translation =
                                           CenterOf(reference.positions)};
  const IcpPoints reading_points = Prepare(reading, reading_frame.translation);
  const IcpPoints reference_points =
      Prepare(reference, reference_frame.translation);
  Icp icp(reading_points, reference_points, options, *context.executor);
  MAPSIEVE_ASSIGN_OR_RETURN(
      IcpResult result,
      icp.Run(reference_frame.Inverse() * start * reading_frame, context));
  result.T_reference_reading =
      reference_frame * result.T_reference_reading * reading_frame.Inverse();
  result.information.center = reference_frame(result.information.center);
  return result;
}

}  // namespace mapsieve::core
