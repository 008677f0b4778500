#ifndef MAPSIEVE_CLIENT_LAB_EVALUATION_H_
#define MAPSIEVE_CLIENT_LAB_EVALUATION_H_

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/lab/evaluation_options.h"
#include "client/lab/scan_pair.h"
#include "core/base/executor.h"
#include "core/registration/icp.h"
#include "core/sampling/sampler_options.h"

/// The registration experiment of Labussière et al. 2020: both scans of a pair
/// are sampled to as many points, and ICP starts at poses beside the truth.
namespace mapsieve::client {

enum class TrialOutcome : uint8_t {
  kConverged = 1,
  kIterationLimit,
  /// ICP was left with too few pairs.
  kTooFewPairs,
  /// The method cannot give so few points, or gives too few for ICP.
  kNoSample,
  /// One of the scans does not have so many points. Counts nowhere.
  kSkipped,
};

/// "converged", "iteration-limit", "too-few-pairs", "no-sample", "skipped".
std::string_view TrialOutcomeName(TrialOutcome outcome);

/// Whether an ICP ran.
inline bool HasPose(TrialOutcome outcome) {
  return outcome <= TrialOutcome::kTooFewPairs;
}

/// A registration.
struct Trial {
  std::string pair;
  Environment environment = Environment::kReal;
  std::string method;
  core::IcpMethod icp = core::IcpMethod::kPointToPlane;
  /// Of EvaluationOptions.
  double min_normal_cosine = 0;
  int label_neighbor_count = 0;
  int64_t reading_point_count = 0;
  int64_t count = 0;
  int number = 0;
  /// How far the start is from the truth.
  double initial_translation_m = 0;
  double initial_rotation_deg = 0;
  TrialOutcome outcome = TrialOutcome::kSkipped;
  /// Points that ICP was given, without those that have no normal.
  int64_t reading_points = 0;
  int64_t reference_points = 0;
  int iteration_count = 0;
  /// Directions of motion that the pairs at the result do not hold
  /// (core::PoseInformation): the pose stays along them as it was.
  int degenerate_count = 0;
  /// core::CompareTransforms of result and truth; infinite without a pose.
  double translation_error_m = 0;
  double rotation_error_deg = 0;
  /// Time on one thread: of sampling both scans by the parameter found, its
  /// search aside (the samples are made once for all trials), and of ICP.
  double sample_s = 0;
  double icp_s = 0;
};

/// How long RunEvaluation will take, in seconds, judged by the first pair that
/// is not done: roughly, and if the machine does as much else as it does now.
/// `first` is the number of registrations that are done already (CountDone).
/// Errors: those of EvaluationOptions::Validate and of PairSource::load.
absl::StatusOr<double> EstimateEvaluation(const EvaluationOptions& options,
                                          std::span<const PairSource> pairs,
                                          int64_t first, Executor& executor);

/// Registrations that RunEvaluation makes, those that are skipped included.
int64_t TrialCount(const EvaluationOptions& options,
                   std::span<const PairSource> pairs);

/// Registrations that `file` holds whole; 0 if there is none. They must be the
/// first of this evaluation. kFailedPrecondition: they are those of another
/// one; kInvalidArgument: it is no such file, or one that cannot be read.
absl::StatusOr<int64_t> CountDone(const EvaluationOptions& options,
                                  std::span<const PairSource> pairs,
                                  const std::filesystem::path& file);

/// Makes all registrations and writes each as a line of the CSV `file`, in the
/// order of pairs, counts, methods, ICP methods and trials. If it exists the
/// evaluation goes on after the last sample whose trials it holds all: so one
/// that broke off ends with the same lines, as does one with any number of
/// threads, but for the columns of times.
///
/// Normals for point-to-plane are those of the votes on the whole scan, all of
/// its points kept, at the sampled points. Covariances for plane-to-plane are
/// those that the service gives: of the labels that the method itself found, or
/// of the votes on the whole scan for methods that label nothing. Votes have
/// the default options; spatial-spdf has a density radius of 0.2 m, and the
/// methods by the filter options.label_neighbor_count. ICP pairs
/// two neighbours, leaves out those whose normals differ by more than
/// options.min_normal_cosine allows (the normals of point-to-plane, with either
/// ICP), keeps 75 % of the rest and makes 45 steps at most.
///
/// Reports progress in registrations, to context.progress, from any of the
/// workers, one call at a time. Errors: kInvalidArgument (options; a pair's
/// name that comes twice), those of CountDone and of PairSource::load,
/// kResourceExhausted (the disk is full), kCancelled.
absl::Status RunEvaluation(const EvaluationOptions& options,
                           std::span<const PairSource> pairs,
                           const std::filesystem::path& file,
                           const ExecutionContext& context = {});

/// The registrations that `file` holds. kNotFound; kInvalidArgument naming the
/// line that is none.
absl::StatusOr<std::vector<Trial>> ReadTrials(
    const std::filesystem::path& file);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_EVALUATION_H_
