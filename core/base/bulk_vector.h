#ifndef MAPSIEVE_CORE_BASE_BULK_VECTOR_H_
#define MAPSIEVE_CORE_BASE_BULK_VECTOR_H_

#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

namespace mapsieve {

/// Allocates like std::allocator, but asks the system for huge pages for what
/// is as large as several of them: touching fresh memory page by page costs
/// more than all else that is done with an array which is filled once.
template <typename T>
class BulkAllocator {
 public:
  using value_type = T;

  BulkAllocator() = default;
  template <typename U>
  explicit BulkAllocator(const BulkAllocator<U>&) {}

  T* allocate(size_t count) {
    constexpr size_t kHugePage = size_t{1} << 21;
    if (count < 2 * kHugePage / sizeof(T)) {
      return std::allocator<T>().allocate(count);
    }
    if (count > static_cast<size_t>(-1) / 2 / sizeof(T)) throw std::bad_alloc();
    const size_t bytes =
        (count * sizeof(T) + kHugePage - 1) / kHugePage * kHugePage;
    void* block = std::aligned_alloc(kHugePage, bytes);
    if (block == nullptr) throw std::bad_alloc();
#if defined(MADV_HUGEPAGE)
    // Advice: refusing it is no error.
    (void)madvise(block, bytes, MADV_HUGEPAGE);
#endif
    return static_cast<T*>(block);
  }

  void deallocate(T* block, size_t count) {
    constexpr size_t kHugePage = size_t{1} << 21;
    if (count < 2 * kHugePage / sizeof(T)) {
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
};

/// A vector for arrays of millions of elements. resize leaves new elements of a
/// trivial type without a value.
template <typename T>
using BulkVector = std::vector<T, BulkAllocator<T>>;

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_BULK_VECTOR_H_
