#!/usr/bin/env bash
# Set up .venv with everything the package needs, system libraries included. Safe to run again.
# ROS 2 Jazzy comes as wheels, or from apt where its setup.bash was sourced: then NumPy and SciPy are
# the system's, for which ROS was compiled.
set -euo pipefail
cd "$(dirname "$0")/.."
python="${PYTHON:-python3}"

missing_system() {
    # ldconfig lies where an ordinary user does not look
    local need=() known soname package rest
    known="$(PATH="$PATH:/usr/sbin:/sbin" ldconfig -p)"
    while read -r soname package rest; do
        case "$soname" in '' | '#'*) continue ;; esac
        grep -qF "$soname (" <<<"$known" || need+=("$package")
    done <tools/system_libraries.txt
    "$python" -c 'import ensurepip, venv' 2>/dev/null || need+=(python3-venv)
    echo "${need[@]}"
}

install_system() {
    local sudo=""
    if [ "$(id -u)" -ne 0 ]; then
        if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then sudo="sudo"; else return 1; fi
    fi
    command -v apt-get >/dev/null || return 1
    export DEBIAN_FRONTEND=noninteractive
    $sudo apt-get install -y -q "$@" || { $sudo apt-get update -q && $sudo apt-get install -y -q "$@"; }
}

read -r -a need <<<"$(missing_system)"
if [ "${#need[@]}" -gt 0 ]; then
    echo "Installing system libraries: ${need[*]}"
    if ! install_system "${need[@]}"; then
        echo "Missing system libraries. Install them and run this again:" >&2
        echo "    sudo apt-get install ${need[*]}" >&2
        exit 1
    fi
fi

if [ "${ROS_DISTRO:-}" = jazzy ] && "$python" -c 'import rclpy' 2>/dev/null; then
    wanted=requirements-apt.txt options=--system-site-packages
    # the compiled kernels and the tests load these: one word instead of a traceback later
    "$python" -c 'import matplotlib, numpy, pyproj, scipy, setuptools, yaml' || {
        echo "Install what package.xml names: rosdep install --from-paths . --ignore-src" >&2
        exit 1
    }
elif [ -e /opt/ros/jazzy/setup.bash ]; then
    echo "ROS 2 Jazzy is installed, but not in this shell: source /opt/ros/jazzy/setup.bash" >&2
    exit 1
elif [ "$(uname -m)" != x86_64 ]; then
    echo "The wheels of ROS 2 Jazzy are for x86_64. Install it from apt (docs/installation.md)," >&2
    echo "source /opt/ros/jazzy/setup.bash and run this again." >&2
    exit 1
else
    wanted=requirements-dev.txt options=
fi
"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' || {
    echo "Python 3.11, 3.12 or 3.13 is needed (PYTHON=python3.12 make run chooses one)" >&2
    exit 1
}
# machine code is recompiled when its own file changes, not when a kernel it calls does
find ladar_volume -name '*.nb[ic]' -delete
compiling=()
trap 'for process in "${compiling[@]}"; do kill "$process" 2>/dev/null || true; done' EXIT
compile_kernels() {
    # once, so that the first survey does not wait for it; stages that share kernels one after the
    # other
    echo "Compiling the kernels (a few minutes)"
    for stages in "volume epochs georeference cloud_volumes" clouds filter; do
        # shellcheck disable=SC2086
        .venv/bin/python -m ladar_volume.compile_kernels $stages &
        compiling+=($!)
    done
}

want="$(cat requirements.txt "$wanted" | sha256sum)"
[ -x .venv/bin/python ] || "$python" -m venv $options .venv
if [ "$(cat .venv/requirements.sha256 2>/dev/null || true)" != "$want" ]; then
    echo "Installing Python packages into .venv (a few minutes the first time)"
    install() { .venv/bin/python -m pip install -q --disable-pip-version-check --no-compile "$@"; }
    # the kernels need these alone, and compile while one core installs the rest
    pins="$([ "$wanted" = requirements-apt.txt ] && echo "$wanted" || echo requirements.txt)"
    # shellcheck disable=SC2046
    install $(grep -E '^(numba|numpy|scipy|pyproj|PyYAML|rich)==' "$pins")
    compile_kernels
    install -r "$wanted"
    # pip compiles on one core; some packages bring templates, which do not compile, and much that
    # is imported by nothing here
    .venv/bin/python -m compileall -qq -j 0 -x '/(tests?|plotly|sqlalchemy|v09|v10|pip|mypyc?)/|/v20/(?!ardup|comm)' .venv/lib || true
    echo "$want" >.venv/requirements.sha256
else
    compile_kernels
fi
# from the tree, so that commands, nodes and tests share one copy and its machine code; launch and config go where ament looks for them
.venv/bin/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
.venv/bin/python -W ignore setup.py -q install_data --install-dir=.venv
rm -rf build ladar_volume.egg-info
# where the environment forbids Python to write bytecode, every process would compile it anew
.venv/bin/python -m compileall -q ladar_volume
for process in "${compiling[@]}"; do wait "$process"; done
compiling=()
touch .venv/ready
