#include "server/engine/answer_columns.h"

#include <algorithm>
#include <array>
#include <set>
#include <string_view>
#include <utility>

#include "core/base/status.h"
#include "core/geometry/octahedral.h"
#include "core/registration/label_covariance.h"
#include "core/spdf/cloud_filter.h"
#include "server/engine/field_error.h"
#include "server/engine/product_chunk.h"
#include "storage/names.h"

namespace mapsieve::engine {
namespace {

using core::Column;
using core::ColumnSpec;
using core::LatticeCloud;
using core::ScalarType;

constexpr std::array<std::string_view, 3> kLambdaNames = {"lambda1", "lambda2",
                                                          "lambda3"};

/// What a block needs at most besides values: position columns, fixed fields
/// and an entry for each column without its name.
constexpr int64_t kBlockHeadBytes = 512;
constexpr int64_t kColumnHeadBytes = 64;
constexpr int64_t kPositionBytes = 3 * (8 + 1);

constexpr size_t kNamesInMessage = 20;

constexpr std::array<std::string_view, 3> kSaliencyNames = {
    "saliency_surface", "saliency_curve", "saliency_junction"};
constexpr std::array<std::string_view, 6> kCovarianceNames = {
    "cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"};

bool HasFilterColumn(const ColumnSelection& c) {
  return c.label || c.confidence || c.normal || c.tangent || c.eigenvalues ||
         c.saliencies || c.covariance;
}

/// A float32 column by each name.
template <size_t count>
std::vector<ColumnSpec> FloatSpecs(
    const std::array<std::string_view, count>& names) {
  std::vector<ColumnSpec> specs;
  for (const std::string_view name : names) {
    specs.push_back({std::string(name), ScalarType::kFloat32});
  }
  return specs;
}

/// Appends columns of `size` values and returns the number of the first one.
size_t AppendColumns(const std::vector<ColumnSpec>& specs, size_t size,
                     std::vector<Column>& answer) {
  const size_t first = answer.size();
  for (const ColumnSpec& spec : specs) answer.emplace_back(spec, size);
  return first;
}

}  // namespace

std::string UnknownAttribute(std::string_view name,
                             std::span<const ColumnSpec> attributes) {
  std::string known;
  for (size_t i = 0; i < std::min(attributes.size(), kNamesInMessage); ++i) {
    absl::StrAppend(&known, i == 0 ? "" : ", ", attributes[i].name);
  }
  if (attributes.size() > kNamesInMessage) absl::StrAppend(&known, ", …");
  return absl::StrCat("the map has no attribute ", storage::Quoted(name),
                      "; it has ", attributes.empty() ? "none" : known);
}

absl::StatusOr<AnswerColumns> AnswerColumns::Make(
    const QuerySpec& spec, std::span<const ColumnSpec> attributes) {
  const ColumnSelection selection =
      spec.columns.value_or(ColumnSelection{.label = !spec.raw,
                                            .confidence = !spec.raw,
                                            .normal = !spec.raw,
                                            .all_attributes = true});
  if (spec.raw && HasFilterColumn(selection)) {
    return FieldError(
        "columns.filter_columns",
        "raw points have nothing of the filter; ask for attributes only, or "
        "for processed points");
  }
  std::set<std::string_view> wanted(selection.attributes.begin(),
                                    selection.attributes.end());
  for (const std::string& name : selection.attributes) {
    if (std::none_of(attributes.begin(), attributes.end(),
                     [&](const ColumnSpec& a) { return a.name == name; })) {
      return absl::NotFoundError(UnknownAttribute(name, attributes));
    }
  }
  AnswerColumns columns;
  columns.AddFilterColumns(selection, spec.packed_columns);
  // Attributes have the same names beside packed columns.
  AnswerColumns unpacked;
  unpacked.AddFilterColumns(selection, false);
  std::vector<std::string_view> taken;
  if (!spec.raw) {
    taken.assign(core::kLabelColumnNames.begin(),
                 core::kLabelColumnNames.end());
  }
  for (const ColumnSpec& column : unpacked.specs_) taken.push_back(column.name);
  for (const ColumnSpec& attribute : attributes) {
    if (selection.all_attributes || wanted.contains(attribute.name)) {
      columns.AddAttribute(attribute, core::NameBeside(attribute.name, taken));
    }
  }
  return columns;
}

void AnswerColumns::Add(std::vector<ColumnSpec> specs,
                        std::vector<std::string> stored_names, Source source) {
  for (ColumnSpec& spec : specs) specs_.push_back(std::move(spec));
  for (std::string& name : stored_names) {
    stored_names_.push_back(std::move(name));
  }
  sources_.push_back(std::move(source));
}

void AnswerColumns::AddUnpacked(const ColumnSpec& packed) {
  Add(core::UnpackedSpecs(packed), {packed.name},
      [packed](const LatticeCloud& chunk, std::span<const uint32_t> rows,
               std::vector<Column>& answer) -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(
            const Column* const stored,
            FindProductColumn(chunk.attributes, packed.name, packed.type));
        core::Unpack(stored->Select(rows), answer);
        return absl::OkStatus();
      });
}

void AnswerColumns::AddCopy(const ColumnSpec& spec,
                            const std::string& stored_name) {
  Add({spec}, {stored_name},
      [spec, stored_name](const LatticeCloud& chunk,
                          std::span<const uint32_t> rows,
                          std::vector<Column>& answer) -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(
            const Column* const stored,
            FindProductColumn(chunk.attributes, stored_name, spec.type));
        answer.push_back(stored->Select(rows));
        answer.back().Rename(spec.name);
        return absl::OkStatus();
      });
}

void AnswerColumns::AddSaliencies() {
  const std::vector<ColumnSpec> specs = FloatSpecs(kSaliencyNames);
  Add(specs, {kLambdaColumns.begin(), kLambdaColumns.end()},
      [specs](const LatticeCloud& chunk, std::span<const uint32_t> rows,
              std::vector<Column>& answer) -> absl::Status {
        std::array<const Column*, 3> lambda{};
        for (size_t l = 0; l < lambda.size(); ++l) {
          MAPSIEVE_ASSIGN_OR_RETURN(
              lambda[l], FindProductColumn(chunk.attributes, kLambdaColumns[l],
                                           ScalarType::kFloat32));
        }
        const size_t first = AppendColumns(specs, rows.size(), answer);
        for (size_t i = 0; i < rows.size(); ++i) {
          float smaller = 0;
          for (size_t l = lambda.size(); l-- > 0;) {
            const auto value = lambda[l]->Get<float>(rows[i]);
            answer[first + l].Set(i, value - smaller);
            smaller = value;
          }
        }
        return absl::OkStatus();
      });
}

void AnswerColumns::AddCovariance() {
  const std::vector<ColumnSpec> specs = FloatSpecs(kCovarianceNames);
  Add(specs,
      {std::string(kLabelColumn), std::string(kConfidenceColumn),
       std::string(kNormalColumn)},
      [specs](const LatticeCloud& chunk, std::span<const uint32_t> rows,
              std::vector<Column>& answer) -> absl::Status {
        MAPSIEVE_ASSIGN_OR_RETURN(const LabelColumnView labels,
                                  LabelColumnView::Of(chunk.attributes));
        MAPSIEVE_ASSIGN_OR_RETURN(
            const Column* const normal,
            FindProductColumn(chunk.attributes, kNormalColumn,
                              ScalarType::kUint32));
        const size_t first = AppendColumns(specs, rows.size(), answer);
        for (size_t i = 0; i < rows.size(); ++i) {
          const core::Covariance values = core::LabelCovariance(
              labels.label(rows[i]),
              core::DecodeOctahedral(normal->Get<uint32_t>(rows[i])));
          for (size_t c = 0; c < values.size(); ++c) {
            answer[first + c].Set(i, values[c]);
          }
        }
        return absl::OkStatus();
      });
}

void AnswerColumns::AddFilterColumns(const ColumnSelection& selection,
                                     bool packed) {
  if (selection.label) {
    AddCopy({"label", ScalarType::kUint8}, std::string(kLabelColumn));
  }
  const auto add = [&](std::string_view name, ScalarType type) {
    const ColumnSpec spec = {std::string(name), type};
    if (packed) {
      AddCopy(spec, spec.name);
    } else {
      AddUnpacked(spec);
    }
  };
  if (selection.confidence) add(kConfidenceColumn, ScalarType::kUint16);
  if (selection.normal) add(kNormalColumn, ScalarType::kUint32);
  if (selection.tangent) add(kTangentColumn, ScalarType::kUint32);
  if (selection.eigenvalues) {
    for (size_t l = 0; l < kLambdaNames.size(); ++l) {
      AddCopy({std::string(kLambdaNames[l]), ScalarType::kFloat32},
              std::string(kLambdaColumns[l]));
    }
  }
  if (selection.saliencies) AddSaliencies();
  if (selection.covariance) AddCovariance();
}

void AnswerColumns::AddAttribute(const ColumnSpec& attribute,
                                 std::string name) {
  const ColumnSpec spec = {std::move(name), attribute.type};
  Add({spec}, {attribute.name},
      [spec, attribute](const LatticeCloud& chunk,
                        std::span<const uint32_t> rows,
                        std::vector<Column>& answer) -> absl::Status {
        const Column* const stored = chunk.attributes.Find(attribute.name);
        if (stored == nullptr) {
          answer.emplace_back(spec).AppendMissing(rows.size());
          return absl::OkStatus();
        }
        MAPSIEVE_RETURN_IF_ERROR(
            FindProductColumn(chunk.attributes, attribute.name, spec.type)
                .status());
        answer.push_back(stored->Select(rows));
        answer.back().Rename(spec.name);
        return absl::OkStatus();
      });
}

absl::StatusOr<core::ColumnSet> AnswerColumns::Build(
    const LatticeCloud& chunk, std::span<const uint32_t> rows) const {
  core::ColumnSet answer;
  answer.columns().reserve(specs_.size());
  for (const Source& source : sources_) {
    MAPSIEVE_RETURN_IF_ERROR(source(chunk, rows, answer.columns()));
  }
  return answer;
}

int64_t AnswerColumns::stored_point_bytes() const {
  return ProductPointBytes(specs_);
}

size_t AnswerColumns::PointsPerBlock(int64_t max_bytes) const {
  int64_t head = kBlockHeadBytes;
  int64_t point = kPositionBytes;
  for (const ColumnSpec& spec : specs_) {
    head += kColumnHeadBytes + static_cast<int64_t>(spec.name.size());
    // A byte more than the value bounds every transform and the bitmap of
    // missing values.
    point += static_cast<int64_t>(core::ScalarSize(spec.type)) + 1;
  }
  return static_cast<size_t>(std::max((max_bytes - head) / point, int64_t{1}));
}

}  // namespace mapsieve::engine
