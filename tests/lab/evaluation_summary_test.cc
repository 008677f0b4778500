#include "client/lab/evaluation_summary.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "client/lab/draws.h"
#include "gtest/gtest.h"

namespace mapsieve::client {
namespace {

Trial TrialOf(int pair, const std::string& method, double error,
              int64_t count = 1000) {
  Trial trial;
  trial.pair = absl::StrCat("pair ", pair);
  trial.environment = pair < 4 ? Environment::kStructured : Environment::kReal;
  trial.method = method;
  trial.count = count;
  trial.outcome = TrialOutcome::kConverged;
  trial.translation_error_m = error;
  trial.rotation_error_deg = 10 * error;
  trial.reference_points = count - 1;
  trial.sample_s = 2;
  trial.icp_s = 3;
  return trial;
}

const GroupSummary* Find(const std::vector<GroupSummary>& summaries,
                         std::optional<Environment> environment,
                         std::optional<int64_t> count,
                         const std::string& method) {
  for (const GroupSummary& s : summaries) {
    if (s.environment == environment && s.count == count &&
        s.method == method) {
      return &s;
    }
  }
  return nullptr;
}

TEST(Quantile, LiesBetweenItsNeighbours) {
  const std::vector<double> four = {1, 2, 4, 8};
  EXPECT_EQ(Quantile(four, 0), 1);
  EXPECT_EQ(Quantile(four, 0.25), 1.75);
  EXPECT_EQ(Quantile(four, 0.5), 3);
  EXPECT_EQ(Quantile(four, 0.75), 5);
  EXPECT_EQ(Quantile(four, 1), 8);
  EXPECT_EQ(Quantile(std::vector<double>{7}, 0.3), 7);
  const std::vector<double> endless = {1, 2, HUGE_VAL, HUGE_VAL};
  EXPECT_EQ(Quantile(endless, 1. / 3), 2);
  EXPECT_EQ(Quantile(endless, 0.5), HUGE_VAL);
  EXPECT_EQ(Quantile(std::vector<double>{-HUGE_VAL, 1}, 0.5), -HUGE_VAL);
}

TEST(BootstrapMedians, AreThoseOfResamplesMadeOneByOne) {
  constexpr uint32_t kGroups = 7;
  std::vector<double> values;
  std::vector<uint32_t> groups;
  Draws draws(4, 4);
  for (int i = 0; i < 60; ++i) {
    values.push_back(draws.Integer(0, 30));
    groups.push_back(static_cast<uint32_t>(draws.Integer(0, kGroups - 1)));
  }
  const std::vector<double> medians =
      BootstrapMedians(values, groups, kGroups, 50, 9);
  ASSERT_EQ(medians.size(), 50u);
  for (int resample = 0; resample < 50; ++resample) {
    Draws choice(9, resample);
    std::vector<double> drawn;
    for (uint32_t i = 0; i < kGroups; ++i) {
      const auto group = static_cast<uint32_t>(choice.Integer(0, kGroups - 1));
      for (size_t v = 0; v < values.size(); ++v) {
        if (groups[v] == group) drawn.push_back(values[v]);
      }
    }
    std::sort(drawn.begin(), drawn.end());
    const size_t n = drawn.size();
    EXPECT_EQ(medians[static_cast<size_t>(resample)],
              (drawn[(n - 1) / 2] + drawn[n / 2]) / 2);
  }
}

TEST(BootstrapMedians, DrawGroupsWithReplacement) {
  const std::vector<double> values = {0, 0, 0, 10, 10, 10};
  const std::vector<uint32_t> groups = {0, 0, 0, 1, 1, 1};
  const std::vector<double> medians =
      BootstrapMedians(values, groups, 2, 4000, 1);
  const auto share = [&](double value) {
    return static_cast<double>(
               std::count(medians.begin(), medians.end(), value)) /
           4000;
  };
  // Five standard deviations.
  EXPECT_NEAR(share(0), 0.25, 0.035);
  EXPECT_NEAR(share(5), 0.5, 0.04);
  EXPECT_NEAR(share(10), 0.25, 0.035);
}

TEST(Summarize, GivesTheValuesOfHand) {
  std::vector<Trial> trials;
  for (int pair = 0; pair < 5; ++pair) {
    for (int number = 0; number < 2; ++number) {
      trials.push_back(TrialOf(pair, "a", 0.01 * (2 * pair + number + 1)));
      trials.push_back(TrialOf(pair, "a", 0.3, 2000));
    }
  }
  Trial none = TrialOf(0, "a", HUGE_VAL);
  none.outcome = TrialOutcome::kNoSample;
  trials.push_back(none);
  Trial skipped = none;
  skipped.outcome = TrialOutcome::kSkipped;
  trials.push_back(skipped);
  Trial turned = TrialOf(4, "a", 0.11);
  turned.rotation_error_deg = 5.1;
  turned.outcome = TrialOutcome::kIterationLimit;
  turned.degenerate_count = 2;
  trials.push_back(turned);

  const std::vector<GroupSummary> summaries = Summarize(trials);
  // 0.01, … 0.10, 0.11 and one without end.
  const GroupSummary* all = Find(summaries, std::nullopt, 1000, "a");
  ASSERT_NE(all, nullptr);
  EXPECT_EQ(all->pair_count, 5);
  EXPECT_EQ(all->trial_count, 12);
  EXPECT_EQ(all->failure_count, 2);
  EXPECT_EQ(all->converged_count, 10);
  EXPECT_EQ(all->degenerate_count, 1);
  EXPECT_NEAR(all->translation_m.median, 0.065, 1e-12);
  EXPECT_NEAR(all->translation_m.lower_quartile, 0.0375, 1e-12);
  EXPECT_NEAR(all->translation_m.upper_quartile, 0.0925, 1e-12);
  EXPECT_LT(all->translation_m.low, 0.065);
  EXPECT_GT(all->translation_m.high, 0.065);
  EXPECT_TRUE(all->translation_m.ties_with_best);
  EXPECT_NEAR(all->rotation_deg.median, 0.65, 1e-12);
  EXPECT_EQ(all->points, 999);
  EXPECT_EQ(all->sample_s, 2);
  EXPECT_EQ(all->icp_s, 3);

  const GroupSummary* real = Find(summaries, Environment::kReal, 1000, "a");
  ASSERT_NE(real, nullptr);
  EXPECT_EQ(real->pair_count, 1);
  EXPECT_EQ(real->trial_count, 3);
  EXPECT_NEAR(real->translation_m.median, 0.10, 1e-12);
  // One pair says nothing of others.
  EXPECT_EQ(real->translation_m.low, real->translation_m.high);

  const GroupSummary* both = Find(summaries, std::nullopt, std::nullopt, "a");
  ASSERT_NE(both, nullptr);
  EXPECT_EQ(both->trial_count, 22);
  EXPECT_EQ(both->failure_count, 12);
  EXPECT_EQ(Find(summaries, Environment::kUnstructured, 1000, "a"), nullptr);
}

TEST(Summarize, ReportsTies) {
  std::vector<Trial> trials;
  for (int pair = 0; pair < 20; ++pair) {
    const double error = 0.01 + 0.002 * pair;
    trials.push_back(TrialOf(pair, "best", error));
    // Worse on every pair, though less than the pairs differ.
    trials.push_back(TrialOf(pair, "worse", 1.2 * error));
    // Better on half of the pairs.
    trials.push_back(
        TrialOf(pair, "other", (pair % 2 == 0 ? 0.8 : 1.25) * error));
  }
  const std::vector<GroupSummary> summaries = Summarize(trials);
  const auto ties = [&](const char* method) {
    return Find(summaries, std::nullopt, 1000, method)
        ->translation_m.ties_with_best;
  };
  EXPECT_TRUE(ties("best"));
  EXPECT_FALSE(ties("worse"));
  EXPECT_TRUE(ties("other"));
}

}  // namespace
}  // namespace mapsieve::client
