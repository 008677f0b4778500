#include "core/spdf/work_unit.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/geometry/octahedral.h"
#include "core/geometry/vector3.h"
#include "core/spdf/integer_root.h"
#include "core/spdf/quota.h"
#include "core/spdf/strength_tests.h"

namespace mapsieve::core {
namespace {

/// Points of one task: enough to hide its start, few enough to balance.
constexpr uint32_t kTaskPoints = 2048;

/// Nearby points that are evaluated together. They share one gathered block:
/// many make it cheap, few keep it small.
constexpr uint32_t kGroupPoints = 32;
/// The same where they are only counted, so that a larger block costs little.
constexpr uint32_t kQuotaGroupPoints = 64;
/// Wanted points that lie among so many others are still nearby.
constexpr uint32_t kGroupSpread = 128;

/// Share of flagged points that survive a draw, in units of 2^-24.
constexpr double kJunctionSurvival = 0.2;
constexpr double kOtherSurvival = 0.5;

/// Most points settle within 1.25 times the density radius: the rounds look no
/// farther unless that leaves a point undecided.
int32_t EarlyRadius(const SpdfConstants& constants) {
  return static_cast<int32_t>(std::min<int64_t>(
      constants.reach_d2, int64_t{constants.density_d2} * 25 / 16 + 1));
}

double ToStrength(int32_t sum, int neighbor_count) {
  return static_cast<double>(sum) / (neighbor_count * 0x1p24);
}

/// Longest distance of two points of a box.
int64_t Diagonal(const IndexBox& box) {
  int64_t square = 0;
  for (size_t a = 0; a < 3; ++a) {
    // Capped so that the square fits; the bound is only used below it.
    const int64_t edge =
        std::min<int64_t>(int64_t{box.max[a]} - box.min[a], int64_t{1} << 30);
    square += edge * edge;
  }
  return CeilRoot(square);
}

}  // namespace

/// Counts by itself and adds to a shared total when it ends: threads that
/// changed the total often would wait for its cache line.
class WorkUnit::LocalCount {
 public:
  explicit LocalCount(std::atomic<int64_t>& total) : total_(total) {}
  ~LocalCount() { total_.fetch_add(count_, std::memory_order_relaxed); }
  LocalCount(const LocalCount&) = delete;
  LocalCount& operator=(const LocalCount&) = delete;

  void Add(int64_t count) { count_ += count; }

 private:
  std::atomic<int64_t>& total_;
  int64_t count_ = 0;
};

WorkUnit::WorkUnit(const LatticePoint& origin, const SpdfOptions& options,
                   const SpdfConstants& constants)
    : options_(options), constants_(constants), index_(origin), dead_(origin) {}

void WorkUnit::Reserve(size_t size) {
  index_.Reserve(size);
  is_core_.reserve(size);
  deaths_.reserve(size);
}

void WorkUnit::Grow(size_t count, bool is_core) {
  index_.Grow(count, static_cast<uint32_t>(deaths_.size()));
  is_core_.resize(is_core_.size() + count, is_core ? 1 : 0);
  deaths_.resize(deaths_.size() + count, kAlive);
}

void WorkUnit::IndexSurvivors(int round, const ExecutionContext& context) {
  if (indexed_round_ == round) return;
  Executor& executor = *context.executor;
  const bool is_next_round = round == indexed_round_ + 1;
  if (indexed_round_ < 0) index_.Build(executor);
  dead_ = PointIndex(index_.origin());
  const auto died = static_cast<size_t>(std::count(
      deaths_.begin(), deaths_.end(), static_cast<DeathRound>(round)));
  dead_.Reserve(died);
  if (is_next_round && (index_.removed_count() + died) * 8 < index_.size()) {
    RemoveDead(round);
  } else {
    index_.Filter(
        executor, [&](uint32_t number) { return deaths_[number] > round; },
        [&](int32_t x, int32_t y, int32_t z, uint32_t number) {
          if (deaths_[number] == round) dead_.Append(x, y, z, number);
        });
  }
  dead_.Build(executor);
  indexed_round_ = round;
}

void WorkUnit::RemoveDead(int round) {
  const std::span<const uint32_t> numbers = index_.numbers();
  auto from = numbers.begin();
  const DeathRound* const begin = deaths_.data();
  const DeathRound* const end = begin + deaths_.size();
  for (const DeathRound* dead = begin; dead != end; ++dead) {
    dead = static_cast<const DeathRound*>(
        std::memchr(dead, round, static_cast<size_t>(end - dead)));
    if (dead == nullptr) return;
    const auto number = static_cast<uint32_t>(dead - begin);
    from = std::lower_bound(from, numbers.end(), number);
    const auto i = static_cast<uint32_t>(from - numbers.begin());
    const auto [x, y, z] = index_.Coordinates(i);
    dead_.Append(x, y, z, number);
    index_.Remove(i);
  }
}

template <typename IsWanted, typename MakeVisitor>
absl::Status WorkUnit::ForEachGroup(const ExecutionContext& context,
                                    uint32_t group_points, int neighbor_count,
                                    const IsWanted& is_wanted,
                                    const MakeVisitor& make_visitor) const {
  using Node = PointIndex::Node;
  const std::span<const Node> nodes = index_.nodes();
  const auto k = static_cast<uint32_t>(neighbor_count);
  const auto bound_within = [&](const Node& node, int64_t bound) {
    return node.size() > k ? std::min(bound, Diagonal(node.box)) : bound;
  };
  struct Task {
    uint32_t node;
    int64_t bound;
  };
  std::vector<Task> tasks;
  const auto add_tasks = [&](const auto& self, uint32_t n,
                             int64_t bound) -> void {
    const Node& node = nodes[n];
    bound = bound_within(node, bound);
    if (node.size() <= kTaskPoints || node.is_leaf()) {
      tasks.push_back({n, bound});
      return;
    }
    self(self, n + 1, bound);
    self(self, node.right, bound);
  };
  if (!nodes.empty()) add_tasks(add_tasks, 0, kUnbounded);

  context.executor->ParallelFor(
      static_cast<int64_t>(tasks.size()), [&](int64_t t) {
        if (context.stop.stop_requested()) return;
        auto visitor = make_visitor();
        std::vector<uint32_t> wanted;
        const auto visit = [&](const auto& self, uint32_t n,
                               int64_t bound) -> void {
          const Node& node = nodes[n];
          bound = bound_within(node, bound);
          if (node.is_leaf() || node.size() <= kGroupSpread) {
            wanted.clear();
            for (uint32_t i = node.begin; i < node.end; ++i) {
              const uint32_t number = index_.numbers()[i];
              if (is_core_[number] != 0 && is_wanted(number)) {
                wanted.push_back(i);
              }
            }
            if (wanted.empty()) return;
            if (node.is_leaf() || wanted.size() <= group_points) {
              visitor(bound, std::span<const uint32_t>(wanted));
              return;
            }
          }
          self(self, n + 1, bound);
          self(self, node.right, bound);
        };
        const Task& task = tasks[static_cast<size_t>(t)];
        visit(visit, task.node, task.bound);
      });
  return context.CheckStop();
}

template <typename Use>
void WorkUnit::CastBallVotes(GatheredBlock& block, int neighbor_count,
                             int64_t bound, int32_t limit_d2,
                             std::span<const uint32_t> points,
                             LocalCount& votes, const Use& use) const {
  const Kernels& kernels = ActiveKernels();
  const int k = neighbor_count;
  const int64_t radius = std::min(CeilRoot(limit_d2), bound);
  SplitWide(
      index_, points, GroupExtent(radius),
      [&](const IndexBox& box, std::span<const uint32_t> part) {
        block.GatherNearest(box, radius, k);
        const KernelScratch scratch = block.scratch();
        BallSums sums;
        std::array<int32_t, 3> last{};
        int64_t last_radius = kUnbounded;
        for (const uint32_t i : part) {
          const auto [x, y, z] = block.Relative(i);
          int32_t bound_d2 = block.CompleteWithin(x, y, z, limit_d2);
          if (last_radius != kUnbounded) {
            // k + 1 points lie within the last point's radius of it.
            const int64_t dx = x - last[0];
            const int64_t dy = y - last[1];
            const int64_t dz = z - last[2];
            const int64_t far =
                last_radius + CeilRoot(dx * dx + dy * dy + dz * dz);
            bound_d2 =
                static_cast<int32_t>(std::min<int64_t>(bound_d2, far * far));
          }
          kernels.ball_vote(block.block(),
                            {x, y, z, k, bound_d2, constants_.weight_scale},
                            scratch, &sums);
          votes.Add(sums.member_count);
          last = {x, y, z};
          last_radius =
              sums.member_count == k ? CeilRoot(sums.radius_d2) : kUnbounded;
          use(i, sums);
        }
      });
}

class WorkUnit::RoundVisitor {
 public:
  RoundVisitor(WorkUnit& unit, int round, std::atomic<int64_t>& died,
               std::atomic<int64_t>& flagged)
      : unit_(unit),
        constants_(unit.constants_),
        round_(round),
        votes_(unit.vote_count_),
        died_(died),
        flagged_(flagged),
        early_d2_(EarlyRadius(constants_)),
        // The slack covers the rounding of a weight that need not be monotone.
        early_weight_(
            ActiveKernels().weight(early_d2_, constants_.weight_scale) + 2),
        block_(unit.index_),
        dead_block_(unit.dead_) {}

  void operator()(int64_t bound, std::span<const uint32_t> active) {
    if (round_ == 1) {
      Evaluate(bound, active);
    } else if (unit_.dead_.size() > 0) {
      FindTouched(active);
      if (!touched_.empty()) Evaluate(bound, touched_);
    }
    Draw(active);
  }

 private:
  RoundState& StateOf(uint32_t i) {
    return unit_.round_states_[unit_.index_.numbers()[i]];
  }

  /// Makes touched_ those of `active` with a dead point among their
  /// neighbours. A neighbourhood changes only where one of its points died; a
  /// re-evaluation that was not needed changes nothing.
  void FindTouched(std::span<const uint32_t> active) {
    const Kernels& kernels = ActiveKernels();
    touched_.clear();
    SplitWide(unit_.index_, active, kMaxRadiusSteps,
              [&](const IndexBox& box, std::span<const uint32_t> part) {
                int32_t largest = 0;
                for (const uint32_t i : part) {
                  largest = std::max(largest, StateOf(i).radius_d2);
                }
                dead_block_.Gather(box, CeilRoot(largest));
                const CandidateBlock near = dead_block_.block();
                if (near.count == 0) return;
                for (const uint32_t i : part) {
                  const auto [x, y, z] =
                      dead_block_.RelativeOf(unit_.index_, i);
                  if (kernels.any_within(near, x, y, z, StateOf(i).radius_d2)) {
                    touched_.push_back(i);
                  }
                }
              });
  }

  void Evaluate(int64_t bound, std::span<const uint32_t> points) {
    const int k = constants_.neighbor_count;
    undecided_.clear();
    unit_.CastBallVotes(
        block_, k, bound, early_d2_, points, votes_,
        [&](uint32_t i, const BallSums& sums) {
          // Without all neighbours, whatever is missing lies beyond.
          const int64_t missing =
              early_d2_ < constants_.reach_d2 ? k - sums.member_count : 0;
          const int64_t most = sums.c0 + missing * early_weight_;
          if (!MayBeFlagged(most, constants_)) {
            StateOf(i) = {};
          } else if (missing > 0) {
            undecided_.push_back(i);
          } else {
            StateOf(i) = {sums.radius_d2, StrengthFlags(sums, constants_)};
          }
        });
    if (undecided_.empty()) return;
    unit_.CastBallVotes(
        block_, k, bound, constants_.reach_d2, undecided_, votes_,
        [&](uint32_t i, const BallSums& sums) {
          StateOf(i) = {};
          if (MayBeFlagged(sums.c0, constants_)) {
            StateOf(i) = {sums.radius_d2, StrengthFlags(sums, constants_)};
          }
        });
  }

  void Draw(std::span<const uint32_t> active) {
    for (const uint32_t i : active) {
      RoundState& state = StateOf(i);
      if (state.flags == 0) continue;
      if (SurvivesDraws(i, state.flags)) {
        flagged_.Add(1);
      } else {
        unit_.deaths_[unit_.index_.numbers()[i]] =
            static_cast<DeathRound>(round_);
        state = {};
        died_.Add(1);
      }
    }
  }

  bool SurvivesDraws(uint32_t i, uint32_t flags) const {
    const LatticePoint q = unit_.index_.Position(i);
    for (const Label test :
         {Label::kJunction, Label::kCurve, Label::kSurface}) {
      const auto number = static_cast<unsigned>(test);
      if ((flags >> number & 1) == 0) continue;
      const int64_t key[6] = {q.x,    q.y,    q.z,
                              round_, number, unit_.options_.seed};
      const auto draw = static_cast<double>(HashIntegers(key) >> 40);
      const double survival =
          test == Label::kJunction ? kJunctionSurvival : kOtherSurvival;
      if (draw >= survival * 0x1p24) return false;
    }
    return true;
  }

  WorkUnit& unit_;
  const SpdfConstants& constants_;
  const int round_;
  LocalCount votes_;
  LocalCount died_;
  LocalCount flagged_;
  const int32_t early_d2_;
  /// An upper bound of the weight of a voter beyond it.
  const int32_t early_weight_;
  GatheredBlock block_;
  GatheredBlock dead_block_;
  std::vector<uint32_t> touched_;
  std::vector<uint32_t> undecided_;
};

absl::StatusOr<WorkUnit::RoundCounts> WorkUnit::RunPaperRound(
    int round, const ExecutionContext& context) {
  IndexSurvivors(round - 1, context);
  if (round == 1) round_states_.assign(size(), {});
  std::atomic<int64_t> died = 0;
  std::atomic<int64_t> flagged = 0;
  MAPSIEVE_RETURN_IF_ERROR(ForEachGroup(
      context, kGroupPoints, constants_.neighbor_count,
      [&](uint32_t number) {
        return round == 1 || round_states_[number].radius_d2 > 0;
      },
      [&] { return RoundVisitor(*this, round, died, flagged); }));
  return RoundCounts{died.load(), flagged.load()};
}

absl::Status WorkUnit::RunQuota(int64_t radius_d2,
                                const ExecutionContext& context) {
  IndexSurvivors(0, context);
  const QuotaRule rule = {.neighbor_count = constants_.neighbor_count,
                          .radius_d2 = radius_d2,
                          .seed = options_.seed};
  const QuotaPriorities priorities(index_, rule.seed, *context.executor);
  return ForEachGroup(
      context, kQuotaGroupPoints, constants_.neighbor_count,
      [](uint32_t) { return true; },
      [&] {
        return [this, counter = QuotaCounter(priorities, rule)](
                   int64_t, std::span<const uint32_t> points) mutable {
          for (const uint32_t i : counter.FindCrowded(points)) {
            deaths_[index_.numbers()[i]] = 1;
          }
        };
      });
}

class WorkUnit::VoterVisitor {
 public:
  explicit VoterVisitor(WorkUnit& unit)
      : unit_(unit), votes_(unit.vote_count_), block_(unit.index_) {}

  void operator()(int64_t bound, std::span<const uint32_t> points) {
    const int k = unit_.constants_.label_neighbor_count;
    unit_.CastBallVotes(block_, k, bound, unit_.constants_.reach_d2, points,
                        votes_, [&](uint32_t i, const BallSums& s) {
                          // T = C0 I - A / 2.
                          const double c0 = ToStrength(s.c0, k);
                          const double tensor[6] = {
                              c0 - ToStrength(s.xx, k) / 2,
                              -ToStrength(s.xy, k) / 2,
                              -ToStrength(s.xz, k) / 2,
                              c0 - ToStrength(s.yy, k) / 2,
                              -ToStrength(s.yz, k) / 2,
                              c0 - ToStrength(s.c0 - s.xx - s.yy, k) / 2};
                          for (size_t e = 0; e < 6; ++e)
                            batch_.entry[e][pending_] = tensor[e];
                          numbers_[pending_] = unit_.index_.numbers()[i];
                          radius_d2_[pending_] = s.radius_d2;
                          if (++pending_ == EigenBatch::kSize) Flush();
                        });
    Flush();
  }

 private:
  void Flush() {
    if (pending_ == 0) return;
    ActiveKernels().find_eigenvalues(&batch_);
    const auto& value = batch_.value;
    const auto& t = batch_.entry;
    for (size_t i = 0; i < pending_; ++i) {
      const double smallest = std::min({value[0][i], value[1][i], value[2][i]});
      unit_.voters_[numbers_[i]] = {
          {static_cast<float>(t[0][i] - smallest), static_cast<float>(t[1][i]),
           static_cast<float>(t[2][i]), static_cast<float>(t[3][i] - smallest),
           static_cast<float>(t[4][i]), static_cast<float>(t[5][i] - smallest)},
          radius_d2_[i]};
    }
    pending_ = 0;
  }

  WorkUnit& unit_;
  LocalCount votes_;
  GatheredBlock block_;
  EigenBatch batch_;
  size_t pending_ = 0;
  std::array<uint32_t, EigenBatch::kSize> numbers_{};
  std::array<int32_t, EigenBatch::kSize> radius_d2_{};
};

absl::Status WorkUnit::ComputeVoters(const ExecutionContext& context) {
  round_states_ = BulkVector<RoundState>();
  IndexSurvivors(kAlive - 1, context);
  voters_.resize(size());
  return ForEachGroup(
      context, kGroupPoints, constants_.label_neighbor_count,
      [](uint32_t) { return true; }, [&] { return VoterVisitor(*this); });
}

class WorkUnit::LabelVisitor {
 public:
  LabelVisitor(WorkUnit& unit, LabelColumns& columns)
      : unit_(unit),
        columns_(columns),
        votes_(unit.vote_count_),
        block_(unit.index_) {}

  void operator()(int64_t, std::span<const uint32_t> points) {
    SplitWide(unit_.index_, points, kMaxRadiusSteps,
              [&](const IndexBox& box, std::span<const uint32_t> part) {
                Vote(box, part);
              });
    Flush();
  }

 private:
  const VoterState& VoterOf(uint32_t i) const {
    return unit_.voters_[unit_.index_.numbers()[i]];
  }

  void Vote(const IndexBox& box, std::span<const uint32_t> points) {
    const Kernels& kernels = ActiveKernels();
    const SpdfConstants& constants = unit_.constants_;
    int32_t largest = 0;
    for (const uint32_t i : points) {
      largest = std::max(largest, VoterOf(i).radius_d2);
    }
    block_.Gather(box, CeilRoot(largest));
    const std::span<const int32_t> ids = block_.ids();
    const size_t room = ids.size() + 2 * kKernelPadding;
    tensors_.resize(12 * room);
    VoterTensors tensors;
    KernelScratch scratch = block_.scratch();
    for (size_t e = 0; e < 6; ++e) {
      tensors.entry[e] = tensors_.data() + e * room;
      scratch.entry[e] = tensors_.data() + (6 + e) * room;
    }
    for (size_t c = 0; c < ids.size(); ++c) {
      const VoterState& voter = VoterOf(static_cast<uint32_t>(ids[c]));
      for (size_t e = 0; e < 6; ++e) {
        tensors_[e * room + c] = std::bit_cast<int32_t>(voter.tensor[e]);
      }
    }
    for (const uint32_t i : points) {
      const auto [x, y, z] = block_.Relative(i);
      VoteSums sums;
      kernels.aware_vote(block_.block(),
                         {x, y, z, constants.label_neighbor_count,
                          VoterOf(i).radius_d2, constants.weight_scale},
                         tensors, scratch, &sums);
      votes_.Add(sums.member_count);
      if (sums.member_count == 0) {
        columns_.label[i] = Label::kNone;
        columns_.confidence[i] = 0;
        columns_.lambda[i] = {};
        columns_.normal[i] = {};
        columns_.tangent[i] = {};
        continue;
      }
      const int32_t entries[6] = {sums.xx, sums.xy, sums.xz,
                                  sums.yy, sums.yz, sums.zz};
      for (size_t e = 0; e < 6; ++e) {
        batch_.entry[e][pending_] =
            ToStrength(entries[e], constants.label_neighbor_count);
      }
      rows_[pending_] = i;
      if (++pending_ == EigenBatch::kSize) Flush();
    }
  }

  void Flush() {
    if (pending_ == 0) return;
    ActiveKernels().decompose(&batch_);
    for (size_t i = 0; i < pending_; ++i) WriteLabel(i);
    pending_ = 0;
  }

  void WriteLabel(size_t i) {
    std::array<size_t, 3> order = {0, 1, 2};
    const auto value = [&](size_t d) { return batch_.value[order[d]][i]; };
    // Equal eigenvalues keep their order.
    if (value(0) < value(1)) std::swap(order[0], order[1]);
    if (value(1) < value(2)) std::swap(order[1], order[2]);
    if (value(0) < value(1)) std::swap(order[0], order[1]);
    const auto vector = [&](size_t d) {
      const auto& v = batch_.vector[order[d]];
      return WithCanonicalSign({v[0][i], v[1][i], v[2][i]});
    };
    const uint32_t row = rows_[i];
    std::array<float, 3>& lambda = columns_.lambda[row];
    for (size_t d = 0; d < 3; ++d) lambda[d] = static_cast<float>(value(d));
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
    columns_.label[row] = label;
    const double scaled =
        std::nearbyint(static_cast<double>(saliency) * 65535.0);
    columns_.confidence[row] =
        static_cast<uint16_t>(std::clamp(scaled, 0.0, 65535.0));
    columns_.normal[row] = EncodeOctahedral(vector(0));
    columns_.tangent[row] = EncodeOctahedral(vector(2));
  }

  const WorkUnit& unit_;
  LabelColumns& columns_;
  LocalCount votes_;
  GatheredBlock block_;
  std::vector<int32_t> tensors_;
  EigenBatch batch_;
  size_t pending_ = 0;
  std::array<uint32_t, EigenBatch::kSize> rows_{};
};

absl::StatusOr<WorkUnit::Labeled> WorkUnit::CastAwareVotes(
    const ExecutionContext& context) {
  IndexSurvivors(kAlive - 1, context);
  Labeled result{.points = index_.numbers()};
  result.columns.Resize(index_.size());
  MAPSIEVE_RETURN_IF_ERROR(ForEachGroup(
      context, kGroupPoints, constants_.label_neighbor_count,
      [](uint32_t) { return true; },
      [&] { return LabelVisitor(*this, result.columns); }));
  voters_ = BulkVector<VoterState>();
  return result;
}

}  // namespace mapsieve::core
