#include "client/formats/point_file.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/csv_file.h"
#include "client/formats/file_input.h"
#include "client/formats/las_file.h"
#include "client/formats/pcd_file.h"
#include "client/formats/ply_file.h"
#include "client/formats/text_numbers.h"
#include "client/formats/vtk_file.h"
#include "core/base/status.h"

namespace mapsieve::client {
namespace {

enum class Kind {
  kUnknown,
  kLas,
  kLaz,
  kPcd,
  kPly,
  kCsv,
  kVtk,
  kXmlVtk,
  kE57,
  kPts,
  kPtx,
};

Kind KindOfContent(std::string_view first_bytes) {
  if (first_bytes.starts_with("LASF")) return Kind::kLas;
  if (first_bytes.starts_with("ASTM-E57")) return Kind::kE57;
  if (first_bytes.starts_with("# .PCD")) return Kind::kPcd;
  if (first_bytes.starts_with("# vtk DataFile")) return Kind::kVtk;
  if (first_bytes.starts_with("ply\n") || first_bytes.starts_with("ply\r")) {
    return Kind::kPly;
  }
  return Kind::kUnknown;
}

Kind KindOfExtension(const std::filesystem::path& path) {
  const std::string extension = ToLower(path.extension().string());
  if (extension == ".las") return Kind::kLas;
  if (extension == ".laz") return Kind::kLaz;
  if (extension == ".pcd") return Kind::kPcd;
  if (extension == ".ply") return Kind::kPly;
  if (extension == ".csv" || extension == ".xyz" || extension == ".txt" ||
      extension == ".asc") {
    return Kind::kCsv;
  }
  if (extension == ".vtk") return Kind::kVtk;
  if (extension == ".vtp" || extension == ".vtu") return Kind::kXmlVtk;
  if (extension == ".e57") return Kind::kE57;
  if (extension == ".pts") return Kind::kPts;
  if (extension == ".ptx") return Kind::kPtx;
  return Kind::kUnknown;
}

// Why a format that is known is not read.
absl::Status RefuseToRead(const std::string& name, const char* format,
                          const char* hint) {
  return absl::UnimplementedError(absl::StrCat(
      name, ": ", format, " is not read; convert it first, e.g. with ", hint));
}

absl::Status RefuseToWrite(const std::string& name, const char* format) {
  return absl::UnimplementedError(absl::StrCat(
      name, ": ", format, " is not written; write .las, .ply, .pcd or .csv"));
}

}  // namespace

absl::StatusOr<std::unique_ptr<PointReader>> OpenPointFile(
    const std::filesystem::path& path, const ReadOptions& options) {
  constexpr size_t kMagicBytes = 16;
  std::string name;
  Kind kind = Kind::kUnknown;
  {
    MAPSIEVE_ASSIGN_OR_RETURN(const auto file, InputFile::Open(path));
    name = file->name();
    if (file->size() == 0) {
      return absl::DataLossError(
          absl::StrCat(name, ": the file is empty (0 bytes)"));
    }
    std::string first_bytes(
        std::min(kMagicBytes, static_cast<size_t>(file->size())), '\0');
    MAPSIEVE_RETURN_IF_ERROR(
        file->ReadAt(0, std::as_writable_bytes(std::span(first_bytes))));
    kind = KindOfContent(first_bytes);
  }
  if (kind == Kind::kUnknown) kind = KindOfExtension(path);
  switch (kind) {
    case Kind::kLas:
    case Kind::kLaz:  // the header tells whether it is compressed
      return OpenLasFile(path);
    case Kind::kPcd:
      return OpenPcdFile(path);
    case Kind::kPly:
      return OpenPlyFile(path);
    case Kind::kCsv:
      return OpenCsvFile(path, options);
    case Kind::kVtk:
      return OpenVtkFile(path);
    case Kind::kXmlVtk:
      return RefuseToRead(name, "VTK in XML",
                          "ParaView: save it as legacy ASCII VTK or as PLY");
    case Kind::kE57:
      return RefuseToRead(name, "E57",
                          "\"pdal translate IN.e57 OUT.las\" or CloudCompare");
    case Kind::kPts:
      return RefuseToRead(name, "PTS",
                          "\"pdal translate IN.pts OUT.las\" or CloudCompare");
    case Kind::kPtx:
      return RefuseToRead(name, "PTX",
                          "\"pdal translate IN.ptx OUT.las\" or CloudCompare");
    case Kind::kUnknown:
      break;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      name,
      ": not a kind of point file that is known, by its first bytes or "
      "its extension; LAS, PCD, PLY, CSV, XYZ and VTK are read"));
}

absl::StatusOr<std::unique_ptr<PointWriter>> CreatePointFile(
    const std::filesystem::path& path, const WriteOptions& options) {
  const std::string name = path.string();
  switch (KindOfExtension(path)) {
    case Kind::kLas:
      return CreateLasFile(path, options);
    case Kind::kPcd:
      return CreatePcdFile(path, options);
    case Kind::kPly:
      return CreatePlyFile(path, options);
    case Kind::kCsv:
      return CreateCsvFile(path, options);
    case Kind::kLaz:
      return RefuseToWrite(name, "LAZ");
    case Kind::kVtk:
    case Kind::kXmlVtk:
      return RefuseToWrite(name, "VTK");
    case Kind::kE57:
      return RefuseToWrite(name, "E57");
    case Kind::kPts:
      return RefuseToWrite(name, "PTS");
    case Kind::kPtx:
      return RefuseToWrite(name, "PTX");
    case Kind::kUnknown:
      break;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      name,
      ": the extension names no kind of point file; use .las, .pcd, "
      ".ply, .csv, .xyz or .txt"));
}

absl::StatusOr<core::PointCloud> ReadPointFile(
    const std::filesystem::path& path, const ReadOptions& options) {
  constexpr size_t kBatchPoints = size_t{1} << 20;
  MAPSIEVE_ASSIGN_OR_RETURN(const auto reader, OpenPointFile(path, options));
  MAPSIEVE_ASSIGN_OR_RETURN(core::PointCloud cloud,
                            reader->ReadBatch(kBatchPoints));
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud batch,
                              reader->ReadBatch(kBatchPoints));
    if (batch.size() == 0) return cloud;
    MAPSIEVE_RETURN_IF_ERROR(cloud.attributes.AppendAll(
        cloud.size(), batch.attributes, batch.size()));
    cloud.positions.insert(cloud.positions.end(), batch.positions.begin(),
                           batch.positions.end());
  }
}

absl::Status WritePointFile(const std::filesystem::path& path,
                            const core::PointCloud& cloud,
                            WriteOptions options) {
  options.attributes = cloud.attributes.specs();
  MAPSIEVE_ASSIGN_OR_RETURN(const auto writer, CreatePointFile(path, options));
  MAPSIEVE_RETURN_IF_ERROR(writer->Write(cloud));
  return writer->Finish();
}

}  // namespace mapsieve::client
