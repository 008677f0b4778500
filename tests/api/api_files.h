#ifndef MAPSIEVE_TESTS_API_API_FILES_H_
#define MAPSIEVE_TESTS_API_API_FILES_H_

#include <memory>
#include <string>
#include <vector>

#include "google/protobuf/compiler/importer.h"
#include "google/protobuf/descriptor.h"

namespace mapsieve::testing {

/// The files below ROOT that are made of the protos.
inline constexpr char kWireListingPath[] = "tests/api/wire.txt";
inline constexpr char kReferencePath[] = "docs/api.md";

/// The .proto files of a tree, parsed with their comments. Not thread-safe.
class ApiFiles {
 public:
  /// Parses the files at `paths` below `folder`. What they import besides them
  /// is part of protobuf.
  ApiFiles(const std::string& folder, const std::vector<std::string>& paths);
  ~ApiFiles();
  ApiFiles(const ApiFiles&) = delete;
  ApiFiles& operator=(const ApiFiles&) = delete;

  /// In the order of the paths; empty if there are errors.
  const std::vector<const google::protobuf::FileDescriptor*>& files() const {
    return files_;
  }
  /// One line an error; empty if there are none.
  const std::string& errors() const { return errors_; }

 private:
  class Errors;

  std::string errors_;
  std::unique_ptr<Errors> collector_;
  google::protobuf::compiler::DiskSourceTree tree_;
  google::protobuf::DescriptorPoolDatabase standard_;
  google::protobuf::compiler::SourceTreeDescriptorDatabase database_;
  google::protobuf::DescriptorPool pool_;
  std::vector<const google::protobuf::FileDescriptor*> files_;
};

/// The API of the tree at `root`: the services first, then what they share.
std::unique_ptr<ApiFiles> ReadApi(const std::string& root);

/// Whole content of a file; empty if there is none.
std::string ReadText(const std::string& path);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_API_API_FILES_H_
