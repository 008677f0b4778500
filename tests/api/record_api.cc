// Records the API of a tree: adds what is new to the listing of its wire form
// and writes the page of its reference.
//
//   record_api ROOT
//
// Exits with 1 and changes nothing if something recorded is gone or different.

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "tests/api/api_files.h"
#include "tests/api/api_reference.h"
#include "tests/api/wire_listing.h"

namespace mapsieve::testing {
namespace {

int Record(const std::string& root) {
  const auto api = ReadApi(root);
  if (!api->errors().empty()) {
    std::fputs(api->errors().c_str(), stderr);
    return EXIT_FAILURE;
  }
  const std::string listing_path = absl::StrCat(root, "/", kWireListingPath);
  const std::vector<std::string> recorded =
      absl::StrSplit(ReadText(listing_path), '\n', absl::SkipEmpty());
  const std::vector<std::string> current = WireListing(api->files());
  const std::vector<std::string> broken = BrokenLines(recorded, current);
  for (const std::string& line : broken) {
    std::fprintf(stderr, "record_api: gone or different: %s\n", line.c_str());
  }
  if (!broken.empty()) return EXIT_FAILURE;
  std::ofstream(listing_path) << absl::StrJoin(current, "\n") << "\n";
  std::ofstream(absl::StrCat(root, "/", kReferencePath))
      << ApiReference(api->files());
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace mapsieve::testing

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: record_api ROOT\n", stderr);
    return 2;
  }
  return mapsieve::testing::Record(argv[1]);
}
