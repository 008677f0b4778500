#include "client/lab/evaluation.h"

#include <cmath>
#include <cstdint>
#include <fstream>
#include <map>
#include <memory>
#include <set>
#include <sstream>
#include <stop_token>
#include <string>
#include <vector>

#include "client/lab/trial_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/clouds.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::client {
namespace {

using core::IcpMethod;
using core::SampleMethod;
using mapsieve::testing::StatusIs;
using mapsieve::testing::TemporaryDirectory;
using ::testing::HasSubstr;

/// A corner of three boards without noise: its own reading.
core::LatticeCloud Corner() {
  core::LatticeCloud cloud = mapsieve::testing::PlaneCloud(1600, 2, 3);
  const size_t board = cloud.size();
  for (size_t i = 0; i < board; ++i) {
    const core::LatticePoint p = cloud.positions[i];
    cloud.positions.push_back({p.y, -2000, p.x + 2000});
    cloud.positions.push_back({-2000, p.x, p.y + 2000});
  }
  return cloud;
}

PairSource PairOf(const std::string& name, const core::LatticeCloud& cloud) {
  return {name, Environment::kStructured, [cloud] {
            return absl::StatusOr<ScanPair>(ScanPair{cloud, cloud, {}});
          }};
}

std::string ReadAll(const std::string& path) {
  std::ifstream stream(path);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

void WriteAll(const std::string& path, const std::string& text) {
  std::ofstream(path, std::ios::trunc) << text;
}

/// The lines of a file without the columns of times.
std::vector<std::string> Results(const std::string& path) {
  std::istringstream text(ReadAll(path));
  std::vector<std::string> lines;
  for (std::string line; std::getline(text, line);) {
    line.erase(line.rfind(','));
    line.erase(line.rfind(','));
    lines.push_back(line);
  }
  return lines;
}

/// Two pairs, a few methods, seconds in all.
struct SmallEvaluation {
  SmallEvaluation() {
    options.methods = {{SampleMethod::kRandom},
                       {SampleMethod::kVoxel},
                       {SampleMethod::kSpatialSpdf, core::DensityRule::kQuota}};
    options.counts = {100, 400};
    pairs = {PairOf("scene", mapsieve::testing::SceneCloud(3000, 3, 1)),
             PairOf("corner", Corner())};
  }
  EvaluationOptions options;
  std::vector<PairSource> pairs;
};

TEST(Evaluation, FindsThePoseOfAPairWithoutNoise) {
  const TemporaryDirectory folder;
  const core::LatticeCloud corner = Corner();
  EvaluationOptions options;
  // All points, or nearly: some share a place of the lattice.
  options.methods = {{SampleMethod::kRandom}};
  options.counts = {static_cast<int64_t>(corner.size()) - 50};
  options.trial_count = 4;
  const std::vector<PairSource> pairs = {PairOf("corner", corner)};
  MAPSIEVE_ASSERT_OK(RunEvaluation(options, pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  ASSERT_EQ(trials.size(), 8u);
  for (const Trial& trial : trials) {
    EXPECT_TRUE(HasPose(trial.outcome));
    EXPECT_GT(trial.reading_points, 4000);
    EXPECT_LT(trial.translation_error_m, 1e-3) << TrialLine(trial);
    EXPECT_LT(trial.rotation_error_deg, 0.05) << TrialLine(trial);
  }
}

TEST(Evaluation, TellsDirectionsThatNothingHolds) {
  const TemporaryDirectory folder;
  EvaluationOptions options;
  options.methods = {{SampleMethod::kRandom}};
  options.counts = {1000};
  options.max_rotation_deg = 5;
  const core::LatticeCloud plane = mapsieve::testing::PlaneCloud(2000, 4, 5);
  const std::vector<PairSource> pairs = {PairOf("corner", Corner()),
                                         PairOf("plane", plane)};
  MAPSIEVE_ASSERT_OK(RunEvaluation(options, pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  ASSERT_EQ(trials.size(), 8u);
  for (const Trial& trial : trials) {
    // Two ways to slide on a plane and one to turn.
    EXPECT_EQ(trial.degenerate_count, trial.pair == "plane" ? 3 : 0)
        << TrialLine(trial);
  }
}

TEST(Evaluation, BrokenOffItEndsWithTheSameLines) {
  const TemporaryDirectory folder;
  const SmallEvaluation small;
  const std::string path = folder / "trials.csv";
  MAPSIEVE_ASSERT_OK(RunEvaluation(small.options, small.pairs, path));
  const std::string whole = ReadAll(path);
  const std::vector<std::string> results = Results(path);
  ASSERT_EQ(results.size(), 1u + 2 * 2 * 3 * 2 * 2);

  // Within a line, within a sample's lines, within the header's line end.
  for (const size_t size : {whole.size() * 2 / 3, whole.find("voxel") + 200,
                            TrialHeader().size()}) {
    WriteAll(path, whole.substr(0, size));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const int64_t done,
                                  CountDone(small.options, small.pairs, path));
    MAPSIEVE_ASSERT_OK(RunEvaluation(small.options, small.pairs, path));
    EXPECT_EQ(Results(path), results) << size;
    // What was there whole has not been made again: even its times are there.
    size_t kept = TrialHeader().size();
    for (int64_t i = 0; i < done; ++i) kept = whole.find('\n', kept) + 1;
    EXPECT_EQ(ReadAll(path).substr(0, kept), whole.substr(0, kept));
    EXPECT_LE(kept, size);
    EXPECT_EQ(done % 4, 0);
  }
}

TEST(Evaluation, IsTheSameForAnyNumberOfThreads) {
  const TemporaryDirectory folder;
  const SmallEvaluation small;
  MAPSIEVE_ASSERT_OK(
      RunEvaluation(small.options, small.pairs, folder / "one.csv"));
  const std::unique_ptr<Executor> workers = MakeWorkerPool(4);
  MAPSIEVE_ASSERT_OK(RunEvaluation(small.options, small.pairs,
                                   folder / "four.csv",
                                   {.executor = workers.get()}));
  EXPECT_EQ(Results(folder / "one.csv"), Results(folder / "four.csv"));
}

TEST(Evaluation, ComparesNamedMethodsOfDifferentSamples) {
  const TemporaryDirectory folder;
  EvaluationOptions options;
  std::set<std::string> names;
  for (const EvaluatedMethod& method : options.methods) {
    names.insert(method.name());
  }
  EXPECT_EQ(names.size(), options.methods.size());
  EXPECT_TRUE(names.contains("spatial-spdf"));
  EXPECT_TRUE(names.contains("spatial-spdf-quota"));
  EXPECT_TRUE(names.contains("spatial-spdf-quota-wide"));
  EXPECT_TRUE(names.contains("spatial-spdf-quota-surest"));

  // Two draws of one scene, so that every sample has an error of its own.
  options.methods = {{SampleMethod::kSpatialSpdf},
                     {SampleMethod::kSpatialSpdf, core::DensityRule::kQuota},
                     {SampleMethod::kSpatialSpdf, core::DensityRule::kQuota,
                      SpatialVariant::kWide},
                     {SampleMethod::kSpatialSpdf, core::DensityRule::kQuota,
                      SpatialVariant::kSurest}};
  options.icp_methods = {IcpMethod::kPlaneToPlane};
  options.counts = {300};
  options.trial_count = 1;
  const std::vector<PairSource> pairs = {
      {"scene", Environment::kStructured, [] {
         return absl::StatusOr<ScanPair>(
             ScanPair{mapsieve::testing::SceneCloud(6000, 3, 1),
                      mapsieve::testing::SceneCloud(6000, 3, 2),
                      {}});
       }}};
  MAPSIEVE_ASSERT_OK(RunEvaluation(options, pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  ASSERT_EQ(trials.size(), 4u);
  std::set<double> errors;
  for (const Trial& trial : trials) errors.insert(trial.translation_error_m);
  EXPECT_EQ(errors.size(), 4u);
}

TEST(Evaluation, PairsNoPointsWhoseNormalsDisagree) {
  // Starts are turned, so no two normals agree to the last bit.
  for (const double min_normal_cosine : {0.0, 1.0}) {
    const TemporaryDirectory folder;
    SmallEvaluation small;
    small.options.counts = {400};
    small.options.min_normal_cosine = min_normal_cosine;
    MAPSIEVE_ASSERT_OK(
        RunEvaluation(small.options, small.pairs, folder / "trials.csv"));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                  ReadTrials(folder / "trials.csv"));
    ASSERT_EQ(trials.size(), 2u * 3 * 2 * 2);
    for (const Trial& trial : trials) {
      EXPECT_EQ(trial.min_normal_cosine, min_normal_cosine);
      EXPECT_EQ(trial.outcome == TrialOutcome::kTooFewPairs,
                min_normal_cosine == 1)
          << TrialLine(trial);
    }
  }
}

TEST(Evaluation, LabelsOfTheFilterAreByAsManyNeighboursAsItIsTold) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.options.counts = {400};
  // Of each method, with k and with fewer.
  std::map<std::string, std::map<int, std::vector<double>>> errors;
  for (const int label_neighbor_count : {0, 12}) {
    const std::string path =
        folder / (std::to_string(label_neighbor_count) + ".csv");
    small.options.label_neighbor_count = label_neighbor_count;
    MAPSIEVE_ASSERT_OK(RunEvaluation(small.options, small.pairs, path));
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                  ReadTrials(path));
    for (const Trial& trial : trials) {
      EXPECT_EQ(trial.label_neighbor_count, label_neighbor_count);
      errors[trial.method][label_neighbor_count].push_back(
          trial.translation_error_m);
    }
  }
  ASSERT_EQ(errors.size(), 3u);
  for (const auto& [method, by_count] : errors) {
    EXPECT_EQ(by_count.at(0) != by_count.at(12), method == "spatial-spdf-quota")
        << method;
  }
}

TEST(Evaluation, TakesAsManyPointsOfEveryReadingAsItIsTold) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.options.counts = {400, 1200};
  small.options.reading_point_count = 700;
  MAPSIEVE_ASSERT_OK(
      RunEvaluation(small.options, small.pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  std::map<std::string, std::set<int64_t>> readings;
  for (const Trial& trial : trials) {
    EXPECT_EQ(trial.reading_point_count, 700);
    readings[trial.pair].insert(trial.reading_points);
    EXPECT_LE(trial.reference_points, trial.count);
    EXPECT_GT(trial.reference_points, trial.count / 2);
  }
  for (const auto& [pair, counts] : readings) {
    // The same sample for all methods and counts; points without a vote are
    // left out.
    ASSERT_EQ(counts.size(), 1u) << pair;
    EXPECT_LE(*counts.begin(), 700) << pair;
    EXPECT_GT(*counts.begin(), 600) << pair;
  }
}

TEST(Evaluation, RefusesTheFileOfAnother) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.options.methods.resize(1);
  small.options.counts = {100};
  const std::string path = folder / "trials.csv";
  MAPSIEVE_ASSERT_OK(RunEvaluation(small.options, small.pairs, path));
  const auto expect_refused = [&](const EvaluationOptions& options,
                                  std::span<const PairSource> pairs) {
    EXPECT_THAT(RunEvaluation(options, pairs, path),
                StatusIs(absl::StatusCode::kFailedPrecondition,
                         HasSubstr("trials.csv")));
  };
  EvaluationOptions other = small.options;
  other.seed = 2;
  expect_refused(other, small.pairs);
  other = small.options;
  other.methods = {{SampleMethod::kVoxel}};
  expect_refused(other, small.pairs);
  other = small.options;
  other.max_rotation_deg = 19;
  expect_refused(other, small.pairs);
  other = small.options;
  other.min_normal_cosine = 0.001;
  expect_refused(other, small.pairs);
  other = small.options;
  other.label_neighbor_count = 40;
  expect_refused(other, small.pairs);
  other = small.options;
  other.reading_point_count = 100;
  expect_refused(other, small.pairs);
  expect_refused(small.options, std::span(small.pairs).first(1));

  const std::string text = ReadAll(path);
  WriteAll(path, "x,y,z\n1,2,3\n");
  EXPECT_THAT(CountDone(small.options, small.pairs, path),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("does not begin like")));
  WriteAll(path, text + "nonsense\n");
  EXPECT_THAT(ReadTrials(path), StatusIs(absl::StatusCode::kInvalidArgument,
                                         HasSubstr("line 10: has 1 columns")));
}

TEST(Evaluation, SkipsCountsThatAScanDoesNotHave) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.options.counts = {100, 1'000'000};
  MAPSIEVE_ASSERT_OK(
      RunEvaluation(small.options, small.pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  for (const Trial& trial : trials) {
    EXPECT_EQ(trial.outcome == TrialOutcome::kSkipped,
              trial.count == 1'000'000);
    EXPECT_EQ(std::isinf(trial.translation_error_m), !HasPose(trial.outcome));
  }
}

TEST(Evaluation, StartsUniformlyAroundTheTruth) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.options.counts = {1'000'000};  // no registration, only its start
  small.options.methods.resize(1);
  small.options.trial_count = 3000;
  MAPSIEVE_ASSERT_OK(
      RunEvaluation(small.options, small.pairs, folder / "trials.csv"));
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const std::vector<Trial> trials,
                                ReadTrials(folder / "trials.csv"));
  double translation_sum = 0;
  double rotation_sum = 0;
  double product_sum = 0;
  int below_quarter = 0;
  for (const Trial& trial : trials) {
    EXPECT_LE(trial.initial_translation_m, 0.5);
    EXPECT_LE(trial.initial_rotation_deg, 20);
    translation_sum += trial.initial_translation_m;
    rotation_sum += trial.initial_rotation_deg;
    product_sum += trial.initial_translation_m * trial.initial_rotation_deg;
    below_quarter += trial.initial_translation_m < 0.125 ? 1 : 0;
  }
  // Five standard deviations of 6000 independent draws, twice each.
  const auto count = static_cast<double>(trials.size());
  EXPECT_NEAR(translation_sum / count, 0.25, 0.014);
  EXPECT_NEAR(rotation_sum / count, 10, 0.53);
  EXPECT_NEAR(product_sum / count, 2.5, 0.25);
  EXPECT_NEAR(below_quarter / count, 0.25, 0.04);
}

TEST(Evaluation, StopsWhenAskedTo) {
  const TemporaryDirectory folder;
  const SmallEvaluation small;
  std::stop_source stop;
  stop.request_stop();
  const std::string path = folder / "trials.csv";
  EXPECT_THAT(RunEvaluation(small.options, small.pairs, path,
                            {.stop = stop.get_token()}),
              StatusIs(absl::StatusCode::kCancelled, ::testing::_));
  EXPECT_EQ(ReadAll(path), TrialHeader());
}

TEST(Evaluation, EstimateGrowsWithTheWorkLeft) {
  const SmallEvaluation small;
  EvaluationOptions more = small.options;
  more.trial_count *= 1000;
  const auto estimate = [&](const EvaluationOptions& options, int64_t first) {
    return EstimateEvaluation(options, small.pairs, first, InlineExecutor())
        .value();
  };
  const double few = estimate(small.options, 0);
  EXPECT_GT(few, 0);
  EXPECT_GT(estimate(more, 0), 10 * few);
  EXPECT_EQ(estimate(small.options, TrialCount(small.options, small.pairs)), 0);
}

TEST(Evaluation, TellsErrorsOfPairsByName) {
  const TemporaryDirectory folder;
  SmallEvaluation small;
  small.pairs[1].load = []() -> absl::StatusOr<ScanPair> {
    return absl::DataLossError("bad bytes");
  };
  EXPECT_THAT(RunEvaluation(small.options, small.pairs, folder / "trials.csv"),
              StatusIs(absl::StatusCode::kDataLoss, "corner: bad bytes"));
  small.pairs[1].name = "scene";
  EXPECT_THAT(RunEvaluation(small.options, small.pairs, folder / "other.csv"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("scene")));
}

TEST(EvaluationOptions, HaveLimits) {
  const auto expect_wrong = [](const EvaluationOptions& options,
                               const std::string& field) {
    EXPECT_THAT(options.Validate(),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(field)));
  };
  MAPSIEVE_EXPECT_OK(EvaluationOptions{}.Validate());
  expect_wrong({.methods = {}}, "methods");
  expect_wrong({.methods = {{SampleMethod::kVoxel}, {SampleMethod::kVoxel}}},
               "methods");
  expect_wrong({.icp_methods = {}}, "icp_methods");
  expect_wrong({.counts = {}}, "counts is empty");
  expect_wrong({.counts = {9}}, "counts holds 9");
  expect_wrong({.counts = {20, 20}}, "expected 21 or more");
  expect_wrong({.trial_count = 0}, "trial_count is 0");
  expect_wrong({.seed = uint64_t{1} << 63}, "seed");
  expect_wrong({.max_translation_m = NAN}, "max_translation_m");
  expect_wrong({.max_rotation_deg = 181}, "max_rotation_deg is 181");
  expect_wrong({.min_normal_cosine = -0.1}, "min_normal_cosine is -0.1");
  expect_wrong({.min_normal_cosine = 1.01}, "min_normal_cosine is 1.01");
  expect_wrong({.min_normal_cosine = NAN}, "min_normal_cosine");
  expect_wrong({.label_neighbor_count = 5},
               "label_neighbor_count is 5; it must be 6 to 127, or 0");
  expect_wrong({.label_neighbor_count = 128}, "label_neighbor_count is 128");
  expect_wrong({.reading_point_count = 9}, "reading_point_count is 9");
}

TEST(TrialFile, LinesComeBack) {
  Trial trial = {.pair = "a b",
                 .environment = Environment::kUnstructured,
                 .method = "spdf-quota",
                 .icp = IcpMethod::kPlaneToPlane,
                 .min_normal_cosine = 0.8,
                 .label_neighbor_count = 25,
                 .reading_point_count = 30,
                 .count = 2000,
                 .number = 3,
                 .initial_translation_m = 0.25,
                 .initial_rotation_deg = 12.5,
                 .outcome = TrialOutcome::kNoSample,
                 .reading_points = 5,
                 .reference_points = 6,
                 .iteration_count = 7,
                 .degenerate_count = 3,
                 .translation_error_m = HUGE_VAL,
                 .rotation_error_deg = HUGE_VAL,
                 .sample_s = 0.5,
                 .icp_s = 0.25};
  const std::string line = TrialLine(trial);
  EXPECT_EQ(
      line,
      "a b,unstructured,spdf-quota,plane-to-plane,0.800000000,25,30,2000,3,"
      "0.250000000,12.500000000,no-sample,5,6,7,3,inf,inf,0.500000,0.250000\n");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const Trial back,
                                ParseTrial(line.substr(0, line.size() - 1)));
  EXPECT_EQ(TrialLine(back), line);
  EXPECT_EQ(std::count(line.begin(), line.end(), ','),
            std::count(TrialHeader().begin(), TrialHeader().end(), ','));
  EXPECT_THAT(ParseTrial("a,b,c"),
              StatusIs(absl::StatusCode::kInvalidArgument, ::testing::_));
  EXPECT_THAT(ParseTrial("a,real,m,none,0,0,0,1,0,0,0,skipped,0,0,0,0,0,0,0,0"),
              StatusIs(absl::StatusCode::kInvalidArgument, ::testing::_));
}

}  // namespace
}  // namespace mapsieve::client
