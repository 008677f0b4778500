#ifndef MAPSIEVE_CLIENT_LAB_SPLAT_BUFFER_H_
#define MAPSIEVE_CLIENT_LAB_SPLAT_BUFFER_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "client/lab/image.h"

namespace mapsieve::client {

/// A picture of points as round splats with a depth buffer. Every pixel is
/// made of kSamplesPerAxis x kSamplesPerAxis samples, so that edges are smooth.
/// The nearest splat wins a sample; the darker of two colours at equal depth:
/// the picture does not depend on the order of the points. Memory: 32 bytes a
/// pixel, 64 in Resolve. Not thread-safe.
class SplatBuffer {
 public:
  static constexpr int kSamplesPerAxis = 2;

  /// `width`, `height`: pixels; `diameter`: of a splat, in pixels;
  /// `elevation_deg`: of the eye over the horizon, 90 for a view from above.
  SplatBuffer(int width, int height, double diameter, double elevation_deg);

  /// Draws a point. `x`, `y`: pixels from the top left corner; anything outside
  /// is cut off. `depth`: pixels too, growing away from the viewer.
  void Splat(double x, double y, double depth, Color color);

  /// Puts the picture on `image` at column `left` and row `top`, over what is
  /// there. `shading` darkens samples next to which something stands that is
  /// both nearer to the eye and higher: a form of eye-dome lighting, which
  /// shows shape without normals and leaves level ground bright in every view.
  /// 0 leaves the colours alone, 1 is natural.
  void Resolve(double shading, int left, int top, Image& image) const;

 private:
  struct Sample {
    float depth;
    Color color;
  };
  struct StampCell {
    int dx;
    int dy;
    float depth;
  };

  size_t Index(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(width_) +
           static_cast<size_t>(x);
  }
  // Depths without the relief of single splats; edges stay where they are.
  std::vector<float> SmoothDepths() const;
  double Light(const std::vector<float>& depths, int x, int y,
               double shading) const;

  // In samples.
  int width_;
  int height_;
  int reach_;
  double sine_;
  double cosine_;
  std::vector<StampCell> stamp_;
  std::vector<Sample> samples_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SPLAT_BUFFER_H_
