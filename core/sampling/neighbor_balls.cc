#include "core/sampling/neighbor_balls.h"

#include <algorithm>
#include <cstddef>
#include <numeric>

#include "core/base/status.h"
#include "core/geometry/cell_key.h"
#include "core/spdf/gathered_block.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/point_index.h"

namespace mapsieve::core {
namespace {

/// Cells of this level and what is within reach of them fit an index.
constexpr int kIndexedLevel = 28;

constexpr int32_t kMaxD2 = kMaxRadiusSteps * kMaxRadiusSteps;

/// Points of one parallel task.
constexpr uint32_t kTaskPoints = 4096;

struct IndexedCell {
  CellKey key;
  size_t begin = 0;
  size_t end = 0;
};

/// Finds the balls of the index points of one node after the other.
class BallFinder {
 public:
  BallFinder(const PointIndex& index, int neighbor_count,
             std::span<NeighborBall> balls)
      : index_(index),
        neighbor_count_(neighbor_count),
        balls_(balls),
        block_(index) {}

  /// Every point of the node has its neighbours within `bound` steps, or as
  /// many as it has within kMaxRadiusSteps.
  void Visit(uint32_t n, int64_t bound) {
    const PointIndex::Node& node = index_.nodes()[n];
    if (static_cast<int64_t>(node.size()) > neighbor_count_) {
      // No two points of it are farther apart.
      bound = std::min(bound, 2 * node.box.Extent());
    }
    if (!node.is_leaf()) {
      Visit(n + 1, bound);
      Visit(node.right, bound);
      return;
    }
    wanted_.resize(node.end - node.begin);
    std::iota(wanted_.begin(), wanted_.end(), node.begin);
    // Points of the halo are not asked for.
    std::erase_if(wanted_, [&](uint32_t i) {
      return index_.numbers()[i] >= balls_.size();
    });
    if (wanted_.empty()) return;
    SplitWide(index_, wanted_, GroupExtent(bound),
              [&](const IndexBox& box, std::span<const uint32_t> points) {
                block_.GatherNearest(box, bound, neighbor_count_);
                for (const uint32_t i : points) {
                  balls_[index_.numbers()[i]] = Find(i);
                }
              });
  }

 private:
  NeighborBall Find(uint32_t i) {
    const Kernels& kernels = ActiveKernels();
    const auto [x, y, z] = block_.Relative(i);
    const CandidateBlock block = block_.block();
    const KernelScratch scratch = block_.scratch();
    kernels.distances(block, x, y, z, scratch.d2);
    const int32_t bound =
        kernels.select(scratch.d2, block.count, neighbor_count_ + 1,
                       block_.CompleteWithin(x, y, z, kMaxD2));
    NeighborBall ball;
    int32_t count = 0;
    for (int c = 0; c < block.count; ++c) {
      if (scratch.d2[c] > bound) continue;
      ++count;
      ball.radius_d2 = std::max(ball.radius_d2, scratch.d2[c]);
    }
    ball.count = count - 1;
    if (ball.count < neighbor_count_) ball.radius_d2 = kMaxD2;
    return ball;
  }

  const PointIndex& index_;
  const int neighbor_count_;
  const std::span<NeighborBall> balls_;
  GatheredBlock block_;
  std::vector<uint32_t> wanted_;
};

/// An index of the points of `cell`, numbered from 0 on, and of those within
/// reach of them in other cells, with higher numbers.
PointIndex MakeIndex(std::span<const LatticePoint> positions,
                     std::span<const IndexedCell> cells,
                     const IndexedCell& cell, Executor& executor) {
  PointIndex index(cell.key.corner());
  index.Reserve(positions.size());
  const LatticePoint origin = cell.key.corner();
  const LatticeBox near = cell.key.box().Grown(kMaxRadiusSteps);
  auto next_number = static_cast<uint32_t>(cell.end - cell.begin);
  for (const IndexedCell& other : cells) {
    if (!other.key.box().Intersects(near)) continue;
    const bool is_own = other.key == cell.key;
    uint32_t own_number = 0;
    for (size_t i = other.begin; i < other.end; ++i) {
      const LatticePoint& q = positions[i];
      if (!near.Contains(q)) continue;
      index.Append(static_cast<int32_t>(q.x - origin.x),
                   static_cast<int32_t>(q.y - origin.y),
                   static_cast<int32_t>(q.z - origin.z),
                   is_own ? own_number++ : next_number++);
    }
  }
  index.Build(executor);
  return index;
}

/// Appends the highest nodes below `n` that hold no more points than a task
/// takes.
void FindTasks(const PointIndex& index, uint32_t n,
               std::vector<uint32_t>& tasks) {
  const PointIndex::Node& node = index.nodes()[n];
  if (node.size() <= kTaskPoints || node.is_leaf()) {
    tasks.push_back(n);
    return;
  }
  FindTasks(index, n + 1, tasks);
  FindTasks(index, node.right, tasks);
}

}  // namespace

absl::StatusOr<std::vector<NeighborBall>> FindNeighborBalls(
    std::span<const LatticePoint> positions, int neighbor_count,
    const ExecutionContext& context) {
  std::vector<IndexedCell> cells;
  for (size_t begin = 0; begin < positions.size();) {
    const size_t end =
        CellEnd(begin, positions.size(), kIndexedLevel,
                [&](size_t i) -> const LatticePoint& { return positions[i]; });
    cells.push_back({CellKey::Of(positions[begin], kIndexedLevel), begin, end});
    begin = end;
  }
  std::vector<NeighborBall> balls(positions.size());
  for (const IndexedCell& cell : cells) {
    const PointIndex index =
        MakeIndex(positions, cells, cell, *context.executor);
    std::vector<uint32_t> tasks;
    FindTasks(index, 0, tasks);
    context.executor->ParallelFor(
        static_cast<int64_t>(tasks.size()), [&](int64_t t) {
          if (context.stop.stop_requested()) return;
          BallFinder finder(
              index, neighbor_count,
              std::span(balls).subspan(cell.begin, cell.end - cell.begin));
          finder.Visit(tasks[static_cast<size_t>(t)], kMaxRadiusSteps);
        });
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
  }
  return balls;
}

}  // namespace mapsieve::core
