#include "core/cloud/packed_columns.h"

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "core/cloud/label.h"
#include "core/geometry/octahedral.h"

namespace mapsieve::core {
namespace {

struct Packing {
  ColumnSpec packed;
  std::vector<ColumnSpec> unpacked;
};

ColumnSpec Float(std::string name) {
  return {std::move(name), ScalarType::kFloat32};
}

const std::vector<Packing>& Packings() {
  static const auto& packings = *new std::vector<Packing>{
      {{std::string(kPackedConfidence), ScalarType::kUint16},
       {Float("confidence")}},
      {{std::string(kPackedNormal), ScalarType::kUint32},
       {Float("nx"), Float("ny"), Float("nz")}},
      {{std::string(kPackedTangent), ScalarType::kUint32},
       {Float("tx"), Float("ty"), Float("tz")}}};
  return packings;
}

}  // namespace

std::vector<ColumnSpec> UnpackedSpecs(const ColumnSpec& spec) {
  for (const Packing& packing : Packings()) {
    if (packing.packed == spec) return packing.unpacked;
  }
  return {spec};
}

void Unpack(Column column, std::vector<Column>& unpacked) {
  const std::vector<ColumnSpec> specs = UnpackedSpecs(column.spec());
  if (specs.front() == column.spec()) {
    unpacked.push_back(std::move(column));
    return;
  }
  const size_t first = unpacked.size();
  for (const ColumnSpec& spec : specs) {
    unpacked.emplace_back(spec, column.size());
  }
  if (specs.size() == 1) {
    for (size_t i = 0; i < column.size(); ++i) {
      unpacked[first].Set(i, ConfidenceValue(column.Get<uint16_t>(i)));
    }
    return;
  }
  for (size_t i = 0; i < column.size(); ++i) {
    const std::array<float, 3> v = DecodeOctahedral(column.Get<uint32_t>(i));
    for (size_t axis = 0; axis < v.size(); ++axis) {
      unpacked[first + axis].Set(i, v[axis]);
    }
  }
}

}  // namespace mapsieve::core
