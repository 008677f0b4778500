#ifndef MAPSIEVE_TESTS_API_WIRE_LISTING_H_
#define MAPSIEVE_TESTS_API_WIRE_LISTING_H_

#include <string>
#include <vector>

#include "google/protobuf/descriptor.h"

namespace mapsieve::testing {

/// What a program compiled against `files` relies on: a line for each method
/// (names and types), each field (message, number, name, label, type) and each
/// value of an enum. Sorted.
std::vector<std::string> WireListing(
    const std::vector<const google::protobuf::FileDescriptor*>& files);

/// The lines of `recorded` that `current` lacks: each breaks such a program.
std::vector<std::string> BrokenLines(const std::vector<std::string>& recorded,
                                     const std::vector<std::string>& current);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_API_WIRE_LISTING_H_
