#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/cli/commands.h"
#include "client/cli/output.h"
#include "client/cli/progress_bar.h"
#include "client/cli/sample_report.h"
#include "client/formats/point_file.h"
#include "client/lab/room_survey.h"
#include "core/base/executor.h"
#include "core/base/status.h"
#include "core/sampling/sampler.h"
#include "core/spdf/cloud_filter.h"

namespace mapsieve::client {
namespace {

/// Points read or written at a time.
constexpr size_t kBatchPoints = 262144;

class Stopwatch {
 public:
  /// Seconds since the last lap.
  double Lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - last_).count();
    last_ = now;
    return RoundSeconds(seconds);
  }

 private:
  std::chrono::steady_clock::time_point last_ =
      std::chrono::steady_clock::now();
};

struct Sample {
  core::CloudSample of_cloud;
  core::RefusedCounts refused;
  /// Of methods without rounds: the sample's size.
  int64_t points_after_rounds = 0;
  /// From points in file order to the sample, all of it.
  double filter_s = 0;
  std::optional<FilterReport> report;
};

core::Lattice LatticeOf(const SampleCommand& command) {
  return core::Lattice(
      static_cast<int64_t>(std::nearbyint(command.step * 1e9)));
}

/// A line where the CRS of an input is not read whole.
void TellCrsProblem(const std::string& path, const PointFileInfo& info) {
  if (info.crs_problem.empty()) return;
  std::fprintf(stderr, "mapsieve: %s: the CRS is not read whole: %s\n",
               path.c_str(), info.crs_problem.c_str());
}

absl::StatusOr<Sample> TakeSample(core::PointCloud input,
                                  const SampleCommand& command,
                                  Executor& executor) {
  Sample sample;
  Stopwatch stopwatch;
  const core::LatticeCloud cloud = core::Quantize(
      std::move(input), LatticeOf(command), sample.refused, executor);
  const double quantize_s = stopwatch.Lap();
  {
    ProgressBar bar("sample", "visits");
    MAPSIEVE_ASSIGN_OR_RETURN(
        sample.of_cloud,
        core::Sample(cloud, command.sampler,
                     {.executor = &executor, .progress = &bar}));
  }
  const double sample_s = stopwatch.Lap();
  sample.filter_s = RoundSeconds(quantize_s + sample_s);
  const std::optional<core::FilteredCloud>& filtered = sample.of_cloud.filtered;
  sample.points_after_rounds =
      filtered.has_value() ? filtered->summary.survivor_count
                           : static_cast<int64_t>(sample.of_cloud.rows.size());
  if (!command.report.empty()) {
    core::SpdfOptions spdf = command.sampler.spdf;
    spdf.density_radius_m = sample.of_cloud.parameter;
    MAPSIEVE_ASSIGN_OR_RETURN(
        sample.report, CompareRules(cloud, *std::move(sample.of_cloud.filtered),
                                    sample_s, spdf, executor));
  }
  sample.of_cloud.filtered.reset();
  return sample;
}

/// Copies a file in batches.
absl::StatusOr<int64_t> Copy(PointReader& reader, PointWriter& writer,
                             ProgressSink& progress) {
  int64_t count = 0;
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud batch,
                              reader.ReadBatch(kBatchPoints));
    if (batch.size() == 0) return count;
    MAPSIEVE_RETURN_IF_ERROR(writer.Write(batch));
    count += static_cast<int64_t>(batch.size());
    progress.Report(count, reader.info().point_count.value_or(0));
  }
}

}  // namespace

absl::Status SampleCommand::Validate() const {
  if (!(step >= 1e-9 && step <= 1)) {
    return absl::InvalidArgumentError(
        absl::StrCat("--step is ", step, "; it must be 1e-9 to 1"));
  }
  if (!report.empty() && sampler.method != core::SampleMethod::kSpdf) {
    return absl::InvalidArgumentError("--report needs --method spdf");
  }
  return sampler.Validate(LatticeOf(*this));
}

absl::Status RunSample(const CommonOptions& common,
                       const SampleCommand& command) {
  Stopwatch stopwatch;
  const ReadOptions read_options = {.column_names = command.column_names};
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<PointReader> reader,
                            OpenPointFile(command.input, read_options));
  const PointFileInfo info = reader->info();
  TellCrsProblem(command.input, info);
  MAPSIEVE_ASSIGN_OR_RETURN(core::PointCloud input,
                            ReadPointFile(command.input, read_options));
  const size_t points_in = input.size();
  const double read_s = stopwatch.Lap();
  const std::unique_ptr<Executor> workers = MakeWorkerPool(command.threads);
  MAPSIEVE_ASSIGN_OR_RETURN(const Sample sample,
                            TakeSample(std::move(input), command, *workers));
  const core::CloudSample& chosen = sample.of_cloud;
  core::LabelCounts label_counts{};
  for (const core::Label label : chosen.columns.label) {
    ++label_counts[static_cast<size_t>(label)];
  }
  stopwatch.Lap();
  MAPSIEVE_RETURN_IF_ERROR(
      WritePointFile(command.output, core::ToPointCloud(chosen.cloud),
                     {.coordinate_step = chosen.cloud.lattice.step(),
                      .crs_wkt = info.crs_wkt,
                      .frame_id = info.frame_id}));
  Json result = {
      {"method", std::string(core::SampleMethodName(command.sampler.method))},
      {"parameter", chosen.parameter},
      {"points_in", points_in},
      {"refused_non_finite_count", sample.refused.non_finite},
      {"refused_out_of_lattice_count", sample.refused.out_of_lattice},
      {"points_after_rounds", sample.points_after_rounds},
      {"points_out", chosen.cloud.size()},
      {"label_counts", LabelCountsJson(label_counts)},
      {"read_s", read_s},
      {"filter_s", sample.filter_s},
      {"write_s", stopwatch.Lap()},
      {"peak_rss_bytes", PeakRssBytes()},
      {"output", command.output}};
  if (sample.report) {
    MAPSIEVE_RETURN_IF_ERROR(WriteReport(*sample.report, command.report));
    result["report"] = command.report;
  }
  PrintResult(common.json, result);
  return absl::OkStatus();
}

absl::Status RunConvert(const CommonOptions& common,
                        const ConvertCommand& command) {
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::unique_ptr<PointReader> reader,
      OpenPointFile(command.input, {.column_names = command.column_names}));
  const PointFileInfo& info = reader->info();
  TellCrsProblem(command.input, info);
  WriteOptions options = {.attributes = info.attributes,
                          .crs_wkt = info.crs_wkt,
                          .frame_id = info.frame_id};
  if (info.coordinate_step > 0) {
    options.coordinate_step = info.coordinate_step;
  } else if (std::filesystem::path(command.output).extension() != ".las") {
    options.coordinate_step = 0;  // all digits, where the format has no scale
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<PointWriter> writer,
                            CreatePointFile(command.output, options));
  int64_t count = 0;
  {
    ProgressBar bar("convert", "points");
    MAPSIEVE_ASSIGN_OR_RETURN(count, Copy(*reader, *writer, bar));
  }
  MAPSIEVE_RETURN_IF_ERROR(writer->Finish());
  PrintResult(common.json, {{"input", command.input},
                            {"format", info.format},
                            {"point_count", count},
                            {"output", command.output}});
  return absl::OkStatus();
}

absl::Status RunRender(const CommonOptions& common,
                       const RenderCommand& command) {
  std::vector<RenderPanel> panels;
  for (const std::string& input : command.inputs) {
    // A file that exists is meant as it stands, even with a "=" in its name.
    const size_t equals = input.find('=');
    if (equals == std::string::npos || std::filesystem::exists(input)) {
      panels.push_back({"", input});
    } else {
      panels.push_back({input.substr(0, equals), input.substr(equals + 1)});
    }
  }
  {
    ProgressBar bar("render", "points");
    MAPSIEVE_RETURN_IF_ERROR(RenderComparison(
        panels, command.output, command.options, {.progress = &bar}));
  }
  PrintResult(common.json, {{"output", command.output}});
  return absl::OkStatus();
}

absl::Status RunSimulate(const CommonOptions& common,
                         const SimulateCommand& command) {
  Stopwatch stopwatch;
  MAPSIEVE_RETURN_IF_ERROR(command.options.Validate());
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::unique_ptr<PointWriter> writer,
      CreatePointFile(command.output, command.rooms ? RoomWriteOptions()
                                                    : SimulatedWriteOptions()));
  {
    ProgressBar bar("simulate", "points");
    const auto simulate = command.rooms ? SimulateRooms : Simulate;
    MAPSIEVE_RETURN_IF_ERROR(
        simulate(command.options, *writer, {.progress = &bar}));
  }
  PrintResult(common.json, {{"point_count", command.options.point_count},
                            {"seed", command.options.seed},
                            {"simulate_s", stopwatch.Lap()},
                            {"peak_rss_bytes", PeakRssBytes()},
                            {"output", command.output}});
  return absl::OkStatus();
}

}  // namespace mapsieve::client
