#ifndef MAPSIEVE_TESTS_FORMATS_LAS_TEXT_H_
#define MAPSIEVE_TESTS_FORMATS_LAS_TEXT_H_

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "tests/formats/packed.h"

/// LAS files as their bytes.
namespace mapsieve::client::testing {

/// Zeros behind a text.
inline std::string Padded(std::string text, size_t size) {
  text.resize(size, '\0');
  return text;
}

/// A variable length record, and an extended one.
inline std::string Vlr(const std::string& user, uint16_t id,
                       const std::string& payload) {
  return Packed(uint16_t{0}) + Padded(user, 16) +
         Packed(id, static_cast<uint16_t>(payload.size())) +
         Padded("description", 32) + payload;
}

inline std::string Evlr(const std::string& user, uint16_t id,
                        const std::string& payload) {
  return Packed(uint16_t{0}) + Padded(user, 16) +
         Packed(id, static_cast<uint64_t>(payload.size())) +
         Padded("description", 32) + payload;
}

/// A LAS file byte by byte, as the specification has it.
struct LasText {
  int minor = 2;
  int format = 0;
  std::vector<std::string> vlrs;
  std::vector<std::string> records;
  std::vector<std::string> evlrs;
  std::array<double, 3> scale = {0.01, 0.01, 0.01};
  std::array<double, 3> offset = {};
  /// What the header says, where it is not the truth.
  int record_bytes = -1;
  int64_t legacy_count = -1;
  int64_t count = -1;
  int64_t vlr_count = -1;

  std::string Build() const {
    const auto size = static_cast<int64_t>(records.size());
    const size_t header_bytes = minor >= 4 ? 375 : minor == 3 ? 235 : 227;
    std::string all_vlrs;
    for (const std::string& vlr : vlrs) all_vlrs += vlr;
    std::string all_records;
    for (const std::string& record : records) all_records += record;
    const size_t points_offset = header_bytes + all_vlrs.size();
    const int64_t legacy = format >= 6 ? 0 : size;

    std::string text = "LASF" + std::string(20, '\0');
    text += Packed(uint8_t{1}, static_cast<uint8_t>(minor));
    text += Padded("system", 32) + Padded("software", 32);
    text += Packed(
        uint16_t{1}, uint16_t{2024}, static_cast<uint16_t>(header_bytes),
        static_cast<uint32_t>(points_offset),
        static_cast<uint32_t>(vlr_count < 0 ? static_cast<int64_t>(vlrs.size())
                                            : vlr_count),
        static_cast<uint8_t>(format));
    const size_t actual = records.empty() ? 0 : records[0].size();
    text +=
        Packed(static_cast<uint16_t>(record_bytes < 0 ? static_cast<int>(actual)
                                                      : record_bytes),
               static_cast<uint32_t>(legacy_count < 0 ? legacy : legacy_count));
    text += std::string(20, '\0');
    for (const double value : scale) text += Packed(value);
    for (const double value : offset) text += Packed(value);
    text += std::string(48, '\0');
    if (minor >= 3) text += Packed(uint64_t{0});
    if (minor >= 4) {
      text +=
          Packed(static_cast<uint64_t>(
                     evlrs.empty() ? 0 : points_offset + all_records.size()),
                 static_cast<uint32_t>(evlrs.size()),
                 static_cast<uint64_t>(count < 0 ? size : count));
      text += std::string(120, '\0');
    }
    EXPECT_EQ(text.size(), header_bytes);
    text += all_vlrs + all_records;
    for (const std::string& evlr : evlrs) text += evlr;
    return text;
  }
};

inline std::string Xyz(int32_t x, int32_t y, int32_t z) {
  return Packed(x, y, z);
}

/// A record of format 0 with `x`; the other bytes are zero.
inline std::string Record0(int32_t x) { return Padded(Xyz(x, 0, 0), 20); }

}  // namespace mapsieve::client::testing

#endif  // MAPSIEVE_TESTS_FORMATS_LAS_TEXT_H_
