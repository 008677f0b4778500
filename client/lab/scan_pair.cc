#include "client/lab/scan_pair.h"

#include <algorithm>
#include <set>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "client/formats/point_file.h"
#include "core/base/status.h"
#include "yaml-cpp/yaml.h"

namespace mapsieve::client {
namespace {

struct PairEntry {
  std::string name;
  Environment environment = Environment::kReal;
  std::filesystem::path reference;
  std::filesystem::path reading;
  core::RigidTransform T_reference_reading;
};

absl::Status WrongEntry(const YAML::Node& node, const std::string& what) {
  return absl::InvalidArgumentError(
      absl::StrCat("line ", node.Mark().line + 1, ": ", what));
}

absl::StatusOr<std::string> TextOf(const YAML::Node& entry, const char* key) {
  const YAML::Node value = entry[key];
  if (!value || !value.IsScalar() || value.Scalar().empty()) {
    return WrongEntry(entry, absl::StrCat("a pair needs a text '", key, "'"));
  }
  return value.Scalar();
}

absl::StatusOr<core::RigidTransform> TransformOf(const YAML::Node& entry) {
  std::vector<double> numbers;
  for (const YAML::Node& value : entry["transform"]) {
    if (!YAML::convert<double>::decode(value, numbers.emplace_back())) {
      return WrongEntry(value, "a 'transform' holds numbers alone");
    }
  }
  absl::StatusOr<core::RigidTransform> result = TransformOfRows(numbers);
  if (result.ok()) return result;
  return WrongEntry(
      entry, absl::StrCat("a pair's 'transform': ", result.status().message()));
}

absl::StatusOr<PairEntry> EntryOf(const YAML::Node& node,
                                  const std::filesystem::path& folder) {
  if (!node.IsMap()) return WrongEntry(node, "a pair is a map of its entries");
  const std::set<std::string> keys = {"name", "environment", "reference",
                                      "reading", "transform"};
  for (const auto& member : node) {
    if (!keys.contains(member.first.Scalar())) {
      return WrongEntry(member.first, absl::StrCat("unknown entry '",
                                                   member.first.Scalar(), "'"));
    }
  }
  PairEntry entry;
  MAPSIEVE_ASSIGN_OR_RETURN(entry.name, TextOf(node, "name"));
  if (entry.name.find_first_of(",\"\n\r") != std::string::npos) {
    return WrongEntry(node, "a name holds no comma, quote or line break");
  }
  if (node["environment"]) {
    MAPSIEVE_ASSIGN_OR_RETURN(const std::string name,
                              TextOf(node, "environment"));
    const std::optional<Environment> environment = EnvironmentOfName(name);
    if (!environment) {
      return WrongEntry(node,
                        "an environment is structured, semi-structured, "
                        "unstructured or real");
    }
    entry.environment = *environment;
  }
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string reference,
                            TextOf(node, "reference"));
  MAPSIEVE_ASSIGN_OR_RETURN(const std::string reading, TextOf(node, "reading"));
  entry.reference = folder / reference;
  entry.reading = folder / reading;
  MAPSIEVE_ASSIGN_OR_RETURN(entry.T_reference_reading, TransformOf(node));
  for (const auto& path : {entry.reference, entry.reading}) {
    std::error_code ignored;
    if (std::filesystem::is_regular_file(path, ignored)) continue;
    return absl::NotFoundError(absl::StrCat("line ", node.Mark().line + 1, ": ",
                                            path.string(), ": no such file"));
  }
  return entry;
}

absl::StatusOr<core::LatticeCloud> ReadScan(const std::filesystem::path& path) {
  MAPSIEVE_ASSIGN_OR_RETURN(core::PointCloud cloud, ReadPointFile(path));
  cloud.attributes = {};
  core::RefusedCounts refused;
  return core::Quantize(std::move(cloud), core::Lattice(), refused);
}

absl::StatusOr<ScanPair> ReadPair(const PairEntry& entry) {
  ScanPair pair;
  MAPSIEVE_ASSIGN_OR_RETURN(pair.reference, ReadScan(entry.reference));
  MAPSIEVE_ASSIGN_OR_RETURN(pair.reading, ReadScan(entry.reading));
  pair.T_reference_reading = entry.T_reference_reading;
  return pair;
}

absl::StatusOr<std::vector<PairSource>> SourcesOf(
    const YAML::Node& root, const std::filesystem::path& folder) {
  if (!root.IsMap() || root.size() != 1 || !root["pairs"] ||
      !root["pairs"].IsSequence()) {
    return absl::InvalidArgumentError("expected one entry, 'pairs', a list");
  }
  std::vector<PairSource> sources;
  std::set<std::string> names;
  for (const YAML::Node& node : root["pairs"]) {
    MAPSIEVE_ASSIGN_OR_RETURN(PairEntry entry, EntryOf(node, folder));
    if (!names.insert(entry.name).second) {
      return WrongEntry(
          node, absl::StrCat("another pair is '", entry.name, "' already"));
    }
    PairSource source = {entry.name, entry.environment, nullptr};
    source.load = [entry = std::move(entry)] { return ReadPair(entry); };
    sources.push_back(std::move(source));
  }
  return sources;
}

}  // namespace

std::string_view EnvironmentName(Environment environment) {
  switch (environment) {
    case Environment::kStructured:
      return "structured";
    case Environment::kSemiStructured:
      return "semi-structured";
    case Environment::kUnstructured:
      return "unstructured";
    case Environment::kReal:
      break;
  }
  return "real";
}

std::optional<Environment> EnvironmentOfName(std::string_view name) {
  for (const Environment environment : kEnvironments) {
    if (EnvironmentName(environment) == name) return environment;
  }
  return std::nullopt;
}

absl::StatusOr<core::RigidTransform> TransformOfRows(
    std::span<const double> numbers) {
  constexpr std::array<double, 4> kLastRow = {0, 0, 0, 1};
  if (numbers.size() != 16 ||
      !std::equal(kLastRow.begin(), kLastRow.end(), numbers.begin() + 12)) {
    return absl::InvalidArgumentError(
        "expected 16 numbers, the rows of a matrix; the last is 0, 0, 0, 1");
  }
  core::RigidTransform transform;
  for (size_t row = 0; row < 3; ++row) {
    for (size_t column = 0; column < 3; ++column) {
      transform.rotation[row][column] = numbers[4 * row + column];
    }
    transform.translation[row] = numbers[4 * row + 3];
  }
  return core::Orthonormalized(transform);
}

absl::StatusOr<std::vector<PairSource>> ReadPairList(
    const std::filesystem::path& list, const std::filesystem::path& folder) {
  // The library reports by exceptions; none leaves this function.
  try {
    absl::StatusOr<std::vector<PairSource>> sources =
        SourcesOf(YAML::LoadFile(list.string()),
                  folder.empty() ? list.parent_path() : folder);
    if (sources.ok()) return sources;
    return Annotate(sources.status(), list.string());
  } catch (const YAML::BadFile&) {
    return absl::NotFoundError(
        absl::StrCat(list.string(), ": cannot be opened"));
  } catch (const YAML::Exception& error) {
    return absl::InvalidArgumentError(absl::StrCat(
        list.string(), ": line ", error.mark.line + 1, ": ", error.msg));
  }
}

}  // namespace mapsieve::client
