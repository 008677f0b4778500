#ifndef MAPSIEVE_TESTS_FUZZ_CHECK_H_
#define MAPSIEVE_TESTS_FUZZ_CHECK_H_

#include <cstdio>
#include <cstdlib>
#include <string>

/// What the fuzzers share.
namespace mapsieve::testing {

/// Ends the process, so that libFuzzer keeps the input, unless `holds`.
inline void Check(bool holds, const char* what,
                  const std::string& detail = {}) {
  if (holds) return;
  std::fprintf(stderr, "does not hold: %s. %s\n", what, detail.c_str());
  std::abort();
}

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_FUZZ_CHECK_H_
