#include "tests/api/api_files.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "absl/strings/str_cat.h"

namespace mapsieve::testing {

class ApiFiles::Errors final
    : public google::protobuf::compiler::MultiFileErrorCollector {
 public:
  explicit Errors(std::string& text) : text_(text) {}

  void AddError(const std::string& file, int line, int /*column*/,
                const std::string& message) override {
    absl::StrAppend(&text_, file, ":", line + 1, ": ", message, "\n");
  }

 private:
  std::string& text_;
};

ApiFiles::ApiFiles(const std::string& folder,
                   const std::vector<std::string>& paths)
    : collector_(std::make_unique<Errors>(errors_)),
      standard_(*google::protobuf::DescriptorPool::generated_pool()),
      database_(&tree_, &standard_),
      pool_(&database_, database_.GetValidationErrorCollector()) {
  tree_.MapPath("", folder);
  database_.RecordErrorsTo(collector_.get());
  for (const std::string& path : paths) {
    const auto* file = pool_.FindFileByName(path);
    if (file != nullptr) files_.push_back(file);
  }
  if (files_.size() != paths.size() && errors_.empty()) {
    errors_ = absl::StrCat("not all files of ", folder, " could be read\n");
  }
  if (!errors_.empty()) files_.clear();
}

ApiFiles::~ApiFiles() = default;

std::unique_ptr<ApiFiles> ReadApi(const std::string& root) {
  const std::filesystem::path folder = std::filesystem::path(root) / "proto";
  std::vector<std::string> paths;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(folder)) {
    if (entry.path().extension() == ".proto") {
      paths.push_back(std::filesystem::relative(entry.path(), folder).string());
    }
  }
  // Those with a service of this name, as a user meets them; then the others.
  const std::vector<std::string> order = {"map_service", "upload_service",
                                          "processing_service", "query_service",
                                          "operations"};
  const auto place = [&](const std::string& path) {
    return std::find(order.begin(), order.end(),
                     std::filesystem::path(path).stem().string()) -
           order.begin();
  };
  std::sort(paths.begin(), paths.end());
  std::stable_sort(
      paths.begin(), paths.end(),
      [&](const auto& a, const auto& b) { return place(a) < place(b); });
  return std::make_unique<ApiFiles>(folder.string(), paths);
}

std::string ReadText(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

}  // namespace mapsieve::testing
