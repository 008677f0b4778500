#include "core/spdf/kernels.h"

namespace mapsieve::core {

extern const Kernels kPortableKernels;
#ifdef MAPSIEVE_X86_KERNELS
extern const Kernels kAvx2Kernels;
extern const Kernels kAvx512Kernels;
#endif

namespace {

struct Available {
  const Kernels* kernels[3] = {&kPortableKernels, nullptr, nullptr};
  int count = 1;
  Available() {
#ifdef MAPSIEVE_X86_KERNELS
    if (__builtin_cpu_supports("avx2")) kernels[count++] = &kAvx2Kernels;
    if (__builtin_cpu_supports("avx512f") &&
        __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl")) {
      kernels[count++] = &kAvx512Kernels;
    }
#endif
  }
};

const Available& GetAvailable() {
  static const Available available;
  return available;
}

const Kernels*& GetActive() {
  static const Kernels* active =
      GetAvailable().kernels[GetAvailable().count - 1];
  return active;
}

}  // namespace

const Kernels& ActiveKernels() { return *GetActive(); }

void UseKernels(const Kernels& kernels) { GetActive() = &kernels; }

const Kernels* const* AvailableKernels(int* count) {
  *count = GetAvailable().count;
  return GetAvailable().kernels;
}

}  // namespace mapsieve::core
