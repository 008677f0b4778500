#include "tests/testing/registration_scenes.h"

#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/registration/label_covariance.h"

namespace mapsieve::testing {

using core::Cross;
using core::Dot;
using core::RigidTransform;
using core::Vector3;

namespace {

Vector3 Scaled(const Vector3& v, double factor) {
  return {v[0] * factor, v[1] * factor, v[2] * factor};
}

Vector3 ToVector(const core::Point3& p) { return {p.x, p.y, p.z}; }

}  // namespace

void RegistrationCloud::Add(const Vector3& position, const Vector3& normal) {
  positions.push_back({position[0], position[1], position[2]});
  normals.push_back(normal);
  const std::array<float, 3> n = {static_cast<float>(normal[0]),
                                  static_cast<float>(normal[1]),
                                  static_cast<float>(normal[2])};
  covariances.push_back(
      core::LabelCovariance(core::Label::kSurface, n, {0, 0, 1}));
}

std::vector<Board> RoomBoards() {
  return {{{0, 0, 0}, {5, 0, 0}, {0, 5, 0}},
          {{-6, 0, 3.5}, {0, 5, 0}, {0, 0, 2}},
          {{0, -6, 3.5}, {5, 0, 0}, {0, 0, 2}},
          {{7, 3, 3}, {0, 2, 0}, {1, 0, 1.5}}};
}

std::vector<Board> CorridorBoards() {
  return {{{0, 0, 0}, {10, 0, 0}, {0, 1, 0}},
          {{0, 2, 2.5}, {10, 0, 0}, {0, 0, 1.5}},
          {{0, -2, 2.5}, {10, 0, 0}, {0, 0, 1.5}}};
}

std::vector<Board> StairBoards() {
  std::vector<Board> boards = {{{0, 0, 0}, {4, 0, 0}, {0, 4, 0}},
                               {{-4, 0, 2}, {0, 4, 0}, {0, 0, 2}},
                               {{0, -4, 2}, {4, 0, 0}, {0, 0, 2}}};
  for (int step = 0; step < 8; ++step) {
    const double x = 0.4 * step;
    const double z = 0.3 * step;
    boards.push_back({{x, 2, z}, {0, 1.5, 0}, {0, 0, 0.15}});
    boards.push_back({{x + 0.2, 2, z + 0.15}, {0.2, 0, 0}, {0, 1.5, 0}});
  }
  return boards;
}

RegistrationCloud SampleBoards(const std::vector<Board>& boards,
                               int points_per_board, double noise_m,
                               Random& random) {
  RegistrationCloud cloud;
  for (const Board& board : boards) {
    const Vector3 across = Cross(board.u, board.v);
    const Vector3 normal = Scaled(across, 1 / std::sqrt(Dot(across, across)));
    for (int i = 0; i < points_per_board; ++i) {
      const double u = random.Uniform(-1, 1);
      const double v = random.Uniform(-1, 1);
      const double off = noise_m * random.Normal();
      Vector3 p = board.center;
      for (size_t a = 0; a < 3; ++a) {
        p[a] += u * board.u[a] + v * board.v[a] + off * normal[a];
      }
      cloud.Add(p, normal);
    }
  }
  return cloud;
}

RegistrationCloud Moved(const RegistrationCloud& cloud,
                        const RigidTransform& transform) {
  RegistrationCloud moved;
  for (size_t i = 0; i < cloud.size(); ++i) {
    moved.Add(ToVector(transform(cloud.positions[i])),
              transform.Rotate(cloud.normals[i]));
  }
  return moved;
}

RegistrationCloud Shuffled(const RegistrationCloud& cloud, Random& random) {
  std::vector<size_t> order(cloud.size());
  std::iota(order.begin(), order.end(), size_t{0});
  for (size_t i = order.size(); i > 1; --i) {
    const double draw = random.Uniform(0, static_cast<double>(i));
    std::swap(order[i - 1], order[static_cast<size_t>(draw)]);
  }
  RegistrationCloud result;
  for (const size_t i : order) {
    result.Add(ToVector(cloud.positions[i]), cloud.normals[i]);
  }
  return result;
}

Vector3 RandomDirection(Random& random) {
  Vector3 v;
  for (double& value : v) value = random.Normal();
  return Scaled(v, 1 / std::sqrt(Dot(v, v)));
}

RigidTransform RandomMotion(double translation_m, double rotation_rad,
                            Random& random) {
  const Vector3 axis = RandomDirection(random);
  const Vector3 direction = RandomDirection(random);
  return {.rotation = core::RotationFromVector(Scaled(axis, rotation_rad)),
          .translation = Scaled(direction, translation_m)};
}

}  // namespace mapsieve::testing
