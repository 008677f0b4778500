#include "tests/rpc/failing_calls.h"

namespace mapsieve::rpc {

using Code = absl::StatusCode;

const FailingCalls& AtRest() {
  static const auto& calls = *new FailingCalls{
      {"MapService.CreateMap", Code::kInvalidArgument, {"map_id: '..'"}},
      {"MapService.CreateMap", Code::kAlreadyExists, {"map_id: 'campus'"}},
      {"MapService.GetMap", Code::kInvalidArgument, {"name: 'campus'"}},
      {"MapService.GetMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"MapService.ListMaps", Code::kInvalidArgument, {"page_size: -1"}},
      {"MapService.DeleteMap", Code::kInvalidArgument, {""}},
      {"MapService.DeleteMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"MapService.DeleteMap",
       Code::kFailedPrecondition,
       {"name: 'maps/empty'"}},
      {"MapService.GetMapStats",
       Code::kInvalidArgument,
       {"name: 'maps/campus'"}},
      {"MapService.GetMapStats", Code::kNotFound, {"name: 'maps/none/stats'"}},
      {"MapService.ListRevisions",
       Code::kInvalidArgument,
       {"parent: 'maps/campus' page_token: 'x'"}},
      {"MapService.ListRevisions", Code::kNotFound, {"parent: 'maps/none'"}},
      {"MapService.CompareRevisions",
       Code::kInvalidArgument,
       {"name: 'maps/campus' base_revision: 1 target_revision: 2 "
        "page_token: 'x'"}},
      {"MapService.CompareRevisions",
       Code::kNotFound,
       {"name: 'maps/none' base_revision: 1 target_revision: 1"}},
      {"MapService.CompareRevisions",
       Code::kOutOfRange,
       {"name: 'maps/campus' base_revision: 1 target_revision: 9"}},
      {"MapService.DeleteRegion",
       Code::kInvalidArgument,
       {"name: 'maps/campus'"}},
      {"MapService.DeleteRegion",
       Code::kNotFound,
       {"name: 'maps/none' sphere { center {} radius: 1 }"}},
      {"MapService.RollBackMap", Code::kInvalidArgument, {"revision: 1"}},
      {"MapService.RollBackMap",
       Code::kNotFound,
       {"name: 'maps/none' revision: 1"}},
      {"MapService.RollBackMap",
       Code::kOutOfRange,
       {"name: 'maps/campus' revision: 9"}},
      {"MapService.VerifyMap",
       Code::kInvalidArgument,
       {"name: 'maps/campus' compared_tile_count: -1"}},
      {"MapService.VerifyMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"MapService.VerifyMap",
       Code::kFailedPrecondition,
       {"name: 'maps/empty' compared_tile_count: 1"}},
      {"MapService.RepairMap", Code::kInvalidArgument, {""}},
      {"MapService.RepairMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"MapService.WatchMap",
       Code::kInvalidArgument,
       {"name: 'maps/campus' from_revision: -1"}},
      {"MapService.WatchMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"MapService.WatchMap",
       Code::kOutOfRange,
       {"name: 'maps/campus' from_revision: 9"}},

      {"UploadService.CreateUpload",
       Code::kInvalidArgument,
       {"parent: 'maps/campus' upload_id: 'v' upload { content_hash: 'x' }"}},
      {"UploadService.CreateUpload",
       Code::kNotFound,
       {"parent: 'maps/none' upload_id: 'v' upload { "
        "content_hash: '00000000000000000000000000000000' }"}},
      {"UploadService.CreateUpload",
       Code::kAlreadyExists,
       {"parent: 'maps/campus' upload_id: 'u' upload { "
        "content_hash: '00000000000000000000000000000000' }"}},
      {"UploadService.GetUpload", Code::kInvalidArgument, {"name: 'u'"}},
      {"UploadService.GetUpload",
       Code::kNotFound,
       {"name: 'maps/campus/uploads/none'"}},
      {"UploadService.ListUploads",
       Code::kInvalidArgument,
       {"parent: 'maps/campus' page_size: -1"}},
      {"UploadService.ListUploads", Code::kNotFound, {"parent: 'maps/none'"}},
      {"UploadService.DeleteUpload", Code::kInvalidArgument, {""}},
      {"UploadService.DeleteUpload",
       Code::kNotFound,
       {"name: 'maps/campus/uploads/none'"}},
      {"UploadService.WriteUpload", Code::kInvalidArgument, {""}},
      {"UploadService.WriteUpload",
       Code::kNotFound,
       {"name: 'maps/campus/uploads/none' data { content: 'a' "
        "xxh3_64: $SUM }"}},
      {"UploadService.WriteUpload",
       Code::kFailedPrecondition,
       {"name: 'maps/campus/uploads/u' data { content: 'a' xxh3_64: $SUM }"}},
      {"UploadService.WriteUpload",
       Code::kOutOfRange,
       {"name: 'maps/empty/uploads/u' write_offset: 5 "
        "data { content: 'a' xxh3_64: $SUM }"}},
      {"UploadService.WriteUpload",
       Code::kDataLoss,
       {"name: 'maps/empty/uploads/u' data { content: 'a' xxh3_64: 1 }"}},
      {"UploadService.FinalizeUpload",
       Code::kInvalidArgument,
       {"name: 'maps/empty/uploads/u' sphere { radius: 1 }"}},
      {"UploadService.FinalizeUpload",
       Code::kNotFound,
       {"name: 'maps/empty/uploads/none'"}},
      {"UploadService.FinalizeUpload",
       Code::kFailedPrecondition,
       {"name: 'maps/empty/uploads/u'"}},

      {"ProcessingService.ProcessMap",
       Code::kInvalidArgument,
       {"name: 'maps/campus' options { density_radius_m: -1 }"}},
      {"ProcessingService.ProcessMap", Code::kNotFound, {"name: 'maps/none'"}},
      {"ProcessingService.ProcessMap",
       Code::kFailedPrecondition,
       {"name: 'maps/empty'"}},

      {"QueryService.QueryRegion",
       Code::kInvalidArgument,
       {"name: 'maps/campus' max_point_count: -1"}},
      {"QueryService.QueryRegion",
       Code::kNotFound,
       {"name: 'maps/campus' columns { attributes: 'none' }"}},
      {"QueryService.QueryRegion",
       Code::kFailedPrecondition,
       {"name: 'maps/empty'"}},
      {"QueryService.QueryRegion",
       Code::kOutOfRange,
       {"name: 'maps/campus' revision: 9"}},

      {"QueryService.SyncRegion",
       Code::kInvalidArgument,
       {"query { name: 'maps/campus' max_point_count: 9 }"}},
      {"QueryService.SyncRegion",
       Code::kNotFound,
       {"query { name: 'maps/campus' columns { attributes: 'none' } }"}},
      {"QueryService.SyncRegion",
       Code::kFailedPrecondition,
       {"query { name: 'maps/empty' }"}},
      {"QueryService.SyncRegion",
       Code::kOutOfRange,
       {"query { name: 'maps/campus' revision: 9 }"}},

      {"Operations.GetOperation", Code::kInvalidArgument, {"name: 'x'"}},
      {"Operations.GetOperation", Code::kNotFound, {"name: 'operations/x'"}},
      {"Operations.ListOperations", Code::kInvalidArgument, {"page_size: -1"}},
      {"Operations.CancelOperation", Code::kInvalidArgument, {"name: 'x'"}},
      {"Operations.CancelOperation", Code::kNotFound, {"name: 'operations/x'"}},
      {"Operations.WaitOperation",
       Code::kInvalidArgument,
       {"name: 'operations/x' timeout { seconds: -1 }"}},
      {"Operations.WaitOperation", Code::kNotFound, {"name: 'operations/x'"}},
  };
  return calls;
}

const FailingCalls& OnAFullDisk() {
  static const auto& calls = *new FailingCalls{
      {"MapService.CreateMap", Code::kResourceExhausted, {"map_id: 'next'"}},
      {"MapService.RollBackMap",
       Code::kResourceExhausted,
       {"name: 'maps/campus' revision: 1"}},
      {"UploadService.CreateUpload",
       Code::kResourceExhausted,
       {"parent: 'maps/campus' upload_id: 'v' upload { "
        "content_hash: '00000000000000000000000000000000' }"}},
      {"UploadService.WriteUpload",
       Code::kResourceExhausted,
       {"name: 'maps/empty/uploads/u' data { content: 'a' xxh3_64: $SUM }"}},
  };
  return calls;
}

const FailingCalls& WhileOperationsGoOn() {
  static const auto& calls = *new FailingCalls{
      {"MapService.RollBackMap",
       Code::kAborted,
       {"name: 'maps/campus' revision: 1"}},
      {"MapService.RepairMap", Code::kAborted, {"name: 'maps/campus'"}},
      {"UploadService.DeleteUpload",
       Code::kFailedPrecondition,
       {"name: 'maps/campus/uploads/whole'"}},
      {"ProcessingService.ProcessMap", Code::kAborted, {"name: 'maps/campus'"}},
  };
  return calls;
}

void PrintTo(const Place& place, std::ostream* out) {
  *out << place.method << (place.of_operation ? " (operation): " : ": ")
       << place.code;
}

const std::vector<ElsewherePlace>& Elsewhere() {
  static const auto& places = *new std::vector<ElsewherePlace>{
      {{"QueryService.QueryRegion", false, "DATA_LOSS"},
       "DocumentedErrorsTest.DamagedChunksAreDataLoss"},
      {{"ProcessingService.ProcessMap", true, "DATA_LOSS"},
       "DocumentedErrorsTest.DamagedChunksAreDataLoss"},
      {{"MapService.DeleteRegion", true, "DATA_LOSS"},
       "DocumentedErrorsTest.DamagedChunksAreDataLoss"},
      {{"UploadService.FinalizeUpload", true, "DATA_LOSS"},
       "UploadTest.DamagedUploadLeavesTheMapAsItWas"},
      {{"UploadService.FinalizeUpload", true, "INVALID_ARGUMENT"},
       "DocumentedErrorsTest.ABlockOnAnotherLatticeIsInvalid"},
      {{"UploadService.FinalizeUpload", true, "RESOURCE_EXHAUSTED"},
       "DocumentedErrorsTest.OperationsFailOnAFullDisk"},
      {{"ProcessingService.ProcessMap", true, "RESOURCE_EXHAUSTED"},
       "DocumentedErrorsTest.OperationsFailOnAFullDisk"},
      {{"MapService.DeleteRegion", true, "RESOURCE_EXHAUSTED"},
       "DocumentedErrorsTest.OperationsFailOnAFullDisk"},
      {{"UploadService.FinalizeUpload", true, "CANCELLED"},
       "DocumentedErrorsTest.OperationsAreCancelled"},
      {{"ProcessingService.ProcessMap", true, "CANCELLED"},
       "DocumentedErrorsTest.OperationsAreCancelled"},
      {{"MapService.DeleteRegion", true, "CANCELLED"},
       "DocumentedErrorsTest.OperationsAreCancelled"},
      {{"MapService.RepairMap", true, "CANCELLED"},
       "DocumentedErrorsTest.OperationsAreCancelled"},
      {{"UploadService.WriteUpload", false, "ABORTED"},
       "UploadTest.AcknowledgesAFlushAndHasOneWriter"},
      {{"QueryService.QueryRegion", false, "CANCELLED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"QueryService.QueryRegion", false, "DEADLINE_EXCEEDED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"QueryService.SyncRegion", false, "DATA_LOSS"},
       "DocumentedErrorsTest.DamagedChunksAreDataLoss"},
      {{"QueryService.SyncRegion", false, "CANCELLED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"QueryService.SyncRegion", false, "DEADLINE_EXCEEDED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"MapService.VerifyMap", false, "CANCELLED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"MapService.VerifyMap", false, "DEADLINE_EXCEEDED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"MapService.WatchMap", false, "CANCELLED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      {{"MapService.WatchMap", false, "DEADLINE_EXCEEDED"},
       "DocumentedErrorsTest.CallersEndStreams"},
      // Below the network.
      {{"MapService.DeleteRegion", false, "RESOURCE_EXHAUSTED"},
       "JobManagerTest.QueueAndMemoryOfOperationsAreBounded"},
      {{"MapService.RepairMap", false, "RESOURCE_EXHAUSTED"},
       "JobManagerTest.QueueAndMemoryOfOperationsAreBounded"},
      {{"UploadService.FinalizeUpload", false, "RESOURCE_EXHAUSTED"},
       "JobManagerTest.QueueAndMemoryOfOperationsAreBounded"},
      {{"ProcessingService.ProcessMap", false, "RESOURCE_EXHAUSTED"},
       "JobManagerTest.QueueAndMemoryOfOperationsAreBounded"},
      {{"QueryService.QueryRegion", false, "RESOURCE_EXHAUSTED"},
       "RegionQueryTest.KeepsToTheMemoryOfQueries"},
  };
  return places;
}

const std::vector<Place>& NotProvoked() {
  static const auto& places = *new std::vector<Place>{
      {"QueryService.QueryRegion", false, "ABORTED"},
      {"QueryService.SyncRegion", false, "RESOURCE_EXHAUSTED"},
      {"MapService.VerifyMap", false, "DATA_LOSS"},
      {"MapService.RepairMap", true, "DATA_LOSS"},
      {"MapService.RepairMap", true, "UNAVAILABLE"},
  };
  return places;
}

}  // namespace mapsieve::rpc
