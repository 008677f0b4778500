#ifndef MAPSIEVE_CLIENT_LAB_SCAN_PAIR_H_
#define MAPSIEVE_CLIENT_LAB_SCAN_PAIR_H_

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "core/geometry/rigid_transform.h"

/// Pairs of scans whose relative pose is known, to measure registration with.
namespace mapsieve::client {

/// Kinds of places, as Labussière et al. 2020 tell them apart; kReal is what a
/// list does not say more of.
enum class Environment : uint8_t {
  kStructured = 1,
  kSemiStructured,
  kUnstructured,
  kReal,
};

inline constexpr std::array<Environment, 4> kEnvironments = {
    Environment::kStructured, Environment::kSemiStructured,
    Environment::kUnstructured, Environment::kReal};

/// "structured", "semi-structured", "unstructured", "real".
std::string_view EnvironmentName(Environment environment);
/// The inverse; nothing for any other name.
std::optional<Environment> EnvironmentOfName(std::string_view name);

/// Two scans, each in the frame of its sensor, without attributes.
struct ScanPair {
  core::LatticeCloud reference;
  core::LatticeCloud reading;
  /// The truth: moves the reading onto the reference.
  core::RigidTransform T_reference_reading;
};

/// A pair before it is made or read.
struct PairSource {
  /// Unique among the pairs of an evaluation; no comma, quote or line break.
  std::string name;
  Environment environment = Environment::kReal;
  /// Always gives the same pair. Thread-safe.
  std::function<absl::StatusOr<ScanPair>()> load;
};

/// A motion by 16 numbers, the rows of its 4 x 4 matrix. kInvalidArgument:
/// there are fewer or more, or the last row is not 0, 0, 0, 1; those of
/// core::Orthonormalized, whose result it is.
absl::StatusOr<core::RigidTransform> TransformOfRows(
    std::span<const double> numbers);

/// Reads a list of pairs of files:
///
///     pairs:
///       - name: car
///         environment: semi-structured        # optional; real if absent
///         reference: scans/car_400.csv
///         reading: scans/car_401.csv
///         # 4 x 4, row by row: moves the reading onto the reference
///         transform: [1, 0, 0, 0.5,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1]
///
/// Paths are relative to `folder`, or to the list's own folder if that is
/// empty. Files are read, on a lattice of 1 mm, when a pair is loaded.
/// Errors: kNotFound: no such list, or no such file of a pair;
/// kInvalidArgument: it is not YAML, an entry is missing, unknown or wrong (its
/// line is named), a name comes twice. Of `load`: those of ReadPointFile.
absl::StatusOr<std::vector<PairSource>> ReadPairList(
    const std::filesystem::path& list, const std::filesystem::path& folder);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_SCAN_PAIR_H_
