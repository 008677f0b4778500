#ifndef MAPSIEVE_CLIENT_FORMATS_COORDINATE_SYSTEMS_H_
#define MAPSIEVE_CLIENT_FORMATS_COORDINATE_SYSTEMS_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"

struct pj_ctx;

/// What PROJ knows of coordinate reference systems. It looks for its database,
/// proj.db (Debian: proj-data), at run time, in PROJ_DATA if that is set; it
/// never uses the network.
namespace mapsieve::client {

struct ProjContextDeleter {
  void operator()(pj_ctx* context) const;
};
using ProjContext = std::unique_ptr<pj_ctx, ProjContextDeleter>;

/// A context that reports nothing on stderr. One thread at a time may use it.
/// kFailedPrecondition: there is no database.
absl::StatusOr<ProjContext> OpenProj();

/// A coordinate reference system, given as "EPSG:n", "EPSG:n+m" (n: horizontal,
/// m: heights) or WKT, as WKT 1 in one line, with the names of GDAL; as WKT 2
/// (2019) if WKT 1 cannot express it. Thread-safe.
/// kNotFound: PROJ has no such system or does not understand the text;
/// kFailedPrecondition: there is no database.
absl::StatusOr<std::string> WktOfCrs(const std::string& crs);

/// The unit of the horizontal coordinates as core::UnitOfCrs tells it, and of
/// EPSG codes too; empty if it is not known. Thread-safe.
std::string UnitOfCodeOrWkt(const std::string& crs);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_COORDINATE_SYSTEMS_H_
