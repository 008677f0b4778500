#include "client/lab/surveyed_pair.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "client/lab/simulate.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

constexpr int64_t kSurveyPoints = 3'000'000;
constexpr double kRadius = 80;
/// The rotations that are scans are odd, those of the map even.
constexpr int64_t kFirstScan = 5;
constexpr int64_t kScanSpacing = 12;

absl::StatusOr<ScanPair> MakePair(int number) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      CampusScanner scanner,
      CampusScanner::Create({.point_count = kSurveyPoints}));
  const int64_t scan = kFirstScan + kScanSpacing * number;
  const core::Point3 place = scanner.Rotation(scan).start;
  core::PointCloud map;
  core::PointCloud seen;
  while (true) {
    constexpr size_t kBatch = 65536;
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud batch,
                              scanner.NextBatch(kBatch));
    if (batch.positions.empty()) break;
    const core::Column& rotations = *batch.attributes.Find("point_source_id");
    for (size_t i = 0; i < batch.positions.size(); ++i) {
      const core::Point3& p = batch.positions[i];
      const core::Point3 q = {p.x - place.x, p.y - place.y, p.z - place.z};
      if (q.x * q.x + q.y * q.y > kRadius * kRadius) continue;
      const auto rotation = rotations.Get<uint16_t>(i);
      if (rotation % 2 == 0) map.positions.push_back(q);
      if (rotation == scan) seen.positions.push_back(q);
    }
  }
  core::RefusedCounts refused;
  return ScanPair{
      .reference = core::Quantize(std::move(map), core::Lattice(), refused),
      .reading = core::Quantize(std::move(seen), core::Lattice(), refused)};
}

}  // namespace

std::vector<PairSource> SurveyedPairs(int count) {
  std::vector<PairSource> sources;
  for (int i = 0; i < count; ++i) {
    sources.push_back({absl::StrCat("survey-", i), Environment::kSemiStructured,
                       [i] { return MakePair(i); }});
  }
  return sources;
}

}  // namespace mapsieve::client
