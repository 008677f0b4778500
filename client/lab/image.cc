#include "client/lab/image.h"

#include <png.h>

#include <algorithm>
#include <cmath>

#include "core/base/status.h"

namespace mapsieve::client {
namespace {

uint8_t MixChannel(uint8_t from, uint8_t to, double t) {
  return static_cast<uint8_t>(std::lround(from + (to - from) * t));
}

}  // namespace

Color Mix(Color from, Color to, double t) {
  return {MixChannel(from.red, to.red, t), MixChannel(from.green, to.green, t),
          MixChannel(from.blue, to.blue, t)};
}

Image::Image(int width, int height, Color fill)
    : width_(width),
      height_(height),
      pixels_(static_cast<size_t>(width) * static_cast<size_t>(height), fill) {}

void Image::Blend(int x, int y, Color color, double coverage) {
  if (x < 0 || x >= width_ || y < 0 || y >= height_) return;
  Color& pixel = At(x, y);
  pixel = Mix(pixel, color, std::clamp(coverage, 0.0, 1.0));
}

void Image::FillRect(int x, int y, int width, int height, Color color) {
  for (int row = std::max(y, 0); row < std::min(y + height, height_); ++row) {
    for (int column = std::max(x, 0); column < std::min(x + width, width_);
         ++column) {
      At(column, row) = color;
    }
  }
}

void Image::FillDisc(double x, double y, double radius, Color color) {
  const int reach = static_cast<int>(std::ceil(radius)) + 1;
  const int center_x = static_cast<int>(std::floor(x));
  const int center_y = static_cast<int>(std::floor(y));
  for (int row = center_y - reach; row <= center_y + reach; ++row) {
    for (int column = center_x - reach; column <= center_x + reach; ++column) {
      const double distance = std::hypot(column + 0.5 - x, row + 0.5 - y);
      Blend(column, row, color, radius + 0.5 - distance);
    }
  }
}

absl::StatusOr<std::vector<std::byte>> EncodePng(const Image& image) {
  static_assert(sizeof(Color) == 3);
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = static_cast<png_uint_32>(image.width());
  png.height = static_cast<png_uint_32>(image.height());
  png.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png);
  std::vector<std::byte> bytes(size);
  const int written =
      png_image_write_to_memory(&png, bytes.data(), &size,
                                /*convert_to_8bit=*/0, &image.At(0, 0),
                                3 * image.width(), /*colormap=*/nullptr);
  png_image_free(&png);
  if (written == 0) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the picture cannot be encoded: ", png.message));
  }
  bytes.resize(size);
  return bytes;
}

}  // namespace mapsieve::client
