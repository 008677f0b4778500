#ifndef MAPSIEVE_SERVER_ENGINE_ANSWER_COLUMNS_H_
#define MAPSIEVE_SERVER_ENGINE_ANSWER_COLUMNS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "core/cloud/point_cloud.h"
#include "server/engine/query.h"

namespace mapsieve::engine {

/// A sentence for an attribute that is not among those of a map.
std::string UnknownAttribute(std::string_view name,
                             std::span<const core::ColumnSpec> attributes);

/// Columns of an answer and how they come from the columns of chunks.
class AnswerColumns {
 public:
  /// `attributes`: those of the map, by name. Errors as Engine::Query has them
  /// for QuerySpec::columns.
  static absl::StatusOr<AnswerColumns> Make(
      const QuerySpec& spec, std::span<const core::ColumnSpec> attributes);

  const std::vector<core::ColumnSpec>& specs() const { return specs_; }

  /// Columns of a chunk that Build needs.
  const std::vector<std::string>& stored_names() const { return stored_names_; }

  /// The answer's columns for the points of a chunk at `rows`. An attribute
  /// that the chunk lacks is missing there. kDataLoss: the chunk lacks a column
  /// of the filter, or one has another type.
  absl::StatusOr<core::ColumnSet> Build(const core::LatticeCloud& chunk,
                                        std::span<const uint32_t> rows) const;

  /// An upper bound of the memory of one point of a chunk, decoded.
  int64_t stored_point_bytes() const;
  /// How many points fit a block of `max_bytes` however they are encoded; at
  /// least 1.
  size_t PointsPerBlock(int64_t max_bytes) const;

 private:
  /// Appends one or more columns to an answer.
  using Source = std::function<absl::Status(const core::LatticeCloud& chunk,
                                            std::span<const uint32_t> rows,
                                            std::vector<core::Column>& answer)>;

  void Add(std::vector<core::ColumnSpec> specs,
           std::vector<std::string> stored_names, Source source);
  void AddUnpacked(const core::ColumnSpec& packed);
  void AddCopy(const core::ColumnSpec& spec, const std::string& stored_name);
  void AddSaliencies();
  void AddCovariance();
  void AddFilterColumns(const ColumnSelection& selection, bool packed);
  void AddAttribute(const core::ColumnSpec& attribute, std::string name);

  std::vector<core::ColumnSpec> specs_;
  std::vector<std::string> stored_names_;
  /// Together they give the columns of specs_, in that order.
  std::vector<Source> sources_;
};

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_ANSWER_COLUMNS_H_
