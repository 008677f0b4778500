#include "client/lab/campus.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "client/lab/campus_block.h"
#include "core/base/hash.h"

namespace mapsieve::client {
namespace {

constexpr double kCell = Ground::kCellSize;
// Kerbs run along the borders of cells.
static_assert(static_cast<int>(Campus::kBlockX) % static_cast<int>(kCell) == 0);
static_assert(static_cast<int>(Campus::kBlockY) % static_cast<int>(kCell) == 0);
static_assert(static_cast<int>(Campus::kStreetWidth) %
                  static_cast<int>(kCell) ==
              0);

/// Keys the draws of different things at one place.
enum class Layer : int64_t { kHills, kSwells, kTufts };

/// Uniform in [-1, 1], for a place of a lattice.
double LatticeDraw(uint64_t seed, Layer layer, int64_t x, int64_t y) {
  const uint64_t draw = HashIntegers(std::array{
      static_cast<int64_t>(seed), static_cast<int64_t>(layer), x, y});
  return static_cast<double>(draw >> 11) * 0x1p-52 - 1;
}

/// Smooth noise in [-1, 1] that has a free value every `wavelength` metres.
double SmoothNoise(uint64_t seed, Layer layer, double wavelength, double x,
                   double y) {
  const double u = x / wavelength;
  const double v = y / wavelength;
  const double cell_u = std::floor(u);
  const double cell_v = std::floor(v);
  const auto i = static_cast<int64_t>(cell_u);
  const auto j = static_cast<int64_t>(cell_v);
  const auto ease = [](double t) { return t * t * (3 - 2 * t); };
  const double s = ease(u - cell_u);
  const double t = ease(v - cell_v);
  return (1 - t) * ((1 - s) * LatticeDraw(seed, layer, i, j) +
                    s * LatticeDraw(seed, layer, i + 1, j)) +
         t * ((1 - s) * LatticeDraw(seed, layer, i, j + 1) +
              s * LatticeDraw(seed, layer, i + 1, j + 1));
}

/// How far cell border `index` lies behind the kerb at the street of its block,
/// or before the street of the next one; negative on the street.
double BehindKerb(int64_t index, double block) {
  const auto cells = static_cast<int64_t>(block / kCell);
  const double place =
      static_cast<double>(((index % cells) + cells) % cells) * kCell;
  return std::min(place - Campus::kStreetWidth, block - place);
}

Ground MakeGround(const Campus& campus, uint64_t seed, double min_x,
                  double min_y, double max_x, double max_y) {
  const auto behind_kerb = [](int64_t x, int64_t y) {
    return std::min(BehindKerb(x, Campus::kBlockX),
                    BehindKerb(y, Campus::kBlockY));
  };
  Ground ground;
  ground.min_x = static_cast<int64_t>(std::floor(min_x / kCell));
  ground.min_y = static_cast<int64_t>(std::floor(min_y / kCell));
  ground.size_x = static_cast<int>(
      static_cast<int64_t>(std::ceil(max_x / kCell)) - ground.min_x);
  ground.size_y = static_cast<int>(
      static_cast<int64_t>(std::ceil(max_y / kCell)) - ground.min_y);
  for (int j = 0; j <= ground.size_y; ++j) {
    for (int i = 0; i <= ground.size_x; ++i) {
      const int64_t x = ground.min_x + i;
      const int64_t y = ground.min_y + j;
      double z = campus.TerrainHeight(static_cast<double>(x) * kCell,
                                      static_cast<double>(y) * kCell);
      // Lawns are less even than what is paved.
      if (behind_kerb(x, y) > Campus::kPavementWidth) {
        z += 0.04 * LatticeDraw(seed, Layer::kTufts, x, y);
      }
      ground.corners.push_back(static_cast<float>(z));
    }
  }
  for (int j = 0; j < ground.size_y; ++j) {
    for (int i = 0; i < ground.size_x; ++i) {
      const int64_t x = ground.min_x + i;
      const int64_t y = ground.min_y + j;
      const double near =
          std::min(behind_kerb(x, y), behind_kerb(x + 1, y + 1));
      const bool street = behind_kerb(x, y) < 0;
      const bool pavement = near < Campus::kPavementWidth;
      ground.steps.push_back(street ? 0
                                    : static_cast<float>(Campus::kKerbHeight));
      ground.reflectances.push_back(street ? 0.15F : pavement ? 0.35F : 0.5F);
    }
  }
  return ground;
}

}  // namespace

double Campus::TerrainHeight(double x, double y) const {
  return 2.0 * SmoothNoise(seed_, Layer::kHills, 160, x, y) +
         0.35 * SmoothNoise(seed_, Layer::kSwells, 37, x, y);
}

SceneDescription Campus::Surroundings(int64_t block_x, int64_t block_y,
                                      double range) const {
  const double margin = range + kReach;
  const double min_x = static_cast<double>(block_x) * kBlockX - margin;
  const double min_y = static_cast<double>(block_y) * kBlockY - margin;
  const double max_x = static_cast<double>(block_x + 1) * kBlockX + margin;
  const double max_y = static_cast<double>(block_y + 1) * kBlockY + margin;
  SceneDescription scene;
  scene.ground = MakeGround(*this, seed_, min_x, min_y, max_x, max_y);
  const auto block = [](double place, double size) {
    return static_cast<int64_t>(std::floor(place / size));
  };
  for (int64_t y = block(min_y - kBlockOverhang, kBlockY);
       y <= block(max_y + kBlockOverhang, kBlockY); ++y) {
    for (int64_t x = block(min_x - kBlockOverhang, kBlockX);
         x <= block(max_x + kBlockOverhang, kBlockX); ++x) {
      AddBlock(*this, seed_, x, y, scene);
    }
  }
  return scene;
}

core::Point3 SpiralDrive(double distance) {
  // Turn q is a straight of q + 1 blocks along x and one of q + 1 along y; the
  // turns before it are (kBlockX + kBlockY) q (q + 1) / 2 long.
  constexpr double kPerTurn = (Campus::kBlockX + Campus::kBlockY) / 2;
  double turn = std::floor((std::sqrt(1 + 4 * distance / kPerTurn) - 1) / 2);
  if (kPerTurn * turn * (turn + 1) > distance) --turn;
  double rest = distance - kPerTurn * turn * (turn + 1);
  const bool odd = std::fmod(turn, 2) != 0;
  const double corner = odd ? (turn + 1) / 2 : -turn / 2;
  const double sign = odd ? -1 : 1;
  const double along_x = std::min(rest, Campus::kBlockX * (turn + 1));
  rest -= along_x;
  constexpr double kMiddle = Campus::kStreetWidth / 2;
  constexpr double kSway = 0.6;
  return {corner * Campus::kBlockX + sign * along_x + kMiddle +
              kSway * std::sin(distance / 17),
          corner * Campus::kBlockY + sign * rest + kMiddle +
              kSway * std::sin(distance / 23 + 1),
          0};
}

}  // namespace mapsieve::client
