#include "client/formats/coordinate_systems.h"

#include <proj.h>

#include <array>

#include "absl/strings/str_cat.h"
#include "core/base/status.h"
#include "core/geometry/crs.h"

namespace mapsieve::client {

void ProjContextDeleter::operator()(pj_ctx* context) const {
  proj_context_destroy(context);
}

absl::StatusOr<ProjContext> OpenProj() {
  // libgeotiff asks for units in the context of the process.
  [[maybe_unused]] static const PJ_LOG_LEVEL kSilenced =
      proj_log_level(nullptr, PJ_LOG_NONE);
  ProjContext context(proj_context_create());
  if (context == nullptr) {
    return absl::ResourceExhaustedError("PROJ has no memory for a context");
  }
  proj_log_level(context.get(), PJ_LOG_NONE);
  proj_context_set_enable_network(context.get(), 0);
  if (proj_context_get_database_path(context.get()) == nullptr) {
    return absl::FailedPreconditionError(
        "coordinate reference systems need PROJ's database, proj.db, and it is "
        "not found; install it (Debian: proj-data), or set PROJ_DATA to its "
        "folder");
  }
  return context;
}

absl::StatusOr<std::string> WktOfCrs(const std::string& crs) {
  MAPSIEVE_ASSIGN_OR_RETURN(const ProjContext context, OpenProj());
  const std::unique_ptr<PJ, decltype(&proj_destroy)> system(
      proj_create(context.get(), crs.c_str()), &proj_destroy);
  if (system != nullptr && proj_is_crs(system.get()) != 0) {
    // Heights above the ellipsoid are a vertical system in LAS.
    static constexpr std::array<const char*, 3> kOptions = {
        "MULTILINE=NO", "ALLOW_ELLIPSOIDAL_HEIGHT_AS_VERTICAL_CRS=YES",
        nullptr};
    static constexpr std::array<const char*, 2> kOneLine = {"MULTILINE=NO",
                                                            nullptr};
    const char* wkt =
        proj_as_wkt(context.get(), system.get(), PJ_WKT1_GDAL, kOptions.data());
    if (wkt == nullptr) {
      wkt = proj_as_wkt(context.get(), system.get(), PJ_WKT2_2019,
                        kOneLine.data());
    }
    if (wkt != nullptr) return std::string(wkt);
  }
  return absl::NotFoundError(
      absl::StrCat("PROJ ", proj_info().release,
                   " knows no coordinate reference system \"", crs, "\""));
}

std::string UnitOfCodeOrWkt(const std::string& crs) {
  if (core::ParseEpsgName(crs) == 0) return core::UnitOfCrs(crs);
  const absl::StatusOr<std::string> wkt = WktOfCrs(crs);
  return wkt.ok() ? core::UnitOfCrs(*wkt) : "";
}

}  // namespace mapsieve::client
