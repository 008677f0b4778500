#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/batch_columns.h"
#include "client/formats/coordinate_systems.h"
#include "client/formats/las_file.h"
#include "client/formats/las_layout.h"
#include "client/formats/output_file.h"
#include "client/formats/record_columns.h"
#include "client/formats/text_numbers.h"
#include "core/base/bytes.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::Point3;
using core::ScalarType;

constexpr size_t kChunkBytes = size_t{256} << 10;
constexpr size_t kMaxVlrBytes = 65535;
constexpr size_t kMaxExtras = kMaxVlrBytes / kLasExtraBytes;
constexpr size_t kReturnByte = 14;

// Where an attribute goes.
struct Target {
  ScalarType type = ScalarType::kUint8;
  LasField field;
  bool is_extra = false;
  bool has_missing = false;
};

// Whether every value of `from` is a value of `to`.
bool Fits(ScalarType from, ScalarType to) {
  return core::VisitScalarType(from, [&](auto narrow) {
    using From = std::numeric_limits<decltype(narrow)>;
    return core::VisitScalarType(to, [](auto wide) {
      using To = std::numeric_limits<decltype(wide)>;
      return (From::is_integer || !To::is_integer) &&
             (!From::is_signed || To::is_signed) && From::digits <= To::digits;
    });
  });
}

bool Fits(ScalarType type, const LasField& field) {
  return field.bits != 0 ? type == field.type : Fits(type, field.type);
}

const LasField* FindField(const std::vector<LasField>& fields,
                          const std::string& name) {
  for (const LasField& field : fields) {
    if (field.name == name) return &field;
  }
  return nullptr;
}

// The smallest point format of 6, 7 and 8 with fields for the attributes.
int ChoosePointFormat(const std::vector<core::ColumnSpec>& attributes) {
  int format = 6;
  const std::vector<LasField> fields = LasFields(8);
  for (const core::ColumnSpec& attribute : attributes) {
    const LasField* field = FindField(fields, attribute.name);
    if (field == nullptr || !Fits(attribute.type, *field)) continue;
    if (attribute.name == "nir") format = 8;
    if (attribute.name == "red" || attribute.name == "green" ||
        attribute.name == "blue") {
      format = std::max(format, 7);
    }
  }
  return format;
}

void PutText(ByteWriter& out, std::string_view text, size_t size) {
  const std::string_view shown = text.substr(0, size);
  out.PutBytes(TextBytes(shown));
  for (size_t i = shown.size(); i < size; ++i) out.Put(uint8_t{0});
}

void PutVlrHead(ByteWriter& out, std::string_view user, uint16_t id,
                size_t bytes, std::string_view description) {
  out.Put(uint16_t{0});
  PutText(out, user, 16);
  out.Put(id);
  out.Put(static_cast<uint16_t>(bytes));
  PutText(out, description, 32);
}

void PutExtraDescription(ByteWriter& out, const Target& target,
                         bool instead_of_field) {
  const bool marks_missing =
      target.has_missing && (target.type == ScalarType::kFloat32 ||
                             target.type == ScalarType::kFloat64);
  out.Put(uint16_t{0});
  out.Put(static_cast<uint8_t>(LasExtraType(target.type)));
  out.Put(static_cast<uint8_t>(marks_missing ? 1 : 0));
  PutText(out, target.field.name, kLasExtraNameBytes);
  out.Put(uint32_t{0});
  out.Put(marks_missing ? std::numeric_limits<double>::quiet_NaN() : 0.0);
  PutText(out, "", 112);
  PutText(out, instead_of_field ? kLasInsteadOfField : "", 32);
}

// Writes rows [row, row + count) of `column` into `count` records.
void Encode(const Target& target, const Column& column, size_t row,
            size_t count, size_t record_bytes, std::byte* records) {
  std::byte* to = records + target.field.offset;
  if (target.field.bits != 0) {
    for (size_t i = 0; i < count; ++i) {
      const auto value = column.Get<uint8_t>(row + i);
      to[i * record_bytes] |=
          static_cast<std::byte>(value << target.field.shift);
    }
    return;
  }
  core::VisitScalarType(target.type, [&](auto narrow) {
    using From = decltype(narrow);
    if (target.type == target.field.type) {
      ScatterField(column.bytes().data() + row * sizeof(From), record_bytes,
                   count, sizeof(From), to);
    } else {
      core::VisitScalarType(target.field.type, [&](auto wide) {
        for (size_t i = 0; i < count; ++i) {
          wide = static_cast<decltype(wide)>(column.Get<From>(row + i));
          std::memcpy(to + i * record_bytes, &wide, sizeof(wide));
        }
      });
    }
    if constexpr (std::is_floating_point_v<From>) {
      if (!target.is_extra || !column.has_missing()) return;
      const From nan = std::numeric_limits<From>::quiet_NaN();
      for (size_t i = 0; i < count; ++i) {
        if (column.IsMissing(row + i)) {
          std::memcpy(to + i * record_bytes, &nan, sizeof(nan));
        }
      }
    }
  });
}

class LasWriter : public PointWriter {
 public:
  LasWriter(std::unique_ptr<OutputFile> file, const WriteOptions& options,
            int point_format, std::vector<Target> targets, size_t record_bytes)
      : file_(std::move(file)),
        options_(options),
        point_format_(point_format),
        fields_(LasFields(point_format)),
        targets_(std::move(targets)),
        record_bytes_(record_bytes) {
    if (!(options.origin == Point3{})) SetOffset(options.origin);
    for (size_t i = 0; i < targets_.size(); ++i) {
      if (targets_[i].is_extra) continue;
      if (targets_[i].field.name == "return_number") return_column_ = i;
      has_return_count_ |= targets_[i].field.name == "number_of_returns";
    }
  }

  absl::Status WriteHead() { return file_->Append(Head()); }

  absl::Status Write(const core::PointCloud& batch) override {
    MAPSIEVE_ASSIGN_OR_RETURN(
        const auto columns,
        MatchColumns(file_->name(), options_.attributes, batch));
    MAPSIEVE_RETURN_IF_ERROR(CheckBits(columns));
    MAPSIEVE_RETURN_IF_ERROR(Quantize(batch.positions));
    for (size_t i = 0; i < columns.size(); ++i) {
      targets_[i].has_missing |= columns[i]->has_missing();
    }
    CountReturns(columns, batch.size());

    const size_t chunk = std::max<size_t>(1, kChunkBytes / record_bytes_);
    for (size_t row = 0; row < batch.size(); row += chunk) {
      const size_t count = std::min(chunk, batch.size() - row);
      records_.assign(count * record_bytes_, std::byte{0});
      EncodePoints(row, count);
      for (size_t i = 0; i < targets_.size(); ++i) {
        Encode(targets_[i], *columns[i], row, count, record_bytes_,
               records_.data());
      }
      MAPSIEVE_RETURN_IF_ERROR(file_->Append(records_));
    }
    point_count_ += batch.size();
    return absl::OkStatus();
  }

  absl::Status Finish() override {
    MAPSIEVE_RETURN_IF_ERROR(file_->Overwrite(0, Head()));
    return file_->Finish();
  }

 private:
  void SetOffset(const Point3& origin) {
    // A round number of steps, so that lattice points stay lattice points.
    const double unit = 1000 * options_.coordinate_step;
    const auto round = [&](double x) {
      return std::nearbyint(x / unit) * unit;
    };
    offset_ = {round(origin.x), round(origin.y), round(origin.z)};
    has_offset_ = true;
  }

  // Sets the offset to the middle of the finite points.
  void ChooseOffset(const std::vector<Point3>& positions) {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    std::array<double, 3> low = {kInfinity, kInfinity, kInfinity};
    std::array<double, 3> high = {-kInfinity, -kInfinity, -kInfinity};
    for (const Point3& p : positions) {
      const std::array<double, 3> xyz = {p.x, p.y, p.z};
      for (size_t axis = 0; axis < 3; ++axis) {
        low[axis] = std::min(low[axis], xyz[axis]);
        high[axis] = std::max(high[axis], xyz[axis]);
      }
    }
    const auto middle = [&](size_t axis) {
      const double value = low[axis] / 2 + high[axis] / 2;
      return std::isfinite(value) ? value : 0.0;
    };
    SetOffset({middle(0), middle(1), middle(2)});
  }

  // Positions as integers into quantized_, and their bounds.
  absl::Status Quantize(const std::vector<Point3>& positions) {
    if (!has_offset_ && !positions.empty()) ChooseOffset(positions);
    quantized_.resize(positions.size());
    auto low = low_;
    auto high = high_;
    for (size_t i = 0; i < positions.size(); ++i) {
      const Point3& p = positions[i];
      const std::array<double, 3> xyz = {p.x, p.y, p.z};
      for (size_t axis = 0; axis < 3; ++axis) {
        const double steps = std::nearbyint((xyz[axis] - offset_[axis]) /
                                            options_.coordinate_step);
        // False for NaN and the infinities too.
        if (!(std::abs(steps) <= std::numeric_limits<int32_t>::max())) {
          return RefuseCoordinate(point_count_ + i, axis, xyz[axis]);
        }
        const auto value = static_cast<int32_t>(steps);
        quantized_[i][axis] = value;
        low[axis] = std::min(low[axis], value);
        high[axis] = std::max(high[axis], value);
      }
    }
    low_ = low;
    high_ = high;
    return absl::OkStatus();
  }

  absl::Status RefuseCoordinate(size_t point, size_t axis, double value) const {
    const std::string where =
        absl::StrCat(file_->name(), ": point ", point, ": ",
                     std::string(1, "xyz"[axis]), " = ", NumberText(value));
    if (!std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(
          where, " cannot be written to LAS; leave such points out"));
    }
    const double reach =
        std::abs(value - offset_[axis]) / std::numeric_limits<int32_t>::max();
    return absl::InvalidArgumentError(absl::StrCat(
        where, " is beyond what LAS holds at scale ",
        NumberText(options_.coordinate_step), " and offset ",
        NumberText(offset_[axis]), "; a scale of ",
        NumberText(std::pow(10.0, std::ceil(std::log10(reach)))), " would do"));
  }

  absl::Status CheckBits(const std::vector<const Column*>& columns) const {
    for (size_t k = 0; k < columns.size(); ++k) {
      const LasField& field = targets_[k].field;
      if (field.bits == 0) continue;
      const int limit = 1 << field.bits;
      for (size_t i = 0; i < columns[k]->size(); ++i) {
        const int value = columns[k]->Get<uint8_t>(i);
        if (value >= limit) {
          return absl::InvalidArgumentError(absl::StrCat(
              file_->name(), ": point ", point_count_ + i, ": ", field.name,
              " = ", value, " is beyond ", limit - 1,
              ", the largest that LAS holds; rename the attribute"));
        }
      }
    }
    return absl::OkStatus();
  }

  void CountReturns(const std::vector<const Column*>& columns, size_t size) {
    if (!return_column_.has_value()) {
      returns_[0] += size;
      return;
    }
    const Column& column = *columns[*return_column_];
    for (size_t i = 0; i < size; ++i) {
      const size_t number = column.Get<uint8_t>(i);
      if (number > 0) ++returns_[number - 1];
    }
  }

  void EncodePoints(size_t row, size_t count) {
    const auto first =
        static_cast<std::byte>((return_column_.has_value() ? 0x00 : 0x01) |
                               (has_return_count_ ? 0x00 : 0x10));
    for (size_t i = 0; i < count; ++i) {
      std::byte* record = records_.data() + i * record_bytes_;
      std::memcpy(record, quantized_[row + i].data(), 12);
      record[kReturnByte] = first;
    }
  }

  // The header and the variable length records; always of the same length.
  std::vector<std::byte> Head() const {
    ByteWriter records;
    uint32_t record_count = 0;
    const auto extra_count = static_cast<size_t>(
        std::count_if(targets_.begin(), targets_.end(),
                      [](const Target& target) { return target.is_extra; }));
    if (extra_count > 0) {
      PutVlrHead(records, "LASF_Spec", 4, extra_count * kLasExtraBytes,
                 "extra bytes");
      for (const Target& target : targets_) {
        if (!target.is_extra) continue;
        PutExtraDescription(records, target,
                            FindField(fields_, target.field.name) != nullptr);
      }
      ++record_count;
    }
    if (!options_.crs_wkt.empty()) {
      PutVlrHead(records, "LASF_Projection", 2112, options_.crs_wkt.size() + 1,
                 "CRS as WKT");
      records.PutBytes(TextBytes(options_.crs_wkt));
      records.Put(uint8_t{0});
      ++record_count;
    }

    ByteWriter head;
    PutText(head, "LASF", 4);
    head.Put(uint16_t{0});
    // WKT: point formats from 6 on must say so. PDAL refuses files that do not.
    head.Put(uint16_t{0x10});
    PutText(head, "", 16);
    head.Put(uint8_t{1});
    head.Put(uint8_t{4});
    PutText(head, "OTHER", 32);
    PutText(head, "mapsieve", 32);
    head.Put(uint32_t{0});  // no date: the same points give the same bytes
    head.Put(static_cast<uint16_t>(kLasHeaderBytes));
    head.Put(static_cast<uint32_t>(kLasHeaderBytes + records.size()));
    head.Put(record_count);
    head.Put(static_cast<uint8_t>(point_format_));
    head.Put(static_cast<uint16_t>(record_bytes_));
    PutText(head, "", 24);  // legacy counts
    for (int i = 0; i < 3; ++i) head.Put(options_.coordinate_step);
    for (const double offset : offset_) head.Put(offset);
    for (size_t axis = 0; axis < 3; ++axis) {
      const auto coordinate = [&](int32_t value) {
        return point_count_ == 0
                   ? 0.0
                   : value * options_.coordinate_step + offset_[axis];
      };
      head.Put(coordinate(high_[axis]));
      head.Put(coordinate(low_[axis]));
    }
    PutText(head, "", 20);  // no waveforms, no extended records
    head.Put(uint64_t{point_count_});
    for (const uint64_t count : returns_) head.Put(count);
    head.PutBytes(records.bytes());
    return std::move(head.bytes());
  }

  std::unique_ptr<OutputFile> file_;
  WriteOptions options_;
  int point_format_;
  std::vector<LasField> fields_;
  std::vector<Target> targets_;
  size_t record_bytes_;
  std::optional<size_t> return_column_;
  bool has_return_count_ = false;

  bool has_offset_ = false;
  std::array<double, 3> offset_{};
  std::array<int32_t, 3> low_ = {INT32_MAX, INT32_MAX, INT32_MAX};
  std::array<int32_t, 3> high_ = {INT32_MIN, INT32_MIN, INT32_MIN};
  uint64_t point_count_ = 0;
  std::array<uint64_t, 15> returns_{};
  std::vector<std::array<int32_t, 3>> quantized_;
  std::vector<std::byte> records_;
};

absl::Status CheckOptions(const std::string& name,
                          const WriteOptions& options) {
  MAPSIEVE_RETURN_IF_ERROR(CheckAttributes(name, options.attributes));
  const auto refuse = [&](const std::string& what) {
    return absl::InvalidArgumentError(absl::StrCat(name, ": ", what));
  };
  if (!std::isfinite(options.coordinate_step) || options.coordinate_step <= 0) {
    return refuse(absl::StrCat("LAS needs a coordinate step above 0, got ",
                               NumberText(options.coordinate_step),
                               "; 0.001 keeps millimetres"));
  }
  const Point3& origin = options.origin;
  if (!std::isfinite(origin.x) || !std::isfinite(origin.y) ||
      !std::isfinite(origin.z)) {
    return refuse("the origin of LAS must be finite");
  }
  // A NUL follows the text.
  if (options.crs_wkt.size() >= kMaxVlrBytes) {
    return refuse(absl::StrCat("the CRS has ", options.crs_wkt.size(),
                               " bytes; LAS holds ", kMaxVlrBytes - 1));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<PointWriter>> CreateLasFile(
    const std::filesystem::path& path, const WriteOptions& given) {
  const std::string name = path.string();
  WriteOptions options = given;
  if (core::ParseEpsgName(given.crs_wkt) != 0) {
    absl::StatusOr<std::string> wkt = WktOfCrs(given.crs_wkt);
    if (wkt.ok()) {
      options.crs_wkt = *std::move(wkt);
    } else if (!absl::IsNotFound(wkt.status())) {
      return Annotate(wkt.status(), name);
    }
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckOptions(name, options));
  const int point_format = ChoosePointFormat(options.attributes);
  const std::vector<LasField> fields = LasFields(point_format);
  std::vector<Target> targets;
  size_t record_bytes = LasRecordBytes(point_format);
  size_t extra_count = 0;
  for (const core::ColumnSpec& attribute : options.attributes) {
    const LasField* field = FindField(fields, attribute.name);
    if (field != nullptr && Fits(attribute.type, *field)) {
      targets.push_back({.type = attribute.type, .field = *field});
      continue;
    }
    if (attribute.name.size() > kLasExtraNameBytes) {
      return absl::InvalidArgumentError(
          absl::StrCat(name, ": the attribute name \"", attribute.name,
                       "\" has ", attribute.name.size(), " bytes; LAS holds ",
                       kLasExtraNameBytes, ": rename it or leave it out"));
    }
    if (++extra_count > kMaxExtras) {
      return absl::InvalidArgumentError(
          absl::StrCat(name, ": more than ", kMaxExtras,
                       " attributes beyond the fields of LAS; leave some out"));
    }
    targets.push_back({.type = attribute.type,
                       .field = {.name = attribute.name,
                                 .type = attribute.type,
                                 .offset = record_bytes},
                       .is_extra = true});
    record_bytes += core::ScalarSize(attribute.type);
  }
  MAPSIEVE_ASSIGN_OR_RETURN(auto file, OutputFile::Create(path));
  auto writer = std::make_unique<LasWriter>(
      std::move(file), options, point_format, std::move(targets), record_bytes);
  MAPSIEVE_RETURN_IF_ERROR(writer->WriteHead());
  return writer;
}

}  // namespace mapsieve::client
