#include "server/engine/opaque_records.h"

#include <cstdint>
#include <type_traits>
#include <utility>

#include "core/base/bytes.h"
#include "core/base/status.h"

namespace mapsieve::engine {
namespace {

/// Options of version 1 belong to products whose directions have 16 bits a
/// side: they never equal present ones, so that such a product is made anew and
/// not brought up to date. Those of version 2 lack label_neighbor_count, and
/// are still written where it is 0, so that they equal those of older products.
/// Of records of operations, 2 has what concerns repairs, and requests of
/// version 3 have label_neighbor_count. Notes of version 2 and outcomes of
/// version 3 have all of an upload's report, and the notes its source. All
/// others are 1.
constexpr uint8_t kVersion = 1;
constexpr uint8_t kDefaultLabelsVersion = 2;
constexpr uint8_t kOptionsVersion = 3;
constexpr uint8_t kNotesVersion = 2;
constexpr uint8_t kSpecVersion = 3;
constexpr uint8_t kOutcomeVersion = 3;

// Each record has one function Visit, which names its fields in their order:
// the writer and the reader below walk through the same list.

class Writer {
 public:
  explicit Writer(uint8_t version) : version_(version) { writer_.Put(version); }

  uint8_t version() const { return version_; }

  template <Scalar T>
  void Field(const char* /*name*/, const T& value) {
    writer_.Put(value);
  }
  void Field(const char* /*name*/, const std::string& value) {
    writer_.PutShortText(value);
  }
  void LongText(const char* /*name*/, const std::string& value) {
    writer_.Put(static_cast<uint32_t>(value.size()));
    writer_.PutBytes(TextBytes(value));
  }
  /// How many elements `list` has, which follow.
  template <typename T>
  void Size(const char* /*name*/, const std::vector<T>& list) {
    writer_.Put(static_cast<uint16_t>(list.size()));
  }
  /// Whether the optional fields that follow are there.
  bool Presence(const char* /*name*/, bool present) {
    writer_.Put(static_cast<uint8_t>(present));
    return present;
  }
  std::string Text() && {
    const std::vector<std::byte>& bytes = writer_.bytes();
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }

 private:
  const uint8_t version_;
  ByteWriter writer_;
};

/// Remembers the first error and leaves fields alone after it.
class Reader {
 public:
  Reader(std::string_view bytes, uint8_t newest_version)
      : reader_(TextBytes(bytes)) {
    Field("version", version_);
    if (status_.ok() && (version_ < 1 || version_ > newest_version)) {
      status_ = absl::DataLossError(absl::StrCat(
          "version ", version_, ", expected at most ", newest_version));
    }
  }

  uint8_t version() const { return version_; }

  template <Scalar T>
  void Field(const char* name, T& value) {
    Store(reader_.Take<T>(name), value);
  }
  void Field(const char* name, std::string& value) {
    Store(reader_.TakeShortText(name), value);
  }
  void LongText(const char* name, std::string& value) {
    uint32_t size = 0;
    Field(name, size);
    if (!status_.ok()) return;
    const auto bytes = reader_.TakeBytes(size, name);
    if (!bytes.ok()) {
      status_ = bytes.status();
      return;
    }
    value.assign(reinterpret_cast<const char*>(bytes->data()), bytes->size());
  }
  template <typename T>
  void Size(const char* name, std::vector<T>& list) {
    uint16_t size = 0;
    Field(name, size);
    list.resize(size);
  }
  bool Presence(const char* name, bool /*present*/) {
    uint8_t present = 0;
    Field(name, present);
    return present != 0;
  }
  absl::Status Finish(std::string_view record) {
    if (status_.ok() && reader_.remaining() != 0) {
      status_ = absl::DataLossError(
          absl::StrCat(reader_.remaining(), " bytes too many"));
    }
    return Annotate(status_, record);
  }

 private:
  template <typename T>
  void Store(absl::StatusOr<T> taken, T& value) {
    if (!status_.ok()) return;
    if (taken.ok()) {
      value = *std::move(taken);
    } else {
      status_ = taken.status();
    }
  }

  ByteReader reader_;
  uint8_t version_ = 0;
  absl::Status status_;
};

template <typename V, typename T>
void VisitPoint(V& v, const char* name, T& point) {
  v.Field(name, point.x);
  v.Field(name, point.y);
  v.Field(name, point.z);
}

template <typename V, typename T>
void VisitCounts(V& v, const char* name, T& counts) {
  for (auto& count : counts) v.Field(name, count);
}

// `T` is the record, const for a writer.

template <typename V, typename T>
void VisitOptions(V& v, T& options) {
  v.Field("neighbor_count", options.neighbor_count);
  v.Field("vote_scale_m2", options.vote_scale_m2);
  v.Field("density_radius_m", options.density_radius_m);
  v.Field("reach_m", options.reach_m);
  v.Field("max_round_count", options.max_round_count);
  v.Field("rule", options.rule);
  v.Field("seed", options.seed);
  v.Field("outlier_share", options.outlier_share);
  if (v.version() >= 3) {
    v.Field("label_neighbor_count", options.label_neighbor_count);
  }
}

template <typename V, typename T>
void VisitRegion(V& v, T& region) {
  if (!v.Presence("has_region", region.has_value())) return;
  constexpr bool kIsReader = !std::is_const_v<T>;
  const bool is_sphere =
      region.has_value() && std::holds_alternative<Sphere>(*region);
  if (v.Presence("is_sphere", is_sphere)) {
    if constexpr (kIsReader) region = Sphere();
    VisitPoint(v, "center", std::get<Sphere>(*region).center);
    v.Field("radius", std::get<Sphere>(*region).radius);
  } else {
    if constexpr (kIsReader) region = Box();
    VisitPoint(v, "min", std::get<Box>(*region).min);
    VisitPoint(v, "max", std::get<Box>(*region).max);
  }
}

template <typename V, typename T>
void VisitEditRecord(V& v, T& edit) {
  v.Field("edit_uid", edit.edit_uid);
  v.Field("upload_id", edit.upload_id);
  VisitRegion(v, edit.region);
  v.Field("added_point_count", edit.added_point_count);
  v.Field("removed_point_count", edit.removed_point_count);
  v.Field("tile_count", edit.tile_count);
}

template <typename V, typename T>
void VisitDeleteReport(V& v, T& report) {
  v.Field("revision", report.revision);
  v.Field("removed_point_count", report.removed_point_count);
  v.Field("tile_count", report.tile_count);
}

template <typename V, typename T>
void VisitRepairReport(V& v, T& report) {
  v.Field("damaged_chunk_count", report.damaged_chunk_count);
  v.Field("repaired_chunk_count", report.repaired_chunk_count);
  v.Field("raw_chunk_count", report.raw_chunk_count);
  v.Field("obstacle", report.obstacle);
}

template <typename V, typename T>
void VisitCensus(V& v, T& census) {
  v.Field("duplicate_point_count", census.duplicate_point_count);
  if (v.Presence("is_compared", census.overlapping_point_count.has_value())) {
    if constexpr (!std::is_const_v<T>) census.overlapping_point_count.emplace();
    v.Field("overlapping_point_count", *census.overlapping_point_count);
  }
  v.Field("density_cell_level", census.density_cell_level);
  v.Size("density_histogram", census.density_histogram);
  VisitCounts(v, "density_histogram", census.density_histogram);
}

/// `is_whole`: the record has all that a report has.
template <typename V, typename T>
void VisitUploadReport(V& v, bool is_whole, T& report) {
  v.Field("revision", report.revision);
  v.Field("added_point_count", report.added_point_count);
  v.Field("refused.non_finite", report.refused.non_finite);
  v.Field("refused.out_of_lattice", report.refused.out_of_lattice);
  v.Field("removed_point_count", report.removed_point_count);
  v.Field("block_count", report.block_count);
  v.Field("tile_count", report.tile_count);
  if (v.Presence("has_bounds", report.bounds.has_value())) {
    if constexpr (!std::is_const_v<T>) report.bounds.emplace();
    VisitPoint(v, "bounds.min", report.bounds->min);
    VisitPoint(v, "bounds.max", report.bounds->max);
  }
  if (!is_whole) return;
  if (v.Presence("has_census", report.census.has_value())) {
    if constexpr (!std::is_const_v<T>) report.census.emplace();
    VisitCensus(v, *report.census);
  }
  v.Size("warnings", report.warnings);
  for (auto& warning : report.warnings) {
    v.Field("warning.code", warning.code);
    v.Field("warning.message", warning.message);
  }
}

template <typename V, typename T>
void VisitUploadNotes(V& v, T& notes) {
  const bool is_whole = v.version() >= 2;
  VisitUploadReport(v, is_whole, notes.report);
  if (!is_whole) return;
  v.LongText("source.crs_wkt", notes.source.crs_wkt);
  v.Field("source.frame_id", notes.source.frame_id);
  v.Field("source.unit", notes.source.unit);
  v.Field("source.coordinate_step", notes.source.coordinate_step);
}

template <typename V, typename T>
void VisitProcessReport(V& v, T& report) {
  v.Field("revision", report.revision);
  v.Field("distinct_point_count", report.distinct_point_count);
  v.Field("point_count", report.point_count);
  VisitCounts(v, "label_counts", report.label_counts);
  for (auto& counts : report.level_counts) {
    VisitCounts(v, "level_counts", counts);
  }
  v.Field("outlier_count", report.outlier_count);
  v.Field("round_count", report.round_count);
  v.Field("updated_tile_count", report.updated_tile_count);
}

template <typename V, typename T>
void VisitJobSpec(V& v, T& spec) {
  v.Field("map_uid", spec.map_uid);
  if (v.Presence("is_upload", spec.verb == OperationVerb::kFinalizeUpload)) {
    if constexpr (!std::is_const_v<T>) {
      spec.verb = OperationVerb::kFinalizeUpload;
    }
    v.Field("upload_id", spec.upload_id);
    v.Field("upload_uid", spec.upload_uid);
    VisitRegion(v, spec.region);
  } else if (v.Presence("is_deletion",
                        spec.verb == OperationVerb::kDeleteRegion)) {
    if constexpr (!std::is_const_v<T>) {
      spec.verb = OperationVerb::kDeleteRegion;
    }
    VisitRegion(v, spec.region);
    v.Field("edit_uid", spec.edit_uid);
    v.Field("base_revision", spec.base_revision);
  } else if (v.version() >= 2 &&
             v.Presence("is_repair", spec.verb == OperationVerb::kRepairMap)) {
    if constexpr (!std::is_const_v<T>) spec.verb = OperationVerb::kRepairMap;
  } else {
    VisitOptions(v, spec.options);
  }
}

/// Visits the result if it is an `R`, or is to be one.
template <typename R, typename V, typename T, typename Visit>
void VisitResult(V& v, const char* name, T& outcome, const Visit& visit) {
  if (!v.Presence(name, std::holds_alternative<R>(outcome.result))) return;
  if constexpr (!std::is_const_v<T>) outcome.result.template emplace<R>();
  visit(v, std::get<R>(outcome.result));
}

template <typename V, typename T>
void VisitOutcome(V& v, T& outcome) {
  int64_t start_us = absl::ToUnixMicros(outcome.start_time);
  v.Field("start_time", start_us);
  if constexpr (!std::is_const_v<T>) {
    outcome.start_time = absl::FromUnixMicros(start_us);
  }
  VisitResult<UploadReport>(v, "is_upload_report", outcome,
                            [](auto& w, auto& report) {
                              VisitUploadReport(w, w.version() >= 3, report);
                            });
  VisitResult<ProcessReport>(
      v, "is_process_report", outcome,
      [](auto& w, auto& report) { VisitProcessReport(w, report); });
  VisitResult<DeleteReport>(
      v, "is_delete_report", outcome,
      [](auto& w, auto& report) { VisitDeleteReport(w, report); });
  if (v.version() < 2) return;
  VisitResult<RepairReport>(
      v, "is_repair_report", outcome,
      [](auto& w, auto& report) { VisitRepairReport(w, report); });
}

template <typename T, typename Visit>
std::string Format(const T& record, const Visit& visit,
                   uint8_t version = kVersion) {
  Writer writer(version);
  visit(writer, record);
  return std::move(writer).Text();
}

template <typename T, typename Visit>
absl::StatusOr<T> Parse(std::string_view bytes, std::string_view name,
                        const Visit& visit, uint8_t newest_version = kVersion) {
  T record;
  Reader reader(bytes, newest_version);
  visit(reader, record);
  MAPSIEVE_RETURN_IF_ERROR(reader.Finish(name));
  return record;
}

constexpr auto kOptions = [](auto& v, auto& r) { VisitOptions(v, r); };
constexpr auto kNotes = [](auto& v, auto& r) { VisitUploadNotes(v, r); };
constexpr auto kProcess = [](auto& v, auto& r) { VisitProcessReport(v, r); };
constexpr auto kEdit = [](auto& v, auto& r) { VisitEditRecord(v, r); };
constexpr auto kSpec = [](auto& v, auto& r) { VisitJobSpec(v, r); };
constexpr auto kOutcome = [](auto& v, auto& r) { VisitOutcome(v, r); };

}  // namespace

std::string FormatSpdfOptions(const core::SpdfOptions& options) {
  return Format(options, kOptions,
                options.label_neighbor_count == 0 ? kDefaultLabelsVersion
                                                  : kOptionsVersion);
}
absl::StatusOr<core::SpdfOptions> ParseSpdfOptions(std::string_view bytes) {
  return Parse<core::SpdfOptions>(bytes, "stored filter options", kOptions,
                                  kOptionsVersion);
}

std::string FormatUploadNotes(const UploadNotes& notes) {
  return Format(notes, kNotes, kNotesVersion);
}
absl::StatusOr<UploadNotes> ParseUploadNotes(std::string_view bytes) {
  return Parse<UploadNotes>(bytes, "stored notes of an upload", kNotes,
                            kNotesVersion);
}

std::string FormatProcessReport(const ProcessReport& report) {
  return Format(report, kProcess);
}
absl::StatusOr<ProcessReport> ParseProcessReport(std::string_view bytes) {
  return Parse<ProcessReport>(bytes, "stored report of a run", kProcess);
}

std::string FormatEditRecord(const EditRecord& edit) {
  return Format(edit, kEdit);
}
absl::StatusOr<EditRecord> ParseEditRecord(std::string_view bytes) {
  return Parse<EditRecord>(bytes, "stored description of an edit", kEdit);
}

std::string FormatJobSpec(const JobSpec& spec) {
  return Format(spec, kSpec, kSpecVersion);
}
absl::StatusOr<JobSpec> ParseJobSpec(std::string_view bytes) {
  return Parse<JobSpec>(bytes, "stored request of an operation", kSpec,
                        kSpecVersion);
}

std::string FormatJobOutcome(const JobOutcome& outcome) {
  return Format(outcome, kOutcome, kOutcomeVersion);
}
absl::StatusOr<JobOutcome> ParseJobOutcome(std::string_view bytes) {
  return Parse<JobOutcome>(bytes, "stored outcome of an operation", kOutcome,
                           kOutcomeVersion);
}

}  // namespace mapsieve::engine
