#ifndef MAPSIEVE_CLIENT_LAB_FILTER_REPORT_H_
#define MAPSIEVE_CLIENT_LAB_FILTER_REPORT_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/base/executor.h"
#include "core/cloud/label.h"
#include "core/cloud/point_cloud.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/spdf_options.h"

/// How well the density rules of the filter keep their word on a cloud: the
/// density reached, the saliencies before and after, labels against known
/// classes.
namespace mapsieve::client {

/// One entry a label; that of core::Label::kNone is not used.
template <typename T>
using PerLabel = std::array<T, core::kLabelCount>;

inline constexpr std::array<core::Label, 3> kGeometricLabels = {
    core::Label::kCurve, core::Label::kSurface, core::Label::kJunction};

/// Dimension of what a label stands for: 1 curve, 2 surface, 3 junction.
int LabelDimension(core::Label label);

/// Values in few numbers; zero where there are none.
struct Distribution {
  int64_t count = 0;
  double mean = 0;
  double p10 = 0;
  double median = 0;
  double p90 = 0;
};

/// Bins of histograms. What lies beyond either end counts in its last bin.
struct SaliencyBins {
  static constexpr size_t kCount = 100;
  static constexpr double kWidth = 0.005;
};
struct RatioBins {
  static constexpr size_t kCount = 80;
  static constexpr int kPerOctave = 8;
  /// Binary logarithm of the lower edge of the first bin.
  static constexpr int kFirstExponent = -5;
  /// Lower edge of `bin`.
  static double LowerEdge(size_t bin);
};

/// The density that the survivors of one label reach. Measured in the rule's
/// own terms, which hold for every dimension: the number of other points in
/// the ball of the density radius around a survivor, over the k aimed at.
struct LabelDensity {
  /// Survivors of the rounds, outliers included.
  int64_t survivor_count = 0;
  /// Of these, how many had fewer than k others in their ball in the input:
  /// no rule brings these to the density aimed at. Not in what follows.
  int64_t sparse_count = 0;
  /// Input and survivors over target.
  Distribution input;
  Distribution reached;
  std::vector<int64_t> reached_histogram =
      std::vector<int64_t>(RatioBins::kCount);
};

/// Distribution of a saliency.
struct SaliencyHistogram {
  /// Over all points, and over those whose label it decided.
  std::vector<int64_t> all = std::vector<int64_t>(SaliencyBins::kCount);
  std::vector<int64_t> labeled = std::vector<int64_t>(SaliencyBins::kCount);
};

/// What became of the input's points of one known class; the counts sum to
/// all of them, duplicates apart.
struct ClassOutcome {
  int value = 0;
  std::string name;
  /// Kept, by label.
  core::LabelCounts kept{};
  int64_t outlier_count = 0;
  /// Removed by the density rule.
  int64_t thinned_count = 0;
};

/// Labels against a known class: an attribute of type uint8.
struct Confusion {
  std::string attribute;
  /// Ascending values; those that occur.
  std::vector<ClassOutcome> classes;
};

/// One rule on the cloud.
struct RuleReport {
  core::DensityRule rule = core::DensityRule::kPaper;
  double filter_s = 0;
  int round_count = 0;
  /// After the rounds, and after the outlier test.
  int64_t survivor_count = 0;
  int64_t kept_count = 0;
  core::LabelCounts survivor_label_counts{};
  core::LabelCounts kept_label_counts{};
  PerLabel<LabelDensity> density;
  /// Of the survivors.
  PerLabel<SaliencyHistogram> saliency;
  std::vector<Confusion> confusions;
};

/// Several rules side by side.
struct FilterReport {
  core::SpdfOptions options;
  double step = 0;
  /// Distinct points of the input.
  int64_t point_count = 0;
  /// Points in a unit of length, area or volume: k / (V_D rho^D).
  PerLabel<double> target_density{};
  /// Mean vote weight of an ideal shape at that density.
  PerLabel<double> expected_strength{};
  /// core::ExpectedSaliency of it.
  PerLabel<double> expected_saliency{};
  /// Of the whole input, before any point was removed.
  core::LabelCounts input_label_counts{};
  PerLabel<SaliencyHistogram> input_saliency;
  std::vector<RuleReport> rules;
};

/// A run of the filter to report on.
struct RuleRun {
  core::DensityRule rule = core::DensityRule::kPaper;
  core::FilteredCloud filtered;
  double filter_s = 0;
};

/// Reports on `runs`: results of FilterCloud for `cloud` with `options`, but
/// for the rule. `unfiltered`: its result with rule kPaper and no rounds. Known
/// classes are the attributes `classification` (an ObjectClass or another code
/// of LAS) and `truth` (a core::Label) of type uint8, where there are.
/// O(N log N). Thread-safe.
FilterReport MakeFilterReport(const core::LatticeCloud& cloud,
                              const core::FilteredCloud& unfiltered,
                              std::span<const RuleRun> runs,
                              const core::SpdfOptions& options,
                              const ExecutionContext& context = {});

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_FILTER_REPORT_H_
