// Times the filter against one plain nanoflann pass over the same points, in
// one run, and prints a table.
//   filter_bench [--repeats N] [--threads N] [--rho M] [--sigma M2] [--reach M]
//                [--neighbors K] [--label-neighbors K]
//                [--kernels Portable|Avx2|Avx512] CLOUD…
// CLOUD is campus:N (N points of the simulated campus), campus:N:S (a rotation
// every S metres: dense near the scanner as a standing scan is), or a file:
// *.bin is float32 x y z, the rest by its extension.
#include <malloc.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>
#include <vector>

#include "client/formats/point_file.h"
#include "client/lab/simulate.h"
#include "core/base/heap.h"
#include "core/cloud/merge_duplicates.h"
#include "core/spdf/cloud_filter.h"
#include "core/spdf/kernels.h"
#include "core/spdf/work_unit.h"
#include "tests/bench/bench_util.h"
#include "tests/bench/nanoflann_pass.h"

namespace mapsieve::bench {
namespace {

struct BenchOptions {
  int repeats = 5;
  int threads = 2;
  core::SpdfOptions spdf = {.density_radius_m = 0.2};
  std::string kernels;
  std::vector<std::string> clouds;
  /// Filter the one cloud and print what it needs of memory.
  bool memory = false;
};

std::vector<core::Point3> Simulated(const std::string& spec) {
  client::SimulateOptions options;
  const size_t colon = spec.find(':');
  options.point_count = std::atoll(spec.substr(0, colon).c_str());
  if (colon != std::string::npos) {
    options.rotation_spacing_m = std::atof(spec.substr(colon + 1).c_str());
  }
  return SimulatedPoints(options);
}

std::vector<core::Point3> ReadCloud(const std::string& name) {
  constexpr std::string_view kCampus = "campus:";
  if (name.starts_with(kCampus)) {
    return Simulated(name.substr(kCampus.size()));
  }
  if (!name.ends_with(".bin")) {
    return ValueOrDie(client::ReadPointFile(name, {})).positions;
  }
  std::ifstream file(name, std::ios::binary);
  if (!file) Fail(name + ": cannot be opened");
  std::vector<core::Point3> points;
  std::array<float, 3> p;
  while (file.read(reinterpret_cast<char*>(p.data()), sizeof(p))) {
    points.push_back({p[0], p[1], p[2]});
  }
  return points;
}

struct FilterRun {
  core::SpdfSummary summary;
  size_t inliers = 0;
};

/// From points in file order to labelled output: DESIGN's filter_s.
FilterRun Filter(std::vector<core::Point3> points,
                 const core::SpdfOptions& options, Executor& executor) {
  core::RefusedCounts refused;
  const core::LatticeCloud cloud = core::Quantize(
      {std::move(points), {}}, core::Lattice(), refused, executor);
  const core::FilteredCloud filtered =
      ValueOrDie(core::FilterCloud(cloud, options, {.executor = &executor}));
  return {filtered.summary, filtered.Inliers(options.outlier_share).size()};
}

/// The distinct lattice points in Morton order.
std::vector<core::LatticePoint> Distinct(
    const std::vector<core::Point3>& points) {
  core::RefusedCounts refused;
  return core::DistinctPoints(
      core::Quantize({points, {}}, core::Lattice(), refused).positions);
}

/// Distinct points relative to the first.
std::vector<std::array<float, 3>> Relative(
    const std::vector<core::LatticePoint>& distinct) {
  std::vector<std::array<float, 3>> sorted;
  const core::LatticePoint origin = distinct.at(0);
  const double step = core::Lattice().step();
  for (const core::LatticePoint& q : distinct) {
    sorted.push_back({static_cast<float>(double(q.x - origin.x) * step),
                      static_cast<float>(double(q.y - origin.y) * step),
                      static_cast<float>(double(q.z - origin.z) * step)});
  }
  return sorted;
}

/// Rule quota's counting pass alone, tree included.
double CountingPassSeconds(const std::vector<core::LatticePoint>& distinct,
                           const core::SpdfOptions& options) {
  const core::SpdfConstants constants =
      core::MakeSpdfConstants(options, core::Lattice());
  core::WorkUnit unit(distinct.front(), options, constants);
  unit.Grow(distinct.size(), /*is_core=*/true);
  unit.SetPoints(0, distinct);
  return Seconds([&] {
    if (!unit.RunQuota(constants.density_d2, {}).ok())
      Fail("the counting pass failed");
  });
}

/// Peak of the resident set since the start or the last ForgetPeak.
int64_t PeakBytes() {
  std::ifstream status("/proc/self/status");
  std::string word;
  while (status >> word) {
    int64_t kilobytes = 0;
    if (word == "VmHWM:" && status >> kilobytes) return kilobytes * 1024;
  }
  Fail("/proc/self/status has no VmHWM");
}

/// What reading the cloud needed is not the filter's.
void ForgetPeak() {
  malloc_trim(0);
  std::ofstream("/proc/self/clear_refs") << "5";
}

/// Bytes a point at peak, input included, in a process of its own.
double PeakBytesPerPoint(const char* program, const std::string& cloud,
                         const BenchOptions& options) {
  const std::string command =
      std::string(program) + " --memory --rho " +
      std::to_string(options.spdf.density_radius_m) + " --sigma " +
      std::to_string(options.spdf.vote_scale_m2) + " --reach " +
      std::to_string(options.spdf.reach_m) + " --neighbors " +
      std::to_string(options.spdf.neighbor_count) + " --label-neighbors " +
      std::to_string(options.spdf.label_neighbor_count) + " --threads " +
      std::to_string(options.threads) +
      (options.kernels.empty() ? "" : " --kernels " + options.kernels) + " '" +
      cloud + "'";
  FILE* pipe = popen(command.c_str(), "r");
  double value = 0;
  if (pipe == nullptr || std::fscanf(pipe, "%lf", &value) != 1) {
    Fail("cannot run " + command);
  }
  pclose(pipe);
  return value;
}

void PrintMemory(const BenchOptions& options) {
  const int64_t empty = PeakBytes();
  std::vector<core::Point3> points = ReadCloud(options.clouds.at(0));
  const auto count = static_cast<double>(points.size());
  points.shrink_to_fit();
  ForgetPeak();
  const std::unique_ptr<Executor> workers = MakeWorkerPool(options.threads);
  Filter(std::move(points), options.spdf, *workers);
  std::cout << static_cast<double>(PeakBytes() - empty) / count << "\n";
}

void Bench(const char* program, const std::string& name,
           const BenchOptions& options) {
  const std::vector<core::Point3> points = ReadCloud(name);
  const std::vector<core::LatticePoint> distinct = Distinct(points);
  const std::vector<std::array<float, 3>> sorted = Relative(distinct);
  const std::unique_ptr<Executor> workers = MakeWorkerPool(options.threads);
  core::SpdfOptions quota = options.spdf;
  quota.rule = core::DensityRule::kQuota;
  core::SpdfOptions default_reach = options.spdf;
  default_reach.reach_m = core::SpdfOptions().reach_m;
  std::vector<double> pass_s;
  std::vector<double> one_s;
  std::vector<double> all_s;
  std::vector<double> quota_s;
  std::vector<double> count_s;
  std::vector<double> default_reach_s;
  double default_reach_votes = 0;
  FilterRun run;
  double sum = 0;
  // The filter takes its input over; the copy is not its work.
  const auto filter_s = [&](const core::SpdfOptions& spdf, Executor& executor) {
    std::vector<core::Point3> input = points;
    return Seconds([&] { run = Filter(std::move(input), spdf, executor); });
  };
  for (int i = 0; i < options.repeats; ++i) {
    pass_s.push_back(Seconds(
        [&] { sum += NanoflannPass(sorted, options.spdf.neighbor_count); }));
    count_s.push_back(CountingPassSeconds(distinct, quota));
    quota_s.push_back(filter_s(quota, InlineExecutor()));
    all_s.push_back(filter_s(options.spdf, *workers));
    default_reach_s.push_back(filter_s(default_reach, InlineExecutor()));
    default_reach_votes = static_cast<double>(run.summary.vote_count);
    one_s.push_back(filter_s(options.spdf, InlineExecutor()));
  }
  if (!(sum > 0)) Fail(name + ": no neighbours");
  const double pass = Median(pass_s);
  const auto votes = static_cast<double>(run.summary.vote_count);
  std::printf(
      "| %s | %lld | %.3f | %.3f | %.2f | %.2f | %+.1f | %+.1f | %.1f | %.2f | "
      "%.2f | %.2f | %.0f | %lld | %zu |\n",
      name.substr(name.rfind('/') + 1).c_str(),
      static_cast<long long>(run.summary.point_count), pass, Median(one_s),
      Median(one_s) / pass, Median(default_reach_s) / pass,
      (Median(default_reach_s) / Median(one_s) - 1) * 100,
      (default_reach_votes / votes - 1) * 100, Median(one_s) / votes * 1e9,
      Median(one_s) / Median(all_s), Median(quota_s) / pass,
      Median(count_s) / pass, PeakBytesPerPoint(program, name, options),
      static_cast<long long>(run.summary.survivor_count), run.inliers);
  std::fflush(stdout);
}

/// Filters with the version named; the fastest for none.
void ChooseKernels(const std::string& name) {
  if (name.empty()) return;
  int count = 0;
  const core::Kernels* const* kernels = core::AvailableKernels(&count);
  for (int i = 0; i < count; ++i) {
    if (name == kernels[i]->name) return core::UseKernels(*kernels[i]);
  }
  Fail("this processor has no kernels " + name);
}

BenchOptions ParseOptions(int argc, char** argv) {
  BenchOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view arg = argv[i];
    const auto value = [&] {
      if (i + 1 >= argc) Fail(std::string(arg) + " needs a value");
      return std::atof(argv[++i]);
    };
    if (arg == "--memory") {
      options.memory = true;
    } else if (arg == "--repeats") {
      options.repeats = static_cast<int>(value());
    } else if (arg == "--threads") {
      options.threads = static_cast<int>(value());
    } else if (arg == "--rho") {
      options.spdf.density_radius_m = value();
    } else if (arg == "--sigma") {
      options.spdf.vote_scale_m2 = value();
    } else if (arg == "--reach") {
      options.spdf.reach_m = value();
    } else if (arg == "--neighbors") {
      options.spdf.neighbor_count = static_cast<int>(value());
    } else if (arg == "--label-neighbors") {
      options.spdf.label_neighbor_count = static_cast<int>(value());
    } else if (arg == "--kernels" && i + 1 < argc) {
      options.kernels = argv[++i];
    } else if (arg.starts_with("--")) {
      Fail("unknown option " + std::string(arg));
    } else {
      options.clouds.emplace_back(arg);
    }
  }
  if (options.clouds.empty()) Fail("name a cloud: campus:N or a file");
  return options;
}

}  // namespace
}  // namespace mapsieve::bench

int main(int argc, char** argv) {
  mapsieve::ReturnFreedBlocks();
  using namespace mapsieve::bench;
  const BenchOptions options = ParseOptions(argc, argv);
  ChooseKernels(options.kernels);
  if (options.memory) {
    PrintMemory(options);
    return 0;
  }
  std::printf(
      "| cloud | distinct points | nanoflann pass s | filter s | ratio | "
      "default reach: ratio | %% more time | %% more votes | ns per vote | "
      "%d threads: times faster | quota: ratio | "
      "its counting pass | peak bytes/point | after rounds | after outliers "
      "|\n|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
      options.threads);
  for (const std::string& cloud : options.clouds) {
    Bench(argv[0], cloud, options);
  }
}
