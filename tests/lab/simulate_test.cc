#include "client/lab/simulate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <numbers>
#include <stop_token>
#include <string_view>
#include <utility>
#include <vector>

#include "client/lab/room_survey.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"

namespace mapsieve::client {
namespace {

using core::Point3;
using core::PointCloud;
using ::testing::HasSubstr;

constexpr size_t kBatch = 10'000;

PointCloud Collect(const SimulateOptions& options, size_t batch_size = kBatch) {
  PointCloud all;
  auto scanner = CampusScanner::Create(options);
  if (!scanner.ok()) {
    ADD_FAILURE() << scanner.status();
    return all;
  }
  while (true) {
    const auto batch = scanner->NextBatch(batch_size);
    if (!batch.ok()) {
      ADD_FAILURE() << batch.status();
      return all;
    }
    EXPECT_LE(batch->size(), batch_size);
    for (const core::Column& column : batch->attributes.columns()) {
      EXPECT_EQ(column.size(), batch->size());
    }
    if (batch->size() == 0) return all;
    MAPSIEVE_EXPECT_OK(
        all.attributes.AppendAll(all.size(), batch->attributes, batch->size()));
    all.positions.insert(all.positions.end(), batch->positions.begin(),
                         batch->positions.end());
  }
}

template <typename T>
T Value(const PointCloud& cloud, std::string_view name, size_t i) {
  return cloud.attributes.Find(name)->Get<T>(i);
}

/// Shares of the values of a uint8 attribute.
std::map<int, double> Shares(const PointCloud& cloud, std::string_view name) {
  std::map<int, double> shares;
  for (size_t i = 0; i < cloud.size(); ++i) {
    shares[Value<uint8_t>(cloud, name, i)] +=
        1 / static_cast<double>(cloud.size());
  }
  return shares;
}

/// Vector from the scanner at the time of point `i` to the point.
std::array<double, 3> FromScanner(const CampusScanner& scanner,
                                  const PointCloud& cloud, size_t i) {
  const ScannerRotation rotation =
      scanner.Rotation(Value<uint16_t>(cloud, "point_source_id", i));
  const Point3 eye = rotation.PositionAt(Value<double>(cloud, "gps_time", i));
  const Point3& p = cloud.positions[i];
  return {p.x - eye.x, p.y - eye.y, p.z - eye.z};
}

TEST(CampusScannerTest, PointsDoNotDependOnBatchSize) {
  const SimulateOptions options = {.point_count = 50'000, .seed = 7};
  const PointCloud whole = Collect(options, 1'000'000);
  ASSERT_EQ(whole.size(), 50'000);
  for (const size_t batch_size : {1, 17, 4096, 49'999, 50'000}) {
    const PointCloud parts = Collect(options, batch_size);
    EXPECT_EQ(parts.positions, whole.positions) << batch_size;
    EXPECT_EQ(parts.attributes, whole.attributes) << batch_size;
  }
}

TEST(CampusScannerTest, GivesExactlyTheCountAskedFor) {
  for (const int64_t count : {0, 1, 2, 63, 21'000, 100'003}) {
    EXPECT_EQ(Collect({.point_count = count}).size(), count);
  }
}

TEST(CampusScannerTest, ShorterSurveyIsThePrefixOfALongerOne) {
  const PointCloud all = Collect({.point_count = 60'000});
  PointCloud prefix = Collect({.point_count = 30'000});
  ASSERT_EQ(prefix.size(), 30'000);
  EXPECT_TRUE(std::equal(prefix.positions.begin(), prefix.positions.end(),
                         all.positions.begin()));
}

TEST(CampusScannerTest, OtherSeedGivesAnotherSurvey) {
  EXPECT_NE(Collect({.point_count = 1000, .seed = 1}).positions,
            Collect({.point_count = 1000, .seed = 2}).positions);
}

TEST(CampusScannerTest, AttributesAreThoseDeclared) {
  const PointCloud cloud = Collect({.point_count = 1000});
  EXPECT_EQ(cloud.attributes.specs(), CampusScanner::AttributeSpecs());
  EXPECT_EQ(SimulatedWriteOptions().attributes, cloud.attributes.specs());
}

TEST(CampusScannerTest, RefusesBatchesOfNoPoints) {
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(CampusScanner scanner,
                                CampusScanner::Create({}));
  EXPECT_THAT(scanner.NextBatch(0),
              testing::StatusIs(absl::StatusCode::kInvalidArgument,
                                HasSubstr("max_points")));
}

TEST(CampusScannerTest, ElevationsAreThoseOfTheBeamTable) {
  const SimulateOptions options = {
      .point_count = 100'000, .range_noise_m = 0, .spurious_share = 0};
  const PointCloud cloud = Collect(options);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CampusScanner scanner,
                                CampusScanner::Create(options));
  std::array<int, SpinningScanner::kBeamCount> seen = {};
  for (size_t i = 0; i < cloud.size(); ++i) {
    const auto d = FromScanner(scanner, cloud, i);
    const double elevation =
        std::atan2(d[2], std::hypot(d[0], d[1])) * 180 / std::numbers::pi;
    const auto beam = static_cast<int>(
        std::lround(elevation - SpinningScanner::BeamElevationDeg(0)));
    ASSERT_GE(beam, 0);
    ASSERT_LT(beam, SpinningScanner::kBeamCount);
    ASSERT_NEAR(elevation, SpinningScanner::BeamElevationDeg(beam), 1e-5) << i;
    ++seen[static_cast<size_t>(beam)];
  }
  EXPECT_THAT(seen, ::testing::Each(::testing::Gt(0)));
}

TEST(CampusScannerTest, ColumnsAreEvenInBearingAndTime) {
  const SimulateOptions options = {
      .point_count = 40'000, .range_noise_m = 0, .spurious_share = 0};
  const PointCloud cloud = Collect(options);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CampusScanner scanner,
                                CampusScanner::Create(options));
  std::map<int, double> bearing_of_column_0;
  for (size_t i = 0; i < cloud.size(); ++i) {
    const auto d = FromScanner(scanner, cloud, i);
    const int number = Value<uint16_t>(cloud, "point_source_id", i);
    const double columns = (Value<double>(cloud, "gps_time", i) -
                            scanner.Rotation(number).start_time_s) /
                           SpinningScanner::kRotationTime *
                           SpinningScanner::kColumnCount;
    ASSERT_NEAR(columns, std::round(columns), 1e-6);
    constexpr double kStep =
        2 * std::numbers::pi / SpinningScanner::kColumnCount;
    const double bearing = std::atan2(d[1], d[0]) - std::round(columns) * kStep;
    const auto first = bearing_of_column_0.emplace(number, bearing).first;
    ASSERT_NEAR(std::remainder(bearing - first->second, 2 * std::numbers::pi),
                0, 1e-6)
        << i;
  }
  EXPECT_GE(bearing_of_column_0.size(), 2);
}

TEST(CampusScannerTest, TimeNeverRunsBackwards) {
  const PointCloud cloud = Collect({.point_count = 60'000});
  double last = 0;
  for (size_t i = 0; i < cloud.size(); ++i) {
    const auto time = Value<double>(cloud, "gps_time", i);
    ASSERT_GE(time, last);
    last = time;
  }
  // Three rotations at least, 3.5 m apart at 5 m/s.
  EXPECT_GT(last, 1.4);
}

TEST(CampusScannerTest, RangesCarryTheStatedGaussianNoise) {
  constexpr double kSigma = 0.03;
  SimulateOptions options = {.point_count = 100'000, .spurious_share = 0};
  options.range_noise_m = kSigma;
  const PointCloud noisy = Collect(options);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CampusScanner scanner,
                                CampusScanner::Create(options));
  options.range_noise_m = 0;
  const PointCloud exact = Collect(options);
  double sum = 0;
  double sum_squares = 0;
  double beyond_two_sigma = 0;
  for (size_t i = 0; i < exact.size(); ++i) {
    const auto a = FromScanner(scanner, exact, i);
    const auto b = FromScanner(scanner, noisy, i);
    const double range = std::hypot(a[0], a[1], a[2]);
    const double residual = std::hypot(b[0], b[1], b[2]) - range;
    // Along the beam, and nowhere else.
    for (size_t axis = 0; axis < 3; ++axis) {
      ASSERT_NEAR(b[axis], a[axis] * (1 + residual / range), 1e-6);
    }
    sum += residual;
    sum_squares += residual * residual;
    beyond_two_sigma += std::abs(residual) > 2 * kSigma ? 1 : 0;
  }
  const auto n = static_cast<double>(exact.size());
  EXPECT_NEAR(sum / n, 0, 4 * kSigma / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(sum_squares / n), kSigma, 0.01 * kSigma);
  EXPECT_NEAR(beyond_two_sigma / n, 0.0455, 0.003);
}

TEST(CampusScannerTest, SpuriousReturnsAreTheStatedShareAndInTheAir) {
  SimulateOptions options = {.point_count = 100'000, .range_noise_m = 0};
  options.spurious_share = 0.05;
  const PointCloud cloud = Collect(options);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CampusScanner scanner,
                                CampusScanner::Create(options));
  options.spurious_share = 0;
  const PointCloud clean = Collect(options);
  EXPECT_EQ(Shares(clean, "classification").count(7), 0);
  double spurious = 0;
  for (size_t i = 0; i < cloud.size(); ++i) {
    if (Value<uint8_t>(cloud, "classification", i) != 7) {
      ASSERT_EQ(cloud.positions[i], clean.positions[i]);
      continue;
    }
    ++spurious;
    EXPECT_EQ(Value<uint8_t>(cloud, "truth", i), 0);
    const auto d = FromScanner(scanner, cloud, i);
    const auto blocked = FromScanner(scanner, clean, i);
    ASSERT_LE(std::hypot(d[0], d[1], d[2]),
              std::hypot(blocked[0], blocked[1], blocked[2]) + 1e-9);
  }
  EXPECT_NEAR(spurious / 100'000, 0.05, 0.003);
}

/// A survey of the whole campus at an eighth of its density.
SimulateOptions ThinCampus(uint64_t seed) {
  return {.point_count = 4'650'000 / 8,
          .seed = seed,
          .rotation_spacing_m = 8 * 3.5};
}

TEST(CampusScannerTest, ClassesHaveTheSharesOfACampus) {
  for (const uint64_t seed : {1, 2, 3}) {
    const PointCloud cloud = Collect(ThinCampus(seed));
    const auto classes = Shares(cloud, "classification");
    ASSERT_EQ(classes.size(), 6) << "other classes than documented";
    const auto expect = [&](int code, double low, double high) {
      EXPECT_GT(classes.at(code), low) << "seed " << seed << " class " << code;
      EXPECT_LT(classes.at(code), high) << "seed " << seed << " class " << code;
    };
    expect(2, 0.38, 0.58);
    expect(5, 0.08, 0.28);
    expect(6, 0.18, 0.40);
    expect(7, 0.0015, 0.0025);
    expect(64, 0.004, 0.02);
    expect(65, 0.03, 0.10);
    const auto truth = Shares(cloud, "truth");
    EXPECT_GT(truth.at(1), 0.0005);
    EXPECT_GT(truth.at(2), 0.04);
    EXPECT_LT(truth.at(2), 0.15);
    EXPECT_GT(truth.at(3), 0.6);
    EXPECT_NEAR(truth.at(0), classes.at(5) + classes.at(7), 0.03);
  }
}

TEST(CampusScannerTest, SurveyOfThePaperCoversACampus) {
  PointCloud cloud = Collect(ThinCampus(1));
  std::array<std::vector<double>, 3> places;
  for (const Point3& p : cloud.positions) {
    places[0].push_back(p.x);
    places[1].push_back(p.y);
    places[2].push_back(p.z);
  }
  const auto extent = [](std::vector<double>& values) {
    std::ranges::sort(values);
    const size_t cut = values.size() / 100;
    return std::pair(values[cut], values[values.size() - 1 - cut]);
  };
  const auto [west, east] = extent(places[0]);
  const auto [south, north] = extent(places[1]);
  const auto [low, high] = extent(places[2]);
  EXPECT_NEAR(east - west, 260, 50);
  EXPECT_NEAR(north - south, 200, 50);
  EXPECT_LT(high - low, 30);
  EXPECT_NEAR(west, 331000, 300);
  EXPECT_NEAR(south, 5183000, 300);
  EXPECT_NEAR(low, 90, 5);
}

TEST(CampusScannerTest, RangeAndSpacingAreObeyed) {
  SimulateOptions options = {.point_count = 60'000, .range_noise_m = 0};
  options.max_range_m = 20;
  options.rotation_spacing_m = 11;
  const PointCloud cloud = Collect(options);
  MAPSIEVE_ASSERT_OK_AND_ASSIGN(const CampusScanner scanner,
                                CampusScanner::Create(options));
  double farthest = 0;
  for (size_t i = 0; i < cloud.size(); ++i) {
    const auto d = FromScanner(scanner, cloud, i);
    farthest = std::max(farthest, std::hypot(d[0], d[1], d[2]));
  }
  EXPECT_LE(farthest, 20 + 1e-6);
  EXPECT_GT(farthest, 19);
  const Point3 a = scanner.Rotation(0).start;
  const Point3 b = scanner.Rotation(1).start;
  EXPECT_NEAR(std::hypot(a.x - b.x, a.y - b.y), 11, 1);
}

TEST(CampusScannerTest, TheWorldGoesWithTheScanner) {
  const PointCloud cloud =
      Collect({.point_count = 100'000, .rotation_spacing_m = 1000});
  std::map<int, int> returns;
  for (size_t i = 0; i < cloud.size(); ++i) {
    ++returns[Value<uint16_t>(cloud, "point_source_id", i)];
  }
  // The last rotation is cut off.
  returns.erase(std::prev(returns.end()));
  ASSERT_GE(returns.size(), 3);
  for (const auto& [rotation, count] : returns) {
    EXPECT_GT(count, SpinningScanner::kPulseCount / 2) << rotation;
  }
}

TEST(SimulateOptionsTest, RefusesWhatItNames) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto expect_refused = [](const SimulateOptions& options,
                                 const char* field) {
    EXPECT_THAT(CampusScanner::Create(options).status(),
                testing::StatusIs(absl::StatusCode::kInvalidArgument,
                                  HasSubstr(field)));
  };
  expect_refused({.point_count = -1}, "point_count");
  expect_refused({.point_count = SimulateOptions::kMaxPointCount + 1},
                 "point_count");
  for (const double bad : {-0.001, 1.001, nan}) {
    expect_refused({.range_noise_m = bad}, "range_noise_m");
    expect_refused({.spurious_share = bad}, "spurious_share");
  }
  for (const double bad : {4.9, 301.0, nan}) {
    expect_refused({.max_range_m = bad}, "max_range_m");
  }
  for (const double bad : {0.49, 1001.0, nan}) {
    expect_refused({.rotation_spacing_m = bad}, "rotation_spacing_m");
  }
  MAPSIEVE_EXPECT_OK((SimulateOptions{.max_range_m = 5}.Validate()));
  MAPSIEVE_EXPECT_OK((SimulateOptions{.spurious_share = 1}.Validate()));
}

class MemoryWriter : public PointWriter {
 public:
  absl::Status Write(const PointCloud& batch) override {
    if (!refusal.ok()) return refusal;
    positions.insert(positions.end(), batch.positions.begin(),
                     batch.positions.end());
    return absl::OkStatus();
  }
  absl::Status Finish() override {
    finished = true;
    return absl::OkStatus();
  }

  std::vector<Point3> positions;
  absl::Status refusal;
  bool finished = false;
};

class Progress : public ProgressSink {
 public:
  void Report(int64_t done, int64_t total) override {
    EXPECT_GT(done, last);
    EXPECT_EQ(total, 150'000);
    last = done;
  }
  int64_t last = 0;
};

TEST(SimulateTest, WritesTheSurveyAndReportsProgress) {
  const SimulateOptions options = {.point_count = 150'000};
  MemoryWriter writer;
  Progress progress;
  ExecutionContext context;
  context.progress = &progress;
  MAPSIEVE_ASSERT_OK(Simulate(options, writer, context));
  EXPECT_TRUE(writer.finished);
  EXPECT_EQ(progress.last, 150'000);
  EXPECT_EQ(writer.positions, Collect(options).positions);
}

TEST(SimulateTest, StopsOnRequestWithoutFinishingTheFile) {
  MemoryWriter writer;
  std::stop_source stop;
  stop.request_stop();
  ExecutionContext context;
  context.stop = stop.get_token();
  EXPECT_EQ(Simulate({}, writer, context).code(), absl::StatusCode::kCancelled);
  EXPECT_FALSE(writer.finished);
}

TEST(SimulateTest, PassesTheWritersErrorOn) {
  MemoryWriter writer;
  writer.refusal = absl::ResourceExhaustedError("disk full");
  EXPECT_EQ(Simulate({}, writer), writer.refusal);
  EXPECT_FALSE(writer.finished);
}

std::vector<Point3> Rooms(const SimulateOptions& options) {
  MemoryWriter writer;
  MAPSIEVE_EXPECT_OK(SimulateRooms(options, writer));
  EXPECT_TRUE(writer.finished);
  return writer.positions;
}

TEST(SimulateRoomsTest, SeesRoomsFromInsideWithoutNoise) {
  SimulateOptions options = {
      .point_count = 100'000, .range_noise_m = 0, .spurious_share = 0};
  const std::vector<Point3> points = Rooms(options);
  ASSERT_EQ(points.size(), 100'000u);
  int on_floor = 0;
  int on_ceiling = 0;
  for (const Point3& p : points) {
    EXPECT_GT(p.z, -1e-6);
    EXPECT_LT(p.z, 2.7 + 1e-6);
    // Walls stand on the lines of the rooms, 20 cm to either side.
    EXPECT_GT(std::min(p.x, p.y), -0.2);
    EXPECT_LT(p.x, 16.2);
    EXPECT_LT(p.y, 8.2);
    on_floor += p.z < 1e-6 ? 1 : 0;
    on_ceiling += p.z > 2.7 - 1e-6 ? 1 : 0;
  }
  EXPECT_GT(on_floor, 5000);
  EXPECT_GT(on_ceiling, 5000);
  // A longer survey begins as a shorter one; another seed is other rooms.
  options.point_count = 40'000;
  EXPECT_EQ(Rooms(options),
            std::vector<Point3>(points.begin(), points.begin() + 40'000));
  options.seed = 2;
  EXPECT_NE(Rooms(options).front(), points.front());
}

TEST(SimulateRoomsTest, RefusesWhatNamesNoRooms) {
  MemoryWriter writer;
  EXPECT_EQ(SimulateRooms({.seed = uint64_t{1} << 31}, writer).code(),
            absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(SimulateRooms({.point_count = -1}, writer).code(),
            absl::StatusCode::kInvalidArgument);
  writer.refusal = absl::ResourceExhaustedError("disk full");
  EXPECT_EQ(SimulateRooms({}, writer), writer.refusal);
  EXPECT_FALSE(writer.finished);
}

}  // namespace
}  // namespace mapsieve::client
