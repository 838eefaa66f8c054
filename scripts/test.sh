#!/usr/bin/env bash
# Installs what is missing, builds and runs every test:
#   scripts/test.sh [--preset test|ci|dev|tsan] [arguments for ctest]
# test: Release.  ci: Release, warnings are errors.  dev: Debug with ASan and UBSan.
# tsan: the tests of the sampler's threads alone, with ThreadSanitizer.
set -euo pipefail
# shellcheck source=scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
preset="test"
if [ "${1:-}" = --preset ]; then
  preset=${2:?--preset needs a name: test, ci, dev or tsan}
  shift 2
fi
setup_packages test
setup_build "$preset"
# Tests on the dragon need it; without a network they are skipped and say so.
program=${root_dir:?}/build/$preset/app/energyprof
[ ! -x "$program" ] || "$program" models fetch dragon >&2 || true
if [ "$preset" = tsan ]; then set -- -R '^sampler\.' "$@"; fi
exec ctest --test-dir "$root_dir/build/$preset" --output-on-failure --parallel "$(nproc)" "$@"
