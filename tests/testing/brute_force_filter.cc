#include "tests/testing/brute_force_filter.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <tuple>
#include <utility>

#include "core/base/hash.h"
#include "core/geometry/vector3.h"
#include "tests/testing/symmetric3.h"

namespace mapsieve::testing {
namespace {

using core::Label;
using core::LatticePoint;
using core::SpdfConstants;
using core::SpdfOptions;

using Tensor = std::array<int64_t, 6>;  // xx xy xz yy yz zz, units of 2^-24

int64_t SquaredDistance(const LatticePoint& a, const LatticePoint& b) {
  const int64_t dx = a.x - b.x;
  const int64_t dy = a.y - b.y;
  const int64_t dz = a.z - b.z;
  return dx * dx + dy * dy + dz * dz;
}

/// 2^24 exp(-d2 * scale) in float, as the specification of the filter has it.
float Weight(int64_t d2, float scale) {
  float x = -(static_cast<float>(d2) * scale);
  x = std::max(x, -87.0f);
  const float n = std::nearbyint(x * 1.44269504f);
  const float r = (x - n * 0.693359375f) - n * -2.12194440e-4f;
  const float coefficients[] = {8.33333333e-3f, 4.16666667e-2f, 1.66666667e-1f,
                                0.5f,           1.0f,           1.0f};
  float p = 1.38888889e-3f;
  for (const float c : coefficients) p = p * r + c;
  return std::ldexp(p, static_cast<int>(n) + 24);
}

int64_t Round(float x) { return static_cast<int64_t>(std::nearbyint(x)); }

class Filter {
 public:
  Filter(std::vector<LatticePoint> points, const core::Lattice& lattice,
         const SpdfOptions& options)
      : options_(options),
        constants_(core::MakeSpdfConstants(options, lattice)),
        points_(std::move(points)) {}

  BruteForceResult Run() {
    if (options_.rule == core::DensityRule::kQuota) {
      RunQuota();
    } else {
      RunRounds();
    }
    std::vector<std::array<float, 6>> voters;
    for (size_t i = 0; i < points_.size(); ++i) voters.push_back(Voter(i));
    BruteForceResult result;
    result.positions = points_;
    for (size_t i = 0; i < points_.size(); ++i) AppendLabel(i, voters, result);
    return result;
  }

 private:
  std::vector<size_t> Neighbors(size_t i, int count) const {
    std::vector<std::tuple<int64_t, int64_t, int64_t, int64_t, size_t>> near;
    for (size_t j = 0; j < points_.size(); ++j) {
      const int64_t d2 = SquaredDistance(points_[i], points_[j]);
      const LatticePoint& q = points_[j];
      if (j != i && d2 <= constants_.reach_d2) {
        near.emplace_back(d2, q.x, q.y, q.z, j);
      }
    }
    std::sort(near.begin(), near.end());
    near.resize(std::min(near.size(), static_cast<size_t>(count)));
    std::vector<size_t> result;
    for (const auto& neighbor : near) result.push_back(std::get<4>(neighbor));
    return result;
  }

  /// C0 and A of the ball vote of `count` neighbours.
  std::pair<int64_t, Tensor> BallVote(size_t i, int count) const {
    int64_t c0 = 0;
    Tensor a{};
    for (const size_t j : Neighbors(i, count)) {
      const auto dx = static_cast<float>(points_[i].x - points_[j].x);
      const auto dy = static_cast<float>(points_[i].y - points_[j].y);
      const auto dz = static_cast<float>(points_[i].z - points_[j].z);
      const int64_t d2 = SquaredDistance(points_[i], points_[j]);
      const float w = Weight(d2, constants_.weight_scale);
      const float g = w / static_cast<float>(d2);
      c0 += Round(w);
      a[0] += Round(g * dx * dx);
      a[1] += Round(g * dx * dy);
      a[2] += Round(g * dx * dz);
      a[3] += Round(g * dy * dy);
      a[4] += Round(g * dy * dz);
    }
    a[5] = c0 - a[0] - a[3];
    return {c0, a};
  }

  static double Scale(int64_t sum, int count) {
    return static_cast<double>(sum) / (count * 0x1p24);
  }

  Symmetric3 BallTensor(size_t i, int count) const {
    const auto [c0, a] = BallVote(i, count);
    const double c = Scale(c0, count);
    const auto half = [count](int64_t sum) { return Scale(sum, count) / 2; };
    return {c - half(a[0]), -half(a[1]), -half(a[2]),
            c - half(a[3]), -half(a[4]), c - half(a[5])};
  }

  void RunRounds() {
    const double xi1 = constants_.strength[0] * 0x1p-24;
    const double xi2 = constants_.strength[1] * 0x1p-24;
    const double xi3 = constants_.strength[2] * 0x1p-24;
    for (int round = 1; round <= options_.max_round_count; ++round) {
      std::vector<LatticePoint> survivors;
      bool any_flagged = false;
      for (size_t i = 0; i < points_.size(); ++i) {
        const auto lambda =
            Decompose(BallTensor(i, constants_.neighbor_count)).values;
        bool dies = false;
        const auto test = [&](bool flagged, int64_t number, double survival) {
          if (!flagged) return;
          any_flagged = true;
          const LatticePoint& q = points_[i];
          const int64_t key[6] = {q.x, q.y, q.z, round, number, options_.seed};
          if (static_cast<double>(HashIntegers(key) >> 40) >=
              survival * 0x1p24) {
            dies = true;
          }
        };
        test(lambda[2] >= 5.0 / 6.0 * xi3, 1, 0.2);
        test(lambda[1] >= xi1 && lambda[2] >= xi1 / 2, 2, 0.5);
        test(lambda[0] >= xi2 && lambda[2] >= 0.75 * xi2, 3, 0.5);
        if (!dies) survivors.push_back(points_[i]);
      }
      points_ = std::move(survivors);
      if (!any_flagged) return;
    }
  }

  void RunQuota() {
    std::vector<LatticePoint> survivors;
    const auto priority = [this](const LatticePoint& q) {
      const int64_t key[4] = {q.x, q.y, q.z, options_.seed};
      return HashIntegers(key);
    };
    for (const LatticePoint& p : points_) {
      int better = 0;
      for (const LatticePoint& q : points_) {
        if (SquaredDistance(p, q) <= constants_.density_d2 &&
            priority(q) < priority(p)) {
          ++better;
        }
      }
      if (better < constants_.neighbor_count) survivors.push_back(p);
    }
    points_ = std::move(survivors);
  }

  std::array<float, 6> Voter(size_t i) const {
    const Symmetric3 t = BallTensor(i, constants_.label_neighbor_count);
    const double smallest = SmallestEigenvalue(t);
    return {static_cast<float>(t.xx - smallest),
            static_cast<float>(t.xy),
            static_cast<float>(t.xz),
            static_cast<float>(t.yy - smallest),
            static_cast<float>(t.yz),
            static_cast<float>(t.zz - smallest)};
  }

  void AppendLabel(size_t i, const std::vector<std::array<float, 6>>& voters,
                   BruteForceResult& result) const {
    Tensor sum{};
    const int count = constants_.label_neighbor_count;
    const std::vector<size_t> neighbors = Neighbors(i, count);
    for (const size_t j : neighbors) {
      const int64_t d2 = SquaredDistance(points_[i], points_[j]);
      const float w = Weight(d2, constants_.weight_scale);
      const float length = std::sqrt(static_cast<float>(d2));
      const float r[3] = {
          static_cast<float>(points_[i].x - points_[j].x) / length,
          static_cast<float>(points_[i].y - points_[j].y) / length,
          static_cast<float>(points_[i].z - points_[j].z) / length};
      const auto& k = voters[j];
      const float g[3] = {(k[0] * r[0] + k[1] * r[1]) + k[2] * r[2],
                          (k[1] * r[0] + k[3] * r[1]) + k[4] * r[2],
                          (k[2] * r[0] + k[4] * r[1]) + k[5] * r[2]};
      const float q3 = 3.0f * ((g[0] * r[0] + g[1] * r[1]) + g[2] * r[2]);
      size_t e = 0;
      for (size_t a = 0; a < 3; ++a) {
        for (size_t b = a; b < 3; ++b, ++e) {
          const float cross = a == b ? 3.5f * (r[a] * g[a])
                                     : 1.75f * (r[a] * g[b] + r[b] * g[a]);
          sum[e] += Round(w * ((k[e] - cross) + q3 * r[a] * r[b]));
        }
      }
    }
    core::LabelColumns& columns = result.columns;
    if (neighbors.empty()) {
      columns.label.push_back(Label::kNone);
      columns.confidence.push_back(0);
      columns.lambda.push_back({0, 0, 0});
      columns.normal.push_back(0);
      columns.tangent.push_back(0);
      return;
    }
    const auto eigen = Decompose({Scale(sum[0], count), Scale(sum[1], count),
                                  Scale(sum[2], count), Scale(sum[3], count),
                                  Scale(sum[4], count), Scale(sum[5], count)});
    const std::array<float, 3> lambda = {static_cast<float>(eigen.values[0]),
                                         static_cast<float>(eigen.values[1]),
                                         static_cast<float>(eigen.values[2])};
    const float saliency[3] = {lambda[0] - lambda[1], lambda[1] - lambda[2],
                               lambda[2]};
    const size_t largest = static_cast<size_t>(
        std::max_element(saliency, saliency + 3) - saliency);
    constexpr core::Label kOrder[3] = {Label::kSurface, Label::kCurve,
                                       Label::kJunction};
    columns.label.push_back(kOrder[largest]);
    columns.confidence.push_back(static_cast<uint16_t>(std::nearbyint(
        std::clamp(static_cast<double>(saliency[largest]), 0.0, 1.0) *
        65535.0)));
    columns.lambda.push_back(lambda);
    columns.normal.push_back(
        core::EncodeOctahedral(core::WithCanonicalSign(eigen.vectors[0])));
    columns.tangent.push_back(
        core::EncodeOctahedral(core::WithCanonicalSign(eigen.vectors[2])));
  }

  const SpdfOptions options_;
  const SpdfConstants constants_;
  std::vector<LatticePoint> points_;
};

}  // namespace

BruteForceResult BruteForceFilter(const std::vector<LatticePoint>& points,
                                  const core::Lattice& lattice,
                                  const SpdfOptions& options) {
  return Filter(points, lattice, options).Run();
}

}  // namespace mapsieve::testing
