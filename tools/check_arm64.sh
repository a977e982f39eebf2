#!/usr/bin/env bash
# Does every pinned package of Python have a wheel for arm64? Downloads them; needs the network.
set -euo pipefail
cd "$(dirname "$0")/.."
python="${PYTHON:-.venv/bin/python}"
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
platforms=()
for glibc in 2014 _2_17 _2_27 _2_28 _2_31 _2_34 _2_35; do
    platforms+=(--platform "manylinux${glibc}_aarch64")
done
missing=0
for version in 3.12 3.13; do
    while read -r package; do
        if "$python" -m pip download -q --disable-pip-version-check --no-deps --only-binary=:all: \
            --dest "$folder" --implementation cp --python-version "$version" "${platforms[@]}" \
            "$package" >/dev/null 2>&1; then
            echo "Python $version: $package"
        else
            echo "Python $version: $package has no wheel for arm64" >&2
            missing=1
        fi
    done < <(grep -vE '^(#|$|ros-jazzy-|open3d-cpu)' requirements.txt | cut -d';' -f1)
done
exit "$missing"
