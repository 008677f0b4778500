#ifndef MAPSIEVE_TESTS_FUZZ_CHECK_H_
#define MAPSIEVE_TESTS_FUZZ_CHECK_H_

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

/// What the fuzzers share.
namespace mapsieve::testing {

/// Ends the process, so that libFuzzer keeps the input, unless `holds`.
inline void Check(bool holds, const char* what,
                  const std::string& detail = {}) {
  if (holds) return;
  std::fprintf(stderr, "does not hold: %s. %s\n", what, detail.c_str());
  std::abort();
}

/// A folder in memory for what is read and written as files. Only a process
/// that ends well removes it.
class MemoryFolder {
 public:
  MemoryFolder() {
    std::string name = "/dev/shm/mapsieve-fuzz-XXXXXX";
    Check(::mkdtemp(name.data()) != nullptr, "a folder is made", name);
    path_ = name;
  }
  ~MemoryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  MemoryFolder(const MemoryFolder&) = delete;
  MemoryFolder& operator=(const MemoryFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_FUZZ_CHECK_H_
