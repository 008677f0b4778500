#ifndef MAPSIEVE_SERVER_ENGINE_OPAQUE_RECORDS_H_
#define MAPSIEVE_SERVER_ENGINE_OPAQUE_RECORDS_H_

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "core/spdf/spdf_options.h"
#include "server/engine/types.h"

/// The engine's own records in the catalogue, which stores them without
/// looking inside: little-endian fields behind a byte that says the version.
/// The parsers give kDataLoss, naming the record and the field, for bytes that
/// are none. opaque_records.cc is the byte table.
namespace mapsieve::engine {

std::string FormatSpdfOptions(const core::SpdfOptions& options);
absl::StatusOr<core::SpdfOptions> ParseSpdfOptions(std::string_view bytes);

/// What the catalogue keeps of an upload besides the fields of its own.
struct UploadNotes {
  UploadSource source;
  /// Before the upload is finalized, `refused` alone.
  UploadReport report;

  friend bool operator==(const UploadNotes&, const UploadNotes&) = default;
};
std::string FormatUploadNotes(const UploadNotes& notes);
absl::StatusOr<UploadNotes> ParseUploadNotes(std::string_view bytes);

std::string FormatProcessReport(const ProcessReport& report);
absl::StatusOr<ProcessReport> ParseProcessReport(std::string_view bytes);

/// What made a revision of kind kUpload, kDeleteRegion or kReplaceRegion.
struct EditRecord {
  /// JobSpec::edit_uid of a deletion; else empty.
  std::string edit_uid;
  /// Of the upload whose points it added; else empty.
  std::string upload_id;
  /// That lost its points.
  std::optional<RegionShape> region;
  int64_t added_point_count = 0;
  int64_t removed_point_count = 0;
  /// Tiles that lost points.
  int64_t tile_count = 0;

  friend bool operator==(const EditRecord&, const EditRecord&) = default;
};
std::string FormatEditRecord(const EditRecord& edit);
absl::StatusOr<EditRecord> ParseEditRecord(std::string_view bytes);

/// What an operation is to do.
struct JobSpec {
  OperationVerb verb = OperationVerb::kProcessMap;
  std::string map_uid;
  /// Of kFinalizeUpload.
  std::string upload_id;
  std::string upload_uid;
  /// Of kDeleteRegion, and of kFinalizeUpload that replaces a region.
  std::optional<RegionShape> region;
  /// Of kDeleteRegion: never used again, and the newest revision at the
  /// request. The revision made is among those after it and bears the uid.
  std::string edit_uid;
  int64_t base_revision = 0;
  /// Of kProcessMap.
  core::SpdfOptions options;

  friend bool operator==(const JobSpec&, const JobSpec&) = default;
};
std::string FormatJobSpec(const JobSpec& spec);
absl::StatusOr<JobSpec> ParseJobSpec(std::string_view bytes);

/// What an operation answers besides its state; nothing before it succeeded.
using JobResult = std::variant<std::monostate, UploadReport, ProcessReport,
                               DeleteReport, RepairReport>;
struct JobOutcome {
  absl::Time start_time;
  JobResult result;
};
std::string FormatJobOutcome(const JobOutcome& outcome);
absl::StatusOr<JobOutcome> ParseJobOutcome(std::string_view bytes);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_OPAQUE_RECORDS_H_
