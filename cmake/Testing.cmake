include(GoogleTest)

# mapsieve_test(NAME LABEL label SOURCES file... LIBS target...)
# One test binary a module; every test in it carries the label.
function(mapsieve_test name)
  cmake_parse_arguments(ARG "" "LABEL;TIMEOUT" "SOURCES;LIBS" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE mapsieve_options ${ARG_LIBS} GTest::gmock GTest::gtest_main)
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  if(EXISTS "${MAPSIEVE_TEST_DATA}")
    target_compile_definitions(${name} PRIVATE MAPSIEVE_TEST_DATA="${MAPSIEVE_TEST_DATA}")
  endif()
  gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST
    PROPERTIES LABELS "${ARG_LABEL}" TIMEOUT ${ARG_TIMEOUT})
endfunction()
