# Most of the time of an unoptimised compilation goes into the same few headers.
# Not for builds that are to show that every file includes what it uses.
function(mapsieve_precompile)
  target_precompile_headers(mapsieve_base PRIVATE
    <algorithm> <array> <chrono> <filesystem> <functional> <map> <memory> <optional> <set>
    <string> <unordered_map> <utility> <vector>
    "${PROJECT_SOURCE_DIR}/core/base/executor.h"
    "${PROJECT_SOURCE_DIR}/core/base/mutex.h"
    "${PROJECT_SOURCE_DIR}/core/base/status.h"
    "${PROJECT_SOURCE_DIR}/core/cloud/point_cloud.h")
  foreach(target ${ARGN})
    target_precompile_headers(${target} REUSE_FROM mapsieve_base)
  endforeach()
  # ccache stores objects made with a precompiled header only with these.
  foreach(target mapsieve_base ${ARGN})
    target_compile_options(${target} PRIVATE
      $<$<CXX_COMPILER_ID:GNU>:-fpch-preprocess>
      "$<$<CXX_COMPILER_ID:Clang>:SHELL:-Xclang -fno-pch-timestamp>")
  endforeach()
endfunction()
