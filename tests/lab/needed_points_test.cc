#include "client/lab/needed_points.h"

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "gtest/gtest.h"

namespace mapsieve::client {
namespace {

GroupSummary SummaryOf(const std::string& method, std::optional<int64_t> count,
                       double median,
                       std::optional<Environment> environment = std::nullopt) {
  GroupSummary summary;
  summary.method = method;
  summary.count = count;
  summary.environment = environment;
  summary.translation_m.median = median;
  return summary;
}

TEST(NeededPoints, AreTheSmallestCountAtOrBelowTheTarget) {
  const std::vector<GroupSummary> summaries = {
      SummaryOf("above", 1000, 0.021),   SummaryOf("above", 2000, 0.0205),
      SummaryOf("at", 1000, 0.03),       SummaryOf("at", 2000, 0.02),
      SummaryOf("at", 5000, 0.001),      SummaryOf("back", 1000, 0.01),
      SummaryOf("back", 2000, 0.5),      SummaryOf("never", 1000, HUGE_VAL),
      SummaryOf("never", 2000, HUGE_VAL)};
  const std::vector<NeededPoints> needed = FindNeededPoints(summaries, 0.02);
  ASSERT_EQ(needed.size(), 4u);
  // Fewest points first, and those that do not reach it after all others.
  EXPECT_TRUE(needed[0].is_reached);
  EXPECT_EQ(needed[0].at.method, "back");
  EXPECT_EQ(needed[0].at.count, 1000);
  EXPECT_TRUE(needed[1].is_reached);
  EXPECT_EQ(needed[1].at.method, "at");
  EXPECT_EQ(needed[1].at.count, 2000);
  EXPECT_FALSE(needed[2].is_reached);
  EXPECT_EQ(needed[2].at.method, "above");
  EXPECT_EQ(needed[2].at.count, 2000);
  EXPECT_FALSE(needed[3].is_reached);
  EXPECT_EQ(needed[3].at.method, "never");
  EXPECT_EQ(needed[3].at.count, 1000);
}

TEST(NeededPoints, OfEqualCountsTheLowerMedianComesFirst) {
  const std::vector<GroupSummary> summaries = {SummaryOf("a", 1000, 0.02),
                                               SummaryOf("b", 1000, 0.01),
                                               SummaryOf("c", 500, 0.02)};
  const std::vector<NeededPoints> needed = FindNeededPoints(summaries, 0.02);
  ASSERT_EQ(needed.size(), 3u);
  EXPECT_EQ(needed[0].at.method, "c");
  EXPECT_EQ(needed[1].at.method, "b");
  EXPECT_EQ(needed[2].at.method, "a");
}

TEST(NeededPoints, AreOfEachIcpAndOfAllEnvironmentsAndOneCount) {
  std::vector<GroupSummary> summaries = {
      SummaryOf("a", 1000, 0.001, Environment::kReal),
      SummaryOf("a", std::nullopt, 0.001), SummaryOf("a", 2000, 0.01),
      SummaryOf("a", 1000, 0.01)};
  summaries[3].icp = core::IcpMethod::kPlaneToPlane;
  const std::vector<NeededPoints> needed = FindNeededPoints(summaries, 0.02);
  ASSERT_EQ(needed.size(), 2u);
  EXPECT_EQ(needed[0].at.icp, core::IcpMethod::kPlaneToPlane);
  EXPECT_EQ(needed[0].at.count, 1000);
  EXPECT_EQ(needed[1].at.icp, core::IcpMethod::kPointToPlane);
  EXPECT_EQ(needed[1].at.count, 2000);
}

}  // namespace
}  // namespace mapsieve::client
