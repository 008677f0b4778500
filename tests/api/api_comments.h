#ifndef MAPSIEVE_TESTS_API_API_COMMENTS_H_
#define MAPSIEVE_TESTS_API_API_COMMENTS_H_

#include <string>
#include <vector>

#include "google/protobuf/descriptor.h"

namespace mapsieve::testing {

/// An error that the comment of a method names.
struct DocumentedError {
  /// A canonical code, "NOT_FOUND".
  std::string code;
  /// When it comes; may be empty.
  std::string when;

  bool operator==(const DocumentedError&) const = default;
};

/// The comment of a method: what it does, then "Errors: CODE (when); CODE.",
/// then, if it starts an operation, "Errors of the operation: …" and what holds
/// after them.
struct MethodComment {
  std::string text;
  std::vector<DocumentedError> errors;
  std::vector<DocumentedError> operation_errors;
  std::string after;
};

/// `comment` as one line.
std::string OneLine(const std::string& comment);

/// The comment above a descriptor as one line.
template <typename Descriptor>
std::string CommentOf(const Descriptor& descriptor) {
  google::protobuf::SourceLocation location;
  if (!descriptor.GetSourceLocation(&location)) return "";
  return OneLine(location.leading_comments);
}

/// The comment of a field; before it that of the oneof it belongs to.
std::string CommentOfField(const google::protobuf::FieldDescriptor& field);

/// The comment of `method` in its parts.
MethodComment CommentOfMethod(const google::protobuf::MethodDescriptor& method);

/// Names of services, methods, messages, fields, enums and values without a
/// comment, and of methods that name no error or an unknown code.
std::vector<std::string> Undocumented(
    const std::vector<const google::protobuf::FileDescriptor*>& files);

}  // namespace mapsieve::testing

#endif  // MAPSIEVE_TESTS_API_API_COMMENTS_H_
