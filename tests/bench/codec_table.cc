// Prints, as markdown, how many bytes point blocks take and how fast they are
// written and read, beside other ways to store the same points.
//   codec_table [--repeats N] CLOUD…
// CLOUD is campus:N (N points of the simulated campus) or a file of points;
// its lattice has the step of the file, 1 mm where that has none. A campus is
// filtered too, for the columns of product chunks. Draco is measured where
// its programs (Debian package draco) are installed, LAZ where FILE.laz lies
// beside FILE.las. Times are processor time of one thread, medians.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <numeric>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "client/formats/point_file.h"
#include "client/lab/simulate.h"
#include "core/base/bytes.h"
#include "core/cloud/merge_duplicates.h"
#include "core/codec/block_head.h"
#include "core/codec/compression.h"
#include "core/codec/points_codec.h"
#include "core/spdf/cloud_filter.h"
#include "server/engine/product_chunk.h"
#include "tests/bench/bench_util.h"

namespace mapsieve::bench {
namespace {

namespace fs = std::filesystem;
using core::Compression;
using core::LatticeCloud;

constexpr std::array kCompressions = {Compression::kLz4, Compression::kZstd};

struct TableOptions {
  int repeats = 5;
  std::vector<std::string> clouds;
};

/// Median processor seconds of `work`.
double ProcessorSeconds(int repeats, const std::function<void()>& work) {
  std::vector<double> seconds;
  for (int i = 0; i < repeats; ++i) {
    const std::clock_t start = std::clock();
    work();
    seconds.push_back(static_cast<double>(std::clock() - start) /
                      CLOCKS_PER_SEC);
  }
  return std::max(Median(std::move(seconds)), 1e-6);
}

/// A folder for the files of other programs, removed with what is in it.
class WorkFolder {
 public:
  WorkFolder() {
    std::string path = (fs::temp_directory_path() / "codec_table.XXXXXX");
    if (mkdtemp(path.data()) == nullptr) Fail(path + ": cannot be made");
    path_ = path;
  }
  ~WorkFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  WorkFolder(const WorkFolder&) = delete;
  WorkFolder& operator=(const WorkFolder&) = delete;

  fs::path File(const char* name) const { return path_ / name; }

 private:
  fs::path path_;
};

struct Cloud {
  std::string name;
  /// The points in the order of the file.
  LatticeCloud points;
  /// The same points as a LAS file.
  std::vector<std::byte> las;
  std::optional<uint64_t> laz_bytes;
  bool is_campus = false;
};

std::vector<std::byte> ReadBytes(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) Fail(path.string() + ": cannot be opened");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const auto bytes = TextBytes(text);
  return {bytes.begin(), bytes.end()};
}

Cloud ReadCloud(const std::string& name, const WorkFolder& folder) {
  Cloud cloud;
  cloud.name = name;
  constexpr std::string_view kCampus = "campus:";
  core::PointCloud points;
  double step = core::Lattice().step();
  if (name.starts_with(kCampus)) {
    cloud.is_campus = true;
    const long long count = std::atoll(name.c_str() + kCampus.size());
    client::CampusScanner scanner =
        ValueOrDie(client::CampusScanner::Create({.point_count = count}));
    points = ValueOrDie(scanner.NextBatch(static_cast<size_t>(count)));
  } else {
    cloud.name = fs::path(name).filename().string();
    const auto reader = ValueOrDie(client::OpenPointFile(name));
    if (reader->info().coordinate_step > 0) {
      step = reader->info().coordinate_step;
    }
    points = ValueOrDie(client::ReadPointFile(name));
  }
  if (name.ends_with(".las")) {
    cloud.las = ReadBytes(name);
    const fs::path twin = fs::path(name).replace_extension(".laz");
    if (fs::exists(twin)) cloud.laz_bytes = fs::file_size(twin);
  } else {
    const fs::path las = folder.File("points.las");
    const absl::Status written =
        client::WritePointFile(las, points, {.coordinate_step = step});
    if (!written.ok()) Fail(written.ToString());
    cloud.las = ReadBytes(las);
  }
  core::RefusedCounts refused;
  cloud.points = core::Quantize(
      std::move(points), core::Lattice(std::llround(step * 1e9)), refused);
  return cloud;
}

LatticeCloud InMortonOrder(const LatticeCloud& cloud) {
  return cloud.Select(core::MortonOrder(cloud.positions));
}

LatticeCloud GeometryOf(const LatticeCloud& cloud) {
  return {cloud.lattice, cloud.positions, {}};
}

std::vector<std::byte> Encode(const LatticeCloud& cloud,
                              Compression compression) {
  return ValueOrDie(core::EncodePoints(cloud, {.compression = compression}));
}

double PerPoint(size_t bytes, const Cloud& cloud) {
  return static_cast<double>(bytes) / static_cast<double>(cloud.points.size());
}

double CompressedPerPoint(Compression compression, const Cloud& cloud) {
  return PerPoint(core::Compress(compression, cloud.las).size(), cloud);
}

// Draco.

struct DracoResult {
  size_t bytes = 0;
  double encode_s = 0;
  double decode_s = 0;
};

/// The milliseconds that a program of Draco says it took; nothing if it is
/// not there.
std::optional<double> DracoSeconds(const std::string& command) {
  std::FILE* const output = popen((command + " 2>/dev/null").c_str(), "r");
  if (output == nullptr) return std::nullopt;
  std::string text;
  std::array<char, 4096> part;
  while (const size_t size = fread(part.data(), 1, part.size(), output)) {
    text.append(part.data(), size);
  }
  const bool succeeded = pclose(output) == 0;
  const size_t ms = text.find(" ms to ");
  if (!succeeded || ms == std::string::npos) return std::nullopt;
  return std::atof(text.c_str() + text.rfind('(', ms) + 1) / 1e3;
}

/// Positions alone, as many bits an axis as the lattice needs; Draco's kd-tree
/// does not keep the order. Encoding with the best compression, level 10.
std::optional<DracoResult> RunDraco(const Cloud& cloud,
                                    const WorkFolder& folder) {
  const core::LatticePoint first = cloud.points.positions.front();
  int64_t range = 1;
  core::LatticePoint min = first;
  core::LatticePoint max = first;
  for (const core::LatticePoint& q : cloud.points.positions) {
    min = {std::min(min.x, q.x), std::min(min.y, q.y), std::min(min.z, q.z)};
    max = {std::max(max.x, q.x), std::max(max.y, q.y), std::max(max.z, q.z)};
  }
  range = std::max({max.x - min.x, max.y - min.y, max.z - min.z, range});
  const int bits = static_cast<int>(std::ceil(std::log2(range + 1)));
  const fs::path ply = folder.File("points.ply");
  std::ofstream file(ply, std::ios::binary);
  file << "ply\nformat binary_little_endian 1.0\nelement vertex "
       << cloud.points.size()
       << "\nproperty float x\nproperty float y\nproperty float z\n"
          "end_header\n";
  for (const core::LatticePoint& q : cloud.points.positions) {
    const std::array<float, 3> xyz = {static_cast<float>(q.x - min.x),
                                      static_cast<float>(q.y - min.y),
                                      static_cast<float>(q.z - min.z)};
    file.write(reinterpret_cast<const char*>(xyz.data()), sizeof(xyz));
  }
  file.close();
  const std::string coded = folder.File("points.drc");
  const auto encode_s = DracoSeconds("draco_encoder -point_cloud -cl 10 -qp " +
                                     std::to_string(bits) + " -i " +
                                     ply.string() + " -o " + coded);
  if (!encode_s.has_value()) return std::nullopt;
  const auto decode_s = DracoSeconds("draco_decoder -i " + coded + " -o " +
                                     folder.File("decoded.ply").string());
  if (!decode_s.has_value()) return std::nullopt;
  return DracoResult{fs::file_size(coded), *encode_s, *decode_s};
}

// Tables.

void PrintOptional(std::optional<double> value) {
  if (value.has_value()) {
    std::printf(" %.2f |", *value);
  } else {
    std::printf(" |");
  }
}

void PrintSizes(const std::vector<Cloud>& clouds,
                const std::vector<std::optional<DracoResult>>& draco) {
  std::printf(
      "Bytes per point.\n\n"
      "| cloud | points | LAS | LAS + LZ4 | LAS + zstd | LAZ | block, LZ4 | "
      "block, zstd | file order, LZ4 | file order, zstd | xyz, LZ4 | xyz, zstd "
      "| xyz, Draco |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  for (size_t i = 0; i < clouds.size(); ++i) {
    const Cloud& cloud = clouds[i];
    std::printf("| %s | %zu | %.2f | %.2f | %.2f |", cloud.name.c_str(),
                cloud.points.size(), PerPoint(cloud.las.size(), cloud),
                CompressedPerPoint(Compression::kLz4, cloud),
                CompressedPerPoint(Compression::kZstd, cloud));
    PrintOptional(cloud.laz_bytes.has_value()
                      ? std::optional(PerPoint(*cloud.laz_bytes, cloud))
                      : std::nullopt);
    const LatticeCloud sorted = InMortonOrder(cloud.points);
    for (const LatticeCloud& points :
         {sorted, cloud.points, GeometryOf(sorted)}) {
      for (const Compression compression : kCompressions) {
        PrintOptional(PerPoint(Encode(points, compression).size(), cloud));
      }
    }
    PrintOptional(draco[i].has_value()
                      ? std::optional(PerPoint(draco[i]->bytes, cloud))
                      : std::nullopt);
    std::printf("\n");
  }
}

/// Stored bits and transform of the columns of a block, by name in its order.
std::vector<std::pair<std::string, std::string>> ColumnBits(
    const LatticeCloud& points, Compression compression) {
  const std::vector<std::byte> block = Encode(points, compression);
  const core::BlockHead head = ValueOrDie(core::ReadBlockHead(block));
  const auto text = [&](uint64_t bytes, std::string_view transform) {
    std::array<char, 64> cell;
    std::snprintf(
        cell.data(), cell.size(), "%.2f %.*s",
        8.0 * static_cast<double>(bytes) / static_cast<double>(points.size()),
        static_cast<int>(transform.size()), transform.data());
    return std::string(cell.data());
  };
  std::vector<std::pair<std::string, std::string>> bits;
  uint64_t position_bytes = 0;
  for (size_t i = 0; i < head.position_column_count(); ++i) {
    position_bytes += head.columns[i].stored_bytes;
  }
  bits.emplace_back("xyz",
                    text(position_bytes,
                         core::TransformName(head.columns.front().transform)));
  for (const core::ColumnEntry& entry : head.attributes()) {
    bits.emplace_back(
        entry.spec.name,
        text(entry.stored_bytes, core::TransformName(entry.transform)));
  }
  bits.emplace_back("block", text(block.size(), ""));
  return bits;
}

void PrintColumns(const Cloud& cloud) {
  std::printf("\n%s: bits per point of each column.\n\n", cloud.name.c_str());
  std::printf(
      "| column | LZ4 | zstd | file order, LZ4 | file order, zstd |\n"
      "|---|---|---|---|---|\n");
  std::vector<std::vector<std::pair<std::string, std::string>>> tables;
  const LatticeCloud sorted = InMortonOrder(cloud.points);
  for (const LatticeCloud* points : {&sorted, &cloud.points}) {
    for (const Compression compression : kCompressions) {
      tables.push_back(ColumnBits(*points, compression));
    }
  }
  for (size_t row = 0; row < tables.front().size(); ++row) {
    std::printf("| %s |", tables.front()[row].first.c_str());
    for (const auto& table : tables) {
      std::printf(" %s |", table[row].second.c_str());
    }
    std::printf("\n");
  }
}

void PrintSpeed(const std::string& name, const LatticeCloud& points,
                const TableOptions& options) {
  const LatticeCloud sorted = InMortonOrder(points);
  const auto millions = [&](double seconds) {
    return static_cast<double>(points.size()) / seconds / 1e6;
  };
  for (const Compression compression : kCompressions) {
    const std::vector<std::byte> block = Encode(sorted, compression);
    const double with_sort_s = ProcessorSeconds(
        options.repeats, [&] { Encode(InMortonOrder(points), compression); });
    const double encode_s =
        ProcessorSeconds(options.repeats, [&] { Encode(sorted, compression); });
    const double decode_s = ProcessorSeconds(
        options.repeats, [&] { ValueOrDie(core::DecodePoints(block)); });
    const auto decoded_bytes = static_cast<size_t>(
        ValueOrDie(core::ReadBlockHeader(block)).decoded_bytes);
    const std::vector<std::byte> source(decoded_bytes, std::byte{1});
    std::vector<std::byte> target(decoded_bytes, std::byte{2});
    const double copy_s = ProcessorSeconds(options.repeats, [&] {
      std::memcpy(target.data(), source.data(), decoded_bytes);
      if (target.back() != source.back()) Fail("memcpy failed");
    });
    std::printf("| %s | %s | %.1f | %.1f | %.1f | %.1f |\n", name.c_str(),
                compression == Compression::kLz4 ? "LZ4" : "zstd",
                millions(with_sort_s), millions(encode_s), millions(decode_s),
                decode_s / copy_s);
  }
}

void PrintSpeeds(const std::vector<Cloud>& clouds,
                 const std::vector<std::optional<DracoResult>>& draco,
                 const TableOptions& options) {
  std::printf(
      "\nMillions of points a second, and the time of decoding over that of a "
      "memcpy of the decoded bytes.\n\n"
      "| cloud | compression | sort and encode | encode | decode | decode / "
      "memcpy |\n"
      "|---|---|---|---|---|---|\n");
  for (size_t i = 0; i < clouds.size(); ++i) {
    const Cloud& cloud = clouds[i];
    PrintSpeed(cloud.name + ", xyz", GeometryOf(cloud.points), options);
    PrintSpeed(cloud.name + ", all columns", cloud.points, options);
    if (draco[i].has_value()) {
      const auto count = static_cast<double>(cloud.points.size()) / 1e6;
      std::printf("| %s, xyz | Draco | | %.1f | %.1f | |\n", cloud.name.c_str(),
                  count / draco[i]->encode_s, count / draco[i]->decode_s);
    }
  }
}

/// The points that the filter leaves, as product chunks hold them, without
/// the attributes of the input.
void PrintProduct(const Cloud& cloud, const TableOptions& options) {
  const core::FilteredCloud filtered =
      ValueOrDie(core::FilterCloud(cloud.points, {.density_radius_m = 0.2}));
  LatticeCloud points = GeometryOf(cloud.points).Select(filtered.rows);
  const LatticeCloud product =
      engine::MakeProductCloud(std::move(points), filtered.columns.All());
  std::printf("\nProduct of %s, %zu points: bits per point.\n\n",
              cloud.name.c_str(), product.size());
  std::printf("| column | LZ4 | zstd |\n|---|---|---|\n");
  const auto lz4 = ColumnBits(product, Compression::kLz4);
  const auto zstd = ColumnBits(product, Compression::kZstd);
  for (size_t row = 0; row < lz4.size(); ++row) {
    std::printf("| %s | %s | %s |\n", lz4[row].first.c_str(),
                lz4[row].second.c_str(), zstd[row].second.c_str());
  }
  LatticeCloud served = GeometryOf(product);
  for (const auto name : {engine::kLabelColumn, engine::kConfidenceColumn,
                          engine::kNormalColumn}) {
    served.attributes.columns().push_back(*product.attributes.Find(name));
  }
  std::printf("\nxyz, label, confidence and normal: ");
  for (const Compression compression : kCompressions) {
    std::printf("%.2f bytes per point with %s%s",
                static_cast<double>(Encode(served, compression).size()) /
                    static_cast<double>(served.size()),
                compression == Compression::kLz4 ? "LZ4" : "zstd",
                compression == Compression::kLz4 ? ", " : ".\n\n");
  }
  std::printf(
      "| cloud | compression | sort and encode | encode | decode | decode / "
      "memcpy |\n"
      "|---|---|---|---|---|---|\n");
  PrintSpeed("product", product, options);
}

void PrintTables(const TableOptions& options) {
  const WorkFolder folder;
  std::vector<Cloud> clouds;
  std::vector<std::optional<DracoResult>> draco;
  for (const std::string& name : options.clouds) {
    clouds.push_back(ReadCloud(name, folder));
    draco.push_back(RunDraco(clouds.back(), folder));
  }
  PrintSizes(clouds, draco);
  PrintSpeeds(clouds, draco, options);
  for (const Cloud& cloud : clouds) PrintColumns(cloud);
  for (const Cloud& cloud : clouds) {
    if (cloud.is_campus) PrintProduct(cloud, options);
  }
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  mapsieve::bench::TableOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view arg = argv[i];
    if (arg == "--repeats" && i + 1 < argc) {
      options.repeats = std::atoi(argv[++i]);
    } else {
      options.clouds.emplace_back(arg);
    }
  }
  if (options.clouds.empty() || options.repeats < 1) {
    std::fprintf(stderr, "usage: %s [--repeats N] CLOUD...\n", argv[0]);
    return 2;
  }
  mapsieve::bench::PrintTables(options);
}
