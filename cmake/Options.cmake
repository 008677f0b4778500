# Compile options of every target of ours, as one interface target.
add_library(mapsieve_options INTERFACE)

# Results are part of the contract: no contraction of a*b+c, no processor of
# the build machine, no relaxed arithmetic. The last two flags only say that
# nobody reads errno or the floating-point flags; they change no value.
# -pthread comes with some of the libraries: with all, precompiled headers fit all.
target_compile_options(mapsieve_options INTERFACE
  -ffp-contract=off -fno-math-errno -fno-trapping-math -pthread)
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  target_compile_options(mapsieve_options INTERFACE -march=x86-64-v2)
endif()

target_compile_options(mapsieve_options INTERFACE
  -Wall -Wextra -Wno-missing-field-initializers -Wpedantic -Wconversion -Wshadow -Wnon-virtual-dtor
  -Woverloaded-virtual -Wunused-result)
if(MAPSIEVE_WERROR)
  target_compile_options(mapsieve_options INTERFACE -Werror)
endif()

if(MAPSIEVE_SANITIZE)
  # A target may have fewer by the property MAPSIEVE_SANITIZERS.
  string(REPLACE "," "$<COMMA>" sanitizers "${MAPSIEVE_SANITIZE}")
  set(own $<TARGET_PROPERTY:MAPSIEVE_SANITIZERS>)
  target_compile_options(mapsieve_options INTERFACE
    "-fsanitize=$<IF:$<BOOL:${own}>,${own},${sanitizers}>" -fno-omit-frame-pointer
    -fno-sanitize-recover=all)
  target_link_options(mapsieve_options INTERFACE
    -fsanitize=${MAPSIEVE_SANITIZE})
endif()

target_include_directories(mapsieve_options INTERFACE ${PROJECT_SOURCE_DIR})
