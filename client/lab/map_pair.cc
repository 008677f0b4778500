#include "client/lab/map_pair.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/formats/point_file.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/registration/kd_tree.h"

namespace mapsieve::client {
namespace {

using core::Point3;

absl::StatusOr<std::vector<Point3>> ReadPositions(
    const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(core::PointCloud cloud, ReadPointFile(path));
  std::erase_if(cloud.positions, [](const Point3& p) {
    return !(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
  });
  return std::move(cloud.positions);
}

Point3 Mean(const std::vector<Point3>& points) {
  // About the first one, so that nothing is lost far from the origin.
  const Point3 first = points.empty() ? Point3{} : points.front();
  Point3 sum = {0, 0, 0};
  for (const Point3& p : points) {
    sum.x += p.x - first.x;
    sum.y += p.y - first.y;
    sum.z += p.z - first.z;
  }
  const double count = std::max(1.0, static_cast<double>(points.size()));
  return {first.x + sum.x / count, first.y + sum.y / count,
          first.z + sum.z / count};
}

/// The distinct points of `points` with `origin` as their origin.
absl::StatusOr<core::LatticeCloud> DistinctCloud(
    const std::filesystem::path& path, std::vector<Point3> points,
    const Point3& origin) {
  for (Point3& p : points) {
    p = {p.x - origin.x, p.y - origin.y, p.z - origin.z};
  }
  core::RefusedCounts refused;
  core::LatticeCloud cloud =
      core::Quantize({.positions = std::move(points), .attributes = {}},
                     core::Lattice(), refused);
  cloud.positions = core::DistinctPoints(cloud.positions);
  if (cloud.size() < MapPair::kMinPointCount) {
    return absl::InvalidArgumentError(absl::StrCat(
        path.string(), ": has ", cloud.size(), " distinct points; expected ",
        MapPair::kMinPointCount, " at least"));
  }
  return cloud;
}

double Overlap(const ScanPair& pair) {
  std::vector<core::Vector3> reference;
  reference.reserve(pair.reference.size());
  for (const core::LatticePoint& q : pair.reference.positions) {
    const Point3 p = pair.reference.lattice.Position(q);
    reference.push_back({p.x, p.y, p.z});
  }
  const core::KdTree tree(reference);
  // Enough to tell the share to a percent.
  constexpr size_t kProbeCount = 20000;
  const size_t step = 1 + pair.reading.size() / kProbeCount;
  int64_t probe_count = 0;
  int64_t near_count = 0;
  for (size_t i = 0; i < pair.reading.size(); i += step) {
    const Point3 p = pair.T_reference_reading(
        pair.reading.lattice.Position(pair.reading.positions[i]));
    std::array<core::KdTree::Neighbor, 1> nearest;
    tree.FindNearest({p.x, p.y, p.z}, nearest);
    ++probe_count;
    near_count += nearest[0].squared_distance <=
                          MapPair::kOverlapDistance * MapPair::kOverlapDistance
                      ? 1
                      : 0;
  }
  return static_cast<double>(near_count) / static_cast<double>(probe_count);
}

/// A file's name without what a pair's name must not hold.
std::string PlainName(const std::filesystem::path& path) {
  std::string name = path.filename().string();
  for (char& c : name) {
    if (c == ',' || c == '"' || c == '\n' || c == '\r') c = '_';
  }
  return name;
}

uint64_t ContentHash(const ScanPair& pair) {
  const std::array<uint64_t, 4> parts = {
      Hash64(std::as_bytes(std::span(pair.reference.positions))),
      Hash64(std::as_bytes(std::span(pair.reading.positions))),
      Hash64(std::as_bytes(std::span(pair.T_reference_reading.rotation))),
      Hash64(std::as_bytes(std::span(pair.T_reference_reading.translation)))};
  return Hash64(std::as_bytes(std::span(parts)));
}

}  // namespace

absl::StatusOr<MapPair> LoadMapPair(
    const std::filesystem::path& reference,
    const std::filesystem::path& reading,
    const core::RigidTransform& T_reference_reading) {
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<Point3> reference_points,
                            ReadPositions(reference));
  MAPSIEVE_ASSIGN_OR_RETURN(std::vector<Point3> reading_points,
                            ReadPositions(reading));
  const Point3 origin = Mean(reading_points);
  const Point3 reference_origin = T_reference_reading(origin);
  const auto pair = std::make_shared<ScanPair>();
  // The origins lie on each other, so nothing is left to move.
  pair->T_reference_reading.rotation = T_reference_reading.rotation;
  MAPSIEVE_ASSIGN_OR_RETURN(
      pair->reference,
      DistinctCloud(reference, std::move(reference_points), reference_origin));
  MAPSIEVE_ASSIGN_OR_RETURN(
      pair->reading, DistinctCloud(reading, std::move(reading_points), origin));
  MapPair result;
  result.point_count = static_cast<int64_t>(
      std::min(pair->reference.size(), pair->reading.size()));
  result.overlap = Overlap(*pair);
  if (result.overlap < MapPair::kMinOverlap) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s and %s do not overlap: %.1f %% of the second one's points have one "
        "of the first within %g m, expected %g %% at least; is the transform "
        "right?",
        reference.string(), reading.string(), 100 * result.overlap,
        MapPair::kOverlapDistance, 100 * MapPair::kMinOverlap));
  }
  result.source.name = absl::StrFormat("%s %s %016x", PlainName(reference),
                                       PlainName(reading), ContentHash(*pair));
  result.source.load = [pair] { return absl::StatusOr<ScanPair>(*pair); };
  return result;
}

}  // namespace mapsieve::client
