#ifndef MAPSIEVE_SERVER_ENGINE_RESUME_TOKEN_H_
#define MAPSIEVE_SERVER_ENGINE_RESUME_TOKEN_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

namespace mapsieve::engine {

/// How far an answer has come.
struct ResumePoint {
  /// Of the map and the query: what the answer is of.
  uint64_t key = 0;
  int64_t revision = 0;
  int64_t point_count = 0;
  int64_t block_bytes = 0;
  int64_t missing_chunk_count = 0;

  friend bool operator==(const ResumePoint&, const ResumePoint&) = default;
};

/// The point as bytes of fixed length with a checksum.
std::string WriteResumeToken(const ResumePoint& point);

/// kInvalidArgument (FieldOf resume_token): not a token, or one of another key.
absl::StatusOr<ResumePoint> ReadResumeToken(const std::string& token,
                                            uint64_t key);

}  // namespace mapsieve::engine

#endif  // MAPSIEVE_SERVER_ENGINE_RESUME_TOKEN_H_
