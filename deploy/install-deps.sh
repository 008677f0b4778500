#!/usr/bin/env bash
# Installs the Debian 12 packages that mapsieve needs.
#   install-deps.sh            to build, test and run it
#   install-deps.sh --build    to build and run it
#   install-deps.sh --runtime  to run its programs only
set -euo pipefail

build=(
  build-essential ca-certificates cmake ninja-build pkg-config ccache python3
  libgrpc++-dev protobuf-compiler protobuf-compiler-grpc libprotobuf-dev
  libabsl-dev libeigen3-dev libnanoflann-dev liblz4-dev libzstd-dev libxxhash-dev liblzf-dev
  libsqlite3-dev libcli11-dev nlohmann-json3-dev libspdlog-dev libpng-dev
  libfreetype-dev libyaml-cpp-dev liboctomap-dev libproj-dev libgeotiff-dev
  fonts-dejavu-core gnuplot-nox
  libgtest-dev libgmock-dev
  clang-14 libclang-rt-14-dev
)
tests=(libprotoc-dev octomap-tools)
# Node.js may come from elsewhere, with an npm of its own.
command -v npm >/dev/null || tests+=(nodejs npm)
runtime=(
  libgrpc++1.51 libprotobuf32 libabsl20220623 liblz4-1 libzstd1 libxxhash0
  liblzf1 libsqlite3-0 libspdlog1.10 libfmt9 libpng16-16 libfreetype6
  libyaml-cpp0.7 liboctomap1.9 libproj25 libgeotiff5
  fonts-dejavu-core gnuplot-nox
)

case "${1:-}" in
  "") packages=("${build[@]}" "${tests[@]}") ;;
  --build) packages=("${build[@]}") ;;
  --runtime) packages=("${runtime[@]}") ;;
  *) echo "usage: $0 [--build | --runtime]" >&2; exit 2 ;;
esac

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query -W -f '${Status}' "$package" 2>/dev/null || true)
  [ "$status" = "install ok installed" ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

sudo=()
[ "$(id -u)" -eq 0 ] || sudo=(sudo)
export DEBIAN_FRONTEND=noninteractive
"${sudo[@]}" apt-get update -qq
"${sudo[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
