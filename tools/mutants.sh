#!/bin/sh
# Mutants of the core and the share that the tests see, on a copy of the tree, for it is changed in
# place. Hours for all of it. Another selection: tools/mutants.sh CONFIG.toml
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
config=$(realpath "${1:-$here/tools/mutants.toml}")
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
(cd "$here" && tar -cf - --exclude=.git --exclude=.venv --exclude=out .) | tar -xf - -C "$copy"
PATH="$here/.venv/bin:$PATH"
export PATH PYTHONPATH="$copy${PYTHONPATH:+:$PYTHONPATH}"
cd "$copy"
cosmic-ray init "$config" mutants.sqlite --force
cosmic-ray exec "$config" mutants.sqlite
cr-report mutants.sqlite --surviving-only --show-diff
printf 'surviving, percent: '
cr-rate mutants.sqlite
