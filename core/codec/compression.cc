#include "core/codec/compression.h"

#include <cstring>
#include <string>

#include "core/base/status.h"
#include "lz4.h"
#include "zstd.h"

namespace mapsieve::core {
namespace {

constexpr int kZstdLevel = 3;

const char* Chars(std::span<const std::byte> bytes) {
  return reinterpret_cast<const char*>(bytes.data());
}

char* Chars(std::span<std::byte> bytes) {
  return reinterpret_cast<char*>(bytes.data());
}

}  // namespace

std::string_view CompressionName(Compression compression) {
  switch (compression) {
    case Compression::kNone:
      return "none";
    case Compression::kLz4:
      return "lz4";
    case Compression::kZstd:
      return "zstd";
  }
  return {};
}

std::vector<std::byte> Compress(Compression compression,
                                std::span<const std::byte> bytes) {
  if (compression == Compression::kNone || bytes.size() < 2) return {};
  // A result that does not fit here is of no use.
  std::vector<std::byte> stored(bytes.size() - 1);
  size_t size = 0;
  if (compression == Compression::kLz4) {
    size = static_cast<size_t>(LZ4_compress_default(
        Chars(bytes), Chars(std::span(stored)), static_cast<int>(bytes.size()),
        static_cast<int>(stored.size())));
  } else {
    const size_t result = ZSTD_compress(stored.data(), stored.size(),
                                        bytes.data(), bytes.size(), kZstdLevel);
    if (ZSTD_isError(result) == 0) size = result;
  }
  stored.resize(size);
  return stored;
}

absl::Status Decompress(Compression compression,
                        std::span<const std::byte> stored,
                        std::span<std::byte> bytes) {
  std::string found;
  switch (compression) {
    case Compression::kNone:
      if (stored.size() == bytes.size()) {
        if (!bytes.empty()) {
          std::memcpy(bytes.data(), stored.data(), bytes.size());
        }
        return absl::OkStatus();
      }
      found = absl::StrCat(stored.size(), " bytes");
      break;
    case Compression::kLz4: {
      const int size = LZ4_decompress_safe(Chars(stored), Chars(bytes),
                                           static_cast<int>(stored.size()),
                                           static_cast<int>(bytes.size()));
      if (size >= 0 && static_cast<size_t>(size) == bytes.size()) {
        return absl::OkStatus();
      }
      found =
          size < 0 ? "no LZ4 block of that size" : absl::StrCat(size, " bytes");
      break;
    }
    case Compression::kZstd: {
      const size_t size = ZSTD_decompress(bytes.data(), bytes.size(),
                                          stored.data(), stored.size());
      if (size == bytes.size()) return absl::OkStatus();
      found = ZSTD_isError(size) != 0 ? ZSTD_getErrorName(size)
                                      : absl::StrCat(size, " bytes");
      break;
    }
  }
  return absl::DataLossError(absl::StrCat(
      "decompression: expected ", bytes.size(), " bytes, have ", found));
}

}  // namespace mapsieve::core
