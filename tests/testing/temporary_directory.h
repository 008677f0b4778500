#ifndef MAPSIEVE_TESTS_TESTING_TEMPORARY_DIRECTORY_H_
#define MAPSIEVE_TESTS_TESTING_TEMPORARY_DIRECTORY_H_

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

namespace mapsieve::testing {

/// A new empty directory of a name that no other process has, removed at the
/// end; in memory where the system offers that, since syncs to a disk take most
/// of a test's time.
class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    const std::filesystem::path memory = "/dev/shm";
    std::error_code error;
    const auto space = std::filesystem::space(memory, error);
    const bool use_memory = !error && space.available > (256u << 20);
    path_ = (use_memory ? memory : std::filesystem::temp_directory_path()) /
            "mapsieve-XXXXXX";
    if (::mkdtemp(path_.data()) == nullptr) {
      std::perror(path_.c_str());
      std::abort();
    }
  }
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;

  const std::string& path() const { return path_; }
  std::string operator/(const std::string& name) const {
    return path_ + "/" + name;
  }

 private:
  std::string path_;
};

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_TESTING_TEMPORARY_DIRECTORY_H_
