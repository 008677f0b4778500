include(GoogleTest)

# mapsieve_test(NAME LABEL label [THREADED] [TIMEOUT seconds] SOURCES file... LIBS target...)
# One test binary a module; every test in it carries the label. The sanitizer
# builds run the binaries of the labels unit and fault; THREADED ones run under
# ThreadSanitizer too.
function(mapsieve_test name)
  cmake_parse_arguments(ARG "THREADED" "LABEL;TIMEOUT" "SOURCES;LIBS" ${ARGN})
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE mapsieve_test_options ${ARG_LIBS} GTest::gtest_main)
  target_precompile_headers(${name} REUSE_FROM mapsieve_test_header)
  get_property(sanitizers GLOBAL PROPERTY MAPSIEVE_TEST_SANITIZERS)
  set_target_properties(${name} PROPERTIES MAPSIEVE_SANITIZERS "${sanitizers}")
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 300)
  endif()
  if(EXISTS "${MAPSIEVE_TEST_DATA}")
    target_compile_definitions(${name} PRIVATE MAPSIEVE_TEST_DATA="${MAPSIEVE_TEST_DATA}")
  endif()
  gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST
    PROPERTIES LABELS "${ARG_LABEL}" TIMEOUT ${ARG_TIMEOUT})
  if(ARG_LABEL MATCHES "^(unit|fault)$")
    set_property(GLOBAL APPEND PROPERTY MAPSIEVE_UNIT_TEST_PROGRAMS ${name})
  endif()
  if(ARG_THREADED)
    set_property(GLOBAL APPEND PROPERTY MAPSIEVE_THREADED_TEST_PROGRAMS ${name})
  endif()
endfunction()

# Writes the names of the programs for deploy/test.sh; called after all tests.
function(mapsieve_list_test_programs)
  foreach(kind UNIT THREADED)
    get_property(programs GLOBAL PROPERTY MAPSIEVE_${kind}_TEST_PROGRAMS)
    string(TOLOWER ${kind} file)
    list(JOIN programs " " text)
    file(WRITE "${PROJECT_BINARY_DIR}/${file}_test_programs.txt" "${text}\n")
  endforeach()
endfunction()
