#include "client/lab/room_survey.h"

#include <limits>

#include "absl/strings/str_cat.h"
#include "client/lab/place.h"
#include "client/lab/scene.h"
#include "client/lab/spinning_scanner.h"
#include "core/base/status.h"

namespace mapsieve::client {

WriteOptions RoomWriteOptions() {
  WriteOptions options;
  options.attributes = CampusScanner::AttributeSpecs();
  return options;
}

absl::Status SimulateRooms(const SimulateOptions& options, PointWriter& writer,
                           const ExecutionContext& context) {
  MAPSIEVE_RETURN_IF_ERROR(options.Validate());
  if (options.seed > uint64_t{std::numeric_limits<int>::max()}) {
    return absl::InvalidArgumentError(
        absl::StrCat("seed is ", options.seed, "; expected 0 to ",
                     std::numeric_limits<int>::max(), " for rooms"));
  }
  const Place place =
      MakePlace(Environment::kStructured, static_cast<int>(options.seed));
  Scene scene(place.scene);
  const SpinningScanner scanner({.seed = options.seed,
                                 .max_range_m = place.max_range_m,
                                 .range_noise_m = options.range_noise_m,
                                 .spurious_share = options.spurious_share});
  int64_t done = 0;
  for (int64_t index = 0; done < options.point_count; ++index) {
    MAPSIEVE_RETURN_IF_ERROR(context.CheckStop());
    const Station& station =
        place.stations[static_cast<size_t>(index) % place.stations.size()];
    const ScannerRotation rotation = {
        .index = index,
        .start = {station.x, station.y, place.scanner_height},
        .start_time_s =
            SpinningScanner::kRotationTime * static_cast<double>(index)};
    core::PointCloud batch = EmptySurvey();
    for (int pulse = 0;
         pulse < SpinningScanner::kPulseCount && done < options.point_count;
         ++pulse) {
      const auto echo = scanner.Fire(scene, rotation, pulse);
      if (!echo) continue;
      AppendReturn(*echo, echo->position, rotation, batch);
      ++done;
    }
    MAPSIEVE_RETURN_IF_ERROR(writer.Write(batch));
    context.ReportProgress(done, options.point_count);
  }
  return writer.Finish();
}

}  // namespace mapsieve::client
