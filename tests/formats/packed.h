#ifndef MAPSIEVE_TESTS_FORMATS_PACKED_H_
#define MAPSIEVE_TESTS_FORMATS_PACKED_H_

#include <string>

#include "core/base/bytes.h"

namespace mapsieve::client::testing {

/// The bytes of little-endian fields, one after another.
template <typename... Fields>
std::string Packed(Fields... fields) {
  ByteWriter writer;
  (writer.Put(fields), ...);
  return {reinterpret_cast<const char*>(writer.bytes().data()), writer.size()};
}

}  // namespace mapsieve::client::testing

#endif  // MAPSIEVE_TESTS_FORMATS_PACKED_H_
