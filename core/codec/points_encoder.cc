#include <algorithm>
#include <cstring>
#include <limits>
#include <set>
#include <string_view>
#include <utility>

#include "absl/status/status.h"
#include "core/base/bytes.h"
#include "core/base/hash.h"
#include "core/base/status.h"
#include "core/codec/block_head.h"
#include "core/codec/compression.h"
#include "core/codec/points_codec.h"
#include "core/codec/transforms.h"
#include "core/geometry/cell_key.h"
#include "core/geometry/morton.h"

namespace mapsieve::core {
namespace {

struct EncodedColumn {
  ColumnEntry entry;
  std::vector<std::byte> stored;
};

/// A column of up to kSampleRuns * kRunValues values is its own sample.
constexpr size_t kSampleRuns = 8;
constexpr size_t kRunValues = 512;

/// Runs of values spread evenly over the column.
std::vector<std::byte> Sample(std::span<const std::byte> values, size_t width) {
  const size_t count = values.size() / width;
  if (count <= kSampleRuns * kRunValues) {
    return {values.begin(), values.end()};
  }
  std::vector<std::byte> sample;
  sample.reserve(kSampleRuns * kRunValues * width);
  for (size_t run = 0; run < kSampleRuns; ++run) {
    const size_t first = run * (count - kRunValues) / (kSampleRuns - 1);
    const auto bytes = values.subspan(first * width, kRunValues * width);
    sample.insert(sample.end(), bytes.begin(), bytes.end());
  }
  return sample;
}

/// Whether all values have the same bytes.
bool IsConstant(std::span<const std::byte> values, size_t width) {
  return values.size() <= width ||
         std::memcmp(values.data(), values.data() + width,
                     values.size() - width) == 0;
}

using PlanEntries = std::map<std::string, EncodePlan::Entry, std::less<>>;

/// Bytes of `sample`, transformed and compressed.
size_t TrialBytes(Transform transform, std::span<const std::byte> sample,
                  size_t width, Compression compression) {
  if (IsCoded(transform)) {
    return static_cast<size_t>(CodedBytes(transform, sample, width));
  }
  std::vector<std::byte> coded;
  AppendTransformed(transform, sample, width, coded);
  const std::vector<std::byte> compressed = Compress(compression, coded);
  return compressed.empty() ? coded.size() : compressed.size();
}

struct Trial {
  Transform transform;
  size_t bytes = 0;

  friend bool operator<(const Trial& a, const Trial& b) {
    return a.bytes < b.bytes;
  }
};

/// The transforms that may make `sample` smallest.
std::vector<Trial> TryAll(std::span<const std::byte> sample, size_t width,
                          Compression compression) {
  std::vector<Trial> trials;
  const auto try_one = [&](Transform transform) {
    trials.push_back(
        {transform, TrialBytes(transform, sample, width, compression)});
    return trials.back().bytes;
  };
  for (const Transform transform : kTransforms) {
    if (IsCoded(transform) && SuitsWidth(transform, width)) try_one(transform);
  }
  size_t repetitive_bytes = try_one(Transform::kPlain);
  for (const Transform transform :
       {Transform::kShuffle, Transform::kDeltaShuffle}) {
    if (transform == Transform::kShuffle && width == 1) continue;
    repetitive_bytes = std::min(repetitive_bytes, try_one(transform));
  }
  // Packed values are better than coded ones where there is much for a
  // compressor to find.
  const size_t least = std::min_element(trials.begin(), trials.end())->bytes;
  if (repetitive_bytes <= least + least / 4) {
    try_one(Transform::kDeltaPacked);
    try_one(Transform::kAscendingPacked);
  }
  return trials;
}

/// The transform that makes a sample of the values, which are not all the same,
/// smallest.
Transform ChooseTransform(std::span<const std::byte> values, size_t width,
                          Compression compression) {
  const std::vector<Trial> trials =
      TryAll(Sample(values, width), width, compression);
  return std::min_element(trials.begin(), trials.end())->transform;
}

/// The same of some transforms, at least one.
Transform ChooseTransform(std::span<const Transform> among,
                          std::span<const std::byte> values, size_t width,
                          Compression compression) {
  if (among.size() == 1) return among.front();
  const std::vector<std::byte> sample = Sample(values, width);
  std::vector<Trial> trials;
  for (const Transform transform : among) {
    trials.push_back(
        {transform, TrialBytes(transform, sample, width, compression)});
  }
  return std::min_element(trials.begin(), trials.end())->transform;
}

bool SuitsWidth(const EncodePlan::Entry& entry, size_t width) {
  return std::all_of(
      entry.transforms.begin(), entry.transforms.end(),
      [&](Transform transform) { return SuitsWidth(transform, width); });
}

void AddToPlan(const ColumnSpec& spec, std::span<const std::byte> values,
               Compression compression, PlanAim aim, PlanEntries& plan) {
  const size_t width = ScalarSize(spec.type);
  if (IsConstant(values, width)) return;
  const std::vector<std::byte> sample = Sample(values, width);
  std::vector<Trial> trials = TryAll(sample, width, compression);
  std::stable_sort(trials.begin(), trials.end());
  const size_t least = trials.front().bytes;
  const double tolerance = aim == PlanAim::kSize ? 1.125 : 1.5;
  EncodePlan::Entry entry = {
      .max_value_bytes = tolerance * static_cast<double>(least * width) /
                         static_cast<double>(sample.size())};
  for (const Trial& trial : trials) {
    // What is a little larger here may be smaller elsewhere.
    if (trial.bytes <= least + least / 16) {
      entry.transforms.push_back(trial.transform);
    }
    if (aim == PlanAim::kSpeed) break;
  }
  plan.emplace(spec.name, std::move(entry));
}

void AppendMissingBitmap(std::span<const uint8_t> missing,
                         std::vector<std::byte>& coded) {
  const size_t at = coded.size();
  coded.resize(at + MissingBitmapBytes(missing.size()));
  for (size_t i = 0; i < missing.size(); ++i) {
    const int bit = missing[i] != 0 ? 1 : 0;
    coded[at + i / 8] |= static_cast<std::byte>(bit << (i % 8));
  }
}

/// `missing`: one byte a value, or empty if none is.
EncodedColumn EncodeColumn(ColumnSpec spec, std::span<const std::byte> values,
                           std::span<const uint8_t> missing,
                           Transform transform, Compression compression) {
  EncodedColumn column;
  column.entry.spec = std::move(spec);
  column.entry.transform = transform;
  column.entry.has_missing = !missing.empty();
  std::vector<std::byte> coded;
  AppendMissingBitmap(missing, coded);
  AppendTransformed(transform, values, ScalarSize(column.entry.spec.type),
                    coded);
  column.entry.coded_bytes = static_cast<uint32_t>(coded.size());
  if (!IsCoded(transform)) column.stored = Compress(compression, coded);
  if (column.stored.empty()) {
    column.stored = std::move(coded);
  } else {
    column.entry.compression = compression;
  }
  column.entry.stored_bytes = static_cast<uint32_t>(column.stored.size());
  column.entry.checksum = Hash64(column.stored);
  return column;
}

/// kPlain where nothing is compressed, else the transform of the plan, if that
/// has one that suits, or the best one. `plan` may be null.
EncodedColumn EncodeColumn(const ColumnSpec& spec,
                           std::span<const std::byte> values,
                           std::span<const uint8_t> missing,
                           Compression compression, const PlanEntries* plan) {
  const size_t width = ScalarSize(spec.type);
  if (compression == Compression::kNone || IsConstant(values, width)) {
    return EncodeColumn(spec, values, missing, Transform::kPlain, compression);
  }
  const auto encode = [&](Transform transform) {
    return EncodeColumn(spec, values, missing, transform, compression);
  };
  if (plan != nullptr) {
    const auto found = plan->find(spec.name);
    if (found != plan->end() && SuitsWidth(found->second, width)) {
      const auto& [transforms, max_value_bytes] = found->second;
      const Transform transform =
          ChooseTransform(transforms, values, width, compression);
      EncodedColumn planned = encode(transform);
      if (static_cast<double>(planned.stored.size()) <=
          max_value_bytes * static_cast<double>(values.size() / width)) {
        return planned;
      }
      const Transform best = ChooseTransform(values, width, compression);
      return best == transform ? planned : encode(best);
    }
  }
  return encode(ChooseTransform(values, width, compression));
}

/// Corner of the Morton codes: on a coarse grid of cells, so that codes sort as
/// MortonLess does.
LatticePoint MortonCorner(const LatticePoint& min) {
  constexpr int kGridBits = kMortonAxisBits - 1;
  const CellKey cell = CellKey::Of(min, kGridBits);
  return cell.corner();
}

/// The Morton codes of positions relative to `corner`; nothing if they do not
/// fit, or if the positions are not by and large in Morton order.
std::optional<std::vector<uint64_t>> MortonCodes(
    std::span<const LatticePoint> positions, const LatticePoint& max,
    const LatticePoint& corner) {
  constexpr int64_t kEdge = int64_t{1} << kMortonAxisBits;
  if (max.x - corner.x >= kEdge || max.y - corner.y >= kEdge ||
      max.z - corner.z >= kEdge) {
    return std::nullopt;
  }
  // A step down costs some 40 bits more than a step up.
  constexpr size_t kMaxDescentShare = 64;
  const size_t max_descents = positions.size() / kMaxDescentShare;
  size_t descents = 0;
  std::vector<uint64_t> codes;
  codes.reserve(positions.size());
  for (const LatticePoint& q : positions) {
    const uint64_t code = MortonCode(static_cast<uint64_t>(q.x - corner.x),
                                     static_cast<uint64_t>(q.y - corner.y),
                                     static_cast<uint64_t>(q.z - corner.z));
    if (!codes.empty() && code < codes.back() && ++descents > max_descents) {
      return std::nullopt;
    }
    codes.push_back(code);
  }
  return codes;
}

/// Calls use(spec, values) for the coordinates of each axis from `corner` on.
template <typename T, typename Use>
void ForEachAxisOf(std::span<const LatticePoint> positions,
                   const LatticePoint& corner, const Use& use) {
  std::vector<T> offsets(positions.size());
  for (size_t axis = 0; axis < 3; ++axis) {
    const auto coordinate = kAxes[axis];
    for (size_t i = 0; i < offsets.size(); ++i) {
      offsets[i] =
          static_cast<T>(positions[i].*coordinate - corner.*coordinate);
    }
    use(ColumnSpec{std::string(kAxisNames[axis]), ScalarTypeOf<T>()},
        AsBytes(offsets));
  }
}

/// ForEachAxisOf in the narrowest type that holds the coordinates.
template <typename Use>
void ForEachAxis(std::span<const LatticePoint> positions,
                 const PointBounds& bounds, const Use& use) {
  const auto& [min, max] = bounds;
  const int64_t widest =
      std::max({max.x - min.x, max.y - min.y, max.z - min.z});
  if (widest <= std::numeric_limits<int32_t>::max()) {
    ForEachAxisOf<int32_t>(positions, min, use);
  } else {
    ForEachAxisOf<int64_t>(positions, min, use);
  }
}

/// Adds the position columns and sets the head's bounds and corner.
void EncodePositions(std::span<const LatticePoint> positions,
                     const EncodeOptions& options, BlockHead& head,
                     std::vector<EncodedColumn>& columns) {
  const Compression compression = options.compression;
  const PointBounds bounds = BoundsOf(positions);
  const auto& [min, max] = bounds;
  head.min = min;
  head.max = max;
  if (compression != Compression::kNone && !positions.empty()) {
    head.corner = MortonCorner(min);
    if (const auto codes = MortonCodes(positions, max, head.corner)) {
      columns.push_back(EncodeColumn(
          {std::string(kMortonName), ScalarType::kUint64}, AsBytes(*codes), {},
          Transform::kAscendingCoded, compression));
      return;
    }
  }
  head.corner = min;
  ForEachAxis(positions, bounds, [&](const ColumnSpec& spec, auto values) {
    columns.push_back(
        EncodeColumn(spec, values, {}, compression,
                     options.plan == nullptr ? nullptr : &options.plan->axes));
  });
}

absl::Status CheckEncodable(const LatticeCloud& cloud) {
  const size_t count = cloud.size();
  if (count > static_cast<size_t>(kMaxBlockPoints)) {
    return absl::InvalidArgumentError(
        absl::StrCat("a block holds at most ", kMaxBlockPoints,
                     " points, have ", count, "; make several blocks"));
  }
  const int64_t step_nm = cloud.lattice.step_nm();
  if (step_nm < 1 || step_nm > kMaxStepNm) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the step must be 1 to ", kMaxStepNm, " nm, have ", step_nm));
  }
  const std::vector<Column>& columns = cloud.attributes.columns();
  if (columns.size() > kMaxBlockColumns - 3) {
    return absl::InvalidArgumentError(
        absl::StrCat("a block holds at most ", kMaxBlockColumns - 3,
                     " attributes, have ", columns.size()));
  }
  std::set<std::string_view> names;
  size_t with_missing = 0;
  for (const Column& column : columns) {
    const std::string& name = column.name();
    if (name.empty() || name.size() > kMaxColumnNameBytes) {
      return absl::InvalidArgumentError(absl::StrCat(
          "the name of an attribute has 1 to ", kMaxColumnNameBytes, " bytes, ",
          QuotedName(name), " has ", name.size()));
    }
    if (!names.insert(name).second) {
      return absl::InvalidArgumentError(
          absl::StrCat("two attributes are named ", QuotedName(name)));
    }
    if (column.size() != count) {
      return absl::InvalidArgumentError(
          absl::StrCat("attribute ", QuotedName(name), ": expected ", count,
                       " values, have ", column.size()));
    }
    with_missing += column.has_missing() ? 1 : 0;
  }
  const int64_t decoded_bytes =
      DecodedBytes(count, cloud.attributes.specs(), with_missing);
  if (decoded_bytes > kMaxDecodedBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("a block holds at most ", kMaxDecodedBytes,
                     " bytes of decoded points, have ", decoded_bytes,
                     "; make several blocks"));
  }
  const auto [min, max] = BoundsOf(cloud.positions);
  for (const int64_t q : {min.x, min.y, min.z, max.x, max.y, max.z}) {
    if (q <= -kLatticeLimit || q >= kLatticeLimit) {
      return absl::InvalidArgumentError(
          absl::StrCat("coordinate ", q, " is outside the lattice of +-",
                       kLatticeLimit, " steps"));
    }
  }
  return absl::OkStatus();
}

}  // namespace

EncodePlan PlanEncoding(const LatticeCloud& cloud, Compression compression,
                        PlanAim aim) {
  EncodePlan plan;
  const PointBounds bounds = BoundsOf(cloud.positions);
  if (!MortonCodes(cloud.positions, bounds.max, MortonCorner(bounds.min))) {
    ForEachAxis(cloud.positions, bounds,
                [&](const ColumnSpec& spec, auto values) {
                  AddToPlan(spec, values, compression, aim, plan.axes);
                });
  }
  for (const Column& column : cloud.attributes.columns()) {
    AddToPlan(column.spec(), column.bytes(), compression, aim, plan.attributes);
  }
  return plan;
}

absl::StatusOr<std::vector<std::byte>> EncodePoints(
    const LatticeCloud& cloud, const EncodeOptions& options) {
  MAPSIEVE_RETURN_IF_ERROR(CheckEncodable(cloud));
  BlockHead head;
  head.step_nm = cloud.lattice.step_nm();
  head.point_count = static_cast<uint32_t>(cloud.size());
  std::vector<EncodedColumn> columns;
  EncodePositions(cloud.positions, options, head, columns);
  for (const Column& column : cloud.attributes.columns()) {
    columns.push_back(EncodeColumn(
        column.spec(), column.bytes(), column.missing(), options.compression,
        options.plan == nullptr ? nullptr : &options.plan->attributes));
  }
  size_t stored_bytes = 0;
  for (const EncodedColumn& column : columns) {
    head.columns.push_back(column.entry);
    stored_bytes += column.stored.size();
  }
  std::vector<std::byte> block = FormatBlockHead(head);
  block.reserve(block.size() + stored_bytes);
  for (const EncodedColumn& column : columns) {
    block.insert(block.end(), column.stored.begin(), column.stored.end());
  }
  return block;
}

}  // namespace mapsieve::core
