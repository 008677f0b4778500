// Feeds bytes to a reader of point files, and what it reads to all writers.
//   point_file_fuzzer --format=las|pcd|ply|csv|vtk [libFuzzer options]

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "client/formats/batch_columns.h"
#include "client/formats/csv_file.h"
#include "client/formats/las_file.h"
#include "client/formats/pcd_file.h"
#include "client/formats/ply_file.h"
#include "client/formats/point_file.h"
#include "client/formats/vtk_file.h"
#include "core/base/status.h"
#include "core/cloud/point_cloud.h"
#include "tests/fuzz/check.h"
#include "tests/testing/temporary_directory.h"

namespace mapsieve::client {
namespace {

using core::Column;
using core::Point3;
using core::PointCloud;
using core::ScalarType;
using mapsieve::testing::Check;

using Opener = absl::StatusOr<std::unique_ptr<PointReader>> (*)(
    const std::filesystem::path&);

struct Format {
  std::string_view name;
  Opener open;
};
constexpr Format kFormats[] = {
    {"las", OpenLasFile},
    {"pcd", OpenPcdFile},
    {"ply", OpenPlyFile},
    {"csv", [](const auto& path) { return OpenCsvFile(path); }},
    {"vtk", OpenVtkFile}};
const Format* format = nullptr;

constexpr size_t kBatchPoints = 64;

bool IsFloating(ScalarType type) {
  return type == ScalarType::kFloat32 || type == ScalarType::kFloat64;
}

bool SameBits(const std::vector<Point3>& a, const std::vector<Point3>& b) {
  return a.size() == b.size() &&
         (a.empty() ||
          std::memcmp(a.data(), b.data(), a.size() * sizeof(Point3)) == 0);
}

/// All points by batches, each of which obeys the contract of PointReader.
absl::StatusOr<PointCloud> ReadAll(PointReader& reader, size_t batch_points) {
  const PointFileInfo& info = reader.info();
  Check(CheckAttributes("file", info.attributes).ok(),
        "attributes are in order");
  Check(info.coordinate_step >= 0, "a step is not negative");
  PointCloud all;
  for (const core::ColumnSpec& spec : info.attributes) {
    all.attributes.columns().emplace_back(spec);
  }
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const PointCloud batch,
                              reader.ReadBatch(batch_points));
    Check(batch.size() <= batch_points, "a batch is as large as asked for");
    Check(batch.attributes.specs() == info.attributes,
          "a batch has the attributes of the file");
    for (const Column& column : batch.attributes.columns()) {
      Check(column.size() == batch.size() &&
                (!column.has_missing() ||
                 column.missing().size() == batch.size()),
            "all columns of a batch are of one length", column.name());
    }
    if (batch.size() == 0) break;
    Check(all.attributes.AppendAll(all.size(), batch.attributes, batch.size())
              .ok(),
          "batches go together");
    all.positions.insert(all.positions.end(), batch.positions.begin(),
                         batch.positions.end());
  }
  Check(info.point_count.value_or(static_cast<int64_t>(all.size())) ==
            static_cast<int64_t>(all.size()),
        "a file has as many points as it declares");
  return all;
}

absl::StatusOr<PointCloud> ReadFile(
    absl::StatusOr<std::unique_ptr<PointReader>> reader, size_t batch_points) {
  MAPSIEVE_RETURN_IF_ERROR(reader.status());
  return ReadAll(**reader, batch_points);
}

void CheckRefusal(const absl::Status& status,
                  const std::filesystem::path& path) {
  const std::string message(status.message());
  Check(absl::IsDataLoss(status) || absl::IsInvalidArgument(status) ||
            absl::IsUnimplemented(status),
        "a refusal has one of the codes of OpenPointFile", status.ToString());
  Check(message.starts_with(path.string()), "a message begins with the file",
        message);
  Check(std::none_of(message.begin(), message.end(),
                     [](unsigned char c) { return c < ' ' || c == 0x7F; }),
        "a message is one line of text", message);
}

/// Whether row `i` of `back` is what a file holds for that of `column`.
bool SameValue(const Column& column, const Column& back, size_t i) {
  if (column.IsMissing(i)) {
    if (!IsFloating(back.type())) return back.GetAsDouble(i) == 0;
    // A column of text knows no types.
    return back.IsMissing(i) || std::isnan(back.GetAsDouble(i)) ||
           (!IsFloating(column.type()) && back.GetAsDouble(i) == 0);
  }
  const double value = column.GetAsDouble(i);
  const double read = back.GetAsDouble(i);
  if (std::isnan(value)) return back.IsMissing(i) || std::isnan(read);
  if (back.IsMissing(i)) return false;
  if (column.type() == ScalarType::kFloat32) {
    return static_cast<float>(value) == static_cast<float>(read);
  }
  return value == read;
}

/// Whether `back` lies within half a step of `value`, but for rounding on the
/// way through the largest of the coordinates.
bool IsNear(double value, double back, double step, double largest) {
  constexpr double kRounding = 8 * std::numeric_limits<double>::epsilon();
  return std::abs(value - back) <= step / 2 * (1 + 1e-9) + kRounding * largest;
}

void CheckPositions(const PointCloud& cloud, const PointCloud& back,
                    double step) {
  Check(cloud.size() == back.size(), "all points that were written are read");
  for (const auto axis : {&Point3::x, &Point3::y, &Point3::z}) {
    double largest = 0;
    for (const Point3& p : cloud.positions) {
      largest = std::max(largest, std::abs(p.*axis));
    }
    for (size_t i = 0; i < cloud.size(); ++i) {
      const double value = cloud.positions[i].*axis;
      const double read = back.positions[i].*axis;
      Check(value == read || (std::isnan(value) && std::isnan(read)) ||
                (step > 0 && IsNear(value, read, step, largest)),
            "a position that was written is read",
            std::to_string(value) + " and " + std::to_string(read));
    }
  }
}

/// A writer refuses `cloud` or writes a file that holds it.
void CheckWriter(const PointCloud& cloud, const PointFileInfo& info,
                 const std::filesystem::path& path) {
  const bool is_las = path.extension() == ".las";
  WriteOptions options{
      .coordinate_step = 0, .crs_wkt = info.crs_wkt, .frame_id = info.frame_id};
  if (is_las) {
    options.coordinate_step =
        info.coordinate_step > 0 ? info.coordinate_step : 0.001;
  }
  const absl::Status written = WritePointFile(path, cloud, options);
  if (!written.ok()) {
    Check(absl::IsInvalidArgument(written),
          "a writer refuses only what its format does not hold",
          written.ToString());
    return;
  }
  const auto back = ReadFile(OpenPointFile(path), kBatchPoints);
  Check(back.ok(), "what was written is read", back.status().ToString());
  CheckPositions(cloud, *back, options.coordinate_step);
  const std::vector<Column>& columns = cloud.attributes.columns();
  const std::vector<Column>& read = back->attributes.columns();
  Check(is_las || columns.size() == read.size(),
        "all attributes that were written are read");
  for (size_t k = 0; k < columns.size(); ++k) {
    // LAS has attributes of its own, the others change blanks in names.
    const Column* found =
        is_las ? back->attributes.Find(columns[k].name()) : &read[k];
    Check(found != nullptr, "an attribute that was written is read",
          columns[k].name());
    for (size_t i = 0; i < cloud.size(); ++i) {
      Check(SameValue(columns[k], *found, i),
            "a value that was written is read",
            path.string() + " " + columns[k].name() + ": " +
                std::to_string(columns[k].GetAsDouble(i)) + " and " +
                std::to_string(found->GetAsDouble(i)));
    }
  }
}

void CheckFile(std::string_view bytes) {
  static const mapsieve::testing::TemporaryDirectory folder;
  const std::filesystem::path path = folder / "input";
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;

  const auto reader = format->open(path);
  if (!reader.ok()) return CheckRefusal(reader.status(), path);
  const auto cloud = ReadAll(**reader, kBatchPoints);
  const auto by_threes = ReadFile(format->open(path), 3);
  Check(cloud.ok() == by_threes.ok(), "batches do not decide what is damaged");
  if (!cloud.ok()) return CheckRefusal(cloud.status(), path);
  Check(SameBits(cloud->positions, by_threes->positions) &&
            cloud->attributes == by_threes->attributes,
        "the points do not depend on the batches");
  for (const char* const name : {"written.las", "written.pcd", "written.ply",
                                 "written.csv", "written.xyz"}) {
    CheckWriter(*cloud, (*reader)->info(), folder / name);
  }
}

}  // namespace
}  // namespace mapsieve::client

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  using mapsieve::client::kFormats;
  constexpr std::string_view kOption = "--format=";
  for (int i = 1; i < *argc; ++i) {
    const std::string_view argument = (*argv)[i];
    if (!argument.starts_with(kOption)) continue;
    for (const auto& known : kFormats) {
      if (known.name == argument.substr(kOption.size())) {
        mapsieve::client::format = &known;
      }
    }
  }
  mapsieve::testing::Check(mapsieve::client::format != nullptr,
                           "--format names a format");
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  mapsieve::client::CheckFile({reinterpret_cast<const char*>(data), size});
  return 0;
}
