#include "core/spdf/work_unit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/geometry/symmetric3.h"
#include "core/spdf/strength_tests.h"

namespace mapsieve::core {
namespace {

/// Leaves of one task: enough to hide its start, few enough to balance.
constexpr int64_t kLeavesPerTask = 64;

/// Share of flagged points that survive a draw, in units of 2^-24.
constexpr double kJunctionSurvival = 0.2;
constexpr double kOtherSurvival = 0.5;

int64_t CeilRoot(int64_t square) {
  return static_cast<int64_t>(
      std::ceil(std::sqrt(static_cast<double>(square))));
}

int32_t EarlyRadius(const SpdfConstants& constants) {
  // 1.25 times the density radius.
  return static_cast<int32_t>(std::min<int64_t>(
      constants.reach_d2, int64_t{constants.density_d2} * 25 / 16 + 1));
}

double ToStrength(int32_t sum, int neighbor_count) {
  return static_cast<double>(sum) / (neighbor_count * 0x1p24);
}

}  // namespace

WorkUnit::WorkUnit(const LatticePoint& origin,
                   std::span<const LatticePoint> points,
                   std::vector<uint8_t> is_core, const SpdfOptions& options,
                   const SpdfConstants& constants)
    : options_(options),
      constants_(constants),
      origin_(origin),
      early_d2_(EarlyRadius(constants)),
      // The slack covers the rounding of a weight that need not be monotone.
      early_weight_(ActiveKernels().weight(early_d2_, constants.weight_scale) +
                    2),
      is_core_(std::move(is_core)),
      deaths_(points.size(), kAlive),
      round_states_(points.size()) {
  x_.reserve(points.size());
  y_.reserve(points.size());
  z_.reserve(points.size());
  for (const LatticePoint& q : points) {
    x_.push_back(static_cast<int32_t>(q.x - origin.x));
    y_.push_back(static_cast<int32_t>(q.y - origin.y));
    z_.push_back(static_cast<int32_t>(q.z - origin.z));
  }
}

LatticePoint WorkUnit::Position(uint32_t point) const {
  return {origin_.x + x_[point], origin_.y + y_[point], origin_.z + z_[point]};
}

PointIndex WorkUnit::MakeIndex(std::span<const uint32_t> points) const {
  std::vector<int32_t> x(points.size());
  std::vector<int32_t> y(points.size());
  std::vector<int32_t> z(points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    x[i] = x_[points[i]];
    y[i] = y_[points[i]];
    z[i] = z_[points[i]];
  }
  return {origin_, std::move(x), std::move(y), std::move(z)};
}

void WorkUnit::IndexSurvivors(int round) {
  if (indexed_round_ == round) return;
  size_t count = 0;
  for (const DeathRound death : deaths_) count += death > round ? 1 : 0;
  // Nobody died since: the index stands.
  const bool unchanged = indexed_round_ >= 0 && round > indexed_round_ &&
                         count == index_points_.size();
  indexed_round_ = round;
  if (unchanged) return;
  index_points_.clear();
  index_points_.reserve(count);
  for (uint32_t i = 0; i < deaths_.size(); ++i) {
    if (deaths_[i] > round) index_points_.push_back(i);
  }
  index_ = MakeIndex(index_points_);
}

template <typename IsWanted, typename Visit>
absl::Status WorkUnit::ForEachGroup(const ExecutionContext& context,
                                    const IsWanted& is_wanted,
                                    const Visit& visit) {
  const auto leaves = index_.leaves();
  const auto leaf_count = static_cast<int64_t>(leaves.size());
  const int64_t task_count = (leaf_count + kLeavesPerTask - 1) / kLeavesPerTask;
  context.executor->ParallelFor(task_count, [&](int64_t task) {
    if (context.stop.stop_requested()) return;
    GatheredBlock block;
    std::vector<uint32_t> wanted;
    const int64_t end = std::min(leaf_count, (task + 1) * kLeavesPerTask);
    for (int64_t l = task * kLeavesPerTask; l < end; ++l) {
      const uint32_t leaf = leaves[static_cast<size_t>(l)];
      const PointIndex::Node& node = index_.nodes()[leaf];
      wanted.clear();
      for (uint32_t i = node.begin; i < node.end; ++i) {
        if (is_wanted(i)) wanted.push_back(i);
      }
      if (!wanted.empty()) visit(block, leaf, std::span(wanted));
    }
  });
  return context.CheckStop();
}

namespace {

IndexBox BoxOf(const PointIndex& index, std::span<const uint32_t> points) {
  IndexBox box = index.PointBox(points[0]);
  for (const uint32_t i : points.subspan(1)) box.Extend(index.PointBox(i));
  return box;
}

/// Calls use(box, points) for `points`, or for halves of halves of them until
/// each part's box is at most `extent` wide.
template <typename Use>
void SplitWide(const PointIndex& index, std::span<const uint32_t> points,
               int64_t extent, const Use& use) {
  const IndexBox box = BoxOf(index, points);
  if (points.size() == 1 || box.Extent() <= extent) {
    use(box, points);
    return;
  }
  const size_t half = points.size() / 2;
  SplitWide(index, points.first(half), extent, use);
  SplitWide(index, points.subspan(half), extent, use);
}

int64_t GroupExtent(int64_t radius) {
  return std::min<int64_t>(2 * radius, kMaxRadiusSteps);
}

}  // namespace

RoundState WorkUnit::Evaluate(const BallSums& sums) const {
  if (!MayBeFlagged(sums.c0, constants_)) return {};
  return {sums.radius_d2, StrengthFlags(sums, constants_)};
}

void WorkUnit::EvaluateGroup(GatheredBlock& block, uint32_t leaf,
                             std::span<const uint32_t> wanted) {
  const Kernels& kernels = ActiveKernels();
  const int k = constants_.neighbor_count;
  const int64_t bound = index_.NeighborDistanceBound(leaf, k);
  std::vector<uint32_t> undecided;
  const auto query_all = [&](std::span<const uint32_t> points, int32_t d2) {
    const bool early = d2 < constants_.reach_d2;
    const int64_t radius = std::min(CeilRoot(d2), bound);
    SplitWide(
        index_, points, GroupExtent(radius),
        [&](const IndexBox& box, std::span<const uint32_t> part) {
          block.Gather(index_, box, radius);
          block.KeepNearest(k);
          const KernelScratch scratch = block.scratch();
          for (const uint32_t i : part) {
            const auto [x, y, z] = block.Relative(index_, i);
            BallSums sums;
            kernels.ball_vote(block.block(),
                              {x, y, z, k, block.CompleteWithin(x, y, z, d2),
                               constants_.weight_scale},
                              scratch, &sums);
            if (early && sums.member_count < k) {
              const int64_t most =
                  sums.c0 + int64_t{k - sums.member_count} * early_weight_;
              if (MayBeFlagged(most, constants_)) {
                undecided.push_back(i);
                continue;
              }
            }
            round_states_[index_points_[i]] = Evaluate(sums);
          }
        });
  };
  query_all(wanted, early_d2_);
  if (!undecided.empty()) {
    const std::vector<uint32_t> rest = std::move(undecided);
    undecided.clear();
    query_all(rest, constants_.reach_d2);
  }
}

bool WorkUnit::SurvivesDraws(uint32_t point, int round) const {
  const LatticePoint q = Position(point);
  for (const Label test : {Label::kJunction, Label::kCurve, Label::kSurface}) {
    const auto number = static_cast<unsigned>(test);
    if ((round_states_[point].flags >> number & 1) == 0) continue;
    const int64_t key[6] = {q.x, q.y, q.z, round, number, options_.seed};
    const auto draw = static_cast<double>(HashIntegers(key) >> 40);
    const double survival =
        test == Label::kJunction ? kJunctionSurvival : kOtherSurvival;
    if (draw >= survival * 0x1p24) return false;
  }
  return true;
}

absl::StatusOr<WorkUnit::RoundCounts> WorkUnit::RunPaperRound(
    int round, const ExecutionContext& context) {
  const int previous = round - 1;
  IndexSurvivors(previous);
  const auto is_core = [&](uint32_t i) {
    return is_core_[index_points_[i]] != 0;
  };
  const auto evaluate = [&](GatheredBlock& block, uint32_t leaf,
                            std::span<const uint32_t> wanted) {
    EvaluateGroup(block, leaf, wanted);
  };
  if (round == 1) {
    MAPSIEVE_RETURN_IF_ERROR(ForEachGroup(context, is_core, evaluate));
  } else {
    std::vector<uint32_t> dead;
    for (uint32_t i = 0; i < deaths_.size(); ++i) {
      if (deaths_[i] == previous) dead.push_back(i);
    }
    const PointIndex dead_index = MakeIndex(dead);
    const auto is_active = [&](uint32_t i) {
      return is_core(i) && round_states_[index_points_[i]].radius_d2 > 0;
    };
    // A neighbourhood changes only where one of its points died; a
    // re-evaluation that was not needed changes nothing.
    const auto evaluate_touched = [&](GatheredBlock& block, uint32_t leaf,
                                      std::span<const uint32_t> active) {
      std::vector<uint32_t> touched;
      SplitWide(index_, active, kMaxRadiusSteps,
                [&](const IndexBox& box, std::span<const uint32_t> part) {
                  int32_t largest = 0;
                  for (const uint32_t i : part) {
                    largest = std::max(
                        largest, round_states_[index_points_[i]].radius_d2);
                  }
                  block.Gather(dead_index, box, CeilRoot(largest));
                  const CandidateBlock near = block.block();
                  if (near.count == 0) return;
                  const KernelScratch scratch = block.scratch();
                  for (const uint32_t i : part) {
                    const auto [x, y, z] = block.Relative(index_, i);
                    ActiveKernels().distances(near, x, y, z, scratch.d2);
                    const int32_t nearest =
                        *std::min_element(scratch.d2, scratch.d2 + near.count);
                    if (nearest <= round_states_[index_points_[i]].radius_d2) {
                      touched.push_back(i);
                    }
                  }
                });
      if (!touched.empty()) EvaluateGroup(block, leaf, touched);
    };
    if (!dead.empty()) {
      MAPSIEVE_RETURN_IF_ERROR(
          ForEachGroup(context, is_active, evaluate_touched));
    }
  }
  RoundCounts counts;
  for (const uint32_t point : index_points_) {
    if (is_core_[point] == 0 || round_states_[point].flags == 0) continue;
    if (SurvivesDraws(point, round)) {
      ++counts.flagged;
    } else {
      deaths_[point] = static_cast<DeathRound>(round);
      round_states_[point] = {};
      ++counts.died;
    }
  }
  return counts;
}

absl::Status WorkUnit::RunQuota(const ExecutionContext& context) {
  IndexSurvivors(0);
  std::vector<uint64_t> priorities(index_points_.size());
  context.executor->ParallelFor(
      static_cast<int64_t>(priorities.size() + 8191) / 8192, [&](int64_t task) {
        const auto begin = static_cast<size_t>(task) * 8192;
        const size_t end = std::min(begin + 8192, priorities.size());
        for (size_t i = begin; i < end; ++i) {
          const LatticePoint q = Position(index_points_[i]);
          const int64_t key[4] = {q.x, q.y, q.z, options_.seed};
          priorities[i] = HashIntegers(key);
        }
      });
  const int64_t radius = CeilRoot(constants_.density_d2);
  return ForEachGroup(
      context, [&](uint32_t i) { return is_core_[index_points_[i]] != 0; },
      [&](GatheredBlock& block, uint32_t, std::span<const uint32_t> wanted) {
        SplitWide(
            index_, wanted, GroupExtent(radius),
            [&](const IndexBox& box, std::span<const uint32_t> part) {
              block.Gather(index_, box, radius);
              std::vector<uint64_t> local;
              local.reserve(block.ids().size());
              for (const uint32_t i : block.ids()) {
                local.push_back(priorities[i]);
              }
              auto at = block.ids().begin();
              for (const uint32_t i : part) {
                at = std::find(at, block.ids().end(), i);
                const auto self = static_cast<int>(at - block.ids().begin());
                const int better = ActiveKernels().count_better(
                    block.block(), local.data(), self, constants_.density_d2);
                if (better >= constants_.neighbor_count) {
                  deaths_[index_points_[i]] = 1;
                }
              }
            });
      });
}

absl::Status WorkUnit::ComputeVoters(const ExecutionContext& context) {
  IndexSurvivors(kAlive - 1);
  voters_.resize(size());
  const Kernels& kernels = ActiveKernels();
  const int k = constants_.neighbor_count;
  return ForEachGroup(
      context, [&](uint32_t i) { return is_core_[index_points_[i]] != 0; },
      [&](GatheredBlock& block, uint32_t leaf,
          std::span<const uint32_t> wanted) {
        const int64_t radius = std::min(CeilRoot(constants_.reach_d2),
                                        index_.NeighborDistanceBound(leaf, k));
        SplitWide(index_, wanted, GroupExtent(radius),
                  [&](const IndexBox& box, std::span<const uint32_t> part) {
                    block.Gather(index_, box, radius);
                    block.KeepNearest(k);
                    const KernelScratch scratch = block.scratch();
                    for (const uint32_t i : part) {
                      const auto [x, y, z] = block.Relative(index_, i);
                      BallSums s;
                      kernels.ball_vote(
                          block.block(),
                          {x, y, z, k,
                           block.CompleteWithin(x, y, z, constants_.reach_d2),
                           constants_.weight_scale},
                          scratch, &s);
                      // T = C0 I - A / 2.
                      const double c0 = ToStrength(s.c0, k);
                      const Symmetric3 t = {
                          c0 - ToStrength(s.xx, k) / 2,
                          -ToStrength(s.xy, k) / 2,
                          -ToStrength(s.xz, k) / 2,
                          c0 - ToStrength(s.yy, k) / 2,
                          -ToStrength(s.yz, k) / 2,
                          c0 - ToStrength(s.c0 - s.xx - s.yy, k) / 2};
                      const double smallest = SmallestEigenvalue(t);
                      voters_[index_points_[i]] = {
                          {{static_cast<float>(t.xx - smallest),
                            static_cast<float>(t.xy), static_cast<float>(t.xz),
                            static_cast<float>(t.yy - smallest),
                            static_cast<float>(t.yz),
                            static_cast<float>(t.zz - smallest)}},
                          s.radius_d2};
                    }
                  });
      });
}

namespace {

/// Writes entry `i` of `columns` from the aware vote of a point.
void LabelPoint(const VoteSums& sums, int neighbor_count, LabelColumns& columns,
                size_t i) {
  if (sums.member_count == 0) {
    columns.label[i] = Label::kNone;
    return;
  }
  const EigenSystem3 eigen = Decompose(
      {ToStrength(sums.xx, neighbor_count), ToStrength(sums.xy, neighbor_count),
       ToStrength(sums.xz, neighbor_count), ToStrength(sums.yy, neighbor_count),
       ToStrength(sums.yz, neighbor_count),
       ToStrength(sums.zz, neighbor_count)});
  std::array<float, 3>& lambda = columns.lambda[i];
  for (size_t d = 0; d < 3; ++d) {
    lambda[d] = static_cast<float>(eigen.values[d]);
  }
  const float surface = lambda[0] - lambda[1];
  const float curve = lambda[1] - lambda[2];
  const float junction = lambda[2];
  // Ties go to the surface, then to the curve.
  Label label = Label::kSurface;
  float saliency = surface;
  if (curve > saliency) {
    label = Label::kCurve;
    saliency = curve;
  }
  if (junction > saliency) {
    label = Label::kJunction;
    saliency = junction;
  }
  columns.label[i] = label;
  const double scaled = std::nearbyint(static_cast<double>(saliency) * 65535.0);
  columns.confidence[i] =
      static_cast<uint16_t>(std::clamp(scaled, 0.0, 65535.0));
  columns.normal[i] = EncodeOctahedral(WithCanonicalSign(eigen.vectors[0]));
  columns.tangent[i] = EncodeOctahedral(WithCanonicalSign(eigen.vectors[2]));
}

}  // namespace

absl::StatusOr<WorkUnit::Labeled> WorkUnit::CastAwareVotes(
    const ExecutionContext& context) {
  IndexSurvivors(kAlive - 1);
  const Kernels& kernels = ActiveKernels();
  const int k = constants_.neighbor_count;
  // Row of each index point in the result.
  std::vector<uint32_t> rows(index_points_.size());
  Labeled result;
  for (size_t i = 0; i < index_points_.size(); ++i) {
    rows[i] = static_cast<uint32_t>(result.points.size());
    if (is_core_[index_points_[i]] != 0) {
      result.points.push_back(index_points_[i]);
    }
  }
  LabelColumns& columns = result.columns;
  columns.label.resize(result.points.size());
  columns.confidence.resize(result.points.size());
  columns.lambda.resize(result.points.size());
  columns.normal.resize(result.points.size());
  columns.tangent.resize(result.points.size());

  MAPSIEVE_RETURN_IF_ERROR(ForEachGroup(
      context, [&](uint32_t i) { return is_core_[index_points_[i]] != 0; },
      [&](GatheredBlock& block, uint32_t, std::span<const uint32_t> wanted) {
        SplitWide(index_, wanted, kMaxRadiusSteps,
                  [&](const IndexBox& box, std::span<const uint32_t> part) {
                    int32_t largest = 0;
                    for (const uint32_t i : part) {
                      largest = std::max(largest,
                                         voters_[index_points_[i]].radius_d2);
                    }
                    block.Gather(index_, box, CeilRoot(largest));
                    const KernelScratch scratch = block.scratch();
                    std::vector<VoterTensor> tensors;
                    tensors.reserve(block.ids().size());
                    for (const uint32_t i : block.ids()) {
                      tensors.push_back(voters_[index_points_[i]].tensor);
                    }
                    for (const uint32_t i : part) {
                      const auto [x, y, z] = block.Relative(index_, i);
                      VoteSums sums;
                      kernels.aware_vote(
                          block.block(),
                          {x, y, z, k, voters_[index_points_[i]].radius_d2,
                           constants_.weight_scale},
                          tensors.data(), scratch, &sums);
                      LabelPoint(sums, k, columns, rows[i]);
                    }
                  });
      }));
  return result;
}

}  // namespace mapsieve::core
