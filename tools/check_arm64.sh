#!/usr/bin/env bash
# Does every pinned package have a wheel for arm64, and do they all go with the NumPy, SciPy, pyproj
# and PyYAML of Ubuntu 24.04, for which ROS from apt was compiled? Asks the index; installs nothing.
set -euo pipefail
cd "$(dirname "$0")/.."
python="${PYTHON:-.venv/bin/python}"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
platforms=()
for glibc in 2014 _2_17 _2_27 _2_28 _2_31 _2_34 _2_35 _2_39; do
    platforms+=(--platform "manylinux${glibc}_aarch64")
done
resolve() { # version of Python, files and options of pip: what would be installed
    "$python" -m pip install -q --dry-run --disable-pip-version-check --only-binary=:all: \
        --ignore-installed --target "$folder/none" --implementation cp --python-version "$1" \
        "${platforms[@]}" "${@:2}"
}
# pip looks at this computer for markers: those of another machine are decided here
for kind in "" -apt; do
    grep -vE '^(#|$|ros-jazzy-)|== "x86_64"' "requirements$kind.txt" | cut -d';' -f1 >"$folder/pins$kind"
done
printf 'numpy==1.26.4\nscipy==1.11.4\npyproj==3.6.1\nPyYAML==6.0.1\n' >"$folder/ubuntu"
for version in 3.12 3.13; do
    resolve "$version" --no-deps -r "$folder/pins"
    echo "Python $version: $(wc -l <"$folder/pins") packages have a wheel for arm64"
    [ "${1:-}" != --pins ] || exit 0 # what the tests ask for: Ubuntu's Python
done
resolve 3.12 -r "$folder/pins-apt" -c "$folder/ubuntu"
echo "Python 3.12: they go with NumPy 1.26.4, SciPy 1.11.4, pyproj 3.6.1 and PyYAML 6.0.1"
