#!/usr/bin/env bash
# Does the package run with the NumPy, SciPy, pyproj, matplotlib and PyYAML of Ubuntu 24.04, for which
# ROS from apt is compiled? A virtual environment with exactly these (x86_64; ROS as wheels), a
# bundled recording replayed to the bits of .venv (the volume and its mesh; sigma, which comes out of
# other versions of BLAS, to 1e-12), and tests; nothing of .venv is changed.
# usage: tools/check_noble.sh [TESTS ...] (default: ROOMS below). PYTHON=python3.12 is Ubuntu's own.
# NOBLE=FOLDER keeps environment and machine code there, for the next time.
set -euo pipefail
cd "$(dirname "$0")/.."
ROOMS=(test/model test/georeference test/rmls test/ground test/volume test/io test/nodes/test_graph.py)
folder="${NOBLE:-$(mktemp -d)}"
[ -n "${NOBLE:-}" ] || trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder"
if [ ! -e "$folder/ready" ]; then
    "${PYTHON:-python3}" -m venv "$folder/venv"
    printf 'numpy==1.26.4\nscipy==1.11.4\npyproj==3.6.1\nPyYAML==6.0.1\nmatplotlib==3.6.3\njinja2==3.1.2\n' \
        >"$folder/ubuntu.txt"
    grep '^ros-jazzy-' requirements.txt >"$folder/ros.txt"
    "$folder/venv/bin/python" -m pip install -q --disable-pip-version-check \
        -r "$folder/ubuntu.txt" -r "$folder/ros.txt" -r requirements-apt.txt setuptools==79.0.1 \
        trimesh jsonschema websockets
    touch "$folder/ready"
fi
python="$folder/venv/bin/python"
# the package of this tree, with machine code of its own
export PYTHONPATH="$PWD" NUMBA_CACHE_DIR="$folder/kernels"
"$python" -c 'import matplotlib, numpy, pyproj, scipy, yaml, sys; print(
    f"Python {sys.version.split()[0]}", *(f"{m.__name__} {m.__version__}" for m in
    (numpy, scipy, pyproj, matplotlib, yaml)), sep=", ")'
volume() { # interpreter, folder: volume to the last digit, sigma, and the digest of the mesh
    "$1" -m ladar_volume.cli.main replay bags/stockpile --json --no-figure -o "$2" |
        "$1" -c 'import json, sys; d = json.load(sys.stdin); print(
            d["volume_m3"], format(d["sigma_m3"], ".12g"))'
    sha256sum <"$2/mesh.ply"
}
volume "$python" "$folder/out" >"$folder/ubuntu.volume"
NUMBA_CACHE_DIR='' volume .venv/bin/python "$folder/pinned" >"$folder/pinned.volume"
echo "Ubuntu 24.04: $(head -1 "$folder/ubuntu.volume"); pinned: $(head -1 "$folder/pinned.volume")"
cmp "$folder/ubuntu.volume" "$folder/pinned.volume"
echo "the same volume and mesh to the bit, the same sigma to twelve digits"
"$python" -m pytest -q -n "${JOBS:-2}" "${@:-${ROOMS[@]}}"
