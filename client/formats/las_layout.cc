#include "client/formats/las_layout.h"

#include <array>

namespace mapsieve::client {
namespace {

using core::ScalarType;

// Bytes of a record and where its optional parts begin; 0: it has none.
struct PointFormat {
  size_t bytes;
  size_t gps_time;
  size_t colour;
  size_t nir;
  size_t wave;
};

constexpr std::array<PointFormat, kLasPointFormats> kPointFormats = {{
    {.bytes = 20, .gps_time = 0, .colour = 0, .nir = 0, .wave = 0},
    {.bytes = 28, .gps_time = 20, .colour = 0, .nir = 0, .wave = 0},
    {.bytes = 26, .gps_time = 0, .colour = 20, .nir = 0, .wave = 0},
    {.bytes = 34, .gps_time = 20, .colour = 28, .nir = 0, .wave = 0},
    {.bytes = 57, .gps_time = 20, .colour = 0, .nir = 0, .wave = 28},
    {.bytes = 63, .gps_time = 20, .colour = 28, .nir = 0, .wave = 34},
    {.bytes = 30, .gps_time = 22, .colour = 0, .nir = 0, .wave = 0},
    {.bytes = 36, .gps_time = 22, .colour = 30, .nir = 0, .wave = 0},
    {.bytes = 38, .gps_time = 22, .colour = 30, .nir = 36, .wave = 0},
    {.bytes = 59, .gps_time = 22, .colour = 0, .nir = 0, .wave = 30},
    {.bytes = 67, .gps_time = 22, .colour = 30, .nir = 36, .wave = 38},
}};

}  // namespace

size_t LasRecordBytes(int point_format) {
  return kPointFormats[static_cast<size_t>(point_format)].bytes;
}

std::vector<LasField> LasFields(int point_format) {
  const PointFormat& format = kPointFormats[static_cast<size_t>(point_format)];
  std::vector<LasField> fields;
  const auto add = [&](const char* name, ScalarType type, size_t offset) {
    fields.push_back({.name = name, .type = type, .offset = offset});
  };
  const auto add_bits = [&](const char* name, size_t offset, int shift,
                            int bits) {
    fields.push_back({.name = name,
                      .type = ScalarType::kUint8,
                      .offset = offset,
                      .bits = bits,
                      .shift = shift});
  };

  add("intensity", ScalarType::kUint16, 12);
  if (point_format < 6) {
    add_bits("return_number", 14, 0, 3);
    add_bits("number_of_returns", 14, 3, 3);
    add_bits("scan_direction", 14, 6, 1);
    add_bits("edge_of_flight_line", 14, 7, 1);
    add_bits("classification", 15, 0, 5);
    add_bits("synthetic", 15, 5, 1);
    add_bits("key_point", 15, 6, 1);
    add_bits("withheld", 15, 7, 1);
    add("scan_angle_rank", ScalarType::kInt8, 16);
    add("user_data", ScalarType::kUint8, 17);
    add("point_source_id", ScalarType::kUint16, 18);
  } else {
    add_bits("return_number", 14, 0, 4);
    add_bits("number_of_returns", 14, 4, 4);
    add_bits("synthetic", 15, 0, 1);
    add_bits("key_point", 15, 1, 1);
    add_bits("withheld", 15, 2, 1);
    add_bits("overlap", 15, 3, 1);
    add_bits("scanner_channel", 15, 4, 2);
    add_bits("scan_direction", 15, 6, 1);
    add_bits("edge_of_flight_line", 15, 7, 1);
    add("classification", ScalarType::kUint8, 16);
    add("user_data", ScalarType::kUint8, 17);
    add("scan_angle", ScalarType::kInt16, 18);
    add("point_source_id", ScalarType::kUint16, 20);
  }
  if (format.gps_time != 0) {
    add("gps_time", ScalarType::kFloat64, format.gps_time);
  }
  if (format.colour != 0) {
    add("red", ScalarType::kUint16, format.colour);
    add("green", ScalarType::kUint16, format.colour + 2);
    add("blue", ScalarType::kUint16, format.colour + 4);
  }
  if (format.nir != 0) add("nir", ScalarType::kUint16, format.nir);
  if (format.wave != 0) {
    add("wave_descriptor_index", ScalarType::kUint8, format.wave);
    add("wave_offset", ScalarType::kUint64, format.wave + 1);
    add("wave_size", ScalarType::kUint32, format.wave + 9);
    add("wave_return_point", ScalarType::kFloat32, format.wave + 13);
    add("wave_x_t", ScalarType::kFloat32, format.wave + 17);
    add("wave_y_t", ScalarType::kFloat32, format.wave + 21);
    add("wave_z_t", ScalarType::kFloat32, format.wave + 25);
  }
  return fields;
}

int LasExtraType(ScalarType type) {
  switch (type) {
    case ScalarType::kUint8:
      return 1;
    case ScalarType::kInt8:
      return 2;
    case ScalarType::kUint16:
      return 3;
    case ScalarType::kInt16:
      return 4;
    case ScalarType::kUint32:
      return 5;
    case ScalarType::kInt32:
      return 6;
    case ScalarType::kUint64:
      return 7;
    case ScalarType::kInt64:
      return 8;
    case ScalarType::kFloat32:
      return 9;
    case ScalarType::kFloat64:
      break;
  }
  return 10;
}

}  // namespace mapsieve::client
