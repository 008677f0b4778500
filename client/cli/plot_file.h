#ifndef MAPSIEVE_CLIENT_CLI_PLOT_FILE_H_
#define MAPSIEVE_CLIENT_CLI_PLOT_FILE_H_

#include <filesystem>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

/// The files of a report.
namespace mapsieve::client {

/// Makes `folder` and those above it, if there is none. kInvalidArgument.
absl::Status MakeFolder(const std::filesystem::path& folder);

/// Writes a whole file, as OutputFile does.
absl::Status WriteFile(const std::filesystem::path& path,
                       std::string_view bytes);

/// In pixels.
struct PlotSize {
  int width = 0;
  int height = 0;
};

/// Draws `script` as `name`.svg and `name`.png in `folder` and returns the SVG.
/// Errors: those of RunGnuplot and of WriteFile.
absl::StatusOr<std::string> WritePlot(const std::filesystem::path& folder,
                                      std::string_view name,
                                      std::string_view script,
                                      const PlotSize& size);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_PLOT_FILE_H_
