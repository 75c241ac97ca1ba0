#!/usr/bin/env bash
# Usage: arm64.sh [TEST ..]
# Builds an arm64 wheel for Python 3.11 with Debian's cross compiler, and runs its tests under qemu-user
# with Debian's arm64 Python. Needs Debian 12 with python3.11, g++-aarch64-linux-gnu and qemu-user; the
# packages of the other architecture are only unpacked, in build/arm64.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$PWD/build/arm64
# Left out is what only takes long, as in `make sanitize`.
[ $# -gt 0 ] || set -- tests/test_core.py tests/test_cholesky.py tests/test_lie.py \
  -k "not (same_bits and 3) and not long_calls"
mkdir -p "$work"/{apt/lists/partial,cache/archives/partial,root,site,wheel}

python3.11 -m venv "$work/tools"
CXX=aarch64-linux-gnu-g++ _PYTHON_HOST_PLATFORM=linux-aarch64 \
  SETUPTOOLS_EXT_SUFFIX=.cpython-311-aarch64-linux-gnu.so \
  CMAKE_ARGS="-DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 \
    -DCMAKE_STRIP=$(command -v aarch64-linux-gnu-strip)" \
  "$work/tools/bin/pip" wheel -q --no-deps -w "$work/wheel" .

touch "$work/apt/status"
apt=(apt-get -q -o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State="$work/apt"
  -o Dir::State::status="$work/apt/status" -o Dir::Cache="$work/cache")
"${apt[@]}" update
"${apt[@]}" install -y --no-install-recommends --download-only python3.11 libstdc++6
for package in "$work"/cache/archives/*.deb; do
  dpkg-deb -x "$package" "$work/system"
done

"$work/tools/bin/pip" install -q --upgrade --target "$work/site" --python-version 3.11 \
  --platform manylinux_2_28_aarch64 --platform manylinux2014_aarch64 --only-binary :all: \
  numpy click rich matplotlib pooch "pytest>=8" "pytest-xdist>=3.6" "hypothesis>=6.100"
"$work/tools/bin/python" -m zipfile -e "$work"/wheel/*aarch64.whl "$work/site"

PYTHONPATH=$work/site OPENBLAS_NUM_THREADS=1 qemu-aarch64 -L "$work/system" \
  "$work/system/usr/bin/python3.11" -m pytest -q -p no:cacheprovider "$@"
