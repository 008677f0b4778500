#ifndef MAPSIEVE_CLIENT_LAB_COLORMAP_H_
#define MAPSIEVE_CLIENT_LAB_COLORMAP_H_

#include <cstddef>

#include "client/lab/image.h"
#include "core/cloud/label.h"

/// The colours of pictures. All are told apart with the common kinds of colour
/// blindness and, by lightness, in grey. Thread-safe.
namespace mapsieve::client {

/// Points without a value.
inline constexpr Color kNoValueColor{108, 111, 118};

/// Colour of a geometric label; kNoValueColor for kNone and unknown numbers.
Color LabelColor(core::Label label);

/// How many classes get a colour of their own.
inline constexpr size_t kCategoryColorCount = 8;

/// Colour of the `index`-th class of an attribute of few values.
Color CategoryColor(size_t index);

/// Colour of `t` in [0, 1] (clamped; NaN: no value) on a scale of evenly rising
/// lightness, from blue over green to yellow.
Color ScaleColor(double t);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_COLORMAP_H_
