#ifndef MAPSIEVE_CLIENT_FORMATS_BATCH_COLUMNS_H_
#define MAPSIEVE_CLIENT_FORMATS_BATCH_COLUMNS_H_

#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"

/// What every writer checks, and what every reader's attributes obey. All
/// functions are thread-safe.
namespace mapsieve::client {

/// Attributes of a file at most; beyond it a reader refuses the file.
inline constexpr size_t kMaxAttributes = 1024;
/// Bytes of an attribute's name at most.
inline constexpr size_t kMaxNameBytes = 255;

/// Checks the attributes of a file: at most kMaxAttributes, every name 1 to
/// kMaxNameBytes long, none twice, none "x", "y" or "z". Otherwise
/// kInvalidArgument, beginning with `file_name`.
absl::Status CheckAttributes(std::string_view file_name,
                             const std::vector<core::ColumnSpec>& attributes);

/// `text` as UTF-8 on one line: control characters and, unless all of `text` is
/// UTF-8, bytes that are not ASCII become `substitute`; blanks at both ends go.
/// Names and other texts of files pass through it.
std::string CleanText(std::string_view text, char substitute);

/// The columns of `batch` in the order of `attributes`. kInvalidArgument,
/// beginning with `file_name`, unless the batch has exactly these attributes,
/// each with a value for every point.
absl::StatusOr<std::vector<const core::Column*>> MatchColumns(
    std::string_view file_name, const std::vector<core::ColumnSpec>& attributes,
    const core::PointCloud& batch);

}  // namespace mapsieve::client

#endif  // MAPSIEVE_CLIENT_FORMATS_BATCH_COLUMNS_H_
