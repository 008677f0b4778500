#ifndef MAPSIEVE_TESTS_API_API_REFERENCE_H_
#define MAPSIEVE_TESTS_API_API_REFERENCE_H_

#include <string>
#include <vector>

#include "google/protobuf/descriptor.h"

namespace mapsieve::testing {

/// A page in Markdown that holds every service, method, error, message, field
/// and enum of `files` with its comment: first the services, then the types, in
/// the order of the files.
std::string ApiReference(
    const std::vector<const google::protobuf::FileDescriptor*>& files);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_API_API_REFERENCE_H_
