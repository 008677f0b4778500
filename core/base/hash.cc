#include "core/base/hash.h"

#include <bit>
#include <new>

#include "absl/strings/str_format.h"
#include "xxhash.h"
#if defined(__x86_64__)
// The widest vectors that the processor has.
#include "xxh_x86dispatch.h"
#endif

namespace mapsieve {

static_assert(std::endian::native == std::endian::little,
              "big-endian machines are not supported");

namespace {

/// To be called after the library has hashed many bytes: it leaves the upper
/// halves of vector registers in use, and what uses the lower ones then is
/// slower by a third.
void LeaveVectors() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx")) asm volatile("vzeroupper");
#endif
}

}  // namespace

uint64_t Hash64(std::span<const std::byte> bytes) {
  const uint64_t hash = XXH3_64bits(bytes.data(), bytes.size());
  LeaveVectors();
  return hash;
}

uint64_t HashIntegers(std::span<const int64_t> values) {
  return XXH3_64bits(values.data(), values.size_bytes());
}

struct ContentHasher::State {
  XXH3_state_t* xxh = XXH3_createState();
  ~State() { XXH3_freeState(xxh); }
};

ContentHasher::ContentHasher() : state_(std::make_unique<State>()) {
  if (state_->xxh == nullptr) throw std::bad_alloc();
  XXH3_128bits_reset(state_->xxh);
}

ContentHasher::~ContentHasher() = default;

void ContentHasher::Update(std::span<const std::byte> bytes) {
  XXH3_128bits_update(state_->xxh, bytes.data(), bytes.size());
  LeaveVectors();
}

std::string ContentHasher::HexDigest() const {
  const XXH128_hash_t hash = XXH3_128bits_digest(state_->xxh);
  return absl::StrFormat("%016x%016x", hash.high64, hash.low64);
}

std::string ContentHash(std::span<const std::byte> bytes) {
  ContentHasher hasher;
  hasher.Update(bytes);
  return hasher.HexDigest();
}

}  // namespace mapsieve
