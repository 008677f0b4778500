#include "client/lab/splat_buffer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <tuple>

namespace mapsieve::client {
namespace {

constexpr float kEmpty = std::numeric_limits<float>::infinity();

bool IsNearer(float depth_a, Color a, float depth_b, Color b) {
  return std::tie(depth_a, a.red, a.green, a.blue) <
         std::tie(depth_b, b.red, b.green, b.blue);
}

}  // namespace

SplatBuffer::SplatBuffer(int width, int height, double diameter,
                         double elevation_deg)
    : width_(width * kSamplesPerAxis),
      height_(height * kSamplesPerAxis),
      sine_(std::sin(elevation_deg * std::numbers::pi / 180)),
      cosine_(std::cos(elevation_deg * std::numbers::pi / 180)) {
  const double radius = std::max(diameter * kSamplesPerAxis / 2, 0.5);
  reach_ = static_cast<int>(std::floor(radius));
  for (int dy = -reach_; dy <= reach_; ++dy) {
    for (int dx = -reach_; dx <= reach_; ++dx) {
      const double distance2 = dx * dx + dy * dy;
      if (distance2 > radius * radius) continue;
      // A shallow bowl, so that overlapping splats meet half way.
      const double depth = distance2 / (6 * radius * kSamplesPerAxis);
      stamp_.push_back({dx, dy, static_cast<float>(depth)});
    }
  }
  samples_.assign(static_cast<size_t>(width_) * static_cast<size_t>(height_),
                  {kEmpty, {}});
}

void SplatBuffer::Splat(double x, double y, double depth, Color color) {
  const double sample_x = std::floor(x * kSamplesPerAxis);
  const double sample_y = std::floor(y * kSamplesPerAxis);
  if (!(sample_x >= -reach_ && sample_x < width_ + reach_ &&
        sample_y >= -reach_ && sample_y < height_ + reach_)) {
    return;
  }
  const int center_x = static_cast<int>(sample_x);
  const int center_y = static_cast<int>(sample_y);
  for (const StampCell& cell : stamp_) {
    const int column = center_x + cell.dx;
    const int row = center_y + cell.dy;
    if (column < 0 || column >= width_ || row < 0 || row >= height_) continue;
    Sample& sample = samples_[Index(column, row)];
    const float cell_depth = static_cast<float>(depth) + cell.depth;
    if (IsNearer(cell_depth, color, sample.depth, sample.color)) {
      sample = {cell_depth, color};
    }
  }
}

std::vector<float> SplatBuffer::SmoothDepths() const {
  // A step of more splat radii than this between neighbours is an edge.
  constexpr int kEdgeRadii = 3;
  const int radius = std::max(reach_, 1);
  const float edge = static_cast<float>(kEdgeRadii * radius) / kSamplesPerAxis;
  std::vector<float> sums(static_cast<size_t>(width_));
  std::vector<float> counts(static_cast<size_t>(width_));
  // Means of the samples within `radius` along x or y (one of dx, dy is 1).
  const auto blur = [&](const std::vector<float>& in, int dx, int dy,
                        std::vector<float>& out) {
    for (int y = 0; y < height_; ++y) {
      std::fill(sums.begin(), sums.end(), 0.0f);
      std::fill(counts.begin(), counts.end(), 0.0f);
      const float* const row = &in[Index(0, y)];
      for (int k = -radius; k <= radius; ++k) {
        if (y + k * dy < 0 || y + k * dy >= height_) continue;
        const float* const neighbors = &in[Index(0, y + k * dy)];
        const int end = std::min(width_, width_ - k * dx);
        for (int x = std::max(0, -k * dx); x < end; ++x) {
          const float difference = neighbors[x + k * dx] - row[x];
          const bool is_near = std::abs(difference) <= edge;
          sums[static_cast<size_t>(x)] += is_near ? difference : 0.0f;
          counts[static_cast<size_t>(x)] += is_near ? 1.0f : 0.0f;
        }
      }
      for (int x = 0; x < width_; ++x) {
        const auto i = static_cast<size_t>(x);
        out[Index(x, y)] = row[x] + sums[i] / std::max(counts[i], 1.0f);
      }
    }
  };
  std::vector<float> depths(samples_.size());
  std::transform(samples_.begin(), samples_.end(), depths.begin(),
                 [](const Sample& sample) { return sample.depth; });
  std::vector<float> rows_done(samples_.size());
  blur(depths, 1, 0, rows_done);
  blur(rows_done, 0, 1, depths);
  return depths;
}

double SplatBuffer::Light(const std::vector<float>& depths, int x, int y,
                          double shading) const {
  struct Ring {
    int radii;  // of a splat
    double weight;
  };
  constexpr std::array<Ring, 2> kRings = {{{1, 0.6}, {2, 0.4}}};
  constexpr std::array<std::array<int, 2>, 8> kDirections = {
      {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {1, -1}, {-1, 1}, {-1, -1}}};
  // Below the first rise over run a neighbour may be the same splat; beyond
  // the second it is an edge, however far it is.
  constexpr double kFlattest = 0.05;
  constexpr double kSteepest = 3;

  const float depth = depths[Index(x, y)];
  double occlusion = 0;
  for (const Ring& ring : kRings) {
    const int radius = ring.radii * std::max(reach_, 2);
    double sum = 0;
    for (const auto& [dx, dy] : kDirections) {
      const int column = x + dx * radius;
      const int row = y + dy * radius;
      if (column < 0 || column >= width_ || row < 0 || row >= height_) continue;
      const float neighbor = depths[Index(column, row)];
      if (neighbor == kEmpty) continue;
      // Both in samples.
      const double nearer = double{depth - neighbor} * kSamplesPerAxis;
      const double higher = nearer * sine_ - dy * radius * cosine_;
      const double rise = std::min(nearer, higher) / radius;
      sum += std::clamp(rise - kFlattest, 0.0, kSteepest);
    }
    occlusion += ring.weight * sum / kDirections.size();
  }
  return std::exp(-1.5 * shading * occlusion);
}

void SplatBuffer::Resolve(double shading, int left, int top,
                          Image& image) const {
  constexpr int kSamples = kSamplesPerAxis * kSamplesPerAxis;
  const std::vector<float> depths = SmoothDepths();
  for (int y = 0; y < height_ / kSamplesPerAxis; ++y) {
    for (int x = 0; x < width_ / kSamplesPerAxis; ++x) {
      std::array<double, 3> sum{};
      int covered = 0;
      for (int k = 0; k < kSamples; ++k) {
        const int column = x * kSamplesPerAxis + k % kSamplesPerAxis;
        const int row = y * kSamplesPerAxis + k / kSamplesPerAxis;
        const Sample& sample = samples_[Index(column, row)];
        if (sample.depth == kEmpty) continue;
        const double light = Light(depths, column, row, shading);
        sum[0] += light * sample.color.red;
        sum[1] += light * sample.color.green;
        sum[2] += light * sample.color.blue;
        ++covered;
      }
      if (covered == 0) continue;
      const auto mean = [&](size_t channel) {
        return static_cast<uint8_t>(std::lround(sum[channel] / covered));
      };
      image.Blend(left + x, top + y, {mean(0), mean(1), mean(2)},
                  static_cast<double>(covered) / kSamples);
    }
  }
}

}  // namespace mapsieve::client
