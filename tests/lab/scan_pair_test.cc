#include "client/lab/scan_pair.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>
#include <numeric>
#include <string>
#include <vector>

#include "client/lab/simulated_pair.h"
#include "client/lab/surveyed_pair.h"
#include "core/registration/kd_tree.h"
#include "core/registration/transform_error.h"
#include "core/spdf/cloud_filter.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::client {
namespace {

using core::RigidTransform;
using core::Vector3;
using mapsieve::testing::StatusIs;
using mapsieve::testing::TemporaryDirectory;
using ::testing::AllOf;
using ::testing::HasSubstr;

/// How far the reading under a pose lies from the reference's surfaces.
class Alignment {
 public:
  explicit Alignment(const ScanPair& pair) : pair_(pair) {
    core::SpdfOptions votes;
    votes.max_round_count = 0;
    const auto filtered = core::FilterCloud(pair.reference, votes);
    for (size_t i = 0; i < filtered->rows.size(); ++i) {
      if (filtered->columns.label[i] == core::Label::kNone) continue;
      positions_.push_back(
          Place(pair.reference, pair.reference.positions[filtered->rows[i]]));
      const auto n = core::DecodeOctahedral(filtered->columns.normal[i]);
      normals_.push_back({n[0], n[1], n[2]});
    }
  }

  /// Mean distance along the normal of the nearest point of the reference,
  /// over the points that have one within 0.2 m.
  double Residual(const RigidTransform& T_reference_reading) const {
    const core::KdTree tree(positions_);
    std::vector<double> residuals;
    for (size_t i = 0; i < pair_.reading.size(); i += 23) {
      const Vector3 at = Place(pair_.reading, pair_.reading.positions[i]);
      const core::Point3 moved = T_reference_reading({at[0], at[1], at[2]});
      const Vector3 p = {moved.x, moved.y, moved.z};
      std::array<core::KdTree::Neighbor, 1> nearest;
      tree.FindNearest(p, nearest);
      if (nearest[0].squared_distance > 0.04) continue;
      const Vector3& q = positions_[nearest[0].row];
      residuals.push_back(std::abs(core::Dot(
          normals_[nearest[0].row], {p[0] - q[0], p[1] - q[1], p[2] - q[2]})));
    }
    if (residuals.size() < 100) return 1;
    const double sum = std::accumulate(residuals.begin(), residuals.end(), 0.0);
    return sum / static_cast<double>(residuals.size());
  }

 private:
  static Vector3 Place(const core::LatticeCloud& cloud,
                       const core::LatticePoint& q) {
    const core::Point3 p = cloud.lattice.Position(q);
    return {p.x, p.y, p.z};
  }

  const ScanPair& pair_;
  std::vector<Vector3> positions_;
  std::vector<Vector3> normals_;
};

/// Truth fits within `limit_m`, and motions of 8 cm and 3 degrees fit worse.
void ExpectTruthAligns(const ScanPair& pair, double limit_m) {
  const Alignment alignment(pair);
  const RigidTransform& truth = pair.T_reference_reading;
  const double at_truth = alignment.Residual(truth);
  EXPECT_LT(at_truth, limit_m);
  for (size_t axis = 0; axis < 3; ++axis) {
    RigidTransform moved;
    moved.translation[axis] = 0.08;
    EXPECT_LT(at_truth, alignment.Residual(truth * moved)) << axis;
    RigidTransform turned;
    Vector3 rotation = {0, 0, 0};
    rotation[axis] = 3 * std::numbers::pi / 180;
    turned.rotation = core::RotationFromVector(rotation);
    EXPECT_LT(at_truth, alignment.Residual(truth * turned)) << axis;
  }
}

TEST(SimulatedPairs, AreAlwaysTheSame) {
  const std::vector<PairSource> pairs =
      SimulatedPairs({.pair_counts = {2, 1, 1}, .rotation_count = 1});
  ASSERT_EQ(pairs.size(), 4u);
  EXPECT_EQ(pairs[1].name, "structured-1-r1");
  EXPECT_EQ(pairs[3].environment, Environment::kUnstructured);
  for (const PairSource& source : pairs) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair pair, source.load());
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair again, source.load());
    EXPECT_EQ(pair.reference.positions, again.reference.positions);
    EXPECT_EQ(pair.reading.positions, again.reading.positions);
    EXPECT_EQ(pair.T_reference_reading, again.T_reference_reading);
    EXPECT_GT(std::min(pair.reference.size(), pair.reading.size()), 8000u);
  }
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair first, pairs[0].load());
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair second, pairs[1].load());
  EXPECT_NE(first.reference.positions, second.reference.positions);

  const std::vector<PairSource> others = SimulatedPairs(
      {.pair_counts = {1, 0, 2}, .first_pair = 1, .rotation_count = 1});
  ASSERT_EQ(others.size(), 3u);
  EXPECT_EQ(others[0].name, "structured-1-r1");
  EXPECT_EQ(others[2].name, "unstructured-2-r1");
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair other, others[0].load());
  EXPECT_EQ(other.reference.positions, second.reference.positions);
}

TEST(SimulatedPairs, TruthAlignsTheScans) {
  // A few times the noise; in woods much of what is seen has no surface.
  constexpr std::array<double, 3> kLimits = {0.02, 0.035, 0.08};
  const std::vector<PairSource> pairs =
      SimulatedPairs({.pair_counts = {1, 1, 1}, .rotation_count = 1});
  for (size_t i = 0; i < pairs.size(); ++i) {
    SCOPED_TRACE(pairs[i].name);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair pair, pairs[i].load());
    ExpectTruthAligns(pair, kLimits[i]);
  }
}

TEST(SimulatedPairs, StandApartAsDocumented) {
  constexpr std::array<double, 3> kMin = {1.2, 3, 3};
  constexpr std::array<double, 3> kMax = {3, 6, 5};
  const std::vector<PairSource> pairs =
      SimulatedPairs({.pair_counts = {2, 2, 2}, .rotation_count = 1});
  for (size_t i = 0; i < pairs.size(); ++i) {
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair pair, pairs[i].load());
    const core::Vector3& t = pair.T_reference_reading.translation;
    const double level = std::hypot(t[0], t[1]);
    EXPECT_GE(level, kMin[i / 2] - 1e-9) << pairs[i].name;
    EXPECT_LE(level, kMax[i / 2] + 1e-9) << pairs[i].name;
    EXPECT_LE(
        core::CompareTransforms(pair.T_reference_reading, {}).rotation_rad,
        40 * std::numbers::pi / 180);
  }
}

TEST(SurveyedPairs, ScansLieInTheirMaps) {
  const std::vector<PairSource> pairs = SurveyedPairs(kMaxSurveyedPairs);
  ASSERT_EQ(pairs.size(), 12u);
  EXPECT_EQ(pairs.back().name, "survey-11");
  // The first one is near the beginning of the survey, the last near its end.
  for (const size_t i : {size_t{0}, pairs.size() - 1}) {
    SCOPED_TRACE(pairs[i].name);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(ScanPair pair, pairs[i].load());
    EXPECT_GT(pair.reference.size(), 500'000u);
    EXPECT_GT(pair.reading.size(), 15'000u);
    EXPECT_EQ(pair.T_reference_reading, RigidTransform());
    // What is near the scanner is enough to tell.
    for (core::LatticeCloud* cloud : {&pair.reference, &pair.reading}) {
      std::erase_if(cloud->positions, [](const core::LatticePoint& q) {
        return std::hypot(q.x, q.y) > 15'000;
      });
    }
    ExpectTruthAligns(pair, 0.035);
  }
}

TEST(SimulatedPairs, OptionsHaveLimits) {
  EXPECT_THAT(SimulatedPairOptions{.rotation_count = 33}.Validate(),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("rotation_count is 33")));
  EXPECT_THAT((SimulatedPairOptions{.pair_counts = {1, -1, 0}}.Validate()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("pair_counts holds -1")));
  EXPECT_THAT((SimulatedPairOptions{.first_pair = -1}.Validate()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("first_pair is -1")));
}

constexpr char kIdentity[] =
    "    transform: [1, 0, 0, 2,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1]\n";

class PairListTest : public ::testing::Test {
 protected:
  PairListTest() {
    std::ofstream(folder_ / "a.csv") << "x,y,z,intensity\n1,2,3,9\n";
    std::ofstream(folder_ / "b.csv") << "x,y,z\n0.5,0,0\n0.5004,0,0\n";
  }
  absl::StatusOr<std::vector<PairSource>> Read(const std::string& text) {
    std::ofstream(folder_ / "list.yaml") << text;
    return ReadPairList(folder_ / "list.yaml", "");
  }
  const TemporaryDirectory folder_;
};

TEST_F(PairListTest, GivesFilesAndTheirTruth) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<PairSource> pairs,
      Read(absl::StrCat("pairs:\n  - name: one\n    environment: structured\n"
                        "    reference: a.csv\n    reading: b.csv\n",
                        kIdentity, "  - name: two\n    reference: a.csv\n",
                        "    reading: b.csv\n", kIdentity)));
  ASSERT_EQ(pairs.size(), 2u);
  EXPECT_EQ(pairs[0].environment, Environment::kStructured);
  EXPECT_EQ(pairs[1].environment, Environment::kReal);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair pair, pairs[0].load());
  EXPECT_EQ(pair.reference.positions,
            (std::vector<core::LatticePoint>{{1000, 2000, 3000}}));
  EXPECT_EQ(pair.reading.positions,
            (std::vector<core::LatticePoint>{{500, 0, 0}, {500, 0, 0}}));
  EXPECT_TRUE(pair.reference.attributes.columns().empty());
  EXPECT_EQ(pair.T_reference_reading.translation, (Vector3{2, 0, 0}));
}

TEST_F(PairListTest, SaysWhatIsWrongAndWhere) {
  const std::string files = "    reference: a.csv\n    reading: b.csv\n";
  const auto expect = [&](const std::string& text, const std::string& what) {
    EXPECT_THAT(Read(text),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr("list.yaml"), HasSubstr(what))))
        << text;
  };
  expect("pears: []\n", "'pairs'");
  expect("pairs: [\n", "line ");
  expect("pairs:\n  - 7\n", "line 2");
  expect("pairs:\n  - name: one\n" + files, "'transform': expected 16 numbers");
  expect("pairs:\n  - name: one\n" + files + "    transform: 7\n",
         "expected 16 numbers");
  expect("pairs:\n  - name: one\n" + files + "    transform: [1,\n  x]\n",
         "line 6: a 'transform' holds numbers alone");
  expect(
      "pairs:\n  - name: one\n" + files +
          "    transform: [1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2]\n",
      "the last is 0, 0, 0, 1");
  expect(
      "pairs:\n  - name: one\n" + files +
          "    transform: [2, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n",
      "line 2");
  expect("pairs:\n  - reference: a.csv\n    reading: b.csv\n", "'name'");
  expect("pairs:\n  - name: \"a,b\"\n" + files + kIdentity, "no comma");
  expect("pairs:\n  - name: one\n    environment: moon\n" + files + kIdentity,
         "an environment is");
  expect("pairs:\n  - name: one\n    color: red\n" + files + kIdentity,
         "line 3: unknown entry 'color'");
  expect("pairs:\n  - name: one\n" + files + kIdentity + "  - name: one\n" +
             files + kIdentity,
         "line 6: another pair is 'one' already");
  EXPECT_THAT(Read(absl::StrCat("pairs:\n  - name: one\n    reference: a.csv\n"
                                "    reading: none.csv\n",
                                kIdentity)),
              StatusIs(absl::StatusCode::kNotFound,
                       AllOf(HasSubstr("line 2"), HasSubstr("none.csv"),
                             HasSubstr("no such file"))));
  EXPECT_THAT(ReadPairList(folder_ / "absent.yaml", ""),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("absent.yaml")));
}

#ifdef MAPSIEVE_TEST_DATA
void ExpectListAligns(const std::string& list,
                      const std::vector<double>& limits_m) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(
      const std::vector<PairSource> pairs,
      ReadPairList(absl::StrCat(MAPSIEVE_PAIR_LISTS, "/", list),
                   MAPSIEVE_TEST_DATA));
  ASSERT_EQ(pairs.size(), limits_m.size());
  for (size_t i = 0; i < pairs.size(); ++i) {
    SCOPED_TRACE(pairs[i].name);
    MAPSIEVE_ASSERT_OK_AND_ASSIGN(const ScanPair pair, pairs[i].load());
    ExpectTruthAligns(pair, limits_m[i]);
  }
}

TEST(RealPairs, TruthAlignsTheScans) {
  // Their truth is good to 1 cm and to 3 cm.
  ExpectListAligns("evaluation_pairs.yaml", {0.03, 0.06});
  ExpectListAligns("evaluation_pairs_norlab.yaml", {0.02, 0.02, 0.02});
}
#endif  // MAPSIEVE_TEST_DATA

}  // namespace
}  // namespace mapsieve::client
