#ifndef MAPSIEVE_CORE_SPDF_WORK_UNIT_H_
#define MAPSIEVE_CORE_SPDF_WORK_UNIT_H_

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/spdf/kernels.h"
#include "core/spdf/labels.h"
#include "core/spdf/point_index.h"
#include "core/spdf/spdf_options.h"

namespace mapsieve::core {

/// Round in which a point died: 1, 2, …; kAlive for a survivor.
using DeathRound = uint8_t;
inline constexpr DeathRound kAlive = 255;

/// What the rounds remember of a point: 8 bytes, zero for a point that can
/// never be flagged again ("settled").
struct RoundState {
  /// Every neighbour of the point lies within it; 0 if settled.
  int32_t radius_d2 = 0;
  /// Tests that flag the point: bit l for the Label l.
  uint32_t flags = 0;
};

/// What the aware vote needs of a survivor.
struct VoterState {
  /// Ball tensor / k less its smallest eigenvalue.
  VoterTensor tensor;
  int32_t radius_d2 = 0;
};

/// The points of some tiles (the core) and of their halo, and the steps of the
/// filter on them. The whole cloud is the unit whose core is everything.
/// A step's result for a core point depends on the points within its reach
/// only, never on how points are grouped into units, on their order of arrival
/// or on the number of workers. Not thread-safe; steps use the executor.
class WorkUnit {
 public:
  /// `points`: distinct, in Morton order; every coordinate within 2^30 steps
  /// of `origin`. `is_core`: one byte a point.
  WorkUnit(const LatticePoint& origin, std::span<const LatticePoint> points,
           std::vector<uint8_t> is_core, const SpdfOptions& options,
           const SpdfConstants& constants);

  size_t size() const { return deaths_.size(); }
  LatticePoint Position(uint32_t point) const;

  /// One entry a point, both written by the steps for core points; of halo
  /// points the deaths are to be set before a step, the state is not used.
  std::vector<DeathRound>& deaths() { return deaths_; }
  std::vector<RoundState>& round_states() { return round_states_; }

  /// Rule kPaper: evaluates core points on the survivors of `round` - 1 (all
  /// of them in round 1, later those that lost a neighbour in it), then draws
  /// for the flagged ones; the dead get death `round`. Returns how many died
  /// and how many core points remain flagged.
  struct RoundCounts {
    int64_t died = 0;
    int64_t flagged = 0;
  };
  absl::StatusOr<RoundCounts> RunPaperRound(int round,
                                            const ExecutionContext& context);

  /// Rule kQuota: core points that too many better points surround get death
  /// 1. The halo is the density radius.
  absl::Status RunQuota(const ExecutionContext& context);

  /// Ball votes of the surviving core points; halo: one reach.
  absl::Status ComputeVoters(const ExecutionContext& context);
  /// One entry a point; of halo points to be set before CastAwareVotes.
  std::vector<VoterState>& voters() { return voters_; }

  /// Aware votes and labels of the surviving core points, in order.
  struct Labeled {
    /// Numbers of the points in the unit, ascending.
    std::vector<uint32_t> points;
    LabelColumns columns;
  };
  absl::StatusOr<Labeled> CastAwareVotes(const ExecutionContext& context);

 private:
  /// Makes index_ hold the points whose death is later than `round`.
  void IndexSurvivors(int round);
  PointIndex MakeIndex(std::span<const uint32_t> points) const;

  /// Calls visit(block, leaf_number, wanted index points) for groups of wanted
  /// points of each leaf, from many tasks; `is_wanted(index point)`.
  template <typename IsWanted, typename Visit>
  absl::Status ForEachGroup(const ExecutionContext& context,
                            const IsWanted& is_wanted, const Visit& visit);

  void EvaluateGroup(GatheredBlock& block, uint32_t leaf,
                     std::span<const uint32_t> wanted);
  RoundState Evaluate(const BallSums& sums) const;
  bool SurvivesDraws(uint32_t point, int round) const;

  const SpdfOptions options_;
  const SpdfConstants constants_;
  const LatticePoint origin_;
  /// Squared radius searched first in the rounds; most points settle within.
  const int32_t early_d2_;
  /// An upper bound of the weight of a voter beyond it.
  const int32_t early_weight_;

  std::vector<int32_t> x_;
  std::vector<int32_t> y_;
  std::vector<int32_t> z_;
  std::vector<uint8_t> is_core_;
  std::vector<DeathRound> deaths_;
  std::vector<RoundState> round_states_;
  std::vector<VoterState> voters_;

  /// Survivors of indexed_round_, and the unit's number of each.
  PointIndex index_;
  std::vector<uint32_t> index_points_;
  int indexed_round_ = -1;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_WORK_UNIT_H_
