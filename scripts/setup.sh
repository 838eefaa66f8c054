#!/usr/bin/env bash
# Installs what building and running needs and is not there yet. Sourced by run.sh and test.sh.
#
#   setup_packages run|test    Debian packages; asks for root (or sudo) only when one is missing
#   setup_build PRESET         configures once, then builds what has changed

root_dir=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
readonly root_dir

run_packages=(
  g++ cmake ninja-build git glslang-tools curl ca-certificates
  libvulkan-dev mesa-vulkan-drivers
  libglm-dev libfmt-dev nlohmann-json3-dev libsqlite3-dev libcli11-dev libvalijson-dev
  libboost-dev libtbb-dev libdeflate-dev libpng-dev libssl-dev libpfm4-dev
)
test_packages=(
  "${run_packages[@]}"
  libgtest-dev libgmock-dev librapidcheck-dev libembree-dev
  vulkan-validationlayers spirv-tools sqlite3 chromium
)

# The packages that are not installed, one a line.
missing_packages() {
  local package
  for package in "$@"; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || echo "$package"
  done
}

as_root() {
  if [ "$(id -u)" -eq 0 ]; then
    "$@"
  elif command -v sudo >/dev/null; then
    sudo "$@"
  else
    echo "energyprof: cannot install packages: not root, and there is no sudo. As root: $*" >&2
    return 1
  fi
}

setup_packages() {
  command -v dpkg-query >/dev/null || return 0  # not Debian: CMake will name what is missing
  local -a wanted missing
  if [ "$1" = test ]; then wanted=("${test_packages[@]}"); else wanted=("${run_packages[@]}"); fi
  # npm gets the chart library and the dragon; any npm will do, also one not from Debian.
  command -v npm >/dev/null || wanted+=(npm)
  mapfile -t missing < <(missing_packages "${wanted[@]}")
  [ "${#missing[@]}" -eq 0 ] && return 0
  echo "Installing: ${missing[*]}" >&2
  as_root env DEBIAN_FRONTEND=noninteractive apt-get update -qq >&2 &&
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
      "${missing[@]}" >&2
}

setup_build() {
  local build_dir=$root_dir/build/$1
  if [ ! -e "$build_dir/build.ninja" ]; then
    (cd "$root_dir" && cmake --preset "$1") >&2 || return 1
  fi
  (cd "$root_dir" && cmake --build --preset "$1") >&2
}
