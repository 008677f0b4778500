#!/usr/bin/env bash
# Builds and tests everything on a bare Debian 12: a release build with all
# tests; AddressSanitizer and UBSan on the unit and fault tests, and 20 s of each
# fuzzer; ThreadSanitizer on all that is concurrent below the RPC layer. The last
# line of the output is "N passed, N failed".
#   test.sh          what a change must pass
#   test.sh --long   the slow tests too
set -euo pipefail
cd "$(dirname "$0")/.."

long=false
case "${1:-}" in
  "") ;;
  --long) long=true ;;
  *) echo "usage: $0 [--long]" >&2; exit 2 ;;
esac

./deploy/install-deps.sh

# Whole builds share what they can; the sloppiness is what ccache asks for with
# precompiled headers.
launcher=()
export CCACHE_SLOPPINESS=pch_defines,time_macros
command -v ccache >/dev/null && launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
jobs=$(nproc)
results=build/test-results
rm -rf "$results"
mkdir -p "$results"

# Syncs to a disk take most of the time of many tests: their files lie in memory
# where there is enough of it.
memory_mib=$(df --output=avail -B1M /dev/shm 2>/dev/null | tail -n 1) || true
if [ "${memory_mib:-0}" -ge 8192 ]; then
  TMPDIR=$(mktemp -d /dev/shm/mapsieve-test.XXXXXX)
  export TMPDIR
  trap 'rm -rf "$TMPDIR"' EXIT
fi

step() { printf '\n== %s (%s)\n' "$1" "$(date +%T)"; }
configure() { cmake --preset "$1" "${launcher[@]}" >"$results/$1.configure.log" || { cat "$results/$1.configure.log"; return 1; }; }

step "release build"
configure ci
grep -o 'No real data at .*' "$results/ci.configure.log" || true
cmake --build --preset ci -j "$jobs"

step "release tests"
filter=(-LE slow)
$long && filter=()
# The longest test waits most of its time.
ctest --test-dir build/release -j "$((jobs + 1))" --output-on-failure --no-tests=error \
  "${filter[@]}" --output-junit "$PWD/$results/release.xml" | tail -n 40 || true

# The sanitizers run whole test programs, each in as many parts as there are
# processors: one process a part is many times faster than one a test.
run_programs() {  # BUILD PROGRAM…
  local build=$1 program part; shift
  for program; do
    for ((part = 0; part < jobs; ++part)); do echo "$program $part"; done
  done | xargs -P "$jobs" -L 1 sh -c '
    export GTEST_TOTAL_SHARDS="$3" GTEST_SHARD_INDEX="$5"
    name="$1-$4-$5"
    if "build/$1/bin/$4" --gtest_brief=1 --gtest_output="xml:$2/$name.xml" >"$2/$name.log" 2>&1
    then echo "$1 $4, part $5: passed"
    else echo "$1 $4, part $5: FAILED"; tail -n 80 "$2/$name.log"; [ -e "$2/$name.xml" ] || touch "$2/$name.died"; fi
  ' sh "$build" "$results" "$jobs"
}

step "ASan and UBSan build"
configure asan
asan=$(cat build/asan/unit_test_programs.txt)
cmake --build --preset asan -j "$jobs" --target $asan fuzzers
step "ASan and UBSan tests"
run_programs asan $asan
step "fuzzers"
ctest --test-dir build/asan -L fuzz -j "$jobs" --output-on-failure --no-tests=error \
  --output-junit "$PWD/$results/fuzz.xml" | tail -n 60 || true

step "TSan build"
configure tsan
tsan=$(cat build/tsan/threaded_test_programs.txt)
cmake --build --preset tsan -j "$jobs" --target $tsan
step "TSan tests"
run_programs tsan $tsan

./tests/count_results.py "$results"
