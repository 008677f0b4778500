#ifndef MAPSIEVE_CLIENT_CLI_UPLOAD_REPORT_H_
#define MAPSIEVE_CLIENT_CLI_UPLOAD_REPORT_H_

#include <optional>
#include <string>

#include "client/api/map_types.h"
#include "client/cli/output.h"

namespace mapsieve::client {

/// {"min": [x, y, z], "max": …}, or null.
Json BoundsJson(const std::optional<Bounds>& bounds);

/// A report for programs; `step`: of the map.
Json UploadJson(const UploadReport& report, double step, double seconds);

/// The same for people, some lines: what became of `title`, a file.
std::string UploadText(const std::string& title, const UploadReport& report,
                       double step);

/// The warning of an upload from a file with this PointFileInfo::crs_problem.
UploadWarning CrsWarning(const std::string& problem);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_UPLOAD_REPORT_H_
