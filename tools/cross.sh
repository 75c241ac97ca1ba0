#!/usr/bin/env bash
# Usage: cross.sh PYTHON TARGET ..
# Compiles the core for other systems with the compiler of the package ziglang, whose targets are for
# example aarch64-linux-gnu.2.28, x86_64-linux-musl, x86_64-windows-gnu, aarch64-macos. PYTHON has
# ziglang, nanobind and cmeel-eigen. Nothing is linked or run. The bindings need Python's headers,
# which are those of this machine: they are left out for Windows, whose types have other sizes.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
shift
eigen=$("$python" -m cmeel cmake 2> /dev/null)/include/eigen3
nanobind=$("$python" -c 'import nanobind; print(nanobind.include_dir())')
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
for target in "$@"; do
  out=build/cross/$target
  mkdir -p "$out"
  count=0
  for file in core/*.cpp core/*/*.cpp; do
    options=()
    case $file in
      */kernels_avx2.cpp) options=(-mavx2 -mfma) ;;
      */kernels_avx512.cpp) options=(-mavx512f -mavx512dq -mavx512vl -mfma) ;;
    esac
    case $target:$file in
      aarch64*:*kernels_avx*) continue ;; # As CMakeLists.txt does.
      *windows*:core/bindings/*) continue ;;
    esac
    "$python" -m ziglang c++ -target "$target" -std=c++20 -O0 -Wall -Wextra -Werror \
      -ffp-contract=fast -fno-math-errno -DEIGEN_MPL2_ONLY "${options[@]}" -I core \
      -isystem core/third_party -isystem "$eigen" -isystem "$nanobind" -isystem "$headers" \
      -c "$file" -o "$out/$(echo "$file" | tr / _).o"
    count=$((count + 1))
  done
  echo "$target: $count files compiled"
done
