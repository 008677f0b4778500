#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "client/cli/commands.h"
#include "client/lab/surveyed_pair.h"
#include "core/base/heap.h"

namespace mapsieve::client {
namespace {

using Run = std::function<absl::Status()>;

/// The options of a filter run, into any struct: each setter gets the value if
/// the option is given.
template <typename Options>
void AddFilterOptions(CLI::App& command, Options& options) {
  const auto add = [&](const char* name, auto& field, const char* help) {
    return command.add_option(name, field, help);
  };
  add("--rho,--density-radius", options.density_radius_m,
      "Radius of uniform density in map units, default 0.4");
  add("--sigma,--vote-scale", options.vote_scale_m2,
      "Vote kernel exp(-d^2 / sigma), in square map units, default 0.2");
  add("--neighbors", options.neighbor_count,
      "Neighbours that vote for a point (k), 6 to 127, default 50");
  add("--label-neighbors", options.label_neighbor_count,
      "Neighbours that vote for the label and normal of a point that stays, 6 "
      "to 127: more against noise; default those of --neighbors");
  add("--reach", options.reach_m,
      "Largest distance of a vote, default where the kernel falls to 0.001");
  add("--rounds", options.max_round_count,
      "Rounds of the rule paper at most, 0 to 15, default 10");
  add("--seed", options.seed, "Changes which points stay, default 0");
  add("--outlier-share", options.outlier_share,
      "Share of a label's largest confidence below which a point is an "
      "outlier, default 0.1");
}

/// Of a finite number above 0.
CLI::Validator Positive() {
  return CLI::Validator(
      [](const std::string& text) {
        double value = 0;
        if (CLI::detail::lexical_cast(text, value) && value > 0 &&
            std::isfinite(value)) {
          return std::string();
        }
        return absl::StrCat("expected a number above 0, have ", text);
      },
      "POSITIVE");
}

void AddColumnsOption(CLI::App& command, std::vector<std::string>& names) {
  command
      .add_option("--columns", names,
                  "Column names of CSV and XYZ files, comma-separated")
      ->delimiter(',');
}

CLI::Option* AddRuleOption(CLI::App& command, std::string& rule) {
  return command.add_option("--rule", rule, "Density rule, default paper")
      ->check(CLI::IsMember({"paper", "quota"}));
}

/// An option that takes one of some words, each of which means a value.
template <typename Value, typename Field>
CLI::Option* AddChoice(CLI::App& command, const char* name,
                       const std::map<std::string, Value>& choices,
                       Field& field, const char* help) {
  return command
      .add_option_function<std::string>(
          name,
          [choices, &field](const std::string& word) {
            field = choices.at(word);
          },
          help)
      ->check(CLI::IsMember(choices));
}

void AddCreate(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<CreateCommand>();
  CLI::App* command = app.add_subcommand("create", "Create an empty map");
  command->add_option("MAP", options->map, "Id of the map")->required();
  command->add_option("--step", options->step,
                      "Edge of a lattice cell in map units, default 0.001");
  command->add_option("--tile-edge", options->tile_edge,
                      "Edge of a processing tile in map units, rounded up to a "
                      "power of two of steps; results do not depend on it");
  command->add_option("--crs", options->crs,
                      "Coordinate reference system, EPSG:n, EPSG:n+m (m: "
                      "heights) or WKT, default "
                      "that of the first upload that names one; nothing is "
                      "converted");
  command->add_option("--frame-id", options->frame_id,
                      "What robots call the map's frame, for instance map; "
                      "default that of the first upload that names one");
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunCreate(common, *options); };
  });
}

void AddUploadOptions(CLI::App& command, UploadCommand& options) {
  command.add_flag("--process", options.process, "Run the filter after it");
  command.add_flag("--again", options.again,
                   "Add the points although they were uploaded before, for "
                   "instance after they were deleted");
  AddColumnsOption(command, options.column_names);
}

void AddUpload(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<UploadCommand>();
  CLI::App* command = app.add_subcommand(
      "upload", "Add point files to a map; again after a break, it resumes");
  command->add_option("MAP", options->map, "Id of the map")->required();
  command->add_option("FILE", options->files, "LAS, PCD, PLY, CSV, XYZ, VTK")
      ->required();
  AddUploadOptions(*command, *options);
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunUpload(common, *options); };
  });
}

/// The options of the region of an edit, one of which is needed.
class RegionOptions {
 public:
  void AddTo(CLI::App& command) {
    CLI::Option_group* group = command.add_option_group("Region");
    group->require_option(1);
    group->add_option("--box", box_, "x0 y0 z0 x1 y1 z1 in map units")
        ->expected(6)
        ->allow_extra_args(false);
    group->add_option("--sphere", sphere_, "x y z radius in map units")
        ->expected(4)
        ->allow_extra_args(false);
  }
  Region region() const {
    if (const std::vector<double>& b = box_; !b.empty()) {
      return BoxRegion{{b[0], b[1], b[2]}, {b[3], b[4], b[5]}};
    }
    const std::vector<double>& s = sphere_;
    return SphereRegion{{s[0], s[1], s[2]}, s[3]};
  }

 private:
  std::vector<double> box_;
  std::vector<double> sphere_;
};

void AddDeleteRegion(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<DeleteRegionCommand>();
  auto region = std::make_shared<RegionOptions>();
  CLI::App* command = app.add_subcommand(
      "delete-region",
      "Take the uploaded points of a region out of a map; process it after");
  command->add_option("MAP", options->map, "Id of the map")->required();
  region->AddTo(*command);
  command->callback([=, &common, &run] {
    options->region = region->region();
    run = [=, &common] { return RunDeleteRegion(common, *options); };
  });
}

void AddReplaceRegion(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<ReplaceRegionCommand>();
  auto region = std::make_shared<RegionOptions>();
  CLI::App* command = app.add_subcommand(
      "replace-region",
      "Put the points of files in the place of the uploaded points of a "
      "region, as one revision for all files; the same files again for the "
      "same region change nothing");
  command->add_option("MAP", options->upload.map, "Id of the map")->required();
  command
      ->add_option("FILE", options->upload.files,
                   "LAS, PCD, PLY, CSV, XYZ, VTK")
      ->required();
  region->AddTo(*command);
  AddUploadOptions(*command, options->upload);
  command->callback([=, &common, &run] {
    options->region = region->region();
    run = [=, &common] { return RunReplaceRegion(common, *options); };
  });
}

void AddRevisionCommands(CLI::App& app, const CommonOptions& common, Run& run) {
  auto rollback = std::make_shared<RollbackCommand>();
  CLI::App* command = app.add_subcommand(
      "rollback", "Make a new revision that equals an earlier one");
  command->add_option("MAP", rollback->map, "Id of the map")->required();
  command->add_option("--to", rollback->revision, "Number of that revision")
      ->required();
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunRollback(common, *rollback); };
  });
  auto revisions = std::make_shared<RevisionsCommand>();
  command = app.add_subcommand(
      "revisions", "List a map's revisions, newest first, or compare two");
  command->add_option("MAP", revisions->map, "Id of the map")->required();
  CLI::Option* compare =
      command
          ->add_option("--compare", revisions->compared,
                       "Numbers of two revisions: tells what changed")
          ->expected(2);
  command
      ->add_option("--tiles", revisions->tiles,
                   "With --compare: CSV file for the tiles that differ, by "
                   "their lowest corner in map units")
      ->needs(compare);
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunRevisions(common, *revisions); };
  });
  auto watch = std::make_shared<WatchCommand>();
  command = app.add_subcommand(
      "watch",
      "Print a line for each new revision of a map, until it is interrupted or "
      "the map is deleted");
  command->add_option("MAP", watch->map, "Id of the map")->required();
  command->add_option("--from", watch->from,
                      "Number of the first revision, at most one above the "
                      "newest; default the newest");
  command->add_option("--count", watch->count,
                      "End after so many revisions, default never");
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunWatch(common, *watch); };
  });
}

void AddVerify(CLI::App& app, const CommonOptions& common, Run& run) {
  // Of --tiling without a number.
  static constexpr int64_t kDefaultTiles = 16;
  auto verify = std::make_shared<VerifyCommand>();
  CLI::App* command = app.add_subcommand(
      "verify", "Read all that is stored of a map and tell what is damaged");
  command->add_option("MAP", verify->map, "Id of the map")->required();
  CLI::Option* tiling =
      command->add_flag("--tiling")
          ->description(
              "Also filter some tiles again, each with the points around it as "
              "one cloud, and compare");
  command
      ->add_option("--tiles", verify->compared_tile_count,
                   "With --tiling: how many tiles, evenly spread (default 16)")
      ->check(CLI::Range(int64_t{1}, int64_t{1'000'000}))
      ->needs(tiling);
  command->add_flag("--repair", verify->repair,
                    "Make damaged chunks of the filter's results again from "
                    "the uploaded points before, byte for byte");
  command->callback([=, &common, &run] {
    if (tiling->count() > 0 && verify->compared_tile_count == 0) {
      verify->compared_tile_count = kDefaultTiles;
    }
    run = [=, &common] { return RunVerify(common, *verify); };
  });
}

void AddProcess(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<ProcessCommand>();
  auto rule = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand(
      "process",
      "Run the filter over a map, with its last options if none "
      "are given");
  command->add_option("MAP", options->map, "Id of the map")->required();
  AddFilterOptions(*command, options->options);
  AddRuleOption(*command, *rule);
  command->add_flag("--no-wait", options->no_wait,
                    "Print the operation instead of waiting for it");
  command->callback([=, &common, &run] {
    if (!rule->empty()) options->options.quota_rule = *rule == "quota";
    run = [=, &common] { return RunProcess(common, *options); };
  });
}

/// The shapes of a query, of which one may be given.
void AddQueryRegion(CLI::App& command, RegionArguments& region) {
  constexpr int kMostNumbers = 3001;
  CLI::Option_group* shapes = command.add_option_group("Region");
  shapes->require_option(0, 1);
  const auto add = [&](const char* name, std::vector<double>& numbers,
                       int least, int most, const char* help) {
    return shapes->add_option(name, numbers, help)
        ->expected(least, most)
        ->allow_extra_args(false);
  };
  add("--box", region.box, 6, 6, "x0 y0 z0 x1 y1 z1 in map units");
  add("--sphere", region.sphere, 4, 4, "x y z radius in map units");
  add("--oriented-box", region.oriented_box, 7, 7,
      "x y z of the centre, length width height, degrees by which the length "
      "is turned from x to y");
  add("--cylinder", region.cylinder, 3, 3, "x y radius; upright");
  add("--polygon", region.polygon, 6, 2000,
      "x y of each vertex, 3 to 1000 of them; an upright prism");
  add("--frustum", region.frustum, 10, 10,
      "What a camera sees: its x y z, x y z that it looks at, vertical angle "
      "of "
      "view in degrees, width / height, nearest and farthest distance");
  add("--corridor", region.corridor, 7, kMostNumbers,
      "radius, then x y z of each point of a path, 2 to 1000 of them");
  command
      .add_option("--z-range", region.z_range,
                  "Least and largest z, of --cylinder and --polygon")
      ->expected(2)
      ->allow_extra_args(false);
}

void AddOriginOption(CLI::App& command, std::vector<double>& origin,
                     const std::string& description) {
  command.add_option("--origin", origin, description + "; default 0 0 0")
      ->expected(3)
      ->allow_extra_args(false);
}

/// 0 0 0 for nothing.
core::Point3 PointOf(const std::vector<double>& coordinates) {
  if (coordinates.empty()) return {};
  return {coordinates[0], coordinates[1], coordinates[2]};
}

void AddQuery(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<QueryCommand>();
  auto labels = std::make_shared<std::vector<std::string>>();
  CLI::App* command =
      app.add_subcommand("query", "Write the points of a region to a file");
  command->add_option("MAP", options->spec.map_id, "Id of the map")->required();
  AddQueryRegion(*command, options->region);
  CLI::Option* label_option =
      command
          ->add_option("--labels", *labels,
                       "Of junction, curve, surface; comma-separated")
          ->delimiter(',')
          ->check(CLI::IsMember({"junction", "curve", "surface"}));
  CLI::Option* confidence_option =
      command
          ->add_option("--confidence", options->confidence,
                       "Least and largest confidence, 0 to 1")
          ->expected(2)
          ->allow_extra_args(false);
  command
      ->add_option("--range", options->ranges,
                   "NAME MIN MAX: only points whose attribute lies between; "
                   "-inf and inf for no limit; may be given again")
      ->type_size(3)
      ->allow_extra_args(false);
  CLI::Option* budget_option = command->add_option(
      "--max-points", options->spec.max_point_count,
      "At most this many points, spread evenly over each label");
  budget_option->check(Positive());
  CLI::Option* bytes_option = command->add_option(
      "--max-bytes", options->spec.max_bytes,
      "At most this many bytes of encoded points, spread in the same way; at "
      "least 65536");
  bytes_option->check(Positive());
  command
      ->add_option("--weights", options->weights,
                   "Shares of the budget of junction, curve and surface, for "
                   "instance 1 1 2; default by their numbers of points")
      ->expected(3)
      ->allow_extra_args(false);
  command->add_flag("--centroids", options->spec.centroids,
                    "Under a budget: centroids instead of points");
  CLI::Option* depth_option = command->add_option(
      "--depth", options->spec.depth,
      "A level of detail: 0 all points, each further one to 10 with balls of "
      "twice the radius");
  depth_option->check(CLI::Range(0, 10));
  CLI::Option* spacing_option = command->add_option(
      "--spacing", options->spec.spacing_m,
      "The coarsest level of detail whose points on surfaces have at most this "
      "mean spacing, in map units: rho 2^level sqrt(pi / neighbors)");
  spacing_option->check(Positive())->excludes(depth_option);
  command->add_flag("--raw", options->spec.raw, "The points as uploaded")
      ->excludes(label_option)
      ->excludes(confidence_option)
      ->excludes(budget_option)
      ->excludes(bytes_option)
      ->excludes(depth_option)
      ->excludes(spacing_option);
  command
      ->add_option("--columns", options->columns,
                   "Comma-separated: label, confidence, normal, tangent, "
                   "eigenvalues, saliencies, covariance (for GICP), attributes "
                   "(all that were uploaded) or names of attributes; default "
                   "label,confidence,normal,attributes")
      ->delimiter(',');
  command->add_option("--revision", options->spec.revision,
                      "Default: the newest processed one");
  command->add_flag("--allow-partial", options->spec.allow_partial,
                    "Leave damaged chunks out, name each on stderr and exit 0, "
                    "instead of failing");
  auto origin = std::make_shared<std::vector<double>>();
  command
      ->add_option("--origin", *origin,
                   "x y z in map units that become 0 0 0, in a file with "
                   "float32 coordinates, which PCL insists on; default: "
                   "float64, as they are")
      ->expected(3)
      ->allow_extra_args(false);
  command->add_option("-o,--output", options->output, "LAS, PCD, PLY or CSV")
      ->required();
  command->callback([=, &common, &run] {
    const RegionArguments& region = options->region;
    if (!region.z_range.empty() && region.cylinder.empty() &&
        region.polygon.empty()) {
      throw CLI::RequiresError("--z-range", "--cylinder or --polygon");
    }
    if (options->spec.centroids && budget_option->count() == 0 &&
        bytes_option->count() == 0) {
      throw CLI::RequiresError("--centroids", "--max-points or --max-bytes");
    }
    if (!origin->empty()) options->origin = PointOf(*origin);
    for (const std::string& label : *labels) {
      for (const auto candidate : {core::Label::kJunction, core::Label::kCurve,
                                   core::Label::kSurface}) {
        if (core::LabelName(candidate) == label) {
          options->spec.labels.push_back(candidate);
        }
      }
    }
    run = [=, &common] { return RunQuery(common, *options); };
  });
}

void AddExport(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<ExportCommand>();
  auto origin = std::make_shared<std::vector<double>>();
  CLI::App* command = app.add_subcommand(
      "export", "Write the uploaded points of a region as an OctoMap");
  command->add_option("MAP", options->spec.map_id, "Id of the map")->required();
  AddQueryRegion(*command, options->region);
  command
      ->add_option("--occupancy", options->occupancy.voxel_edge,
                   "Edge of a voxel in map units; one that holds a point is "
                   "occupied, the others are unknown")
      ->required()
      ->check(Positive());
  AddOriginOption(*command, *origin,
                  "x y z in map units that become 0 0 0, which is at most 2^15 "
                  "voxels from any point");
  command->add_option("--revision", options->spec.revision,
                      "Default: the newest one");
  command
      ->add_option("-o,--output", options->output, ".bt, or .ot with log-odds")
      ->required();
  command->callback([=, &common, &run] {
    options->spec.raw = true;
    options->occupancy.origin = PointOf(*origin);
    run = [=, &common] { return RunExport(common, *options); };
  });
}

void AddSync(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<SyncCommand>();
  auto around = std::make_shared<std::vector<double>>();
  auto origin = std::make_shared<std::vector<double>>();
  CLI::App* command = app.add_subcommand(
      "sync", "Keep the tiles around a place as files; brings what changed");
  command->add_option("MAP", options->query.map_id, "Id of the map")
      ->required();
  command
      ->add_option("DIR", options->folder,
                   "Folder; DIR/current has the files, as Autoware's map "
                   "loader reads them")
      ->required();
  command
      ->add_option("--around", *around,
                   "x y z radius in map units; tiles that it reaches are whole")
      ->required()
      ->expected(4)
      ->allow_extra_args(false);
  command
      ->add_option("--depth", options->query.depth,
                   "A level of detail: 0 all points, to 10")
      ->check(CLI::Range(0, 10));
  AddOriginOption(*command, *origin, "x y z in map units that become 0 0 0");
  command->callback([=, &common, &run] {
    const std::vector<double>& a = *around;
    options->query.region = SphereRegion{{a[0], a[1], a[2]}, a[3]};
    options->origin = PointOf(*origin);
    run = [=, &common] { return RunSync(common, *options); };
  });
}

void AddMapCommands(CLI::App& app, const CommonOptions& common, Run& run) {
  auto map = std::make_shared<std::string>();
  auto force = std::make_shared<bool>(false);
  CLI::App* info = app.add_subcommand(
      "info", "Counts and sizes of a map, and its newest 20 revisions");
  info->add_option("MAP", *map, "Id of the map")->required();
  info->callback([=, &common, &run] {
    run = [=, &common] { return RunInfo(common, *map); };
  });
  CLI::App* list = app.add_subcommand("list", "List the maps");
  list->callback(
      [&common, &run] { run = [&common] { return RunList(common); }; });
  CLI::App* remove = app.add_subcommand("delete", "Remove a map for ever");
  remove->add_option("MAP", *map, "Id of the map")->required();
  remove->add_flag("--force", *force,
                   "Also with unfinished uploads or a running operation");
  remove->callback([=, &common, &run] {
    run = [=, &common] { return RunDelete(common, *map, *force); };
  });
}

void AddOperation(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<OperationCommand>();
  CLI::App* command = app.add_subcommand(
      "operation",
      "Wait for the end of what a map is busy with, as process --no-wait names "
      "it, or end it");
  command->add_option("OPERATION", options->operation, "Id of the operation")
      ->required();
  command->add_flag("--cancel", options->cancel,
                    "Stop it; the map stays as it was, unless it is done");
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunOperation(common, *options); };
  });
}

/// The parameters of the methods of `sample`, one of which `max_points` finds.
void AddSamplerOptions(CLI::App& command, core::SamplerOptions& sampler) {
  std::map<std::string, core::SampleMethod> methods;
  for (const core::SampleMethod method : core::kSampleMethods) {
    methods[std::string(core::SampleMethodName(method))] = method;
  }
  AddChoice(command, "--method", methods, sampler.method, "Default spdf");
  command
      .add_option("--max-points", sampler.max_points,
                  "Points wanted: exactly so many or all, of voxel and spdf "
                  "the nearest count below; in place of the parameter. "
                  "Needed by nss, covs and spatial-spdf")
      ->check(Positive());
  command.add_option("--keep-probability", sampler.keep_probability,
                     "Of random, up to 1");
  command.add_option("--max-density", sampler.max_density,
                     "Of max-density: points per cubic map unit");
  command.add_option("--max-cell-points", sampler.max_cell_points,
                     "Of ss-normal and octree: fuller cells are divided");
  command.add_option("--cell-edge", sampler.cell_edge_m,
                     "Of voxel, in map units; of octree: cells of this edge "
                     "are not divided");
  AddChoice(command, "--cell-split",
            std::map<std::string, core::CellSplit>{
                {"fullest", core::CellSplit::kFullest},
                {"midway", core::CellSplit::kMidway},
                {"widest", core::CellSplit::kWidest}},
            sampler.cell_split,
            "Of spatial-spdf, which cell is divided next: fullest (default, "
            "the paper's), midway, which counts points times the cell's edge, "
            "or widest, times its square; far places get more: better for "
            "registration");
  command.add_option("--ideal-share", sampler.ideal_share,
                     "Of spatial-spdf, in place of --outlier-share: share of "
                     "the confidence of an ideal shape of the label, at the "
                     "density aimed at, below which a point is an outlier; "
                     "0.02 for registration");
  CLI::Option* representative = AddChoice(
      command, "--representative",
      std::map<std::string, core::Representative>{
          {"first", core::Representative::kFirst},
          {"random", core::Representative::kRandom},
          {"centroid", core::Representative::kCentroid},
          {"medoid", core::Representative::kNearest},
          {"nearest", core::Representative::kNearest},
          {"surest", core::Representative::kSurest}},
      sampler.representative,
      "Of a cell, default: octree first, voxel centroid, ss-normal and "
      "spatial-spdf nearest (to the centroid), which is the medoid. Of "
      "spatial-spdf too surest: the nearest of the quarter with the largest "
      "confidences, better for registration");
  command
      .add_flag_callback(
          "--centroids",
          [&sampler] {
            sampler.representative = core::Representative::kCentroid;
          },
          "The same as --representative centroid")
      ->excludes(representative);
}

void AddSample(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<SampleCommand>();
  auto rule = std::make_shared<std::string>();
  core::SamplerOptions& sampler = options->sampler;
  CLI::App* command = app.add_subcommand(
      "sample", "Filter or sample a file in memory, without a server");
  command->add_option("INPUT", options->input, "LAS, PCD, PLY, CSV, XYZ, VTK")
      ->required();
  command->add_option("-o,--output", options->output, "LAS, PCD, PLY or CSV")
      ->required();
  AddSamplerOptions(*command, sampler);
  command->add_option("--step", options->step,
                      "Edge of a lattice cell in map units, default 0.001");
  AddFilterOptions(*command, sampler.spdf);
  AddRuleOption(*command, *rule);
  options->threads =
      static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  command->add_option("--threads", options->threads, "Default: one a processor")
      ->check(CLI::Range(1, 1024));
  command->add_option("--report", options->report,
                      "Of spdf: folder for a report on both density rules: "
                      "report.json, density and saliencies as .svg and .png");
  AddColumnsOption(*command, options->column_names);
  command->callback([=, &common, &run] {
    core::SamplerOptions& given = options->sampler;
    if (*rule == "quota") given.spdf.rule = core::DensityRule::kQuota;
    if (given.method == core::SampleMethod::kSpdf && given.max_points > 0 &&
        command->count("--rho") > 0) {
      throw CLI::ValidationError(
          "method spdf takes --max-points or --rho, "
          "not both");
    }
    const absl::Status valid = options->Validate();
    if (!valid.ok()) {
      throw CLI::ValidationError(std::string(valid.message()));
    }
    run = [=, &common] { return RunSample(common, *options); };
  });
}

void AddConvert(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<ConvertCommand>();
  CLI::App* command = app.add_subcommand(
      "convert", "Write a point file in another format, of any size");
  command->add_option("INPUT", options->input, "LAS, PCD, PLY, CSV, XYZ, VTK")
      ->required();
  command->add_option("OUTPUT", options->output, "LAS, PCD, PLY or CSV")
      ->required();
  AddColumnsOption(*command, options->column_names);
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunConvert(common, *options); };
  });
}

void AddRender(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<RenderCommand>();
  RenderOptions& render = options->options;
  CLI::App* command =
      app.add_subcommand("render", "Draw point files, side by side, as a PNG");
  command
      ->add_option("INPUT", options->inputs, "FILE or TITLE=FILE, a panel each")
      ->required();
  command->add_option("-o,--output", options->output, "A .png file")
      ->required();
  command->add_option("--view", render.view, "top or oblique, default top")
      ->transform(
          CLI::CheckedTransformer(std::map<std::string, RenderOptions::View>{
              {"top", RenderOptions::View::kTop},
              {"oblique", RenderOptions::View::kOblique}}));
  command->add_option("--color-by", render.color_by,
                      "auto, height or an attribute; default auto: label if "
                      "there is one, else height");
  command->add_option("--width", render.width, "Pixels, default 1600");
  command->add_option("--height", render.height,
                      "Pixels, default what the points ask for");
  command->add_option("--azimuth", render.azimuth_deg,
                      "Oblique: compass direction looked to, default 30");
  command->add_option("--elevation", render.elevation_deg,
                      "Oblique: degrees above the horizon, default 35");
  command->add_option("--point-size", render.point_size_px,
                      "Pixels, default what closes the surfaces");
  command->add_option("--background", render.background, "dark or light")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, RenderOptions::Background>{
              {"dark", RenderOptions::Background::kDark},
              {"light", RenderOptions::Background::kLight}}));
  command->add_option("--title", render.title, "Headline");
  auto box = std::make_shared<std::vector<double>>();
  command
      ->add_option("--box", *box,
                   "x0 y0 z0 x1 y1 z1 in map units: nothing outside is drawn, "
                   "for instance no ceiling")
      ->expected(6)
      ->allow_extra_args(false);
  command->callback([=, &common, &run] {
    if (const std::vector<double>& b = *box; !b.empty()) {
      options->options.box_min = {b[0], b[1], b[2]};
      options->options.box_max = {b[3], b[4], b[5]};
    }
    run = [=, &common] { return RunRender(common, *options); };
  });
}

void AddSimulate(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<SimulateCommand>();
  CLI::App* command = app.add_subcommand(
      "simulate",
      "Write a simulated survey of a campus or of rooms, of any size");
  command->add_option("OUTPUT", options->output, "LAS, PCD, PLY or CSV")
      ->required();
  command->add_flag("--rooms", options->rooms,
                    "Two furnished rooms, scanned from two places");
  command->add_option("--points", options->options.point_count,
                      "Default 1000000");
  command->add_option("--seed", options->options.seed, "Default 1");
  command->add_option("--range-noise", options->options.range_noise_m,
                      "Standard deviation in metres, default 0.012");
  command->add_option("--spurious-share", options->options.spurious_share,
                      "Share of returns from nothing, default 0.002");
  command->callback([=, &common, &run] {
    run = [=, &common] { return RunSimulate(common, *options); };
  });
}

/// A comma-separated list of words, each of which means a value.
template <typename Value>
CLI::Option* AddChoices(CLI::App& command, const char* name,
                        const std::map<std::string, Value>& choices,
                        std::vector<Value>& field, const char* help) {
  return command
      .add_option_function<std::vector<std::string>>(
          name,
          [choices, &field](const std::vector<std::string>& words) {
            field.clear();
            for (const std::string& word : words) {
              field.push_back(choices.at(word));
            }
          },
          help)
      ->delimiter(',')
      ->check(CLI::IsMember(choices));
}

void AddEvaluate(CLI::App& app, const CommonOptions& common, Run& run) {
  auto options = std::make_shared<EvaluateCommand>();
  auto simulated = std::make_shared<std::vector<int>>();
  EvaluationOptions& evaluation = options->options;
  CLI::App* command = app.add_subcommand(
      "evaluate",
      "Compare samplers by registration, on pairs of scans of known pose; "
      "again after a break, it resumes");
  command
      ->add_option("-o,--output", options->output,
                   "Folder for report.html, its figures, summary and trials")
      ->required();
  // Before the options that it sets: theirs come after it.
  command->add_flag_callback(
      "--full",
      [options] {
        options->simulated = {.pair_counts = {36, 36, 37},
                              .rotation_count = 12};
        options->options.counts = {1000,  2000,  5000,   10000,
                                   20000, 50000, 100000, 200000};
        options->options.trial_count = 313;
      },
      "The paper's size: 109 simulated pairs of dense scans, 1000 to 200000 "
      "points, 2504 registrations of each pair, method and ICP; some days: ask "
      "--estimate first; options beside it count");
  CLI::Option* maps =
      command
          ->add_option_function<std::vector<std::string>>(
              "--maps",
              [options](const std::vector<std::string>& files) {
                options->maps = files;
                options->simulated.pair_counts = {0, 0, 0};
                options->options.trial_count = 10;
              },
              "Two files of one place, in place of all pairs: which sampler "
              "and how many points do they need? 10 trials")
          ->expected(2)
          ->allow_extra_args(false);
  command
      ->add_option("--transform", options->transform,
                   "Of --maps: 16 numbers, the rows of the matrix that moves "
                   "the second onto the first, default the identity")
      ->expected(16)
      ->allow_extra_args(false);
  command->add_option("--target", options->target_m,
                      "Median error of translation that the smallest count is "
                      "found for, in metres, default 0.02");
  CLI::Option* pairs =
      command->add_option("--pairs", options->pair_lists,
                          "YAML list of pairs of files with their transforms; "
                          "can be repeated");
  maps->excludes(pairs);
  command->add_option("--pairs-folder", options->pair_folder,
                      "Where the lists' relative paths begin, default at the "
                      "list");
  maps->excludes(
      command
          ->add_option("--simulated", *simulated,
                       "Pairs of rooms, streets and woods, default 15 15 15")
          ->expected(3)
          ->allow_extra_args(false));
  command->add_option("--first-pair", options->simulated.first_pair,
                      "Number of the first room, street and wood, default 0");
  maps->excludes(
      command
          ->add_option("--surveyed", options->surveyed_count,
                       "Pairs of a simulated map and a scan that a robot takes "
                       "in it, default 0")
          ->check(CLI::Range(0, kMaxSurveyedPairs)));
  command->add_option("--rotations", options->simulated.rotation_count,
                      "Of the scanner, 32768 pulses each, for a simulated scan "
                      "(1 to 32), default 2");
  std::map<std::string, EvaluatedMethod> methods;
  for (const EvaluatedMethod& method : EvaluatedMethods()) {
    methods[method.name()] = method;
  }
  AddChoices(*command, "--methods", methods, evaluation.methods,
             "Comma-separated, default all");
  AddChoices(*command, "--icp",
             std::map<std::string, core::IcpMethod>{
                 {"point-to-plane", core::IcpMethod::kPointToPlane},
                 {"plane-to-plane", core::IcpMethod::kPlaneToPlane}},
             evaluation.icp_methods, "Comma-separated, default both");
  command->add_option(
      "--reading-points", evaluation.reading_point_count,
      "Sample the first cloud of a pair alone, as a map; of the "
      "second, a robot's scan, take so many random points for "
      "every method");
  command
      ->add_option("--counts", evaluation.counts,
                   "Points of a sample, ascending, comma-separated, default "
                   "1000,2000,5000,10000")
      ->delimiter(',');
  command->add_option("--trials", evaluation.trial_count,
                      "Starting poses of a pair, default 2");
  command->add_option("--seed", evaluation.seed,
                      "Changes starting poses and samples, default 1");
  command->add_option("--max-translation", evaluation.max_translation_m,
                      "Starting poses are so many metres off at most, default "
                      "0.5");
  command->add_option("--max-rotation", evaluation.max_rotation_deg,
                      "And so many degrees, default 20");
  command->add_option("--min-normal-cosine", evaluation.min_normal_cosine,
                      "ICP pairs no points whose normals' cosine is below this "
                      "in magnitude (0 to 1): they lie on different surfaces; "
                      "default 0.5; 0 pairs all");
  command->add_option("--label-neighbors", evaluation.label_neighbor_count,
                      "Of methods by the filter: neighbours that vote for a "
                      "label, 6 to 127; default 50");
  options->threads =
      static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  command->add_option("--threads", options->threads, "Default: one a processor")
      ->check(CLI::Range(1, 1024));
  command->add_flag("--estimate", options->only_estimate,
                    "Print how long it will take, and stop");
  command->callback([=, &common, &run] {
    if (!simulated->empty()) {
      std::copy(simulated->begin(), simulated->end(),
                options->simulated.pair_counts.begin());
    }
    const absl::Status valid = options->Validate();
    if (!valid.ok()) {
      throw CLI::ValidationError(std::string(valid.message()));
    }
    run = [=, &common] { return RunEvaluate(common, *options); };
  });
}

int Main(int argc, char** argv) {
  CLI::App app(
      "mapsieve: compresses point-cloud maps to labeled surfaces, curves and "
      "junctions",
      "mapsieve");
  app.set_version_flag("--version", MAPSIEVE_VERSION);
  app.require_subcommand(1);
  CommonOptions common;
  common.server = "127.0.0.1:7070";
  app.add_option("--server", common.server, "HOST:PORT, default 127.0.0.1:7070")
      ->envname("MAPSIEVE_SERVER");
  app.add_option("--retry-for", common.retry_s,
                 "Seconds to ask again in where the server goes away from an "
                 "upload, or from work that is waited for, default 60")
      ->check(CLI::Range(0.0, 1e6));
  app.add_flag("--json", common.json,
               "Print one JSON document on stdout; watch: one a line");
  app.fallthrough();
  Run run;
  AddCreate(app, common, run);
  AddUpload(app, common, run);
  AddProcess(app, common, run);
  AddQuery(app, common, run);
  AddExport(app, common, run);
  AddSync(app, common, run);
  AddDeleteRegion(app, common, run);
  AddReplaceRegion(app, common, run);
  AddRevisionCommands(app, common, run);
  AddVerify(app, common, run);
  AddOperation(app, common, run);
  AddMapCommands(app, common, run);
  AddSample(app, common, run);
  AddConvert(app, common, run);
  AddRender(app, common, run);
  AddSimulate(app, common, run);
  AddEvaluate(app, common, run);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    const std::vector<std::string> unknown = app.remaining();
    if (app.get_subcommands().empty() && !unknown.empty()) {
      std::fprintf(stderr,
                   "mapsieve: unknown command or option \"%s\"; "
                   "\"mapsieve --help\" lists them\n",
                   unknown.front().c_str());
      return 2;
    }
    return app.exit(error) == 0 ? 0 : 2;
  }
  const absl::Status status = run();
  if (status.ok()) return 0;
  std::fprintf(stderr, "mapsieve: %s\n", std::string(status.message()).c_str());
  return 1;
}

}  // namespace
}  // namespace mapsieve::client

int main(int argc, char** argv) {
  mapsieve::ReturnFreedBlocks();
  // gRPC locks Abseil's mutexes in ways that its deadlock detector, which
  // aborts the process, mistakes for cycles.
  absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore);
  try {
    return mapsieve::client::Main(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mapsieve: %s\n", error.what());
    return 1;
  }
}
