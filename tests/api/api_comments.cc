#include "tests/api/api_comments.h"

#include <algorithm>
#include <array>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "google/protobuf/descriptor.pb.h"

namespace mapsieve::testing {
namespace {

namespace pb = google::protobuf;

constexpr std::string_view kErrors = "Errors: ";
constexpr std::string_view kOperationErrors = "Errors of the operation: ";

constexpr std::array<std::string_view, 12> kCodes = {
    "INVALID_ARGUMENT",    "NOT_FOUND", "ALREADY_EXISTS",     "OUT_OF_RANGE",
    "FAILED_PRECONDITION", "ABORTED",   "RESOURCE_EXHAUSTED", "DATA_LOSS",
    "UNAVAILABLE",         "CANCELLED", "DEADLINE_EXCEEDED",  "UNIMPLEMENTED"};

// Takes "CODE (when); CODE." off the front of `text`; brackets may hold both
// separators.
std::vector<DocumentedError> TakeErrors(std::string_view& text) {
  std::vector<DocumentedError> errors;
  int depth = 0;
  size_t begin = 0;
  size_t i = 0;
  for (; i < text.size(); ++i) {
    if (text[i] == '(') ++depth;
    if (text[i] == ')') --depth;
    if (depth > 0 || (text[i] != ';' && text[i] != '.')) continue;
    const std::string item(text.substr(begin, i - begin));
    const size_t bracket = item.find(" (");
    DocumentedError error;
    error.code = item.substr(0, bracket);
    if (bracket != std::string::npos) {
      error.when = item.substr(bracket + 2, item.size() - bracket - 3);
    }
    errors.push_back(std::move(error));
    begin = i + 2;
    if (text[i] == '.') break;
  }
  text.remove_prefix(std::min(begin, text.size()));
  return errors;
}

class Complaints {
 public:
  template <typename Descriptor>
  void Check(const Descriptor& descriptor) {
    if (CommentOf(descriptor).empty()) {
      lines_.push_back(absl::StrCat(descriptor.full_name(), " has no comment"));
    }
  }

  void CheckAll(const pb::ServiceDescriptor& service) {
    Check(service);
    for (int i = 0; i < service.method_count(); ++i) {
      const pb::MethodDescriptor& method = *service.method(i);
      Check(method);
      const MethodComment comment = CommentOfMethod(method);
      if (comment.errors.empty()) {
        lines_.push_back(absl::StrCat(method.full_name(), " names no errors"));
      }
      for (const auto* errors : {&comment.errors, &comment.operation_errors}) {
        for (const DocumentedError& error : *errors) {
          if (std::find(kCodes.begin(), kCodes.end(), error.code) ==
              kCodes.end()) {
            lines_.push_back(absl::StrCat(method.full_name(), ": \"",
                                          error.code, "\" is not a code"));
          }
        }
      }
    }
  }

  void CheckAll(const pb::EnumDescriptor& type) {
    Check(type);
    for (int i = 0; i < type.value_count(); ++i) Check(*type.value(i));
  }

  void CheckAll(const pb::Descriptor& message) {
    if (message.options().map_entry()) return;
    Check(message);
    for (int i = 0; i < message.field_count(); ++i) {
      if (CommentOfField(*message.field(i)).empty()) {
        Complain(*message.field(i));
      }
    }
    for (int i = 0; i < message.enum_type_count(); ++i) {
      CheckAll(*message.enum_type(i));
    }
    for (int i = 0; i < message.nested_type_count(); ++i) {
      CheckAll(*message.nested_type(i));
    }
  }

  std::vector<std::string> Take() { return std::move(lines_); }

 private:
  template <typename Descriptor>
  void Complain(const Descriptor& descriptor) {
    lines_.push_back(absl::StrCat(descriptor.full_name(), " has no comment"));
  }

  std::vector<std::string> lines_;
};

}  // namespace

std::string OneLine(const std::string& comment) {
  return absl::StrJoin(
      absl::StrSplit(comment, absl::ByAnyChar(" \n"), absl::SkipEmpty()), " ");
}

std::string CommentOfField(const pb::FieldDescriptor& field) {
  const pb::OneofDescriptor* oneof = field.real_containing_oneof();
  std::string comment = CommentOf(field);
  if (oneof == nullptr) return comment;
  return OneLine(absl::StrCat(CommentOf(*oneof), " ", comment));
}

MethodComment CommentOfMethod(const pb::MethodDescriptor& method) {
  MethodComment comment;
  comment.text = CommentOf(method);
  const size_t begin = comment.text.find(kErrors);
  if (begin == std::string::npos) return comment;
  const std::string whole = comment.text;
  comment.text.resize(begin == 0 ? 0 : begin - 1);
  std::string_view rest = whole;
  rest.remove_prefix(begin + kErrors.size());
  comment.errors = TakeErrors(rest);
  if (rest.starts_with(kOperationErrors)) {
    rest.remove_prefix(kOperationErrors.size());
    comment.operation_errors = TakeErrors(rest);
  }
  comment.after = std::string(rest);
  return comment;
}

std::vector<std::string> Undocumented(
    const std::vector<const pb::FileDescriptor*>& files) {
  Complaints complaints;
  for (const pb::FileDescriptor* file : files) {
    for (int i = 0; i < file->service_count(); ++i) {
      complaints.CheckAll(*file->service(i));
    }
    for (int i = 0; i < file->message_type_count(); ++i) {
      complaints.CheckAll(*file->message_type(i));
    }
    for (int i = 0; i < file->enum_type_count(); ++i) {
      complaints.CheckAll(*file->enum_type(i));
    }
  }
  return complaints.Take();
}

}  // namespace mapsieve::testing
