#!/usr/bin/env bash
# Installs what is missing, builds Release and runs energyprof with the given arguments:
#   scripts/run.sh --config configs/dragon.json --quick
set -euo pipefail
# shellcheck source=scripts/setup.sh
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
setup_packages run
setup_build release
exec "${root_dir:?}/build/release/app/energyprof" "$@"
