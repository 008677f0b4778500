#ifndef MAPSIEVE_TESTS_LAB_PICTURE_TEST_UTIL_H_
#define MAPSIEVE_TESTS_LAB_PICTURE_TEST_UTIL_H_

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "client/lab/image.h"
#include "core/cloud/point_cloud.h"
#include "gtest/gtest.h"

namespace mapsieve::client {

/// A cloud of positions with one attribute.
template <typename T>
core::PointCloud MakeCloud(std::vector<core::Point3> positions,
                           const std::string& attribute,
                           const std::vector<T>& values) {
  core::Column column({attribute, core::ScalarTypeOf<T>()});
  for (const T value : values) column.Append(value);
  core::PointCloud cloud;
  cloud.positions = std::move(positions);
  EXPECT_TRUE(cloud.attributes.Add(std::move(column)).ok());
  return cloud;
}

/// Columns [left, right) and rows [top, bottom) of an image.
struct PixelBox {
  int left = 0;
  int top = 0;
  int right = 0;
  int bottom = 0;

  int width() const { return right - left; }
  int height() const { return bottom - top; }
};

/// The smallest box around all pixels within `area` that differ from the top
/// left pixel of `image`, its background.
inline PixelBox InkBox(const Image& image, const PixelBox& area) {
  PixelBox box{area.right, area.bottom, area.left, area.top};
  for (int y = area.top; y < area.bottom; ++y) {
    for (int x = area.left; x < area.right; ++x) {
      if (image.At(x, y) == image.At(0, 0)) continue;
      box.left = std::min(box.left, x);
      box.top = std::min(box.top, y);
      box.right = std::max(box.right, x + 1);
      box.bottom = std::max(box.bottom, y + 1);
    }
  }
  return box;
}

inline PixelBox InkBox(const Image& image) {
  return InkBox(image, {0, 0, image.width(), image.height()});
}

/// The pixel in the middle of the ink within `area`.
inline Color InkColor(const Image& image, const PixelBox& area) {
  const PixelBox box = InkBox(image, area);
  if (box.width() <= 0) return image.At(0, 0);
  return image.At((box.left + box.right) / 2, (box.top + box.bottom) / 2);
}

inline int CountPixels(const Image& image, Color color) {
  int count = 0;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      if (image.At(x, y) == color) ++count;
    }
  }
  return count;
}

}  // namespace mapsieve::client

#endif  // MAPSIEVE_TESTS_LAB_PICTURE_TEST_UTIL_H_
