#include "client/cli/plot_file.h"

#include <memory>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "client/cli/gnuplot.h"
#include "client/formats/output_file.h"
#include "core/base/status.h"

namespace mapsieve::client {

absl::Status MakeFolder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!error) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      folder.string(), ": cannot make this folder: ", error.message()));
}

absl::Status WriteFile(const std::filesystem::path& path,
                       std::string_view bytes) {
  MAPSIEVE_ASSIGN_OR_RETURN(const std::unique_ptr<OutputFile> file,
                            OutputFile::Create(path));
  MAPSIEVE_RETURN_IF_ERROR(file->Append(bytes));
  return file->Finish();
}

absl::StatusOr<std::string> WritePlot(const std::filesystem::path& folder,
                                      std::string_view name,
                                      std::string_view script,
                                      const PlotSize& size) {
  const std::string path = (folder / name).string();
  const std::string pixels = absl::StrCat(size.width, ",", size.height);
  const auto draw = [&](const std::string& terminal) {
    return RunGnuplot(
        absl::StrCat("set terminal ", terminal, "\n", ToAbsl(script)));
  };
  MAPSIEVE_ASSIGN_OR_RETURN(
      std::string svg,
      draw(absl::StrCat("svg size ", pixels,
                        " font \"DejaVu Sans,13\" background \"white\"")));
  MAPSIEVE_RETURN_IF_ERROR(WriteFile(path + ".svg", svg));
  MAPSIEVE_ASSIGN_OR_RETURN(
      const std::string png,
      draw(absl::StrCat("pngcairo size ", pixels, " font \"DejaVu Sans,11\"")));
  MAPSIEVE_RETURN_IF_ERROR(WriteFile(path + ".png", png));
  return svg;
}

}  // namespace mapsieve::client
