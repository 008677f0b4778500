#ifndef MAPSIEVE_SERVER_ENGINE_ANSWER_STREAM_H_
#define MAPSIEVE_SERVER_ENGINE_ANSWER_STREAM_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <future>
#include <optional>
#include <set>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/codec/points_codec.h"
#include "core/sampling/spatial_budget.h"
#include "server/engine/answer_columns.h"
#include "server/engine/chunk_walk.h"
#include "server/engine/point_filter.h"
#include "server/engine/query.h"
#include "storage/store.h"

namespace mapsieve::engine {

/// Chunks that an answer lacks.
struct MissingChunks {
  /// Their numbers.
  std::set<int64_t> numbers;
  int64_t point_count = 0;
  /// The first kMaxListedChunks.
  std::vector<DamagedChunk> listed;

  int64_t count() const { return static_cast<int64_t>(numbers.size()); }
};

/// What all passes over the chunks of one answer share; outlives them.
struct AnswerSource {
  const storage::ReadSnapshot& snapshot;
  storage::ChunkKind kind;
  const PointFilter& filter;
  const AnswerColumns& columns;
  Representative representative;
  bool allows_partial;
  core::Compression compression;
  std::stop_token stop;

  ChunkWalk NewWalk() const {
    return {snapshot, kind, filter.region(), filter.min_depth()};
  }
  /// kCancelled once a stop was requested.
  absl::Status CheckStop() const;

  /// Of a chunk: its points, and which of them pass the filter.
  struct Part {
    core::LatticeCloud points;
    PointFilter::Passed passed;
  };
  /// Reads the columns `names` and those of the filter. Thread-safe.
  absl::StatusOr<Part> Read(const storage::ChunkRef& chunk,
                            std::vector<std::string> names) const;
  /// What Read gave. Nothing: the chunk is damaged, which the answer allows,
  /// and was added to `missing`; null: damage is kDataLoss.
  absl::StatusOr<std::optional<Part>> Accept(const storage::ChunkRef& chunk,
                                             absl::StatusOr<Part> part,
                                             MissingChunks* missing) const;
  /// Read, on another thread. The source outlives the result.
  std::future<absl::StatusOr<Part>> BeginRead(
      const storage::ChunkRef& chunk, std::vector<std::string> names) const {
    return std::async(
        std::launch::async,
        [this, chunk, names = std::move(names)] { return Read(chunk, names); });
  }
  /// The bytes of a chunk that is a block of the answer as it is stored;
  /// nothing: it is none, or missing as for Accept.
  absl::StatusOr<std::optional<std::vector<std::byte>>> ReadAsStored(
      const storage::ChunkRef& chunk, MissingChunks* missing) const;

 private:
  /// `status`, or nothing if it is damage that the answer allows: then the
  /// chunk was added to `missing`.
  absl::Status CheckRead(const storage::ChunkRef& chunk,
                         const absl::Status& status,
                         MissingChunks* missing) const;
};

/// A chunk that another thread reads.
struct ComingChunk {
  storage::ChunkRef ref;
  std::future<absl::StatusOr<AnswerSource::Part>> part;
};
/// Chunks of an answer that are read at the same time, at most.
inline constexpr size_t kMaxChunksAhead = 3;

/// Points chosen among the candidates of an answer: those that pass the filter,
/// in the order of the walk, without the chunks that the answer lacks.
struct Choice {
  /// Its rows are numbers of candidates and ascend.
  core::CellSample sample;
  /// The number of candidates in each chunk that may have any.
  std::vector<uint32_t> chunk_counts;
};

/// Blocks of an answer that are made at the same time, at most.
inline constexpr size_t kMaxBlocksAhead = 3;

/// One pass over the chunks of an answer, as blocks. The same source and choice
/// give the same blocks. Used by one thread.
class AnswerStream {
 public:
  /// `choice`: those that stay of the points that pass the filter, made without
  /// the chunks of `missing`; null: all stay. Everything outlives the stream.
  /// Without a choice damaged chunks are added to `missing`, with one they are
  /// kDataLoss.
  AnswerStream(const AnswerSource& source, const Choice* choice,
               MissingChunks& missing)
      : source_(source),
        choice_(choice),
        missing_(missing),
        walk_(source.NewWalk()) {
    pending_.lattice = core::Lattice(source.snapshot.map().spec.step_nm);
  }

  using Block = std::vector<std::byte>;

  /// The next block; nothing after the last one. Blocks behind it are read and
  /// encoded meanwhile, by other threads too, up to a stored chunk. After an
  /// error the stream is of no further use. Errors as QueryCursor::NextBatch.
  absl::StatusOr<std::optional<Block>> Next();
  /// Whether the last block was a chunk as it is stored: behind it no other was
  /// begun.
  bool gave_stored() const { return gave_stored_; }

  /// Passes over what Next would give, and returns whether that is anything.
  /// Before the first call of Next.
  absl::StatusOr<bool> Skip();

  struct Totals {
    int64_t point_count = 0;
    core::LabelCounts label_counts{};
    /// Of chunks of `missing` found before these blocks were whole.
    int64_t missing_chunk_count = 0;
  };
  /// Of the blocks so far, those passed over included.
  const Totals& given() const { return given_; }

 private:
  /// The points of the next block; none after the last one.
  absl::StatusOr<core::LatticeCloud> TakePoints();
  /// The stored chunk whose turn it is, if any.
  std::optional<Block> TakeStored();
  /// How many blocks are to be made at the same time: together about half of
  /// kMaxBatchBytes, so that with two messages of half of it on their way a
  /// client that reads slowly costs two batches.
  size_t BlocksAhead() const;
  size_t PointsPerBlock() const;
  /// Has the next block encoded, or finds that there is none.
  absl::Status BeginBlock();
  /// Makes `wanted` points pending, if as many come before a stored chunk.
  absl::Status LoadPending(size_t wanted);
  /// Appends what stays of the next chunk to the pending points, or makes it
  /// the stored chunk.
  absl::Status LoadChunk();
  /// LoadPending with a choice: chunks without chosen points are not read,
  /// others side by side.
  absl::Status LoadChosen(size_t wanted);
  /// Leaves those of `passed`, the candidates from number `begin` on, that have
  /// the entries [first, last) of the choice, and returns where they are in the
  /// answer.
  std::vector<core::LatticePoint> KeepChosen(const core::LatticeCloud& points,
                                             uint64_t begin, size_t first,
                                             size_t last,
                                             PointFilter::Passed& passed) const;
  /// Appends the rows `passed` of `points`, which are at `positions` in the
  /// answer.
  absl::Status Append(const core::LatticeCloud& points,
                      const PointFilter::Passed& passed,
                      std::span<const core::LatticePoint> positions);
  size_t PendingCount() const { return pending_.size() - taken_; }
  /// Frees the pending points that were taken.
  void DropTaken();
  /// Those at rows [begin, begin + count).
  core::LatticeCloud PendingPoints(size_t begin, size_t count) const;

  const AnswerSource& source_;
  const Choice* const choice_;
  MissingChunks& missing_;
  ChunkWalk walk_;
  bool is_walked_ = false;
  /// Made for the first block of many points; small ones before it go without.
  std::optional<core::EncodePlan> plan_;
  /// A chunk as it is stored, the block behind all pending points.
  std::optional<Block> stored_;
  int64_t stored_point_count_ = 0;
  /// Points of the answer, those up to taken_ taken.
  core::LatticeCloud pending_;
  std::vector<core::Label> pending_labels_;
  size_t taken_ = 0;
  /// How far the walk has come in the choice: entries, chunks, candidates.
  size_t next_chosen_ = 0;
  size_t chunks_seen_ = 0;
  uint64_t candidates_seen_ = 0;
  /// Of the blocks begun, and of those given.
  Totals taken_totals_;
  Totals given_;
  bool is_ended_ = false;
  bool gave_stored_ = false;
  size_t last_block_bytes_ = 0;
  /// A block being encoded, or a stored chunk, and the totals up to it.
  struct Coming {
    std::future<absl::StatusOr<Block>> encoded;
    std::optional<Block> stored;
    Totals totals;
  };
  /// Last: it waits for what uses the rest.
  std::deque<Coming> coming_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_ANSWER_STREAM_H_
