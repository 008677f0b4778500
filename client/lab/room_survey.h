#ifndef MAPSIEVE_CLIENT_LAB_ROOM_SURVEY_H_
#define MAPSIEVE_CLIENT_LAB_ROOM_SURVEY_H_

#include "absl/status/status.h"
#include "client/formats/point_file.h"
#include "client/lab/simulate.h"
#include "core/base/executor.h"

namespace mapsieve::client {

/// What a writer of SimulateRooms is to be created with: the attributes of a
/// CampusScanner.
WriteOptions RoomWriteOptions();

/// Writes a survey of the furnished rooms that `options.seed` names (MakePlace,
/// structured) to `writer`, created with RoomWriteOptions, and finishes it: a
/// SpinningScanner turns at both stations by turns until there are
/// options.point_count points, in metres, with a corner of the rooms at the
/// origin. Its range and its drive are not those of the options. The points of
/// given options are always the same. Reports progress in points.
/// kInvalidArgument as in SimulateOptions::Validate, or a seed that is no int;
/// kCancelled; the writer's errors.
absl::Status SimulateRooms(const SimulateOptions& options, PointWriter& writer,
                           const ExecutionContext& context = {});

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_ROOM_SURVEY_H_
