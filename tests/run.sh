#!/usr/bin/env bash
# Installs what is missing, builds, and runs every test: tests/run.sh [--quick]
#   --quick   no sanitized build, no fuzzing
# BARYCAST_DATA names the folder with third-party meshes (default ../shared/data where it exists).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

quick=0
for option in "$@"; do
  case "$option" in
    --quick) quick=1 ;;
    *) echo "usage: tests/run.sh [--quick]" >&2; exit 2 ;;
  esac
done

python=/usr/bin/python3  # another one earlier on PATH may lack the Debian packages
jobs=$(nproc)
results=$PWD/build/results
mkdir -p "$results"
rm -f "$results"/*.xml

if [ -z "${BARYCAST_DATA:-}" ] && [ -d ../shared/data ]; then
  BARYCAST_DATA=$(cd ../shared/data && pwd)
fi
[ -z "${BARYCAST_DATA:-}" ] || export BARYCAST_DATA
export BARYCAST_BIN_DIR=$PWD/build/bin BARYCAST_PYTHON_PROTO=$PWD/build/python
export PYTHONDONTWRITEBYTECODE=1
export LSAN_OPTIONS=suppressions=$PWD/tests/house/lsan.supp:print_suppressions=0
export UBSAN_OPTIONS=print_stacktrace=1

# The closing line: totals over ctest and pytest. The sanitized run repeats ctest's tests, so only its failures count;
# a stage that fails without a failing test counts as one.
totals() {
  "$python" - "$results" "$1" <<'PYTHON'
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

passed = failed = skipped = 0
for path in sorted(Path(sys.argv[1]).glob("*.xml")):
    for case in ET.parse(path).iter("testcase"):
        bad = case.find("failure") is not None or case.find("error") is not None
        unrun = case.find("skipped") is not None or case.get("status") in ("notrun", "disabled")
        failed += bad
        if path.stem != "sanitized":
            skipped += unrun and not bad
            passed += not bad and not unrun
if sys.argv[2] != "0":
    failed = max(failed, 1)
print(f"{passed} passed, {failed} failed, {skipped} skipped")
PYTHON
}

# stage NAME COMMAND...: one line with name and seconds; a failing stage shows its output and ends the run.
stage() {
  local name=$1 log start=$SECONDS status
  shift
  log=$results/$name.log
  # Not "|| status=$?": a command tested that way would run on after its first failure.
  set +e
  (set -e; "$@") >"$log" 2>&1 </dev/null
  status=$?
  set -e
  if ((status)); then
    cat "$log"
    printf '%-12s FAILED  %4d s\n' "$name" $((SECONDS - start))
    totals 1
    exit 1
  fi
  printf '%-12s ok      %4d s%s\n' "$name" $((SECONDS - start)) "$(sed -n 's/^note: /  /p' "$log")"
}

skip() { printf '%-12s skipped          %s\n' "$1" "$2"; }

build() {
  cmake -S . -B build -G Ninja -DCMAKE_BUILD_TYPE=Release
  cmake --build build -j "$jobs"
}

run_ctest() { # run_ctest BUILD_DIR RESULT [ctest options]
  local dir=$1 result=$2
  shift 2
  ctest --test-dir "$dir" -j "$jobs" --timeout 600 --no-tests=error --output-on-failure \
    --output-junit "$results/$result.xml" "$@"
}

run_pytest() {
  "$python" -m pytest -q -rs -p no:cacheprovider --junitxml="$results/pytest.xml" tests/python tests/house
}

our_sources() { find core server client_examples tests \( -name '*.h' -o -name '*.cpp' \) -print0; }

format() { our_sources | xargs -0 clang-format --dry-run -Werror; }

scripts() { shellcheck deploy/*.sh proto/*.sh tests/run.sh tests/container/*.sh .ci/run; }

# What a stage ran on: its binaries and their inputs. It is remembered when the stage passes.
fingerprint() { find "$@" -type f -print0 | sort -z | xargs -0 sha256sum | sha256sum; }

unchanged() { # unchanged STAMP PATHS...
  local stamp=$1
  shift
  [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$(fingerprint "$@")" ]
}

# Tests of numbers, at sizes that take minutes under sanitizers; others run the same code.
measurements='Rate\.|Equivariance\.|AreTrilinearInABox|WalksConvergeTo|ReentryAgrees|ClosedFormOnTriangleCages|BoundaryElements\.Converge|JumpsBelow|TargetError\.Covers'

sanitized() {
  local inputs=(build/asan/bin tests/house/lsan.supp)
  cmake -S . -B build/asan -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1" \
    -DBARYCAST_SANITIZE=ON
  cmake --build build/asan -j "$jobs" --target barycast_tests
  if unchanged build/asan/passed "${inputs[@]}"; then
    echo "note: tests not run again: unchanged since they last passed"
    return
  fi
  rm -f build/asan/passed
  run_ctest build/asan sanitized -LE house -E "$measurements"
  fingerprint "${inputs[@]}" >build/asan/passed
}

# Every program NAME_fuzz, from the seeds that NAME_fuzz_seeds writes.
fuzz() {
  local seconds=20 targets target corpus inputs=(build/fuzz/bin)
  cmake -S . -B build/fuzz -G Ninja -DCMAKE_CXX_COMPILER=clang++ -DCMAKE_BUILD_TYPE=RelWithDebInfo -DBARYCAST_FUZZ=ON
  cmake --build build/fuzz -j "$jobs"
  targets=(build/fuzz/bin/*_fuzz)
  if unchanged build/fuzz/passed "${inputs[@]}"; then
    echo "note: not run again: unchanged since it last passed"
    return
  fi
  rm -f build/fuzz/passed
  for target in "${targets[@]}"; do
    corpus=build/fuzz/corpus/$(basename "$target")
    mkdir -p "$corpus"
    "${target}_seeds" "$corpus"
    "$target" -max_total_time=$((seconds / ${#targets[@]})) -max_len=4096 -timeout=5 -rss_limit_mb=1024 \
      -print_final_stats=1 -artifact_prefix=build/fuzz/ "$corpus"
  done
  fingerprint "${inputs[@]}" >build/fuzz/passed
}

stage setup bash deploy/setup.sh
buf=build/tools/node_modules/.bin/buf
if [ -x "$buf" ]; then
  stage buf-lint "$buf" lint proto
  # Clients are built against the committed descriptor; proto/renew_descriptor.sh renews it.
  stage buf-breaking "$buf" breaking proto --against proto/barycast.binpb
else
  skip buf-lint "buf is not installed"
  skip buf-breaking "buf is not installed"
fi
stage format format
if command -v shellcheck >/dev/null; then stage scripts scripts; else skip scripts "shellcheck is not installed"; fi
if command -v yamllint >/dev/null; then stage yaml yamllint --strict deploy; else skip yaml "yamllint is not installed"; fi
if [ -e build/tools/kubernetes/installed ]; then
  stage manifests tests/container/check_manifests.sh
else
  skip manifests "deploy/setup.sh --container was not run"
fi
stage build build
stage ctest run_ctest build ctest
stage pytest run_pytest
if ((quick)); then
  skip sanitized "--quick"
  skip fuzz "--quick"
else
  stage sanitized sanitized
  stage fuzz fuzz
fi
totals 0
