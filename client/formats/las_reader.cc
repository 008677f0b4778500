#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <iterator>
#include <optional>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/coordinate_systems.h"
#include "client/formats/file_input.h"
#include "client/formats/geotiff_keys.h"
#include "client/formats/las_file.h"
#include "client/formats/las_layout.h"
#include "client/formats/record_columns.h"
#include "client/formats/text_numbers.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::ScalarType;

// A part of the file that stays in the processor's cache between the columns.
constexpr size_t kChunkBytes = size_t{256} << 10;
// Variable length records beyond this many, or this long, are passed over.
constexpr int64_t kMaxVlrs = 100'000;
constexpr int64_t kMaxVlrBytes = int64_t{16} << 20;

struct Header {
  int minor = 0;
  int64_t header_bytes = 0;
  int64_t points_offset = 0;
  int64_t vlr_count = 0;
  int64_t evlr_offset = 0;
  int64_t evlr_count = 0;
  int point_format = 0;
  size_t record_bytes = 0;
  int64_t point_count = 0;
  std::array<double, 3> scale{};
  std::array<double, 3> offset{};
};

// One attribute: a field and how its bits become values.
struct Source {
  LasField field;
  /// Value = raw * scale + shift, as float64.
  bool scaled = false;
  double scale = 1;
  double shift = 0;
  /// The raw value that means "missing".
  std::optional<std::array<std::byte, 8>> no_data;
  bool instead_of_field = false;

  core::ColumnSpec spec() const {
    return {field.name, scaled ? ScalarType::kFloat64 : field.type};
  }
};

struct Metadata {
  std::string wkt;
  std::string liblas_wkt;
  GeoKeyRecords keys;
  std::vector<std::byte> extra_bytes;
};

template <typename T>
T At(std::span<const std::byte> bytes, size_t offset) {
  return LoadLittleEndian<T>(bytes.subspan(offset, sizeof(T)).data());
}

std::string_view TextAt(std::span<const std::byte> bytes, size_t offset,
                        size_t size) {
  const std::string_view text(
      reinterpret_cast<const char*>(bytes.subspan(offset, size).data()), size);
  return text.substr(0, text.find('\0'));
}

absl::StatusOr<Header> ReadHeader(const InputFile& file) {
  std::array<std::byte, kLasHeaderBytes> bytes{};
  const size_t have = std::min(bytes.size(), static_cast<size_t>(file.size()));
  MAPSIEVE_RETURN_IF_ERROR(file.ReadAt(0, std::span(bytes).first(have)));
  if (TextAt(bytes, 0, 4) != "LASF") {
    return file.Damaged(
        0, absl::StrCat("expected the signature \"LASF\", found ",
                        Quoted(TextAt(bytes, 0, 4)), "; this is not LAS"));
  }
  if (have < kLasOldHeaderBytes) {
    return file.Damaged(
        0, absl::StrCat("LAS header: expected ", kLasOldHeaderBytes,
                        " bytes, the file has ", have));
  }

  Header header;
  const int major = At<uint8_t>(bytes, 24);
  header.minor = At<uint8_t>(bytes, 25);
  if (major != 1 || header.minor > 4) {
    return absl::UnimplementedError(
        absl::StrCat(file.name(), ": LAS ", major, ".", header.minor,
                     " is not read; convert it to LAS 1.4, which is read as "
                     "1.0 to 1.3 are"));
  }
  const int format_byte = At<uint8_t>(bytes, 104);
  if ((format_byte & 0xC0) != 0) {
    return absl::UnimplementedError(absl::StrCat(
        file.name(),
        ": LAZ (compressed LAS) is not read; decompress it to LAS first, e.g. "
        "with \"laszip -i IN.laz -o OUT.las\" or \"pdal translate IN.laz "
        "OUT.las\""));
  }
  if (format_byte >= kLasPointFormats) {
    return absl::UnimplementedError(
        absl::StrCat(file.name(), ": LAS point format ", format_byte,
                     " is not read; formats 0 to 10 are"));
  }
  header.point_format = format_byte;
  header.header_bytes = At<uint16_t>(bytes, 94);
  const size_t least = header.minor >= 4 ? kLasHeaderBytes : kLasOldHeaderBytes;
  if (header.header_bytes < static_cast<int64_t>(least) || have < least) {
    return file.Damaged(
        94, absl::StrCat("LAS 1.", header.minor, " header: expected at least ",
                         least, " bytes, it declares ", header.header_bytes,
                         " and the file has ", file.size()));
  }
  header.points_offset = At<uint32_t>(bytes, 96);
  if (header.points_offset < header.header_bytes ||
      header.points_offset > file.size()) {
    return file.Damaged(
        96,
        absl::StrCat("offset of the points: expected ", header.header_bytes,
                     " to ", file.size(), ", found ", header.points_offset));
  }
  header.vlr_count = At<uint32_t>(bytes, 100);
  header.record_bytes = At<uint16_t>(bytes, 105);
  if (header.record_bytes < LasRecordBytes(format_byte)) {
    return file.Damaged(
        105,
        absl::StrCat("length of a point: expected at least ",
                     LasRecordBytes(format_byte), " bytes for point format ",
                     format_byte, ", found ", header.record_bytes));
  }

  uint64_t count = At<uint32_t>(bytes, 107);
  if (header.minor >= 4) {
    // A legacy count that is not zero prevails: the rule of LAS 1.4.
    if (count == 0) count = At<uint64_t>(bytes, 247);
    const auto evlr_offset = At<uint64_t>(bytes, 235);
    if (evlr_offset <= static_cast<uint64_t>(file.size())) {
      header.evlr_offset = static_cast<int64_t>(evlr_offset);
      header.evlr_count = At<uint32_t>(bytes, 243);
    }
  }
  const auto room = static_cast<uint64_t>(file.size() - header.points_offset) /
                    header.record_bytes;
  if (count > room) {
    return file.Damaged(
        header.points_offset,
        absl::StrCat("the header declares ", count, " points of ",
                     header.record_bytes, " bytes, the file ends after ", room,
                     "; get a complete copy of the file"));
  }
  header.point_count = static_cast<int64_t>(count);

  for (size_t axis = 0; axis < 3; ++axis) {
    header.scale[axis] = At<double>(bytes, 131 + 8 * axis);
    header.offset[axis] = At<double>(bytes, 155 + 8 * axis);
    if (!std::isfinite(header.scale[axis]) || header.scale[axis] == 0 ||
        !std::isfinite(header.offset[axis])) {
      return file.Damaged(
          static_cast<int64_t>(131 + 8 * axis),
          absl::StrCat("scale and offset of an axis: expected finite numbers "
                       "and a scale that is not 0, found ",
                       NumberText(header.scale[axis]), " and ",
                       NumberText(header.offset[axis])));
    }
  }
  return header;
}

void TakeRecord(std::string_view user, int id,
                std::span<const std::byte> payload, Metadata& metadata) {
  if (user == "LASF_Projection" && id == 2112) {
    metadata.wkt = CleanText(TextAt(payload, 0, payload.size()), ' ');
  } else if (user == "LASF_Projection" && id == 34735) {
    metadata.keys.directory.assign(payload.begin(), payload.end());
  } else if (user == "LASF_Projection" && id == 34736) {
    metadata.keys.doubles.assign(payload.begin(), payload.end());
  } else if (user == "LASF_Projection" && id == 34737) {
    metadata.keys.text.assign(payload.begin(), payload.end());
  } else if (user == "liblas" && id == 2112) {
    metadata.liblas_wkt = CleanText(TextAt(payload, 0, payload.size()), ' ');
  } else if (user == "LASF_Spec" && id == 4) {
    metadata.extra_bytes.assign(payload.begin(), payload.end());
  }
}

// Walks `count` records in [cursor, end) whose head has `head_bytes`.
absl::Status ReadRecords(InputCursor& cursor, int64_t count, int64_t end,
                         size_t head_bytes, Metadata& metadata) {
  for (int64_t i = 0; i < std::min(count, kMaxVlrs); ++i) {
    if (end - cursor.offset() < static_cast<int64_t>(head_bytes)) break;
    MAPSIEVE_ASSIGN_OR_RETURN(const auto head,
                              cursor.Take(head_bytes, "head of a record"));
    const std::string user(TextAt(head, 2, 16));
    const int id = At<uint16_t>(head, 18);
    const uint64_t size = head_bytes == kLasEvlrHeadBytes
                              ? At<uint64_t>(head, 20)
                              : At<uint16_t>(head, 20);
    if (size > static_cast<uint64_t>(end - cursor.offset())) break;
    if (size > static_cast<uint64_t>(kMaxVlrBytes)) {
      MAPSIEVE_RETURN_IF_ERROR(
          cursor.Skip(static_cast<int64_t>(size), "record"));
      continue;
    }
    MAPSIEVE_ASSIGN_OR_RETURN(const auto payload,
                              cursor.Take(static_cast<size_t>(size), "record"));
    TakeRecord(user, id, payload, metadata);
  }
  return absl::OkStatus();
}

absl::StatusOr<Metadata> ReadMetadata(
    const std::shared_ptr<const InputFile>& file, const Header& header) {
  constexpr size_t kBufferBytes = size_t{64} << 10;
  Metadata metadata;
  InputCursor cursor(file, header.header_bytes, kBufferBytes);
  MAPSIEVE_RETURN_IF_ERROR(ReadRecords(cursor, header.vlr_count,
                                       header.points_offset, kLasVlrHeadBytes,
                                       metadata));
  InputCursor extended(file, header.evlr_offset, kBufferBytes);
  MAPSIEVE_RETURN_IF_ERROR(ReadRecords(
      extended, header.evlr_count, file->size(), kLasEvlrHeadBytes, metadata));
  return metadata;
}

std::optional<ScalarType> ScalarOfExtraType(int number) {
  for (int i = 1; i <= 10; ++i) {
    const auto type = static_cast<ScalarType>(i);
    if (LasExtraType(type) == number) return type;
  }
  return std::nullopt;
}

// `count` bytes at `offset` that nothing describes further.
void AddBytes(const std::string& name, size_t count, size_t offset,
              std::vector<Source>& sources) {
  for (size_t i = 0; i < count; ++i) {
    sources.push_back(
        {.field = {.name = count == 1 ? name : absl::StrCat(name, "_", i),
                   .type = ScalarType::kUint8,
                   .offset = offset + i}});
  }
}

// Scale, offset and "no data" of one part of a description.
Source DescribedSource(std::span<const std::byte> description, size_t part) {
  const int options = At<uint8_t>(description, 3);
  Source source;
  if ((options & 0x01) != 0) {
    source.no_data.emplace();
    std::memcpy(source.no_data->data(), description.data() + 40 + 8 * part, 8);
  }
  if ((options & 0x08) != 0) {
    const auto scale = At<double>(description, 112 + 8 * part);
    // A scale that would erase the values was never meant.
    if (std::isfinite(scale) && scale != 0) source.scale = scale;
  }
  if ((options & 0x10) != 0) {
    const auto shift = At<double>(description, 136 + 8 * part);
    if (std::isfinite(shift)) source.shift = shift;
  }
  source.scaled = source.scale != 1 || source.shift != 0;
  return source;
}

// The attributes in bytes [begin, end) of a record.
std::vector<Source> ExtraSources(std::span<const std::byte> descriptions,
                                 size_t begin, size_t end) {
  std::vector<Source> sources;
  size_t at = begin;
  for (; descriptions.size() >= kLasExtraBytes;
       descriptions = descriptions.subspan(kLasExtraBytes)) {
    const auto description = descriptions.first(kLasExtraBytes);
    const size_t number = At<uint8_t>(description, 2);
    std::string name =
        CleanText(TextAt(description, 4, kLasExtraNameBytes), '_');
    if (name.empty()) name = "extra";
    const size_t parts = number == 0 ? 0 : (number - 1) / 10 + 1;
    // Beyond an unknown type nothing is known but that there are bytes.
    if (parts > 3) break;
    const std::optional<ScalarType> type = ScalarOfExtraType(
        number == 0 ? 0 : static_cast<int>((number - 1) % 10 + 1));
    const size_t bytes = number == 0 ? At<uint8_t>(description, 3)
                                     : parts * core::ScalarSize(*type);
    if (bytes > end - at) {
      sources.clear();
      at = begin;
      break;
    }
    if (number == 0) AddBytes(name, bytes, at, sources);
    for (size_t part = 0; part < parts; ++part) {
      Source source = DescribedSource(description, part);
      source.field = {.name = parts == 1 ? name : absl::StrCat(name, "_", part),
                      .type = *type,
                      .offset = at + part * core::ScalarSize(*type)};
      source.instead_of_field =
          parts == 1 && TextAt(description, 160, 32) == kLasInsteadOfField;
      sources.push_back(std::move(source));
    }
    at += bytes;
  }
  AddBytes("extra", end - at, at, sources);
  return sources;
}

// The attributes of a record: the fields of its format, then the extra bytes.
std::vector<Source> ListSources(const Header& header,
                                std::span<const std::byte> descriptions) {
  std::vector<Source> extras = ExtraSources(
      descriptions, LasRecordBytes(header.point_format), header.record_bytes);
  std::set<std::string> replaced;
  for (const Source& extra : extras) {
    if (extra.instead_of_field) replaced.insert(extra.field.name);
  }
  std::vector<Source> sources;
  for (LasField& field : LasFields(header.point_format)) {
    if (replaced.contains(field.name)) continue;
    sources.push_back({.field = std::move(field)});
  }
  // Too many are refused later, and need no names of their own.
  if (sources.size() + extras.size() > kMaxAttributes) {
    std::move(extras.begin(), extras.end(), std::back_inserter(sources));
    return sources;
  }
  std::set<std::string> taken = {"x", "y", "z"};
  for (const Source& source : sources) taken.insert(source.field.name);
  for (Source& extra : extras) {
    std::string& name = extra.field.name;
    if (taken.contains(name)) name = absl::StrCat("extra_", name);
    const std::string base = name;
    for (int i = 2; !taken.insert(name).second; ++i) {
      name = absl::StrCat(base, "_", i);
    }
    sources.push_back(std::move(extra));
  }
  return sources;
}

// Whether a raw value is the one that means "missing"; descriptions hold that
// one widened to 8 bytes.
template <typename T>
bool IsNoData(T raw, const std::array<std::byte, 8>& no_data) {
  if constexpr (std::is_floating_point_v<T>) {
    const auto wide = std::bit_cast<double>(no_data);
    return std::isnan(wide) ? std::isnan(raw)
                            : static_cast<double>(raw) == wide;
  } else if constexpr (std::is_signed_v<T>) {
    return static_cast<int64_t>(raw) == std::bit_cast<int64_t>(no_data);
  } else {
    return static_cast<uint64_t>(raw) == std::bit_cast<uint64_t>(no_data);
  }
}

// Fills rows [row, row + count) of `column` from `count` records.
void Decode(const Source& source, const std::byte* records, size_t record_bytes,
            size_t count, size_t row, Column& column) {
  const std::byte* from = records + source.field.offset;
  std::byte* to = column.mutable_bytes().data() + row * column.value_size();
  if (source.field.bits != 0) {
    const int shift = source.field.shift;
    const unsigned mask = (1U << source.field.bits) - 1;
    for (size_t i = 0; i < count; ++i) {
      const auto byte = std::to_integer<unsigned>(from[i * record_bytes]);
      to[i] = static_cast<std::byte>((byte >> shift) & mask);
    }
    return;
  }
  core::VisitScalarType(source.field.type, [&](auto zero) {
    using T = decltype(zero);
    if (!source.scaled) {
      GatherField(from, record_bytes, count, sizeof(T), to);
    } else {
      for (size_t i = 0; i < count; ++i) {
        const auto raw = LoadLittleEndian<T>(from + i * record_bytes);
        column.Set(row + i,
                   static_cast<double>(raw) * source.scale + source.shift);
      }
    }
    if (!source.no_data.has_value()) return;
    for (size_t i = 0; i < count; ++i) {
      if (IsNoData(LoadLittleEndian<T>(from + i * record_bytes),
                   *source.no_data)) {
        column.SetMissing(row + i);
      }
    }
  });
}

// The CRS of `info`, its problem, and the unit.
void TakeCrs(const Metadata& metadata, PointFileInfo& info) {
  const GeoKeys keys = ReadGeoKeys(metadata.keys.directory);
  if (!metadata.wkt.empty()) {
    info.crs_wkt = metadata.wkt;
  } else if ((keys.horizontal == 0 ||
              keys.horizontal == GeoKeys::kUserDefined) &&
             !metadata.liblas_wkt.empty()) {
    // Of the same system, with all its names.
    info.crs_wkt = metadata.liblas_wkt;
  } else {
    GeoKeyCrs crs = CrsOfGeoKeys(keys, metadata.keys);
    info.crs_wkt = std::move(crs.text);
    info.crs_problem = std::move(crs.problem);
  }
  // Keys may have another one than their code has.
  const bool is_code = core::ParseEpsgName(info.crs_wkt) != 0;
  info.unit =
      is_code && !keys.unit.empty() ? keys.unit : UnitOfCodeOrWkt(info.crs_wkt);
  if (info.unit.empty()) info.unit = keys.unit;
}

class LasReader : public PointReader {
 public:
  LasReader(std::shared_ptr<const InputFile> file, const Header& header,
            std::vector<Source> sources, PointFileInfo info)
      : file_(std::move(file)),
        header_(header),
        sources_(std::move(sources)),
        info_(std::move(info)) {}

  const PointFileInfo& info() const override { return info_; }

  absl::StatusOr<core::PointCloud> ReadBatch(size_t max_points) override {
    const size_t size = static_cast<size_t>(std::min<uint64_t>(
        max_points, static_cast<uint64_t>(header_.point_count - done_)));
    core::PointCloud batch;
    batch.positions.resize(size);
    std::vector<Column>& columns = batch.attributes.columns();
    columns.reserve(sources_.size());
    for (const Source& source : sources_) {
      columns.emplace_back(source.spec(), size);
    }
    const size_t record_bytes = header_.record_bytes;
    const size_t chunk = std::max<size_t>(1, kChunkBytes / record_bytes);
    for (size_t row = 0; row < size; row += chunk) {
      const size_t count = std::min(chunk, size - row);
      records_.resize(std::max(records_.size(), count * record_bytes));
      MAPSIEVE_RETURN_IF_ERROR(file_->ReadAt(
          header_.points_offset + (done_ + static_cast<int64_t>(row)) *
                                      static_cast<int64_t>(record_bytes),
          std::span(records_).first(count * record_bytes)));
      DecodePositions(count, batch.positions.data() + row);
      for (size_t i = 0; i < sources_.size(); ++i) {
        Decode(sources_[i], records_.data(), record_bytes, count, row,
               columns[i]);
      }
    }
    done_ += static_cast<int64_t>(size);
    return batch;
  }

 private:
  void DecodePositions(size_t count, core::Point3* positions) const {
    const auto& scale = header_.scale;
    const auto& offset = header_.offset;
    for (size_t i = 0; i < count; ++i) {
      const std::byte* record = records_.data() + i * header_.record_bytes;
      positions[i] = {
          LoadLittleEndian<int32_t>(record) * scale[0] + offset[0],
          LoadLittleEndian<int32_t>(record + 4) * scale[1] + offset[1],
          LoadLittleEndian<int32_t>(record + 8) * scale[2] + offset[2]};
    }
  }

  std::shared_ptr<const InputFile> file_;
  Header header_;
  std::vector<Source> sources_;
  PointFileInfo info_;
  std::vector<std::byte> records_;
  int64_t done_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenLasFile(
    const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, InputFile::Open(path));
  MAPSIEVE_ASSIGN_OR_RETURN(const Header header, ReadHeader(*file));
  MAPSIEVE_ASSIGN_OR_RETURN(const Metadata metadata,
                            ReadMetadata(file, header));
  std::vector<Source> sources = ListSources(header, metadata.extra_bytes);

  PointFileInfo info;
  info.format = absl::StrCat("LAS 1.", header.minor, ", point format ",
                             header.point_format);
  info.point_count = header.point_count;
  for (const Source& source : sources) {
    info.attributes.push_back(source.spec());
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(file->name(), info.attributes));
  TakeCrs(metadata, info);
  info.coordinate_step =
      std::min({std::abs(header.scale[0]), std::abs(header.scale[1]),
                std::abs(header.scale[2])});
  return std::make_unique<LasReader>(std::move(file), header,
                                     std::move(sources), std::move(info));
}

}  // namespace mapsieve::client
