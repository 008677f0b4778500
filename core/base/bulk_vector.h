#ifndef MAPSIEVE_CORE_BASE_BULK_VECTOR_H_
#define MAPSIEVE_CORE_BASE_BULK_VECTOR_H_

#include <sys/mman.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

namespace mapsieve {

inline constexpr size_t kHugePageBytes = size_t{1} << 21;

/// Asks the system for huge pages for [block, block + bytes): touching fresh
/// memory page by page costs more than all else that is done with an array
/// which is filled once.
inline void AdviseHugePages(void* block, size_t bytes) {
#if defined(MADV_HUGEPAGE)
  const auto begin = reinterpret_cast<uintptr_t>(block);
  const uintptr_t first =
      (begin + kHugePageBytes - 1) / kHugePageBytes * kHugePageBytes;
  const uintptr_t last = (begin + bytes) / kHugePageBytes * kHugePageBytes;
  // Advice: refusing it is no error.
  if (first < last) {
    (void)madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
  }
#else
  (void)block;
  (void)bytes;
#endif
}

/// Allocates like std::allocator, but with huge pages for what fills half of
/// one.
template <typename T>
class BulkAllocator {
 public:
  using value_type = T;

  BulkAllocator() = default;
  template <typename U>
  explicit BulkAllocator(const BulkAllocator<U>&) {}

  T* allocate(size_t count) {
    if (count < kBulkBytes / sizeof(T)) {
      return std::allocator<T>().allocate(count);
    }
    if (count > static_cast<size_t>(-1) / 2 / sizeof(T)) throw std::bad_alloc();
    const size_t bytes = (count * sizeof(T) + kHugePageBytes - 1) /
                         kHugePageBytes * kHugePageBytes;
    void* block = std::aligned_alloc(kHugePageBytes, bytes);
    if (block == nullptr) throw std::bad_alloc();
    AdviseHugePages(block, bytes);
    return static_cast<T*>(block);
  }

  void deallocate(T* block, size_t count) {
    if (count < kBulkBytes / sizeof(T)) {
      std::allocator<T>().deallocate(block, count);
    } else {
      std::free(block);
    }
  }

  /// Elements that are not given a value are not touched, if their type allows
  /// it.
  template <typename U, typename... Args>
  void construct(U* p, Args&&... args) {
    if constexpr (sizeof...(Args) == 0) {
      ::new (static_cast<void*>(p)) U;
    } else {
      ::new (static_cast<void*>(p)) U(std::forward<Args>(args)...);
    }
  }

  friend bool operator==(const BulkAllocator&, const BulkAllocator&) {
    return true;
  }

 private:
  static constexpr size_t kBulkBytes = kHugePageBytes / 2;
};

/// A vector for arrays of millions of elements. resize leaves new elements of a
/// trivial type without a value.
template <typename T>
using BulkVector = std::vector<T, BulkAllocator<T>>;

/// reserve for a vector that will be filled, whatever its allocator.
template <typename Vector>
void ReserveBulk(Vector& vector, size_t size) {
  vector.reserve(size);
  AdviseHugePages(vector.data(), size * sizeof(typename Vector::value_type));
}

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_BULK_VECTOR_H_
