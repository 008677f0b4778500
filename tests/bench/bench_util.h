#ifndef MAPSIEVE_TESTS_BENCH_BENCH_UTIL_H_
#define MAPSIEVE_TESTS_BENCH_BENCH_UTIL_H_

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "client/lab/simulate.h"
#include "core/cloud/point_cloud.h"

namespace mapsieve::bench {

/// Ends the program.
[[noreturn]] inline void Fail(const std::string& message) {
  std::fprintf(stderr, "%s\n", message.c_str());
  std::exit(1);
}

/// Ends the program with the error, if it is one.
template <typename T>
T ValueOrDie(absl::StatusOr<T> value) {
  if (!value.ok()) Fail(value.status().ToString());
  return *std::move(value);
}

/// All points of a simulated survey.
inline std::vector<core::Point3> SimulatedPoints(
    const client::SimulateOptions& options) {
  client::CampusScanner scanner =
      ValueOrDie(client::CampusScanner::Create(options));
  std::vector<core::Point3> points;
  points.reserve(static_cast<size_t>(options.point_count));
  while (true) {
    const core::PointCloud batch = ValueOrDie(scanner.NextBatch(100'000));
    if (batch.size() == 0) return points;
    points.insert(points.end(), batch.positions.begin(), batch.positions.end());
  }
}

/// How long `work` takes.
template <typename Work>
double Seconds(const Work& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start)
      .count();
}

/// Of at least one value.
inline double Median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

}  // namespace mapsieve::bench

#endif  // MAPSIEVE_TESTS_BENCH_BENCH_UTIL_H_
