// Prints the curves and junctions of a map around a position.
//   quickstart SERVER MAP X Y Z RADIUS
#include <cstdio>
#include <cstdlib>
#include <string>

#include "client/api/map_client.h"

namespace {

int Fail(const absl::Status& status) {
  std::fprintf(stderr, "quickstart: %s\n",
               std::string(status.message()).c_str());
  return 1;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 7) {
    std::fprintf(stderr, "usage: %s SERVER MAP X Y Z RADIUS\n", argv[0]);
    return 2;
  }
  mapsieve::client::MapClient client(argv[1]);
  const auto around = client.QueryAll({
      .map_id = argv[2],
      .region =
          mapsieve::client::SphereRegion{
              {std::atof(argv[3]), std::atof(argv[4]), std::atof(argv[5])},
              std::atof(argv[6])},
      .labels = {mapsieve::core::Label::kCurve,
                 mapsieve::core::Label::kJunction},
      .max_point_count = 30000,
  });
  if (!around.ok()) return Fail(around.status());
  for (const auto& q : around->positions) {
    const mapsieve::core::Point3 p = around->lattice.Position(q);
    std::printf("%.3f %.3f %.3f\n", p.x, p.y, p.z);
  }
  return 0;
}
