#include "client/lab/evaluation.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <fstream>
#include <limits>
#include <memory>
#include <numbers>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lab/draws.h"
#include "client/lab/trial_file.h"
#include "core/base/mutex.h"
#include "core/base/status.h"
#include "core/geometry/octahedral.h"
#include "core/registration/label_covariance.h"
#include "core/registration/transform_error.h"
#include "core/sampling/sampler.h"

namespace mapsieve::client {
namespace {

using core::DensityRule;
using core::IcpMethod;
using core::SampleMethod;
using std::numbers::pi;

constexpr double kInfinite = std::numeric_limits<double>::infinity();
constexpr double kSpatialDensityRadius = 0.2;
constexpr int kMaxIterationCount = 45;

double Seconds(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
      .count();
}

// Plan ------------------------------------------------------------------------

/// What is sampled once: all trials of a pair, count and method.
struct Cell {
  size_t pair = 0;
  int64_t count = 0;
  EvaluatedMethod method;
};

/// In the order of the file.
std::vector<Cell> PlanCells(const EvaluationOptions& options,
                            size_t pair_count) {
  std::vector<Cell> cells;
  for (size_t pair = 0; pair < pair_count; ++pair) {
    for (const int64_t count : options.counts) {
      for (const EvaluatedMethod& method : options.methods) {
        cells.push_back({pair, count, method});
      }
    }
  }
  return cells;
}

int64_t TrialsPerCell(const EvaluationOptions& options) {
  return static_cast<int64_t>(options.icp_methods.size()) * options.trial_count;
}

/// A start beside the truth.
struct Perturbation {
  core::RigidTransform motion;
  double translation_m = 0;
  double rotation_deg = 0;
};

core::Vector3 Direction(Draws& draws, double length) {
  const double z = draws.Uniform(-1, 1);
  const double bearing = draws.Uniform(0, 2 * pi);
  const double level = std::sqrt(1 - z * z);
  return {length * level * std::cos(bearing),
          length * level * std::sin(bearing), length * z};
}

Perturbation Perturb(const EvaluationOptions& options,
                     const std::string& pair_name, int trial) {
  const uint64_t pair_key =
      Hash64(std::as_bytes(std::span(pair_name.data(), pair_name.size())));
  Draws draws(options.seed ^ pair_key, trial);
  Perturbation p;
  p.translation_m = draws.Uniform(0, options.max_translation_m);
  p.rotation_deg = draws.Uniform(0, options.max_rotation_deg);
  p.motion.translation = Direction(draws, p.translation_m);
  p.motion.rotation =
      core::RotationFromVector(Direction(draws, p.rotation_deg * pi / 180));
  return p;
}

/// The trials of `cell` before anything is known of them, in file order.
std::vector<Trial> PlannedTrials(const EvaluationOptions& options,
                                 std::span<const PairSource> pairs,
                                 const Cell& cell) {
  std::vector<Trial> trials;
  for (const IcpMethod icp : options.icp_methods) {
    for (int number = 0; number < options.trial_count; ++number) {
      Trial trial;
      trial.pair = pairs[cell.pair].name;
      trial.environment = pairs[cell.pair].environment;
      trial.method = cell.method.name();
      trial.icp = icp;
      trial.min_normal_cosine = options.min_normal_cosine;
      trial.label_neighbor_count = options.label_neighbor_count;
      trial.reading_point_count = options.reading_point_count;
      trial.count = cell.count;
      trial.number = number;
      const Perturbation p = Perturb(options, trial.pair, number);
      trial.initial_translation_m = p.translation_m;
      trial.initial_rotation_deg = p.rotation_deg;
      trial.translation_error_m = kInfinite;
      trial.rotation_error_deg = kInfinite;
      trials.push_back(std::move(trial));
    }
  }
  return trials;
}

// Clouds ----------------------------------------------------------------------

/// A scan's distinct points and what the votes say of each.
struct VotedScan {
  core::LatticeCloud cloud;
  core::LabelColumns columns;
};

struct PreparedPair {
  VotedScan reference;
  VotedScan reading;
  core::RigidTransform T_reference_reading;
};

absl::StatusOr<VotedScan> Vote(const core::LatticeCloud& cloud) {
  core::SpdfOptions votes;
  votes.max_round_count = 0;
  MAPSIEVE_ASSIGN_OR_RETURN(core::FilteredCloud filtered,
                            core::FilterCloud(cloud, votes));
  return VotedScan{cloud.Select(filtered.rows), std::move(filtered.columns)};
}

absl::StatusOr<PreparedPair> Prepare(const PairSource& source) {
  absl::StatusOr<ScanPair> pair = source.load();
  if (!pair.ok()) return Annotate(pair.status(), source.name);
  PreparedPair prepared;
  MAPSIEVE_ASSIGN_OR_RETURN(prepared.reference, Vote(pair->reference));
  MAPSIEVE_ASSIGN_OR_RETURN(prepared.reading, Vote(pair->reading));
  prepared.T_reference_reading = pair->T_reference_reading;
  return prepared;
}

/// A sample with all columns that registration may ask for.
struct SampledScan {
  std::vector<core::Point3> positions;
  std::vector<core::Vector3> normals;
  std::vector<core::Covariance> covariances;
  double sample_s = 0;

  core::IcpCloud view() const { return {positions, normals, covariances}; }
};

absl::StatusOr<core::CloudSample> TimedSample(const core::LatticeCloud& cloud,
                                              core::SamplerOptions sampler,
                                              double& sample_s) {
  auto start = std::chrono::steady_clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(core::CloudSample sample,
                            core::Sample(cloud, sampler));
  // These two have searched; again with what they found.
  if (sampler.method == SampleMethod::kSpdf) {
    sampler.spdf.density_radius_m = sample.parameter;
  } else if (sampler.method == SampleMethod::kVoxel) {
    sampler.cell_edge_m = sample.parameter;
  } else {
    sample_s = Seconds(start);
    return sample;
  }
  sampler.max_points = 0;
  start = std::chrono::steady_clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(sample, core::Sample(cloud, sampler));
  sample_s = Seconds(start);
  return sample;
}

absl::StatusOr<SampledScan> SampleScan(const VotedScan& scan,
                                       const EvaluationOptions& options,
                                       const EvaluatedMethod& method,
                                       int64_t count) {
  core::SamplerOptions sampler;
  sampler.method = method.sampler;
  sampler.max_points = count;
  sampler.spdf.label_neighbor_count = options.label_neighbor_count;
  sampler.spdf.rule = method.rule;
  sampler.spdf.seed = static_cast<int64_t>(options.seed);
  if (method.sampler == SampleMethod::kSpatialSpdf) {
    sampler.spdf.density_radius_m = kSpatialDensityRadius;
  }
  if (method.variant != SpatialVariant::kPaper) {
    sampler.ideal_share = kRegistrationIdealShare;
    sampler.cell_split = core::CellSplit::kWidest;
  }
  if (method.variant == SpatialVariant::kSurest) {
    sampler.cell_split = core::CellSplit::kMidway;
    sampler.representative = core::Representative::kSurest;
  }
  SampledScan result;
  MAPSIEVE_ASSIGN_OR_RETURN(const core::CloudSample sample,
                            TimedSample(scan.cloud, sampler, result.sample_s));
  const bool is_labeled = sample.columns.size() > 0;
  for (size_t i = 0; i < sample.rows.size(); ++i) {
    const uint32_t row = sample.rows[i];
    const core::LabelColumns& served =
        is_labeled ? sample.columns : scan.columns;
    const size_t served_row = is_labeled ? i : row;
    if (scan.columns.label[row] == core::Label::kNone ||
        served.label[served_row] == core::Label::kNone) {
      continue;
    }
    result.positions.push_back(
        sample.cloud.lattice.Position(sample.cloud.positions[i]));
    const auto normal = core::DecodeOctahedral(scan.columns.normal[row]);
    result.normals.push_back({normal[0], normal[1], normal[2]});
    result.covariances.push_back(core::LabelCovariance(
        served.label[served_row],
        core::DecodeOctahedral(served.normal[served_row])));
  }
  return result;
}

// Trials ----------------------------------------------------------------------

TrialOutcome OutcomeOf(core::IcpStop stop) {
  switch (stop) {
    case core::IcpStop::kConverged:
      return TrialOutcome::kConverged;
    case core::IcpStop::kIterationLimit:
      return TrialOutcome::kIterationLimit;
    case core::IcpStop::kTooFewPairs:
      break;
  }
  return TrialOutcome::kTooFewPairs;
}

absl::Status RunTrial(const SampledScan& reading, const SampledScan& reference,
                      const core::RigidTransform& truth,
                      const core::RigidTransform& start, Trial& trial) {
  const core::IcpOptions icp = {.method = trial.icp,
                                .min_normal_cosine = trial.min_normal_cosine,
                                .max_iteration_count = kMaxIterationCount};
  const auto begin = std::chrono::steady_clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(
      const core::IcpResult result,
      core::RunIcp(reading.view(), reference.view(), start, icp));
  trial.icp_s = Seconds(begin);
  trial.outcome = OutcomeOf(result.stop);
  trial.iteration_count = result.iteration_count;
  trial.degenerate_count = result.information.degenerate_count;
  const core::TransformError error =
      core::CompareTransforms(result.T_reference_reading, truth);
  trial.translation_error_m = error.translation_m;
  trial.rotation_error_deg = error.rotation_rad * 180 / pi;
  return absl::OkStatus();
}

void SetOutcome(TrialOutcome outcome, std::vector<Trial>& trials) {
  for (Trial& trial : trials) trial.outcome = outcome;
}

absl::StatusOr<std::vector<Trial>> RunCell(const EvaluationOptions& options,
                                           std::span<const PairSource> pairs,
                                           const Cell& cell,
                                           const PreparedPair& pair) {
  std::vector<Trial> trials = PlannedTrials(options, pairs, cell);
  const bool samples_both = options.reading_point_count == 0;
  const size_t size = samples_both ? std::min(pair.reference.cloud.size(),
                                              pair.reading.cloud.size())
                                   : pair.reference.cloud.size();
  if (cell.count > static_cast<int64_t>(size)) {
    SetOutcome(TrialOutcome::kSkipped, trials);
    return trials;
  }
  std::array<SampledScan, 2> samples;
  for (size_t i = 0; i < samples.size(); ++i) {
    absl::StatusOr<SampledScan> sample =
        i == 0 && !samples_both
            ? SampleScan(pair.reading, options, {SampleMethod::kRandom},
                         options.reading_point_count)
            : SampleScan(i == 0 ? pair.reading : pair.reference, options,
                         cell.method, cell.count);
    if (absl::IsFailedPrecondition(sample.status())) {
      SetOutcome(TrialOutcome::kNoSample, trials);
      return trials;
    }
    if (!sample.ok()) return sample.status();
    samples[i] = *std::move(sample);
  }
  const auto& [reading, reference] = samples;
  for (Trial& trial : trials) {
    trial.reading_points = static_cast<int64_t>(reading.positions.size());
    trial.reference_points = static_cast<int64_t>(reference.positions.size());
    trial.sample_s = reading.sample_s + reference.sample_s;
    if (std::min(reading.positions.size(), reference.positions.size()) <
        core::kMinIcpPointCount) {
      trial.outcome = TrialOutcome::kNoSample;
      continue;
    }
    const core::RigidTransform start =
        pair.T_reference_reading *
        Perturb(options, trial.pair, trial.number).motion;
    MAPSIEVE_RETURN_IF_ERROR(
        RunTrial(reading, reference, pair.T_reference_reading, start, trial));
  }
  return trials;
}

/// A pair that is prepared by the first cell that needs it and dropped after
/// the last.
class PairSlot {
 public:
  void AddCell() { ++cell_count_; }

  absl::StatusOr<std::shared_ptr<const PreparedPair>> Get(
      const PairSource& source) {
    const MutexLock lock(mutex_);
    if (!pair_) {
      MAPSIEVE_ASSIGN_OR_RETURN(PreparedPair prepared, Prepare(source));
      pair_ = std::make_shared<const PreparedPair>(std::move(prepared));
    }
    return pair_;
  }
  void Finish() {
    const MutexLock lock(mutex_);
    if (++finished_count_ == cell_count_) pair_.reset();
  }

 private:
  int64_t cell_count_ = 0;
  Mutex mutex_;
  int64_t finished_count_ ABSL_GUARDED_BY(mutex_) = 0;
  std::shared_ptr<const PreparedPair> pair_ ABSL_GUARDED_BY(mutex_);
};

// File ------------------------------------------------------------------------

/// Writes the lines of cells in the order of cells, whichever ends first.
class CellWriter {
 public:
  CellWriter(std::filesystem::path file, size_t cell_count, int64_t first_trial,
             int64_t trial_count, ProgressSink* progress)
      : name_(file.string()),
        stream_(file, std::ios::app | std::ios::binary),
        done_(first_trial),
        total_(trial_count),
        progress_(progress),
        texts_(cell_count) {}

  absl::Status WriteHeader() {
    const MutexLock lock(mutex_);
    stream_ << TrialHeader() << std::flush;
    return Check();
  }

  absl::Status Write(size_t cell, const std::vector<Trial>& trials) {
    const MutexLock lock(mutex_);
    for (const Trial& trial : trials) texts_[cell] += TrialLine(trial);
    done_ += static_cast<int64_t>(trials.size());
    for (; next_ < texts_.size() && !texts_[next_].empty(); ++next_) {
      stream_ << std::exchange(texts_[next_], {});
    }
    stream_.flush();
    if (progress_ != nullptr) progress_->Report(done_, total_);
    return Check();
  }

 private:
  absl::Status Check() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_) {
    if (stream_) return absl::OkStatus();
    return absl::ResourceExhaustedError(
        absl::StrCat(name_, ": cannot be written"));
  }

  const std::string name_;
  Mutex mutex_;
  std::ofstream stream_ ABSL_GUARDED_BY(mutex_);
  int64_t done_ ABSL_GUARDED_BY(mutex_);
  const int64_t total_;
  ProgressSink* const progress_;
  /// Of cells that ended before an earlier one.
  std::vector<std::string> texts_ ABSL_GUARDED_BY(mutex_);
  size_t next_ ABSL_GUARDED_BY(mutex_) = 0;
};

/// Whether `trial` may be the result of `planned`. Lines round to 9 decimals.
bool IsResultOf(const Trial& trial, const Trial& planned) {
  constexpr double kRounding = 1e-8;
  return trial.pair == planned.pair &&
         trial.environment == planned.environment &&
         trial.method == planned.method && trial.icp == planned.icp &&
         trial.count == planned.count && trial.number == planned.number &&
         trial.label_neighbor_count == planned.label_neighbor_count &&
         trial.reading_point_count == planned.reading_point_count &&
         std::abs(trial.initial_translation_m - planned.initial_translation_m) <
             kRounding &&
         std::abs(trial.min_normal_cosine - planned.min_normal_cosine) <
             kRounding &&
         std::abs(trial.initial_rotation_deg - planned.initial_rotation_deg) <
             kRounding;
}

/// What a file holds of an evaluation.
struct Resumption {
  size_t cell_count = 0;
  /// Of the header and the cells that are whole.
  size_t size = 0;
};

absl::StatusOr<Resumption> FindResumption(const EvaluationOptions& options,
                                          std::span<const PairSource> pairs,
                                          const std::filesystem::path& file) {
  std::error_code error;
  const auto size = std::filesystem::file_size(file, error);
  if (error || size == 0) return Resumption{};
  MAPSIEVE_ASSIGN_OR_RETURN(const TrialLines lines, ReadTrialLines(file));
  const std::vector<Cell> cells = PlanCells(options, pairs.size());
  size_t line = 0;
  for (const Cell& cell : cells) {
    if (line == lines.trials.size()) break;
    for (const Trial& planned : PlannedTrials(options, pairs, cell)) {
      if (line == lines.trials.size()) break;
      if (!IsResultOf(lines.trials[line++], planned)) {
        return absl::FailedPreconditionError(absl::StrCat(
            file.string(), ": line ", line + 1,
            " belongs to another evaluation; move the file away, or give the "
            "options that it was made with"));
      }
    }
  }
  if (line != lines.trials.size()) {
    return absl::FailedPreconditionError(
        absl::StrCat(file.string(),
                     ": holds more registrations than this "
                     "evaluation has; move it away"));
  }
  Resumption found;
  const auto per_cell = static_cast<size_t>(TrialsPerCell(options));
  found.cell_count = line / per_cell;
  found.size = found.cell_count == 0
                   ? TrialHeader().size()
                   : lines.ends[found.cell_count * per_cell - 1];
  return found;
}

absl::Status CheckNames(std::span<const PairSource> pairs) {
  std::set<std::string> names;
  for (const PairSource& pair : pairs) {
    if (!names.insert(pair.name).second) {
      return absl::InvalidArgumentError(
          absl::StrCat("two pairs are named '", pair.name, "'"));
    }
  }
  return absl::OkStatus();
}

/// Time of sampling both scans at all, in passes of the filter's votes over
/// both.
double SamplingCost(SampleMethod method) {
  switch (method) {
    case SampleMethod::kSpdf:
      return 9;
    case SampleMethod::kSpatialSpdf:
      return 1.5;
    case SampleMethod::kNss:
    case SampleMethod::kCovs:
    case SampleMethod::kMaxDensity:
      return 1.5;
    default:
      return 0.4;
  }
}

}  // namespace

int64_t TrialCount(const EvaluationOptions& options,
                   std::span<const PairSource> pairs) {
  return static_cast<int64_t>(PlanCells(options, pairs.size()).size()) *
         TrialsPerCell(options);
}

absl::StatusOr<int64_t> CountDone(const EvaluationOptions& options,
                                  std::span<const PairSource> pairs,
                                  const std::filesystem::path& file) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  MAPSIEVE_ASSIGN_OR_RETURN(const Resumption found,
                            FindResumption(options, pairs, file));
  return static_cast<int64_t>(found.cell_count) * TrialsPerCell(options);
}

absl::StatusOr<double> EstimateEvaluation(const EvaluationOptions& options,
                                          std::span<const PairSource> pairs,
                                          int64_t first, Executor& executor) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  const std::vector<Cell> cells = PlanCells(options, pairs.size());
  const auto first_cell = static_cast<size_t>(first / TrialsPerCell(options));
  if (first_cell >= cells.size()) return 0;
  auto start = std::chrono::steady_clock::now();
  MAPSIEVE_ASSIGN_OR_RETURN(const PreparedPair pair,
                            Prepare(pairs[cells[first_cell].pair]));
  const double prepare_s = Seconds(start);
  start = std::chrono::steady_clock::now();
  MAPSIEVE_RETURN_IF_ERROR(Vote(pair.reference.cloud).status());
  MAPSIEVE_RETURN_IF_ERROR(Vote(pair.reading.cloud).status());
  const double vote_s = Seconds(start);
  // One registration of each kind of a sample that costs nothing.
  constexpr int64_t kProbeCount = 1000;
  // Larger clouds have deeper trees and take more steps.
  constexpr double kIcpGrowth = 1.2;
  EvaluationOptions probe = options;
  probe.trial_count = 1;
  const Cell probe_cell = {
      cells[first_cell].pair, kProbeCount, {SampleMethod::kRandom}};
  MAPSIEVE_ASSIGN_OR_RETURN(const std::vector<Trial> trials,
                            RunCell(probe, pairs, probe_cell, pair));
  double icp_s = 0;
  for (const Trial& trial : trials) icp_s += trial.icp_s;
  const auto size = static_cast<int64_t>(
      std::min(pair.reference.cloud.size(), pair.reading.cloud.size()));
  double total_s = 0;
  for (size_t i = first_cell; i < cells.size(); ++i) {
    if (i == first_cell || cells[i].pair != cells[i - 1].pair) {
      total_s += prepare_s;
    }
    if (cells[i].count > size) continue;
    total_s += vote_s * SamplingCost(cells[i].method.sampler) +
               icp_s * options.trial_count *
                   std::pow(static_cast<double>(cells[i].count) / kProbeCount,
                            kIcpGrowth);
  }
  return total_s / executor.worker_count();
}

absl::Status RunEvaluation(const EvaluationOptions& options,
                           std::span<const PairSource> pairs,
                           const std::filesystem::path& file,
                           const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  MAPSIEVE_RETURN_IF_ERROR(CheckNames(pairs));
  MAPSIEVE_ASSIGN_OR_RETURN(const Resumption found,
                            FindResumption(options, pairs, file));
  const std::vector<Cell> cells = PlanCells(options, pairs.size());
  const std::span<const Cell> rest = std::span(cells).subspan(found.cell_count);
  if (found.size > 0) {
    std::error_code error;
    std::filesystem::resize_file(file, found.size, error);
    if (error) {
      return absl::ResourceExhaustedError(
          absl::StrCat(file.string(), ": cannot be cut: ", error.message()));
    }
  }
  CellWriter writer(
      file, rest.size(),
      static_cast<int64_t>(found.cell_count) * TrialsPerCell(options),
      TrialCount(options, pairs), context.progress);
  if (found.size == 0) MAPSIEVE_RETURN_IF_ERROR(writer.WriteHeader());
  std::vector<PairSlot> slots(pairs.size());
  for (const Cell& cell : rest) slots[cell.pair].AddCell();
  return TryParallelFor(*context.executor, static_cast<int64_t>(rest.size()),
                        [&](int64_t i) -> absl::Status {
                          MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
                          const Cell& cell = rest[static_cast<size_t>(i)];
                          PairSlot& slot = slots[cell.pair];
                          MAPSIEVE_ASSIGN_OR_RETURN(
                              const std::shared_ptr<const PreparedPair> pair,
                              slot.Get(pairs[cell.pair]));
                          MAPSIEVE_ASSIGN_OR_RETURN(
                              const std::vector<Trial> trials,
                              RunCell(options, pairs, cell, *pair));
                          slot.Finish();
                          return writer.Write(static_cast<size_t>(i), trials);
                        });
}

}  // namespace mapsieve::client
