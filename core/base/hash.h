#ifndef MAPSIEVE_CORE_BASE_HASH_H_
#define MAPSIEVE_CORE_BASE_HASH_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

namespace mapsieve {

/// XXH3_64 of `bytes`, seed 0: the checksum of every stored or sent column.
uint64_t Hash64(std::span<const std::byte> bytes);

/// XXH3_64 of the values as little-endian int64s: the draw and the priority of
/// a point are keyed by it.
uint64_t HashIntegers(std::span<const int64_t> values);

/// XXH3_128 of a byte sequence that arrives in pieces; names stored objects by
/// their content.
class ContentHasher {
 public:
  ContentHasher();
  ~ContentHasher();
  ContentHasher(const ContentHasher&) = delete;
  ContentHasher& operator=(const ContentHasher&) = delete;

  void Update(std::span<const std::byte> bytes);
  /// 32 lower-case hexadecimal digits, most significant first.
  std::string HexDigest() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// ContentHasher over one piece.
std::string ContentHash(std::span<const std::byte> bytes);

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_HASH_H_
