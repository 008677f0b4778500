#include "core/cloud/label.h"

namespace mapsieve::core {

std::string_view LabelName(Label label) {
  switch (label) {
    case Label::kNone:
      break;
    case Label::kJunction:
      return "junction";
    case Label::kCurve:
      return "curve";
    case Label::kSurface:
      return "surface";
  }
  return "none";
}

}  // namespace mapsieve::core
