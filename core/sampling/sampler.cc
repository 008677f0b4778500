#include "core/sampling/sampler.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "core/cloud/merge_duplicates.h"
#include "core/geometry/point_hash.h"
#include "core/sampling/covariance_sample.h"
#include "core/sampling/density_sample.h"
#include "core/sampling/normal_space_sample.h"
#include "core/sampling/octree_sample.h"
#include "core/sampling/random_sample.h"
#include "core/sampling/spatial_budget.h"
#include "core/sampling/spdf_search.h"
#include "core/sampling/surface_sample.h"
#include "core/sampling/voxel_sample.h"

namespace mapsieve::core {
namespace {

constexpr int64_t kUnlimited = std::numeric_limits<int64_t>::max();

constexpr std::array<std::string_view, 3> kNormalNames = {"nx", "ny", "nz"};

/// What a method chose of distinct points.
struct Choice {
  /// Ascending.
  std::vector<uint32_t> rows;
  /// One a row, in steps, or none.
  std::vector<Point3> centroids;
  std::vector<Vector3> normals;
  double parameter = 0;
};

/// The largest level of which cells have an edge of at most `edge_m`.
int LevelOfEdge(double edge_m, const Lattice& lattice) {
  return std::min(std::ilogb(LengthInSteps(edge_m, lattice)), kMaxCellLevel);
}

/// The smallest limit that `value` is below.
double NextAbove(double value) { return std::nextafter(value, HUGE_VAL); }

Choice ChooseRandomly(std::span<const LatticePoint> positions,
                      const SamplerOptions& options) {
  const int64_t seed = options.spdf.seed;
  if (options.max_points == 0) {
    return Choice{
        .rows = RandomShare(positions, options.keep_probability, seed),
        .parameter = options.keep_probability};
  }
  Choice choice{.rows = RandomSample(positions, options.max_points, seed)};
  for (const uint32_t row : choice.rows) {
    choice.parameter =
        std::max(choice.parameter, PointDraw(positions[row], seed));
  }
  choice.parameter = NextAbove(choice.parameter);
  return choice;
}

absl::StatusOr<Choice> ChooseByDensity(std::span<const LatticePoint> positions,
                                       const Lattice& lattice,
                                       const SamplerOptions& options,
                                       const ExecutionContext& context) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::vector<double> densities,
      FindDropDensities(positions, lattice, options.spdf.neighbor_count,
                        options.spdf.seed, context));
  Choice choice;
  std::vector<uint32_t>& rows = choice.rows;
  rows.resize(positions.size());
  std::iota(rows.begin(), rows.end(), uint32_t{0});
  if (options.max_points == 0) {
    std::erase_if(rows, [&](uint32_t row) {
      return densities[row] >= options.max_density;
    });
    choice.parameter = options.max_density;
    return choice;
  }
  const auto kept = static_cast<size_t>(
      std::min(options.max_points, static_cast<int64_t>(rows.size())));
  std::nth_element(rows.begin(), rows.begin() + static_cast<ptrdiff_t>(kept),
                   rows.end(), [&](uint32_t a, uint32_t b) {
                     return std::pair(densities[a], a) <
                            std::pair(densities[b], b);
                   });
  rows.resize(kept);
  std::sort(rows.begin(), rows.end());
  for (const uint32_t row : rows) {
    choice.parameter = std::max(choice.parameter, densities[row]);
  }
  choice.parameter = NextAbove(choice.parameter);
  return choice;
}

Choice ChoiceOf(CellSample sample, Representative kind, double parameter) {
  Choice choice{.rows = std::move(sample.rows), .parameter = parameter};
  if (kind == Representative::kCentroid) {
    choice.centroids = std::move(sample.centroids);
  }
  return choice;
}

absl::StatusOr<Choice> ChooseByOctree(std::span<const LatticePoint> positions,
                                      const Lattice& lattice,
                                      const SamplerOptions& options,
                                      const ExecutionContext& context) {
  std::vector<CellRange> cells;
  if (options.max_points > 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        cells, OctreeHalves(positions, options.max_points, context.stop));
  } else {
    cells = OctreeLeaves(
        positions, std::max<int64_t>(options.max_cell_points, 1),
        options.cell_edge_m > 0 ? LevelOfEdge(options.cell_edge_m, lattice)
                                : 0);
  }
  uint32_t largest = 0;
  for (const CellRange& cell : cells) largest = std::max(largest, cell.size());
  std::vector<uint32_t> order(positions.size());
  std::iota(order.begin(), order.end(), uint32_t{0});
  const Representative kind = options.ChosenRepresentative();
  MAPSIEVE_ASSIGN_OR_RETURN(CellSample sample,
                            RepresentCells(positions, order, cells, kind,
                                           options.spdf.seed, context));
  return ChoiceOf(std::move(sample), kind, largest);
}

absl::StatusOr<Choice> ChooseByVoxel(std::span<const LatticePoint> positions,
                                     const Lattice& lattice,
                                     const SamplerOptions& options,
                                     const ExecutionContext& context) {
  double edge_m = options.cell_edge_m;
  if (options.max_points > 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        edge_m, FindVoxelEdge(positions, lattice, options.max_points, context));
  }
  const VoxelCells voxels =
      DivideInVoxels(positions, LengthInSteps(edge_m, lattice));
  const Representative kind = options.ChosenRepresentative();
  MAPSIEVE_ASSIGN_OR_RETURN(
      CellSample sample, RepresentCells(positions, voxels.order, voxels.cells,
                                        kind, options.spdf.seed, context));
  return ChoiceOf(std::move(sample), kind, edge_m);
}

absl::StatusOr<Choice> ChooseBySurface(std::span<const LatticePoint> positions,
                                       const SamplerOptions& options,
                                       const ExecutionContext& context) {
  const Representative kind = options.ChosenRepresentative();
  const bool is_counted = options.max_points > 0;
  MAPSIEVE_ASSIGN_OR_RETURN(
      SurfaceSample sample,
      SampleSurfaces(positions, is_counted ? options.max_points : kUnlimited,
                     is_counted ? 1 : options.max_cell_points, kind,
                     options.spdf.seed, context));
  Choice choice = ChoiceOf(std::move(sample.points), kind,
                           static_cast<double>(sample.largest_cell));
  choice.normals = std::move(sample.normals);
  return choice;
}

absl::StatusOr<Choice> ChooseAmong(std::span<const LatticePoint> positions,
                                   const Lattice& lattice,
                                   const SamplerOptions& options,
                                   const ExecutionContext& context) {
  switch (options.method) {
    case SampleMethod::kRandom:
      return ChooseRandomly(positions, options);
    case SampleMethod::kMaxDensity:
      return ChooseByDensity(positions, lattice, options, context);
    case SampleMethod::kSsNormal:
      return ChooseBySurface(positions, options, context);
    case SampleMethod::kOctree:
      return ChooseByOctree(positions, lattice, options, context);
    default:
      return ChooseByVoxel(positions, lattice, options, context);
  }
}

void MoveToCentroids(std::span<const Point3> centroids, LatticeCloud& cloud) {
  for (size_t i = 0; i < centroids.size(); ++i) {
    cloud.positions[i] = {std::llrint(centroids[i].x),
                          std::llrint(centroids[i].y),
                          std::llrint(centroids[i].z)};
  }
}

/// Puts normals before the other attributes.
void AddNormals(std::span<const Vector3> normals, LatticeCloud& cloud) {
  std::vector<Column> columns;
  for (size_t a = 0; a < 3; ++a) {
    Column column({std::string(kNormalNames[a]), ScalarType::kFloat32},
                  normals.size());
    for (size_t i = 0; i < normals.size(); ++i) {
      if (normals[i] == Vector3{}) {
        column.SetMissing(i);
      } else {
        column.Set(i, static_cast<float>(normals[i][a]));
      }
    }
    columns.push_back(std::move(column));
  }
  for (Column& column : cloud.attributes.columns()) {
    column.Rename(NameBeside(column.name(), kNormalNames));
    columns.push_back(std::move(column));
  }
  cloud.attributes.columns() = std::move(columns);
}

/// The methods that choose by position alone.
absl::StatusOr<CloudSample> SamplePositions(const LatticeCloud& cloud,
                                            const SamplerOptions& options,
                                            const ExecutionContext& context) {
  const std::vector<uint32_t> distinct =
      MergeDuplicates(cloud, *context.executor);
  std::vector<LatticePoint> positions;
  positions.reserve(distinct.size());
  for (const uint32_t row : distinct) {
    positions.push_back(cloud.positions[row]);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(
      const Choice choice,
      ChooseAmong(positions, cloud.lattice, options, context));
  CloudSample sample;
  sample.parameter = choice.parameter;
  sample.rows.reserve(choice.rows.size());
  for (const uint32_t i : choice.rows) sample.rows.push_back(distinct[i]);
  sample.cloud = cloud.Select(sample.rows);
  MoveToCentroids(choice.centroids, sample.cloud);
  if (options.method == SampleMethod::kSsNormal) {
    AddNormals(choice.normals, sample.cloud);
  }
  return sample;
}

std::vector<LatticePoint> PositionsOf(const LatticeCloud& cloud,
                                      const FilteredCloud& filtered) {
  std::vector<LatticePoint> positions;
  positions.reserve(filtered.rows.size());
  for (const uint32_t row : filtered.rows) {
    positions.push_back(cloud.positions[row]);
  }
  return positions;
}

/// The points of `filtered` at `numbers`.
CloudSample LabeledSample(const LatticeCloud& cloud,
                          const FilteredCloud& filtered,
                          std::span<const uint32_t> numbers) {
  CloudSample sample;
  sample.rows.reserve(numbers.size());
  for (const uint32_t i : numbers) sample.rows.push_back(filtered.rows[i]);
  sample.columns = filtered.columns.Select(numbers);
  sample.cloud = MakeLabeledCloud(cloud, sample.rows, sample.columns);
  return sample;
}

/// kNss, kCovs.
absl::StatusOr<CloudSample> SampleByNormals(const LatticeCloud& cloud,
                                            const SamplerOptions& options,
                                            const ExecutionContext& context) {
  SpdfOptions votes = options.spdf;
  votes.rule = DensityRule::kPaper;
  votes.max_round_count = 0;
  MAPSIEVE_ASSIGN_OR_RETURN(const FilteredCloud filtered,
                            FilterCloud(cloud, votes, context));
  const std::vector<LatticePoint> positions = PositionsOf(cloud, filtered);
  std::vector<std::array<float, 3>> normals(positions.size());
  for (size_t i = 0; i < normals.size(); ++i) {
    if (filtered.columns.label[i] != Label::kNone) {
      normals[i] = DecodeOctahedral(filtered.columns.normal[i]);
    }
  }
  std::vector<uint32_t> chosen;
  if (options.method == SampleMethod::kNss) {
    chosen = SampleNormalSpace(positions, normals, options.max_points,
                               options.spdf.seed);
  } else {
    MAPSIEVE_ASSIGN_OR_RETURN(
        chosen,
        SampleCovariance(positions, normals, options.max_points, context));
  }
  CloudSample sample = LabeledSample(cloud, filtered, chosen);
  sample.parameter = static_cast<double>(chosen.size());
  return sample;
}

/// kSpdf, kSpatialSpdf.
absl::StatusOr<CloudSample> SampleBySpdf(const LatticeCloud& cloud,
                                         const SamplerOptions& options,
                                         const ExecutionContext& context) {
  SpdfOptions spdf = options.spdf;
  ExecutionContext filter_context = context;
  const bool is_spatial = options.method == SampleMethod::kSpatialSpdf;
  if (!is_spatial && options.max_points > 0) {
    MAPSIEVE_ASSIGN_OR_RETURN(
        spdf.density_radius_m,
        FindDensityRadius(cloud, spdf, options.max_points, context));
    // Progress has been that of the search.
    filter_context.progress = nullptr;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(FilteredCloud filtered,
                            FilterCloud(cloud, spdf, filter_context));
  CloudSample sample;
  if (is_spatial) {
    const FilteredCloud kept =
        options.ideal_share > 0
            ? filtered.WithoutOutliers(
                  OutlierTest::OfIdealShapes(spdf, options.ideal_share))
            : filtered.WithoutOutliers(spdf.outlier_share);
    std::span<const uint16_t> confidences;
    if (options.ChosenRepresentative() == Representative::kSurest) {
      confidences = kept.columns.confidence;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(
        const CellSample chosen,
        SampleUnderBudget(PositionsOf(cloud, kept), kept.columns.label,
                          options.max_points, std::nullopt, context.stop,
                          options.cell_split.value_or(CellSplit::kFullest),
                          confidences));
    sample = LabeledSample(cloud, kept, chosen.rows);
    if (options.ChosenRepresentative() == Representative::kCentroid) {
      MoveToCentroids(chosen.centroids, sample.cloud);
    }
    sample.parameter = static_cast<double>(chosen.rows.size());
  } else {
    sample =
        LabeledSample(cloud, filtered, filtered.Inliers(spdf.outlier_share));
    sample.parameter = spdf.density_radius_m;
  }
  sample.filtered = std::move(filtered);
  return sample;
}

}  // namespace

absl::StatusOr<CloudSample> Sample(const LatticeCloud& cloud,
                                   const SamplerOptions& options,
                                   const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate(cloud.lattice));
  switch (options.method) {
    case SampleMethod::kSpdf:
    case SampleMethod::kSpatialSpdf:
      return SampleBySpdf(cloud, options, context);
    case SampleMethod::kNss:
    case SampleMethod::kCovs:
      return SampleByNormals(cloud, options, context);
    default:
      return SamplePositions(cloud, options, context);
  }
}

}  // namespace mapsieve::core
