#ifndef MAPSIEVE_CLIENT_CLI_COMMANDS_H_
#define MAPSIEVE_CLIENT_CLI_COMMANDS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "client/api/map_types.h"
#include "client/cli/query_arguments.h"
#include "client/formats/occupancy_file.h"
#include "client/lab/evaluation.h"
#include "client/lab/render.h"
#include "client/lab/simulate.h"
#include "client/lab/simulated_pair.h"
#include "core/sampling/sampler_options.h"

/// The commands of the program, without their parsing: each takes its options,
/// does its work and prints its result.
namespace mapsieve::client {

/// What all commands share.
struct CommonOptions {
  std::string server;
  /// Patience of MapClient.
  double retry_s = 60;
  bool json = false;
};

// Commands against a server ---------------------------------------------------

struct CreateCommand {
  std::string map;
  /// In map units; 0: the server's defaults.
  double step = 0;
  double tile_edge = 0;
  /// WKT, "EPSG:n" or "EPSG:n+m"; empty: that of the first upload that has one.
  std::string crs;
  /// As `crs`.
  std::string frame_id;
};
absl::Status RunCreate(const CommonOptions& common,
                       const CreateCommand& command);

struct ProcessCommand {
  std::string map;
  ProcessOptions options;
  bool no_wait = false;
};
absl::Status RunProcess(const CommonOptions& common,
                        const ProcessCommand& command);

struct OperationCommand {
  std::string operation;
  bool cancel = false;
};
/// Waits until the operation is done, and returns its error if it failed.
absl::Status RunOperation(const CommonOptions& common,
                          const OperationCommand& command);

struct UploadCommand {
  std::string map;
  std::vector<std::string> files;
  std::vector<std::string> column_names;
  bool process = false;
  bool again = false;
};
absl::Status RunUpload(const CommonOptions& common,
                       const UploadCommand& command);

struct QueryCommand {
  /// Without what the arguments below say.
  QuerySpec spec;
  RegionArguments region;
  /// Least and largest; junction, curve and surface; empty: not given.
  std::vector<double> confidence;
  std::vector<double> weights;
  /// See MakeAttributeRanges and MakeColumnSelection.
  std::vector<std::string> ranges;
  std::vector<std::string> columns;
  /// Of a file with float32 coordinates; nothing: float64, as the map has them.
  std::optional<core::Point3> origin;
  std::string output;
};
/// Chunks that spec.allow_partial leaves out are lines on stderr and no error.
absl::Status RunQuery(const CommonOptions& common, const QueryCommand& command);

struct ExportCommand {
  /// Of raw points, without its region.
  QuerySpec spec;
  RegionArguments region;
  OccupancyOptions occupancy;
  std::string output;
};
absl::Status RunExport(const CommonOptions& common,
                       const ExportCommand& command);

struct SyncCommand {
  /// Of the whole tiles around a place.
  QuerySpec query;
  /// Becomes the origin of the files.
  core::Point3 origin;
  std::string folder;
};
absl::Status RunSync(const CommonOptions& common, const SyncCommand& command);

struct DeleteRegionCommand {
  std::string map;
  Region region;
};
absl::Status RunDeleteRegion(const CommonOptions& common,
                             const DeleteRegionCommand& command);

struct ReplaceRegionCommand {
  /// All files become one upload.
  UploadCommand upload;
  Region region;
};
absl::Status RunReplaceRegion(const CommonOptions& common,
                              const ReplaceRegionCommand& command);

struct RollbackCommand {
  std::string map;
  int64_t revision = 0;
};
absl::Status RunRollback(const CommonOptions& common,
                         const RollbackCommand& command);

struct RevisionsCommand {
  std::string map;
  /// Two revisions to compare; empty: list all.
  std::vector<int64_t> compared;
  /// CSV file of the tiles that differ; empty: none.
  std::string tiles;
};
absl::Status RunRevisions(const CommonOptions& common,
                          const RevisionsCommand& command);

struct WatchCommand {
  std::string map;
  /// Number of the first revision; 0: the newest.
  int64_t from = 0;
  /// Ends after so many revisions; 0: never.
  int64_t count = 0;
};
/// Prints a line for each revision as it comes.
absl::Status RunWatch(const CommonOptions& common, const WatchCommand& command);

struct VerifyCommand {
  std::string map;
  /// Tiles to filter again.
  int64_t compared_tile_count = 0;
  /// Make damaged chunks again before.
  bool repair = false;
};
/// kDataLoss if anything is damaged, after the repair, or differs.
absl::Status RunVerify(const CommonOptions& common,
                       const VerifyCommand& command);

/// With the newest revisions.
absl::Status RunInfo(const CommonOptions& common, const std::string& map);
absl::Status RunList(const CommonOptions& common);
absl::Status RunDelete(const CommonOptions& common, const std::string& map,
                       bool force);

// Commands without a server ---------------------------------------------------

struct SampleCommand {
  std::string input;
  std::string output;
  core::SamplerOptions sampler;
  /// Lattice step in map units.
  double step = 0.001;
  int threads = 1;
  std::vector<std::string> column_names;
  /// Folder of a report on both density rules, with the density radius that
  /// max_points finds where it is given (in a time that the report has of its
  /// rule); empty: none. Of spdf alone.
  std::string report;

  /// kInvalidArgument.
  absl::Status Validate() const;
};
/// Of a valid command.
absl::Status RunSample(const CommonOptions& common,
                       const SampleCommand& command);

struct ConvertCommand {
  std::string input;
  std::string output;
  std::vector<std::string> column_names;
};
absl::Status RunConvert(const CommonOptions& common,
                        const ConvertCommand& command);

struct RenderCommand {
  /// FILE or TITLE=FILE, a panel each.
  std::vector<std::string> inputs;
  std::string output;
  RenderOptions options;
};
absl::Status RunRender(const CommonOptions& common,
                       const RenderCommand& command);

struct SimulateCommand {
  std::string output;
  /// Two furnished rooms instead of a campus.
  bool rooms = false;
  SimulateOptions options;
};
absl::Status RunSimulate(const CommonOptions& common,
                         const SimulateCommand& command);

struct EvaluateCommand {
  std::string output;
  EvaluationOptions options;
  SimulatedPairOptions simulated;
  /// Pairs of a simulated map and a scan in it, 0 to kMaxSurveyedPairs.
  int surveyed_count = 0;
  /// Lists of pairs, and the folder of their files (ReadPairList).
  std::vector<std::string> pair_lists;
  std::string pair_folder;
  /// Two files, in place of all pairs (LoadMapPair); empty: none. A count above
  /// the size of the smaller one stands for all of its points.
  std::vector<std::string> maps;
  /// Moves the second onto the first (TransformOfRows); empty: the identity.
  std::vector<double> transform;
  /// Median error of translation to find the smallest counts for.
  double target_m = 0.02;
  int threads = 1;
  /// Prints how long it will take, and does no more.
  bool only_estimate = false;

  /// kInvalidArgument.
  absl::Status Validate() const;
};
/// Of a valid command. Prints the sampler and the count for the target. Goes on
/// where a broken one in the same folder stopped.
absl::Status RunEvaluate(const CommonOptions& common,
                         const EvaluateCommand& command);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_COMMANDS_H_
