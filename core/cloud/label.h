#ifndef MAPSIEVE_CORE_CLOUD_LABEL_H_
#define MAPSIEVE_CORE_CLOUD_LABEL_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

namespace mapsieve::core {

/// The geometric primitive a point lies on. The numbers are part of the
/// formats (and libpointmatcher's).
enum class Label : uint8_t {
  /// No neighbour within reach: no vote, so no label.
  kNone = 0,
  kJunction = 1,
  kCurve = 2,
  kSurface = 3,
};
inline constexpr size_t kLabelCount = 4;

/// "none", "junction", "curve", "surface".
std::string_view LabelName(Label label);

/// A confidence as it is counted in 16 bits, as a number from 0 to 1.
inline float ConfidenceValue(uint16_t confidence) {
  return static_cast<float>(confidence) / 65535.0f;
}

using LabelCounts = std::array<int64_t, kLabelCount>;

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CLOUD_LABEL_H_
