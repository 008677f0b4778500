#include "core/sampling/covariance_sample.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>

#include "Eigen/Eigenvalues"
#include "core/base/status.h"
#include "core/geometry/vector3.h"

namespace mapsieve::core {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

bool HasNormal(const std::array<float, 3>& normal) {
  return normal != std::array<float, 3>{};
}

/// Turns `leverages` into their components along the axes of their covariance.
void TurnToAxes(std::vector<Leverage>& leverages, Executor& executor) {
  Matrix6 covariance = Matrix6::Zero();
  for (const Leverage& v : leverages) {
    const Eigen::Map<const Eigen::Matrix<double, 6, 1>> vector(v.data());
    covariance += vector * vector.transpose();
  }
  const Matrix6 axes =
      Eigen::SelfAdjointEigenSolver<Matrix6>(covariance).eigenvectors();
  constexpr size_t kTaskPoints = 1 << 14;
  ForEachPart(executor, leverages.size(), kTaskPoints,
              [&](size_t, size_t begin, size_t end) {
                for (size_t i = begin; i < end; ++i) {
                  const Leverage v = leverages[i];
                  for (int axis = 0; axis < 6; ++axis) {
                    double along = 0;
                    for (int c = 0; c < 6; ++c) {
                      along += axes(c, axis) * v[static_cast<size_t>(c)];
                    }
                    leverages[i][static_cast<size_t>(axis)] = along;
                  }
                }
              });
}

}  // namespace

std::vector<Leverage> FindLeverages(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals) {
  std::vector<Leverage> leverages(positions.size());
  const auto relative = [&](size_t i) {
    return Vector3{static_cast<double>(positions[i].x - positions[0].x),
                   static_cast<double>(positions[i].y - positions[0].y),
                   static_cast<double>(positions[i].z - positions[0].z)};
  };
  Vector3 mean{};
  double count = 0;
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!HasNormal(normals[i])) continue;
    const Vector3 p = relative(i);
    for (size_t a = 0; a < 3; ++a) mean[a] += p[a];
    ++count;
  }
  if (count == 0) return leverages;
  for (double& m : mean) m /= count;
  const auto centered = [&](size_t i) {
    Vector3 p = relative(i);
    for (size_t a = 0; a < 3; ++a) p[a] -= mean[a];
    return p;
  };
  double scale = 0;
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!HasNormal(normals[i])) continue;
    const Vector3 p = centered(i);
    scale += std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
  }
  scale = scale > 0 ? scale / count : 1;
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!HasNormal(normals[i])) continue;
    const Vector3 p = centered(i);
    const Vector3 n = {normals[i][0], normals[i][1], normals[i][2]};
    leverages[i] = {(p[1] * n[2] - p[2] * n[1]) / scale,
                    (p[2] * n[0] - p[0] * n[2]) / scale,
                    (p[0] * n[1] - p[1] * n[0]) / scale,
                    n[0],
                    n[1],
                    n[2]};
  }
  return leverages;
}

absl::StatusOr<std::vector<uint32_t>> SampleCovariance(
    std::span<const LatticePoint> positions,
    std::span<const std::array<float, 3>> normals, int64_t count,
    const ExecutionContext& context) {
  std::vector<Leverage> leverages = FindLeverages(positions, normals);
  TurnToAxes(leverages, *context.executor);
  MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
  const size_t kept = std::min(static_cast<size_t>(count), positions.size());
  // For each axis the points that hold it most. No list is read any farther
  // than there are points to choose.
  std::array<std::vector<uint32_t>, 6> lists;
  context.executor->ParallelFor(6, [&](int64_t a) {
    const auto axis = static_cast<size_t>(a);
    std::vector<uint32_t>& list = lists[axis];
    list.resize(positions.size());
    std::iota(list.begin(), list.end(), uint32_t{0});
    const auto end_of_kept = list.begin() + static_cast<ptrdiff_t>(kept);
    const auto is_before = [&](uint32_t i, uint32_t j) {
      const bool has_normal = HasNormal(normals[i]);
      if (has_normal != HasNormal(normals[j])) return has_normal;
      const double p = std::abs(leverages[i][axis]);
      const double q = std::abs(leverages[j][axis]);
      return p != q ? p > q : i < j;
    };
    std::nth_element(list.begin(), end_of_kept, list.end(), is_before);
    list.erase(end_of_kept, list.end());
    std::sort(list.begin(), list.end(), is_before);
  });
  MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
  std::vector<uint32_t> rows;
  rows.reserve(kept);
  std::vector<uint8_t> is_chosen(positions.size());
  std::array<size_t, 6> next{};
  std::array<double, 6> held{};
  while (rows.size() < kept) {
    const auto axis = static_cast<size_t>(
        std::min_element(held.begin(), held.end()) - held.begin());
    while (is_chosen[lists[axis][next[axis]]] != 0) ++next[axis];
    const uint32_t row = lists[axis][next[axis]];
    is_chosen[row] = 1;
    rows.push_back(row);
    for (size_t a = 0; a < 6; ++a) {
      held[a] += leverages[row][a] * leverages[row][a];
    }
  }
  std::sort(rows.begin(), rows.end());
  return rows;
}

}  // namespace mapsieve::core
