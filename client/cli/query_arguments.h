#ifndef MAPSIEVE_CLIENT_CLI_QUERY_ARGUMENTS_H_
#define MAPSIEVE_CLIENT_CLI_QUERY_ARGUMENTS_H_

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "client/api/map_types.h"

namespace mapsieve::client {

/// The numbers of the options of `query` that are shapes; empty: not given. At
/// most one of the shapes is.
struct RegionArguments {
  std::vector<double> box;
  std::vector<double> sphere;
  /// Centre, length, width, height, and degrees counter-clockwise.
  std::vector<double> oriented_box;
  /// x, y, radius.
  std::vector<double> cylinder;
  /// x, y of each vertex.
  std::vector<double> polygon;
  /// Eye, target, vertical degrees, aspect, near, far.
  std::vector<double> frustum;
  /// Radius, then x, y, z of each point.
  std::vector<double> corridor;
  /// Of `cylinder` and `polygon`.
  std::vector<double> z_range;
};

/// kInvalidArgument: a list of another length, a look straight up or down, an
/// angle of view that is none. The server checks the rest.
absl::StatusOr<QueryRegion> MakeQueryRegion(const RegionArguments& arguments);

/// Names of filter columns, "attributes" for all of the uploaded ones, and
/// names of attributes; nothing for no names.
std::optional<ColumnSelection> MakeColumnSelection(
    const std::vector<std::string>& names);

/// Name, least and largest value of each range. kInvalidArgument: not a
/// number.
absl::StatusOr<std::vector<AttributeRange>> MakeAttributeRanges(
    const std::vector<std::string>& words);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_CLI_QUERY_ARGUMENTS_H_
