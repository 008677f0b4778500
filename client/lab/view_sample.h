#ifndef MAPSIEVE_CLIENT_LAB_VIEW_SAMPLE_H_
#define MAPSIEVE_CLIENT_LAB_VIEW_SAMPLE_H_

#include <cstddef>
#include <cstdint>
#include <vector>

namespace mapsieve::client {

/// A closed interval.
struct Range {
  double min = 0;
  double max = 0;

  double length() const { return max - min; }
  bool Contains(double x) const { return x >= min && x <= max; }
  Range Union(const Range& other) const;

  friend bool operator==(const Range&, const Range&) = default;
};

/// The range of `values` without the few that lie far from the others: under
/// 0.5 % on each side (one at least, of 16 or more), farther from the rest than
/// half of its range. Reorders `values`, which are finite and not empty.
Range RobustRange(std::vector<double>& values);

/// The range without the lowest and the highest `fraction` of `values`, which
/// are finite and not empty, and are reordered.
Range TrimmedRange(std::vector<double>& values, double fraction);

/// A point as the viewer sees it.
struct ViewPoint {
  /// Right and up, in map units.
  double u = 0;
  double v = 0;
  /// What its colour stands for; NaN if it has no value.
  double value = 0;
};

/// A sample of a stream of points: all of them up to a capacity, beyond it a
/// pseudo-random share that depends on their positions in the stream and on
/// nothing else. Not thread-safe.
class ViewSample {
 public:
  explicit ViewSample(size_t capacity) : capacity_(capacity) {}

  void Add(const ViewPoint& point);

  /// Points added.
  int64_t point_count() const { return point_count_; }
  /// The sample, in stream order.
  const std::vector<ViewPoint>& points() const { return points_; }

  /// Area that the points cover inside the given bounds, from the share of
  /// occupied cells of a grid; at most that of the bounds.
  double CoveredArea(const Range& u, const Range& v) const;

 private:
  size_t capacity_;
  int64_t point_count_ = 0;
  // A point is kept where its hash is 0 in these bits.
  uint64_t mask_ = 0;
  std::vector<ViewPoint> points_;
  std::vector<uint64_t> hashes_;
};

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_LAB_VIEW_SAMPLE_H_
