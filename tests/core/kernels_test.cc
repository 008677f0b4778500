#include "core/spdf/kernels.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/spdf/spdf_options.h"
#include "gtest/gtest.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::core {
namespace {

using testing::Decompose;
using testing::EigenSystem3;
using testing::Symmetric3;

std::vector<const Kernels*> All() {
  int count = 0;
  const Kernels* const* kernels = AvailableKernels(&count);
  return {kernels, kernels + count};
}

/// A block of random points around the origin, the first of which are queries.
struct RandomBlock {
  struct Point {
    int32_t x, y, z;
  };
  std::vector<Point> points;
  std::vector<int32_t> xy, z;
  std::array<std::vector<int32_t>, 6> entries;
  std::vector<int32_t> priorities;

  RandomBlock(int count, int32_t extent, uint64_t seed) {
    std::mt19937_64 random(seed);
    const auto coordinate = [&] {
      return static_cast<int32_t>(random() %
                                  static_cast<uint64_t>(2 * extent + 1)) -
             extent;
    };
    for (int i = 0; i < count; ++i) {
      points.push_back({coordinate(), coordinate(), coordinate()});
      xy.push_back(PackXy(points.back().x, points.back().y));
      z.push_back(PackZ(points.back().z));
      for (std::vector<int32_t>& entry : entries) {
        entry.push_back(std::bit_cast<int32_t>(
            static_cast<float>(random() % 2001) / 1000.0f - 1.0f));
      }
      priorities.push_back(static_cast<int32_t>(random() % 64) - 32);
    }
    const auto padded = static_cast<size_t>(count) + kKernelPadding;
    xy.resize(padded);
    z.resize(padded, PackZ(kFarAway));
    for (std::vector<int32_t>& entry : entries) entry.resize(padded);
    priorities.resize(padded);
  }
  CandidateBlock block() const {
    return {xy.data(), z.data(), static_cast<int>(points.size())};
  }
  VoterTensors tensors() const {
    VoterTensors tensors;
    for (size_t e = 0; e < 6; ++e) tensors.entry[e] = entries[e].data();
    return tensors;
  }
};

/// Room for a query over `count` candidates.
class Scratch {
 public:
  explicit Scratch(int count) {
    for (std::vector<int32_t>& array : arrays_) {
      array.resize(static_cast<size_t>(count) + 2 * kKernelPadding);
    }
  }
  KernelScratch Get() {
    KernelScratch scratch = {arrays_[0].data(), arrays_[1].data(),
                             arrays_[2].data()};
    for (size_t e = 0; e < 6; ++e) scratch.entry[e] = arrays_[3 + e].data();
    return scratch;
  }

 private:
  std::array<std::vector<int32_t>, 9> arrays_;
};

int32_t SquaredDistance(const RandomBlock::Point& a,
                        const RandomBlock::Point& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y) +
         (a.z - b.z) * (a.z - b.z);
}

TEST(Kernels, AlwaysIncludeThePortableVersion) {
  EXPECT_STREQ(All().front()->name, "Portable");
  EXPECT_EQ(&ActiveKernels(), All().back());
}

TEST(Kernels, WeightIsTheKernelToThreeUnitsAndNeverGrows) {
  const SpdfOptions options;
  const SpdfConstants constants = MakeSpdfConstants(options, Lattice());
  ASSERT_EQ(constants.reach_d2, 1381551);
  for (const Kernels* kernels : All()) {
    int32_t previous = 1 << 24;
    for (int32_t d2 = 0; d2 <= constants.reach_d2; ++d2) {
      const int32_t weight = kernels->weight(d2, constants.weight_scale);
      const double exact = 0x1p24 * std::exp(-d2 * 1e-6 / 0.2);
      ASSERT_NEAR(weight, exact, 3.0) << kernels->name << " " << d2;
      ASSERT_LE(weight, previous) << kernels->name << " " << d2;
      previous = weight;
    }
  }
}

TEST(Kernels, SelectSeparatesExactlyTheRankOrStopsAtTies) {
  std::mt19937_64 random(1);
  for (const Kernels* kernels : All()) {
    for (int trial = 0; trial < 300; ++trial) {
      std::vector<int32_t> d2(1 + random() % 300);
      const uint64_t range = trial % 3 == 0 ? 20 : 1000000;
      for (int32_t& d : d2) d = static_cast<int32_t>(random() % range);
      const int count = static_cast<int>(d2.size());
      const int rank = 1 + static_cast<int>(random() % 128);
      const auto bound = static_cast<int32_t>(random() % range);
      std::vector<int32_t> padded = d2;
      padded.resize(d2.size() + kKernelPadding,
                    std::numeric_limits<int32_t>::max());
      const int32_t result = kernels->select(padded.data(), count, rank, bound);
      const auto within = [&](int32_t limit) {
        return std::count_if(d2.begin(), d2.end(),
                             [limit](int32_t d) { return d <= limit; });
      };
      if (within(bound) <= rank) {
        ASSERT_EQ(result, bound);
      } else if (within(result) != rank) {
        ASSERT_GT(within(result), rank);
        ASSERT_LT(within(result - 1), rank);
      }
      ASSERT_LE(result, bound);
    }
  }
}

TEST(Kernels, AllVersionsGiveTheSameVotes) {
  const Kernels& portable = *All().front();
  for (const Kernels* kernels : All()) {
    for (uint64_t seed = 0; seed < 60; ++seed) {
      const int count = 1 + static_cast<int>(seed * 7);
      const int32_t extent = seed % 3 == 0 ? 3 : 400;
      const RandomBlock random(count, extent, seed);
      Scratch scratch(count);
      for (int i = 0; i < std::min(count, 20); ++i) {
        const RandomBlock::Point& q = random.points[static_cast<size_t>(i)];
        NeighborQuery query = {q.x, q.y, q.z, 50, 360000, 5e-6f};
        BallSums expected;
        BallSums actual;
        portable.ball_vote(random.block(), query, scratch.Get(), &expected);
        kernels->ball_vote(random.block(), query, scratch.Get(), &actual);
        ASSERT_EQ(std::memcmp(&expected, &actual, sizeof(actual)), 0)
            << kernels->name;
        query.bound_d2 = expected.radius_d2;
        VoteSums aware_expected;
        VoteSums aware_actual;
        portable.aware_vote(random.block(), query, random.tensors(),
                            scratch.Get(), &aware_expected);
        kernels->aware_vote(random.block(), query, random.tensors(),
                            scratch.Get(), &aware_actual);
        ASSERT_EQ(
            std::memcmp(&aware_expected, &aware_actual, sizeof(aware_actual)),
            0)
            << kernels->name;
      }
    }
  }
}

TEST(Kernels, DistancesReachAsFarAsTheLargestRadius) {
  const int32_t far = kMaxRadiusSteps + kMaxRadiusSteps / 2;
  const int32_t half = kMaxRadiusSteps / 2;
  RandomBlock random(40, far, 2);
  for (const Kernels* kernels : All()) {
    for (const RandomBlock::Point& q :
         {RandomBlock::Point{half, -half, half}, {-half, half, 0}}) {
      std::vector<int32_t> d2(random.points.size() + 2 * kKernelPadding);
      kernels->distances(random.block(), q.x, q.y, q.z, d2.data());
      for (size_t i = 0; i < random.points.size(); ++i) {
        ASSERT_EQ(d2[i], SquaredDistance(random.points[i], q));
      }
      ASSERT_EQ(d2[random.points.size()], std::numeric_limits<int32_t>::max());
      ASSERT_FALSE(kernels->any_within({random.xy.data(), random.z.data(), 0},
                                       q.x, q.y, q.z, 1 << 28));
      const int32_t nearest = *std::min_element(d2.begin(), d2.begin() + 40);
      ASSERT_TRUE(kernels->any_within(random.block(), q.x, q.y, q.z, nearest));
      ASSERT_FALSE(
          kernels->any_within(random.block(), q.x, q.y, q.z, nearest - 1));
    }
  }
}

TEST(Kernels, GatherTakesTheBoxAndKeepWithinKeepsItsOrder) {
  const RandomBlock random(150, 500, 3);
  std::vector<int32_t> x, y, z;
  for (const RandomBlock::Point& p : random.points) {
    x.push_back(p.x + 1000000);
    y.push_back(p.y - 7);
    z.push_back(p.z);
  }
  for (std::vector<int32_t>* axis : {&x, &y, &z}) {
    axis->resize(axis->size() + kKernelPadding);
  }
  const GatherSource source = {
      x.data(), y.data(), z.data(), {1000100, 0, 3}, {300, 250, 400}};
  for (const Kernels* kernels : All()) {
    std::vector<int32_t> xy(200), zs(200), ids(200);
    const BlockArrays arrays = {xy.data(), zs.data(), ids.data()};
    int count = kernels->gather(source, 3, 60, arrays, 0);
    count = kernels->gather(source, 60, 147, arrays, count);
    std::vector<int32_t> expected;
    for (int32_t i = 3; i < 147; ++i) {
      const auto at = static_cast<size_t>(i);
      if (std::abs(x[at] - 1000100) <= 300 && std::abs(y[at]) <= 250 &&
          std::abs(z[at] - 3) <= 400) {
        ASSERT_LT(expected.size(), static_cast<size_t>(count));
        EXPECT_EQ(UnpackX(xy[expected.size()]), x[at] - 1000100);
        EXPECT_EQ(UnpackY(xy[expected.size()]), y[at]);
        EXPECT_EQ(UnpackZ(zs[expected.size()]), z[at] - 3);
        expected.push_back(i);
      }
    }
    ids.resize(static_cast<size_t>(count));
    EXPECT_EQ(ids, expected) << kernels->name;

    ids.resize(200);
    std::vector<int32_t> d2(200);
    std::vector<int32_t> nearer;
    for (size_t i = 0; i < expected.size(); ++i) {
      d2[i] = static_cast<int32_t>(i * 37 % 11);
      if (d2[i] <= 5) nearer.push_back(ids[i]);
    }
    std::fill(d2.begin() + count, d2.end(),
              std::numeric_limits<int32_t>::max());
    ids.resize(
        static_cast<size_t>(kernels->keep_within(arrays, d2.data(), count, 5)));
    EXPECT_EQ(ids, nearer) << kernels->name;
  }
}

TEST(Kernels, CountBetterMatchesItsDefinitionUpToTheLimit) {
  const RandomBlock random(400, 60, 9);
  for (const Kernels* kernels : All()) {
    for (size_t self = 0; self < random.points.size(); ++self) {
      const RandomBlock::Point& q = random.points[self];
      int expected = 0;
      for (size_t i = 0; i < random.points.size(); ++i) {
        if (SquaredDistance(random.points[i], q) <= 900 &&
            random.priorities[i] < random.priorities[self]) {
          ++expected;
        }
      }
      const auto count = [&](int limit) {
        return kernels->count_better(random.block(), random.priorities.data(),
                                     q.x, q.y, q.z, 900,
                                     random.priorities[self], limit);
      };
      ASSERT_EQ(count(1000), expected);
      ASSERT_EQ(count(5) >= 5, expected >= 5);
    }
  }
}

TEST(Kernels, DecomposeEachMatrixAsIfItWereAlone) {
  std::mt19937_64 random(4);
  EigenBatch batch;
  for (int i = 0; i < EigenBatch::kSize; ++i) {
    Symmetric3 m;
    for (double* entry : {&m.xx, &m.xy, &m.xz, &m.yy, &m.yz, &m.zz}) {
      *entry = static_cast<double>(random() % 2001) / 1000.0 - 1.0;
    }
    if (i == 1) m = {1, 0, 0, 2, 0, 3};
    if (i == 2) m = {};
    if (i == 3) m = {2, 1e-12, 0, 2, 0, 2};
    const double entries[6] = {m.xx, m.xy, m.xz, m.yy, m.yz, m.zz};
    for (int e = 0; e < 6; ++e) batch.entry[e][i] = entries[e];
  }
  for (const Kernels* kernels : All()) {
    EigenBatch values = batch;
    EigenBatch whole = batch;
    kernels->find_eigenvalues(&values);
    kernels->decompose(&whole);
    for (int i = 0; i < EigenBatch::kSize; ++i) {
      const EigenSystem3 alone =
          Decompose({batch.entry[0][i], batch.entry[1][i], batch.entry[2][i],
                     batch.entry[3][i], batch.entry[4][i], batch.entry[5][i]});
      for (int d = 0; d < 3; ++d) {
        EXPECT_EQ(values.value[d][i], whole.value[d][i]);
        const auto same = std::find(alone.values.begin(), alone.values.end(),
                                    whole.value[d][i]);
        ASSERT_NE(same, alone.values.end()) << kernels->name << " " << i;
        const auto& vector =
            alone.vectors[static_cast<size_t>(same - alone.values.begin())];
        if (std::count(alone.values.begin(), alone.values.end(), *same) > 1) {
          continue;  // any vector of the plane will do
        }
        for (int a = 0; a < 3; ++a) {
          EXPECT_EQ(whole.vector[d][a][i], vector[static_cast<size_t>(a)]);
        }
      }
    }
  }
}

}  // namespace
}  // namespace mapsieve::core
