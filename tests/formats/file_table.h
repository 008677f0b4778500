#ifndef MAPSIEVE_TESTS_FORMATS_FILE_TABLE_H_
#define MAPSIEVE_TESTS_FORMATS_FILE_TABLE_H_

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "client/formats/point_file.h"
#include "core/base/status.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/testing/status_matchers.h"

/// What the tests of point files share.
namespace mapsieve::client::testing {

/// All points of `reader`, by batches of `batch` points.
inline absl::StatusOr<core::PointCloud> ReadAll(PointReader& reader,
                                                size_t batch = 97) {
  core::PointCloud all;
  for (const core::ColumnSpec& spec : reader.info().attributes) {
    MAPSIEVE_RETURN_IF_ERROR(all.attributes.Add(core::Column(spec)));
  }
  while (true) {
    MAPSIEVE_ASSIGN_OR_RETURN(const core::PointCloud next,
                              reader.ReadBatch(batch));
    EXPECT_LE(next.size(), batch);
    EXPECT_EQ(next.attributes.specs(), reader.info().attributes);
    if (next.size() == 0) return all;
    MAPSIEVE_RETURN_IF_ERROR(
        all.attributes.AppendAll(all.size(), next.attributes, next.size()));
    all.positions.insert(all.positions.end(), next.positions.begin(),
                         next.positions.end());
  }
}

using Opener = std::function<absl::StatusOr<std::unique_ptr<PointReader>>(
    const std::filesystem::path&)>;

inline absl::StatusOr<core::PointCloud> ReadAll(
    const Opener& open, const std::filesystem::path& path, size_t batch = 97) {
  MAPSIEVE_ASSIGN_OR_RETURN(const auto reader, open(path));
  return ReadAll(*reader, batch);
}

/// A file of its own for each test, removed with the object.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::string_view extension,
                         std::string_view content = {}) {
    const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
    path_ = std::filesystem::path(::testing::TempDir()) /
            (std::string(test->test_suite_name()) + "." + test->name() +
             std::string(extension));
    if (!content.empty()) Write(content);
  }
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  const std::filesystem::path& path() const { return path_; }
  void Write(std::string_view content) const {
    std::ofstream(path_, std::ios::binary | std::ios::trunc) << content;
  }
  std::string Read() const { return ReadFile(path_); }

  static std::string ReadFile(const std::filesystem::path& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }

 private:
  std::filesystem::path path_;
};

/// Compares the finite coordinates with a box known to eight digits.
inline void ExpectExtent(const core::PointCloud& cloud, const core::Point3& low,
                         const core::Point3& high) {
  constexpr double kRelative = 5.1e-8;
  for (const auto axis :
       {&core::Point3::x, &core::Point3::y, &core::Point3::z}) {
    double least = std::numeric_limits<double>::infinity();
    double most = -least;
    for (const core::Point3& p : cloud.positions) {
      least = std::fmin(least, p.*axis);
      most = std::fmax(most, p.*axis);
    }
    EXPECT_NEAR(least, low.*axis, kRelative * std::abs(least));
    EXPECT_NEAR(most, high.*axis, kRelative * std::abs(most));
  }
}

/// What a file of the test data gives: so many records, or a refusal.
struct FileCase {
  /// Below the folder of the table.
  std::string path;
  int64_t count = 0;
  absl::StatusCode code = absl::StatusCode::kOk;
  /// Part of the message of a refusal, besides the file's name.
  std::string message;
};

/// Reads every file below `folder` and compares it with its line in `table`;
/// files and table must be the same but for READMEs.
inline void ExpectTable(const std::filesystem::path& folder,
                        const std::vector<FileCase>& table,
                        const Opener& open) {
  std::map<std::string, const FileCase*> cases;
  for (const FileCase& line : table) {
    EXPECT_TRUE(cases.emplace(line.path, &line).second) << line.path;
  }
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file() || entry.path().filename() == "README.md") {
      continue;
    }
    const std::string name =
        std::filesystem::relative(entry.path(), folder).string();
    SCOPED_TRACE(name);
    const auto found = cases.find(name);
    if (found == cases.end()) {
      ADD_FAILURE() << "is not in the table";
      continue;
    }
    const FileCase& expected = *found->second;
    const auto points = ReadAll(open, entry.path());
    EXPECT_EQ(points.status().code(), expected.code) << points.status();
    if (points.ok()) {
      EXPECT_EQ(static_cast<int64_t>(points->size()), expected.count);
    } else {
      const std::string message(points.status().message());
      EXPECT_THAT(message, ::testing::HasSubstr(expected.message));
      EXPECT_THAT(message,
                  ::testing::HasSubstr(entry.path().filename().string()));
      EXPECT_THAT(message, ::testing::Not(::testing::HasSubstr("\n")));
    }
    cases.erase(found);
  }
  for (const auto& [name, line] : cases) {
    ADD_FAILURE() << name << " is in the table, but no such file exists";
  }
}

}  // namespace mapsieve::client::testing

#endif  // MAPSIEVE_TESTS_FORMATS_FILE_TABLE_H_
