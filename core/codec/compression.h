#ifndef MAPSIEVE_CORE_CODEC_COMPRESSION_H_
#define MAPSIEVE_CORE_CODEC_COMPRESSION_H_

#include <cstddef>
#include <span>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "core/codec/points_codec.h"

/// The general-purpose compressors behind one pair of functions. All are
/// thread-safe.
namespace mapsieve::core {

/// "none", "lz4", "zstd"; empty for a number that is not a Compression.
std::string_view CompressionName(Compression compression);

/// Compresses `bytes` (at most 2^30) as one LZ4 block or one zstd frame.
/// Empty if that is not smaller than `bytes`; always for kNone.
std::vector<std::byte> Compress(Compression compression,
                                std::span<const std::byte> bytes);

/// The inverse: fills `bytes`, whose size says how many are expected, and
/// writes nothing else. kDataLoss if `stored` does not give exactly these.
absl::Status Decompress(Compression compression,
                        std::span<const std::byte> stored,
                        std::span<std::byte> bytes);

}  // namespace mapsieve::core

#endif  // MAPSIEVE_CORE_CODEC_COMPRESSION_H_
