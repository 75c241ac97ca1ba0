#!/usr/bin/env bash
# Usage: compilers.sh BIN
# Builds the core with each supported compiler on the PATH (GCC 11 or newer, Clang 14 or newer, by
# names such as g++-12) and runs its tests. BIN holds the python and pip of the environment.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=$1
found=0
for compiler in g++-{11..19} clang++-{14..29}; do
  command -v "$compiler" > /dev/null || continue
  found=1
  echo "$compiler"
  target=build/compilers/$compiler
  CXX=$compiler "$bin/pip" install -q --no-deps --upgrade --target "$target" . \
    -C cmake.define.CMAKE_COMPILE_WARNING_AS_ERROR=ON
  PYTHONPATH=$target "$bin/python" -m pytest -q tests/test_core.py tests/test_cholesky.py
done
if [ $found = 0 ]; then
  echo "No compiler with a version in its name: install for example g++-11 and clang-14." >&2
  exit 1
fi
