#include "client/cli/upload_report.h"

#include <cmath>
#include <cstddef>
#include <cstdint>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace mapsieve::client {
namespace {

double CellEdge(const PointCensus& census, double step) {
  return std::ldexp(step, census.density_cell_level);
}

Json CensusJson(const PointCensus& census, double step) {
  Json overlapping = nullptr;
  if (census.overlapping_point_count.has_value()) {
    overlapping = *census.overlapping_point_count;
  }
  return {{"duplicate_point_count", census.duplicate_point_count},
          {"overlapping_point_count", overlapping},
          {"density",
           {{"cell_edge", CellEdge(census, step)},
            {"cells_by_log2_points", census.density_histogram}}}};
}

std::string PositionText(const core::Point3& p) {
  return absl::StrFormat("(%.12g, %.12g, %.12g)", p.x, p.y, p.z);
}

/// "1: 20, 2-3: 5, …".
std::string HistogramText(const PointCensus& census) {
  std::string text;
  for (size_t i = 0; i < census.density_histogram.size(); ++i) {
    const int64_t least = int64_t{1} << i;
    if (census.density_histogram[i] == 0) continue;
    absl::StrAppend(&text, text.empty() ? "" : ", ", least);
    if (i > 0) absl::StrAppend(&text, "-", 2 * least - 1);
    absl::StrAppend(&text, ": ", census.density_histogram[i]);
  }
  return text;
}

}  // namespace

Json BoundsJson(const std::optional<Bounds>& bounds) {
  if (!bounds.has_value()) return nullptr;
  const auto point = [](const core::Point3& p) {
    return Json::array({p.x, p.y, p.z});
  };
  return {{"min", point(bounds->min)}, {"max", point(bounds->max)}};
}

Json UploadJson(const UploadReport& report, double step, double seconds) {
  Json json = {
      {"already_there", report.already_there},
      {"added_point_count",
       report.already_there ? 0 : report.added_point_count},
      {"refused_non_finite_count", report.refused_non_finite_count},
      {"refused_out_of_lattice_count", report.refused_out_of_lattice_count},
      {"revision", report.revision},
      {"tile_count", report.tile_count},
      {"bounds", BoundsJson(report.bounds)}};
  if (report.census.has_value()) json.update(CensusJson(*report.census, step));
  Json warnings = Json::array();
  for (const UploadWarning& warning : report.warnings) {
    warnings.push_back({{"code", warning.code}, {"message", warning.message}});
  }
  json.update({{"warnings", std::move(warnings)},
               {"upload_bytes", report.upload_bytes},
               {"sent_bytes", report.sent_bytes},
               {"upload_s", seconds}});
  return json;
}

std::string UploadText(const std::string& title, const UploadReport& report,
                       double step) {
  std::string text = absl::StrCat(title, ": ");
  if (report.already_there) {
    absl::StrAppend(&text, "uploaded before, as revision ", report.revision,
                    "; nothing was added (--again adds it once more)\n");
  } else {
    absl::StrAppend(&text, report.added_point_count, " points added, in ",
                    report.tile_count, " tiles, as revision ", report.revision,
                    "\n");
  }
  const auto add = [&text](const char* name, const std::string& line) {
    absl::StrAppendFormat(&text, "  %-10s  %s\n", name, line);
  };
  if (report.removed_point_count > 0 && !report.already_there) {
    add("replaced", absl::StrCat(report.removed_point_count, " points"));
  }
  add("refused", absl::StrCat(report.refused_non_finite_count, " not finite, ",
                              report.refused_out_of_lattice_count,
                              " outside the lattice"));
  if (report.census.has_value()) {
    const PointCensus& census = *report.census;
    add("duplicates",
        absl::StrCat(census.duplicate_point_count, " of the upload itself, ",
                     census.overlapping_point_count.has_value()
                         ? absl::StrCat(*census.overlapping_point_count)
                         : "an unknown number",
                     " of points that the map had"));
    if (!census.density_histogram.empty()) {
      add("density",
          absl::StrFormat("cells of %.6g by points: %s", CellEdge(census, step),
                          HistogramText(census)));
    }
  }
  if (report.bounds.has_value()) {
    add("bounds", absl::StrCat(PositionText(report.bounds->min), " to ",
                               PositionText(report.bounds->max)));
  }
  for (const UploadWarning& warning : report.warnings) {
    add("warning", warning.message);
  }
  return text;
}

UploadWarning CrsWarning(const std::string& problem) {
  return {"crs_not_read",
          absl::StrCat("the CRS of the file is not read whole: ", problem,
                       "; state it with \"create MAP --crs\" as EPSG:n, "
                       "EPSG:n+m (m: heights) or WKT")};
}

}  // namespace mapsieve::client
