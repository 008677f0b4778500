#ifndef MAPSIEVE_CLIENT_LAB_IMAGE_H_
#define MAPSIEVE_CLIENT_LAB_IMAGE_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/statusor.h"

namespace mapsieve::client {

/// An sRGB colour.
struct Color {
  uint8_t red = 0;
  uint8_t green = 0;
  uint8_t blue = 0;

  friend bool operator==(const Color&, const Color&) = default;
};

/// `from` and `to` mixed in sRGB: `from` at t = 0, `to` at t = 1.
Color Mix(Color from, Color to, double t);

/// A picture of width x height pixels, row by row from the top left. What is
/// drawn outside of it is cut off. Not thread-safe.
class Image {
 public:
  Image(int width, int height, Color fill);

  int width() const { return width_; }
  int height() const { return height_; }

  /// The pixel of column `x` and row `y`, which are inside.
  Color& At(int x, int y) { return pixels_[Index(x, y)]; }
  const Color& At(int x, int y) const { return pixels_[Index(x, y)]; }

  /// Lays `color` over a pixel; `coverage` 0 leaves it, 1 replaces it.
  void Blend(int x, int y, Color color, double coverage);
  void FillRect(int x, int y, int width, int height, Color color);
  /// A disc with smooth edges; `x`, `y`: its centre, in pixels from the top
  /// left corner of the image.
  void FillDisc(double x, double y, double radius, Color color);

 private:
  size_t Index(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(width_) +
           static_cast<size_t>(x);
  }

  int width_;
  int height_;
  std::vector<Color> pixels_;
};

/// `image` as the bytes of an 8-bit RGB PNG; the same image gives the same
/// bytes. kResourceExhausted: no memory for them.
absl::StatusOr<std::vector<std::byte>> EncodePng(const Image& image);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_IMAGE_H_
