#ifndef MAPSIEVE_CORE_SPDF_WORK_UNIT_H_
#define MAPSIEVE_CORE_SPDF_WORK_UNIT_H_

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/status/statusor.h"
#include "core/base/bulk_vector.h"
#include "core/base/executor.h"
#include "core/geometry/lattice.h"
#include "core/spdf/gathered_block.h"
#include "core/spdf/kernels.h"
#include "core/spdf/labels.h"
#include "core/spdf/point_index.h"
#include "core/spdf/spdf_options.h"
#include "core/spdf/tile_filter.h"

namespace mapsieve::core {

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
  /// Ball tensor / k less its smallest eigenvalue: xx xy xz yy yz zz.
  std::array<float, 6> tensor{};
  int32_t radius_d2 = 0;
};

/// The points of some tiles (the core) and of their halo, and the steps of the
/// filter on them. The whole cloud is the unit whose core is everything.
/// A step's result for a core point depends on the points within its reach
/// only, never on how points are grouped into units, on their order of arrival
/// or on the number of workers. Not thread-safe; steps use the executor.
class WorkUnit {
 public:
  /// A unit without points; every coordinate is to be within
  /// PointIndex::kMaxCoordinate steps of `origin`.
  WorkUnit(const LatticePoint& origin, const SpdfOptions& options,
           const SpdfConstants& constants);

  void Reserve(size_t size);
  /// Adds `count` points of the core or of the halo, to be set before a step.
  void Grow(size_t count, bool is_core);
  /// Sets points [begin, begin + points.size()): all of a unit are distinct
  /// and in Morton order. Different points may be set at once from several
  /// threads.
  void SetPoints(size_t begin, std::span<const LatticePoint> points) {
    index_.Set(begin, points);
  }

  size_t size() const { return deaths_.size(); }

  /// One entry a point: whether steps compute it, 1, or it is there for others
  /// only, 0; as Grow set it.
  BulkVector<uint8_t>& core() { return is_core_; }

  /// Position of a point; before the first step.
  LatticePoint Position(size_t i) const {
    return index_.Position(static_cast<uint32_t>(i));
  }

  /// One entry a point, written by the steps for core points; of halo points
  /// they are to be set before a step.
  BulkVector<DeathRound>& deaths() { return deaths_; }
  /// Of core points, written by RunPaperRound; given up by ComputeVoters.
  BulkVector<RoundState>& round_states() { return round_states_; }

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

  /// Rule kQuota with any radius: core points that too many better points
  /// within `radius_d2` steps², up to 2^52, surround get death 1. The halo is
  /// that radius.
  absl::Status RunQuota(int64_t radius_d2, const ExecutionContext& context);

  /// Ball votes of the surviving core points; halo: one reach.
  absl::Status ComputeVoters(const ExecutionContext& context);
  /// One entry a point; of halo points to be set before CastAwareVotes, which
  /// gives them up.
  BulkVector<VoterState>& voters() { return voters_; }

  /// The survivors, halo included, in order, and the aware votes and labels of
  /// those of the core.
  struct Labeled {
    /// Numbers of the points in the unit, ascending; valid as long as it is.
    std::span<const uint32_t> points;
    LabelColumns columns;
  };
  absl::StatusOr<Labeled> CastAwareVotes(const ExecutionContext& context);
  /// Position of the i-th of the points that were alive when the last step
  /// began.
  LatticePoint SurvivorPosition(size_t i) const {
    return index_.Position(static_cast<uint32_t>(i));
  }

  /// Votes of neighbours that all steps so far have summed up.
  int64_t vote_count() const {
    return vote_count_.load(std::memory_order_relaxed);
  }

 private:
  /// Makes index_ hold the points whose death is later than `round`, and dead_
  /// those that died in it.
  void IndexSurvivors(int round, const ExecutionContext& context);
  /// Moves those that died in `round`, few, from index_ to dead_.
  void RemoveDead(int round);

  /// Calls make_visitor() in each of many tasks, and what it returns for
  /// groups of up to `group_points` nearby wanted core points: visitor(bound,
  /// index points). Each point of a group has `neighbor_count` neighbours
  /// within `bound` steps, if that is not kUnbounded. `is_wanted(number)`.
  template <typename IsWanted, typename MakeVisitor>
  absl::Status ForEachGroup(const ExecutionContext& context,
                            uint32_t group_points, int neighbor_count,
                            const IsWanted& is_wanted,
                            const MakeVisitor& make_visitor) const;

  class LocalCount;
  /// Calls use(index point, sums) with the ball votes of some points from
  /// neighbours within limit_d2; `bound` and neighbor_count as in
  /// ForEachGroup. Adds to `votes` how many were summed up.
  template <typename Use>
  void CastBallVotes(GatheredBlock& block, int neighbor_count, int64_t bound,
                     int32_t limit_d2, std::span<const uint32_t> points,
                     LocalCount& votes, const Use& use) const;

  class RoundVisitor;
  class VoterVisitor;
  class LabelVisitor;

  const SpdfOptions options_;
  const SpdfConstants constants_;
  BulkVector<uint8_t> is_core_;
  BulkVector<DeathRound> deaths_;
  BulkVector<RoundState> round_states_;
  BulkVector<VoterState> voters_;

  /// Survivors of indexed_round_, and who died in it.
  PointIndex index_;
  PointIndex dead_;
  int indexed_round_ = -1;
  std::atomic<int64_t> vote_count_ = 0;
};

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_SPDF_WORK_UNIT_H_
