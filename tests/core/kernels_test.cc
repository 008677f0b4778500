#include "core/spdf/kernels.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>
#include <string>
#include <tuple>
#include <vector>

#include "core/spdf/spdf_options.h"
#include "gtest/gtest.h"

namespace mapsieve::core {
namespace {

std::vector<const Kernels*> All() {
  int count = 0;
  const Kernels* const* kernels = AvailableKernels(&count);
  return {kernels, kernels + count};
}

/// A block of random points around the origin, the first of which are queries.
struct RandomBlock {
  std::vector<int32_t> x, y, z;
  std::vector<VoterTensor> tensors;
  std::vector<uint64_t> priorities;

  RandomBlock(int count, int32_t extent, uint64_t seed) {
    std::mt19937_64 random(seed);
    const auto coordinate = [&] {
      return static_cast<int32_t>(random() %
                                  static_cast<uint64_t>(2 * extent + 1)) -
             extent;
    };
    for (int i = 0; i < count; ++i) {
      x.push_back(coordinate());
      y.push_back(coordinate());
      z.push_back(coordinate());
      VoterTensor tensor;
      for (float& e : tensor.entry) {
        e = static_cast<float>(random() % 2001) / 1000.0f - 1.0f;
      }
      tensors.push_back(tensor);
      priorities.push_back(random() % 64);
    }
  }
  CandidateBlock block() const {
    return {x.data(), y.data(), z.data(), static_cast<int>(x.size())};
  }
};

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
      const int32_t result = kernels->select(d2.data(), count, rank, bound);
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

TEST(Kernels, AllVersionsGiveTheSameBits) {
  const Kernels& portable = *All().front();
  for (const Kernels* kernels : All()) {
    for (uint64_t seed = 0; seed < 60; ++seed) {
      const int count = 1 + static_cast<int>(seed * 7);
      const int32_t extent = seed % 3 == 0 ? 3 : 400;
      const RandomBlock random(count, extent, seed);
      std::vector<int32_t> d2(static_cast<size_t>(count) + 1);
      std::vector<int32_t> members(static_cast<size_t>(count) + 1);
      const KernelScratch scratch = {d2.data(), members.data()};
      for (int i = 0; i < std::min(count, 20); ++i) {
        const auto q = static_cast<size_t>(i);
        NeighborQuery query = {random.x[q], random.y[q], random.z[q],
                               50,          360000,      5e-6f};
        BallSums expected;
        BallSums actual;
        portable.ball_vote(random.block(), query, scratch, &expected);
        kernels->ball_vote(random.block(), query, scratch, &actual);
        ASSERT_EQ(std::memcmp(&expected, &actual, sizeof(actual)), 0)
            << kernels->name;
        query.bound_d2 = expected.radius_d2;
        VoteSums aware_expected;
        VoteSums aware_actual;
        portable.aware_vote(random.block(), query, random.tensors.data(),
                            scratch, &aware_expected);
        kernels->aware_vote(random.block(), query, random.tensors.data(),
                            scratch, &aware_actual);
        ASSERT_EQ(
            std::memcmp(&aware_expected, &aware_actual, sizeof(aware_actual)),
            0)
            << kernels->name;
        ASSERT_EQ(portable.count_better(random.block(),
                                        random.priorities.data(), i, 40000),
                  kernels->count_better(random.block(),
                                        random.priorities.data(), i, 40000));
      }
    }
  }
}

TEST(Kernels, CountBetterMatchesItsDefinition) {
  const RandomBlock random(400, 60, 9);
  const CandidateBlock block = random.block();
  for (int self = 0; self < block.count; ++self) {
    int expected = 0;
    for (int i = 0; i < block.count; ++i) {
      const int32_t dx = block.x[i] - block.x[self];
      const int32_t dy = block.y[i] - block.y[self];
      const int32_t dz = block.z[i] - block.z[self];
      const auto rank = [&](int j) {
        return std::tuple(random.priorities[static_cast<size_t>(j)], block.x[j],
                          block.y[j], block.z[j]);
      };
      if (dx * dx + dy * dy + dz * dz <= 900 && rank(i) < rank(self)) {
        ++expected;
      }
    }
    ASSERT_EQ(ActiveKernels().count_better(block, random.priorities.data(),
                                           self, 900),
              expected);
  }
}

}  // namespace
}  // namespace mapsieve::core
