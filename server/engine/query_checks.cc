#include "server/engine/query_checks.h"

#include <algorithm>
#include <cstddef>
#include <string>

#include "core/base/status.h"
#include "server/engine/field_error.h"

namespace mapsieve::engine {
namespace {

using core::Label;

constexpr Label kChoices[] = {Label::kJunction, Label::kCurve, Label::kSurface};

/// What asks for more than raw points have.
absl::Status CheckRaw(const QuerySpec& spec) {
  if (!spec.raw) return absl::OkStatus();
  const auto refuse = [](const char* field, const char* why) {
    return FieldError(field, absl::StrCat(why, "; leave it or raw out"));
  };
  if (!spec.labels.empty()) return refuse("labels", "raw points have none");
  if (spec.depth > 0) return refuse("depth", "raw points have no levels");
  if (spec.spacing_m > 0) {
    return refuse("spacing_m", "raw points have no levels");
  }
  if (spec.confidence.has_value()) {
    return refuse("confidence", "raw points have none");
  }
  constexpr char kNoShares[] =
      "a budget is shared out by label, which raw points lack";
  if (spec.max_points > 0) return refuse("max_point_count", kNoShares);
  if (spec.max_bytes > 0) return refuse("max_bytes", kNoShares);
  return absl::OkStatus();
}

absl::Status CheckBudget(const QuerySpec& spec) {
  if (spec.max_points < 0) {
    return FieldError("max_point_count",
                      absl::StrCat("it is ", spec.max_points,
                                   "; it must be 0 (no limit) or above"));
  }
  if (spec.max_bytes != 0 && spec.max_bytes < kMinBudgetBytes) {
    return FieldError("max_bytes",
                      absl::StrCat("it is ", spec.max_bytes,
                                   "; it must be 0 (no limit) or at least ",
                                   kMinBudgetBytes));
  }
  if (!spec.label_weights.has_value()) return absl::OkStatus();
  if (spec.max_points == 0 && spec.max_bytes == 0) {
    return FieldError("label_weights",
                      "there is no budget to share out; give max_point_count "
                      "or max_bytes");
  }
  for (const Label label : kChoices) {
    const double weight = (*spec.label_weights)[static_cast<size_t>(label)];
    const bool is_wanted =
        spec.labels.empty() || std::find(spec.labels.begin(), spec.labels.end(),
                                         label) != spec.labels.end();
    if (weight <= core::kMaxLabelWeight &&
        (weight > 0 || (weight == 0 && !is_wanted))) {
      continue;
    }
    return FieldError(
        std::string("label_weights.").append(core::LabelName(label)),
        absl::StrCat("it is ", weight, "; it must be above 0 and at most ",
                     core::kMaxLabelWeight));
  }
  return absl::OkStatus();
}

absl::Status CheckRange(const std::string& field, const Range& range) {
  // False for NaN too.
  if (range.min <= range.max) return absl::OkStatus();
  return FieldError(field, absl::StrCat("min is ", range.min, " and max is ",
                                        range.max, "; min <= max must hold"));
}

absl::Status CheckRanges(const QuerySpec& spec) {
  if (spec.confidence.has_value()) {
    MAPSIEVE_RETURN_IF_ERROR(CheckRange("confidence", *spec.confidence));
  }
  if (spec.attribute_ranges.size() > kMaxAttributeRanges) {
    return FieldError(
        "attribute_ranges",
        absl::StrCat("there are ", spec.attribute_ranges.size(), "; at most ",
                     kMaxAttributeRanges, " are possible"));
  }
  for (size_t i = 0; i < spec.attribute_ranges.size(); ++i) {
    MAPSIEVE_RETURN_IF_ERROR(
        CheckRange(absl::StrCat("attribute_ranges[", i, "].range"),
                   spec.attribute_ranges[i].range));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status CheckSpec(const QuerySpec& spec) {
  if (spec.revision < 0) {
    return FieldError("revision",
                      absl::StrCat("it is ", spec.revision,
                                   "; it must be 0 (newest) or above"));
  }
  if (spec.depth < 0 || spec.depth > core::kMaxDepth) {
    return FieldError("depth", absl::StrCat("it is ", spec.depth,
                                            "; it must be 0 (all points) to ",
                                            core::kMaxDepth));
  }
  if (!(spec.spacing_m >= 0)) {
    return FieldError("spacing_m",
                      absl::StrCat("it is ", spec.spacing_m,
                                   "; it must be 0 (all points) or above"));
  }
  if (spec.depth > 0 && spec.spacing_m > 0) {
    return FieldError("spacing_m",
                      "depth too chooses a level of detail; leave one out");
  }
  for (size_t i = 0; i < spec.labels.size(); ++i) {
    if (std::find(std::begin(kChoices), std::end(kChoices), spec.labels[i]) ==
        std::end(kChoices)) {
      return FieldError(
          absl::StrCat("labels[", i, "]"),
          absl::StrCat("it is ", static_cast<int>(spec.labels[i]),
                       "; labels are 1 junction, 2 curve and 3 surface"));
    }
  }
  MAPSIEVE_RETURN_IF_ERROR(CheckBudget(spec));
  MAPSIEVE_RETURN_IF_ERROR(CheckRanges(spec));
  return CheckRaw(spec);
}

}  // namespace mapsieve::engine
