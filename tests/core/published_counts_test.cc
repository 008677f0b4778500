// Statistics that the authors' implementation gives on the reference clouds;
// draws differ, so counts agree and points do not.
#include <filesystem>
#include <fstream>
#include <vector>

#include "core/spdf/cloud_filter.h"
#include "tests/testing/status_matchers.h"

#ifdef MAPSIEVE_TEST_DATA

namespace mapsieve::core {
namespace {

LatticeCloud ReadReference(const std::string& name) {
  std::ifstream file(
      std::filesystem::path(MAPSIEVE_TEST_DATA) / "reference" / name,
      std::ios::binary);
  LatticeCloud cloud;
  std::array<float, 3> p;
  while (file.read(reinterpret_cast<char*>(p.data()), sizeof(p))) {
    cloud.positions.push_back(
        cloud.lattice.Quantize({p[0], p[1], p[2]}).value());
  }
  return cloud;
}

void ExpectSurvivors(const LatticeCloud& cloud, SpdfOptions options,
                     double published) {
  options.reach_m = 0.6;  // the published cut-off
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const FilteredCloud result,
                                FilterCloud(cloud, options));
  EXPECT_NEAR(static_cast<double>(result.summary.survivor_count) / published, 1,
              0.005);
}

TEST(PublishedCounts, YardAfterTheRounds) {
  ExpectSurvivors(ReadReference("yard_100k.bin"), {.density_radius_m = 0.2},
                  95706);
}

TEST(PublishedCounts, RoomAfterTheRoundsForManyParameters) {
  const LatticeCloud room = ReadReference("room_370k.bin");
  ExpectSurvivors(room, {.density_radius_m = 0.2}, 104459);
  ExpectSurvivors(room, {.density_radius_m = 0.1}, 367913);
  ExpectSurvivors(room, {.density_radius_m = 0.4}, 12889);
  ExpectSurvivors(room, {.neighbor_count = 10, .density_radius_m = 0.2}, 48599);
  ExpectSurvivors(room, {.neighbor_count = 100, .density_radius_m = 0.2},
                  164574);
}

TEST(PublishedCounts, AShiftOfTheCloudKeepsThem) {
  // Draws are keyed by coordinate, so other points stay, as many.
  LatticeCloud room = ReadReference("room_370k.bin");
  for (LatticePoint& q : room.positions) {
    q = {q.x + 5'000'000'000, q.y - 5'000'000'000, q.z + 5'000'000'000};
  }
  ExpectSurvivors(room, {.density_radius_m = 0.2}, 104348);
}

}  // namespace
}  // namespace mapsieve::core

#endif  // MAPSIEVE_TEST_DATA
