#ifndef MAPSIEVE_CORE_BASE_HEAP_H_
#define MAPSIEVE_CORE_BASE_HEAP_H_

#if defined(__GLIBC__)
#include <malloc.h>
#endif

namespace mapsieve {

/// Makes the process give blocks of 4 MiB and more back to the system when
/// they are freed, so that its resident set follows what it uses: glibc would
/// raise that size by itself to 32 MiB. Up to 16 MiB of smaller ones stay for
/// reuse. To be called first in main.
inline void ReturnFreedBlocks() {
#if defined(__GLIBC__)
  mallopt(M_MMAP_THRESHOLD, 4 << 20);
  mallopt(M_TRIM_THRESHOLD, 16 << 20);
#endif
}

}  // namespace mapsieve

#endif  // MAPSIEVE_CORE_BASE_HEAP_H_
