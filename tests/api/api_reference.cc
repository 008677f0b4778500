#include "tests/api/api_reference.h"

#include <string_view>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "google/protobuf/descriptor.pb.h"
#include "tests/api/api_comments.h"

namespace mapsieve::testing {
namespace {

namespace pb = google::protobuf;

constexpr char kHead[] = R"(# API reference

Package `mapsieve.v1`, made of the comments in `proto/mapsieve/v1/` by
`record_api`, a program of the tests. What all calls have in common (names,
coordinates, streams, operations, errors, limits) is in
[proto/README.md](../proto/README.md), the bytes of points are in
[core/codec/FORMAT.md](../core/codec/FORMAT.md).

Besides the errors it lists, every call can end with `RESOURCE_EXHAUSTED` (too
many calls at a time, or no memory), `UNAVAILABLE` (the server is shutting
down), `DATA_LOSS` (the catalogue is damaged), `INTERNAL` (a defect of the
server) and as its caller wishes, with `CANCELLED` or `DEADLINE_EXCEEDED`.

)";

// Name without the package: "Revision.Kind".
template <typename Descriptor>
std::string ShortName(const Descriptor& type) {
  std::string_view name = type.full_name();
  const std::string& package = type.file()->package();
  if (name.starts_with(package + ".")) name.remove_prefix(package.size() + 1);
  return std::string(name);
}

// Of a heading, as common readers of Markdown make it.
std::string Anchor(const std::string& heading) {
  return absl::AsciiStrToLower(absl::StrReplaceAll(heading, {{".", ""}}));
}

template <typename Descriptor>
std::string Link(const Descriptor& type) {
  const std::string name = ShortName(type);
  if (name.starts_with("google.")) return absl::StrCat("`", name, "`");
  return absl::StrCat("[", name, "](#", Anchor(name), ")");
}

std::string Cell(const std::string& text) {
  return absl::StrReplaceAll(text, {{"|", "\\|"}});
}

std::string TypeOf(const pb::FieldDescriptor& field) {
  if (field.is_map()) {
    return absl::StrCat("map of ", TypeOf(*field.message_type()->map_key()),
                        " to ", TypeOf(*field.message_type()->map_value()));
  }
  std::string type = field.type_name();
  if (field.message_type() != nullptr) type = Link(*field.message_type());
  if (field.enum_type() != nullptr) type = Link(*field.enum_type());
  if (field.is_repeated()) return absl::StrCat("repeated ", type);
  return field.has_optional_keyword() ? absl::StrCat("optional ", type) : type;
}

std::string ErrorTable(const char* title,
                       const std::vector<DocumentedError>& errors) {
  if (errors.empty()) return "";
  std::string page = absl::StrCat("| ", title, " | When |\n|---|---|\n");
  for (const DocumentedError& error : errors) {
    absl::StrAppend(&page, "| `", error.code, "` | ", Cell(error.when), " |\n");
  }
  return page + "\n";
}

std::string Section(const pb::ServiceDescriptor& service) {
  std::string page =
      absl::StrCat("## ", service.name(), "\n\n", CommentOf(service), "\n\n");
  for (int i = 0; i < service.method_count(); ++i) {
    const pb::MethodDescriptor& method = *service.method(i);
    const MethodComment comment = CommentOfMethod(method);
    const auto stream = [](bool is_stream) {
      return is_stream ? "stream of " : "";
    };
    absl::StrAppend(
        &page, "### ", method.name(), "\n\nTakes ",
        stream(method.client_streaming()), Link(*method.input_type()),
        ", returns ", stream(method.server_streaming()),
        Link(*method.output_type()), ".\n\n", comment.text, "\n\n",
        ErrorTable("Error", comment.errors),
        ErrorTable("Error of the operation", comment.operation_errors));
    if (!comment.after.empty()) absl::StrAppend(&page, comment.after, "\n\n");
  }
  return page;
}

std::string Section(const pb::EnumDescriptor& type) {
  std::string page =
      absl::StrCat("### ", ShortName(type), "\n\n", CommentOf(type),
                   "\n\n| Number | Value | Meaning |\n"
                   "|---|---|---|\n");
  for (int i = 0; i < type.value_count(); ++i) {
    const pb::EnumValueDescriptor& value = *type.value(i);
    absl::StrAppend(&page, "| ", value.number(), " | `", value.name(), "` | ",
                    Cell(CommentOf(value)), " |\n");
  }
  return page + "\n";
}

std::string Section(const pb::Descriptor& message) {
  if (message.options().map_entry()) return "";
  std::string page =
      absl::StrCat("### ", ShortName(message), "\n\n", CommentOf(message),
                   "\n\n| Number | Field | Type | Meaning |\n"
                   "|---|---|---|---|\n");
  for (int i = 0; i < message.field_count(); ++i) {
    const pb::FieldDescriptor& field = *message.field(i);
    std::string oneof;
    if (field.real_containing_oneof() != nullptr) {
      oneof = absl::StrCat("One of `", field.real_containing_oneof()->name(),
                           "`. ");
    }
    absl::StrAppend(&page, "| ", field.number(), " | `", field.name(), "` | ",
                    TypeOf(field), " | ", oneof, Cell(CommentOfField(field)),
                    " |\n");
  }
  absl::StrAppend(&page, "\n");
  for (int i = 0; i < message.enum_type_count(); ++i) {
    absl::StrAppend(&page, Section(*message.enum_type(i)));
  }
  for (int i = 0; i < message.nested_type_count(); ++i) {
    absl::StrAppend(&page, Section(*message.nested_type(i)));
  }
  return page;
}

std::string Contents(const std::vector<const pb::FileDescriptor*>& files) {
  std::string page = "| Service | Calls |\n|---|---|\n";
  for (const pb::FileDescriptor* file : files) {
    for (int i = 0; i < file->service_count(); ++i) {
      const pb::ServiceDescriptor& service = *file->service(i);
      absl::StrAppend(&page, "| ", Link(service), " |");
      for (int k = 0; k < service.method_count(); ++k) {
        const std::string& name = service.method(k)->name();
        absl::StrAppend(&page, k == 0 ? " " : ", ", "[", name, "](#",
                        Anchor(name), ")");
      }
      absl::StrAppend(&page, " |\n");
    }
  }
  return page + "\n";
}

}  // namespace

std::string ApiReference(const std::vector<const pb::FileDescriptor*>& files) {
  std::string page = kHead + Contents(files);
  for (const pb::FileDescriptor* file : files) {
    for (int i = 0; i < file->service_count(); ++i) {
      absl::StrAppend(&page, Section(*file->service(i)));
    }
  }
  absl::StrAppend(&page, "## Types\n\n");
  for (const pb::FileDescriptor* file : files) {
    for (int i = 0; i < file->message_type_count(); ++i) {
      absl::StrAppend(&page, Section(*file->message_type(i)));
    }
    for (int i = 0; i < file->enum_type_count(); ++i) {
      absl::StrAppend(&page, Section(*file->enum_type(i)));
    }
  }
  page.pop_back();
  return page;
}

}  // namespace mapsieve::testing
