#include "tests/api/wire_listing.h"

#include <algorithm>
#include <iterator>

#include "absl/strings/str_cat.h"

namespace mapsieve::testing {
namespace {

namespace pb = google::protobuf;

std::string TypeOf(const pb::FieldDescriptor& field) {
  if (field.message_type() != nullptr) return field.message_type()->full_name();
  if (field.enum_type() != nullptr) return field.enum_type()->full_name();
  return field.type_name();
}

std::string LabelOf(const pb::FieldDescriptor& field) {
  if (field.is_repeated()) return "repeated ";
  if (const auto* oneof = field.real_containing_oneof(); oneof != nullptr) {
    return absl::StrCat("oneof ", oneof->name(), " ");
  }
  return field.has_optional_keyword() ? "optional " : "";
}

void List(const pb::EnumDescriptor& type, std::vector<std::string>& lines) {
  for (int i = 0; i < type.value_count(); ++i) {
    const pb::EnumValueDescriptor& value = *type.value(i);
    lines.push_back(absl::StrCat(type.full_name(), " ", value.number(), ": ",
                                 value.name()));
  }
}

void List(const pb::Descriptor& message, std::vector<std::string>& lines) {
  for (int i = 0; i < message.field_count(); ++i) {
    const pb::FieldDescriptor& field = *message.field(i);
    lines.push_back(absl::StrCat(message.full_name(), " ", field.number(), ": ",
                                 LabelOf(field), TypeOf(field), " ",
                                 field.name()));
  }
  for (int i = 0; i < message.enum_type_count(); ++i) {
    List(*message.enum_type(i), lines);
  }
  for (int i = 0; i < message.nested_type_count(); ++i) {
    List(*message.nested_type(i), lines);
  }
}

void List(const pb::ServiceDescriptor& service,
          std::vector<std::string>& lines) {
  const auto stream = [](bool is_stream) { return is_stream ? "stream " : ""; };
  for (int i = 0; i < service.method_count(); ++i) {
    const pb::MethodDescriptor& method = *service.method(i);
    lines.push_back(absl::StrCat(
        method.full_name(), ": ", stream(method.client_streaming()),
        method.input_type()->full_name(), " returns ",
        stream(method.server_streaming()), method.output_type()->full_name()));
  }
}

}  // namespace

std::vector<std::string> WireListing(
    const std::vector<const pb::FileDescriptor*>& files) {
  std::vector<std::string> lines;
  for (const pb::FileDescriptor* file : files) {
    for (int i = 0; i < file->service_count(); ++i) {
      List(*file->service(i), lines);
    }
    for (int i = 0; i < file->message_type_count(); ++i) {
      List(*file->message_type(i), lines);
    }
    for (int i = 0; i < file->enum_type_count(); ++i) {
      List(*file->enum_type(i), lines);
    }
  }
  std::sort(lines.begin(), lines.end());
  return lines;
}

std::vector<std::string> BrokenLines(const std::vector<std::string>& recorded,
                                     const std::vector<std::string>& current) {
  std::vector<std::string> broken;
  std::set_difference(recorded.begin(), recorded.end(), current.begin(),
                      current.end(), std::back_inserter(broken));
  return broken;
}

}  // namespace mapsieve::testing
