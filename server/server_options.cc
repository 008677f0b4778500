#include "server/server_options.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <string>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "core/base/status.h"
#include "server/engine/engine.h"

namespace mapsieve::rpc {
namespace {

constexpr size_t kMaxConfigLine = 4096;
constexpr int kMaxThreadCount = 1024;

absl::Status Wrong(std::string_view expected, std::string_view text) {
  return absl::InvalidArgumentError(absl::StrCat(
      "expected ", ToAbsl(expected), ", have \"", ToAbsl(text), "\""));
}

template <typename T>
bool ParseNumber(std::string_view text, T& value) {
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

std::string_view Strip(std::string_view text) {
  return ToStd(absl::StripAsciiWhitespace(ToAbsl(text)));
}

// "2GiB", "512M", "1073741824": units are powers of 1024.
absl::Status ParseBytes(std::string_view text, int64_t& bytes) {
  constexpr std::string_view kExpected = "a size such as 512MiB or 2GiB";
  const size_t digits =
      std::min(text.find_first_not_of("0123456789."), text.size());
  double number = 0;
  if (!ParseNumber(text.substr(0, digits), number)) {
    return Wrong(kExpected, text);
  }
  std::string unit = absl::AsciiStrToLower(ToAbsl(text.substr(digits)));
  if (unit.ends_with("ib")) {
    unit.resize(unit.size() - 2);
  } else if (unit.ends_with("b")) {
    unit.resize(unit.size() - 1);
  }
  constexpr std::string_view kUnits = "kmgt";
  int exponent = 0;
  if (!unit.empty()) {
    const size_t at = kUnits.find(unit[0]);
    if (unit.size() != 1 || at == kUnits.npos) return Wrong(kExpected, text);
    exponent = 10 * (static_cast<int>(at) + 1);
  }
  const double value = std::ldexp(number, exponent);
  if (!(value < std::ldexp(1.0, 62))) return Wrong(kExpected, text);
  bytes = static_cast<int64_t>(value);
  return absl::OkStatus();
}

absl::Status SetDataDir(std::string_view text, ServerOptions& options) {
  options.data_dir = std::string(text);
  return absl::OkStatus();
}

absl::Status SetListen(std::string_view text, ServerOptions& options) {
  MAPSIEVE_ASSIGN_OR_RETURN(options.listen, ListenAddress::Parse(text));
  return absl::OkStatus();
}

absl::Status SetMemory(std::string_view text, ServerOptions& options) {
  return ParseBytes(text, options.memory_bytes);
}

absl::Status SetThreads(std::string_view text, ServerOptions& options) {
  int count = 0;
  if (!ParseNumber(text, count) || count < 0 || count > kMaxThreadCount) {
    return Wrong(absl::StrCat("0 to ", kMaxThreadCount), text);
  }
  options.thread_count = count;
  return absl::OkStatus();
}

absl::Status SetKeptRevisions(std::string_view text, ServerOptions& options) {
  int64_t count = 0;
  if (!ParseNumber(text, count) || count < 0) {
    return Wrong("0 (all) or a number of revisions", text);
  }
  options.kept_revision_count = count;
  return absl::OkStatus();
}

absl::Status SetInsecure(std::string_view text, ServerOptions& options) {
  if (text != "true" && text != "false") return Wrong("true or false", text);
  options.insecure = text == "true";
  return absl::OkStatus();
}

absl::Status SetLogLevel(std::string_view text, ServerOptions& options) {
  if (text != "debug" && text != "info" && text != "warn" && text != "error") {
    return Wrong("debug, info, warn or error", text);
  }
  options.log_level = std::string(text);
  return absl::OkStatus();
}

constexpr ServerSetting kSettings[] = {
    {"data", "DIR", "directory of all maps, made if absent (required)",
     SetDataDir},
    {"listen", "HOST:PORT",
     "where to serve; port 0: any free one (default 127.0.0.1:7070)",
     SetListen},
    {"memory", "SIZE",
     "memory for points, at least 256MiB; maps may be larger (default 2GiB)",
     SetMemory},
    {"threads", "N",
     "threads of the filter (default 0: one for each processor)", SetThreads},
    {"keep-revisions", "N",
     "newest revisions of each map to keep; older ones expire, but those that "
     "kept ones answer from (default 0: keep all)",
     SetKeptRevisions},
    {"insecure", nullptr,
     "allow --listen on an address that other machines reach: the service "
     "neither encrypts nor asks who calls",
     SetInsecure},
    {"log-level", "LEVEL",
     "debug (every call), info, warn or error (default info)", SetLogLevel},
};

}  // namespace

absl::StatusOr<ListenAddress> ListenAddress::Parse(std::string_view text) {
  const size_t colon = text.rfind(':');
  ListenAddress address;
  if (colon != text.npos) {
    address.host = std::string(text.substr(0, colon));
    const bool bracketed =
        address.host.starts_with('[') && address.host.ends_with(']');
    if (!address.host.empty() &&
        (bracketed || address.host.find(':') == std::string::npos) &&
        ParseNumber(text.substr(colon + 1), address.port) &&
        address.port >= 0 && address.port <= 65535) {
      return address;
    }
  }
  return Wrong("HOST:PORT, an IPv6 address in brackets", text);
}

bool ListenAddress::IsLoopback() const {
  return host == "localhost" || host == "[::1]" || host.starts_with("127.");
}

std::string ListenAddress::ToString() const {
  return absl::StrCat(host, ":", port);
}

absl::Status ServerOptions::Validate() const {
  if (data_dir.empty()) {
    return absl::InvalidArgumentError(
        "data: a directory for the maps is required: --data DIR");
  }
  if (memory_bytes < engine::kMinMemoryBytes) {
    return absl::InvalidArgumentError(absl::StrCat(
        "memory: expected at least ", engine::kMinMemoryBytes >> 20,
        "MiB, have ", memory_bytes, " bytes"));
  }
  if (!insecure && !listen.IsLoopback()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "listen: other machines may reach ", listen.ToString(),
        ", and the service neither encrypts nor asks who calls; listen on "
        "127.0.0.1, or pass --insecure where the network is trusted"));
  }
  return absl::OkStatus();
}

std::span<const ServerSetting> ServerSettings() { return kSettings; }

std::string EnvironmentName(std::string_view setting_name) {
  std::string name =
      absl::StrCat("MAPSIEVED_", absl::AsciiStrToUpper(ToAbsl(setting_name)));
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
}

absl::Status ApplySetting(std::string_view name, std::string_view text,
                          ServerOptions& options) {
  for (const ServerSetting& setting : kSettings) {
    if (name == setting.name) {
      return Annotate(setting.set(text, options), name);
    }
  }
  return absl::InvalidArgumentError(
      absl::StrCat("no setting is named \"", ToAbsl(name), "\""));
}

absl::Status ApplyConfigFile(const std::string& path, ServerOptions& options) {
  std::ifstream file(path);
  if (!file) {
    return absl::NotFoundError(
        absl::StrCat(path, ": cannot be opened for reading"));
  }
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    const std::string where = absl::StrCat(path, ":", number);
    if (line.size() > kMaxConfigLine) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, ": expected at most ", kMaxConfigLine,
                       " characters, have ", line.size()));
    }
    const std::string_view content = Strip(line);
    if (content.empty() || content[0] == '#') continue;
    const size_t equals = content.find('=');
    if (equals == content.npos) {
      return Annotate(Wrong("NAME = VALUE", content), where);
    }
    MAPSIEVE_RETURN_IF_ERROR(
        Annotate(ApplySetting(Strip(content.substr(0, equals)),
                              Strip(content.substr(equals + 1)), options),
                 where));
  }
  return absl::OkStatus();
}

absl::Status ApplyEnvironment(
    const std::function<const char*(const char*)>& get,
    ServerOptions& options) {
  for (const ServerSetting& setting : kSettings) {
    const std::string name = EnvironmentName(setting.name);
    if (const char* text = get(name.c_str())) {
      MAPSIEVE_RETURN_IF_ERROR(Annotate(setting.set(text, options), name));
    }
  }
  return absl::OkStatus();
}

}  // namespace mapsieve::rpc
