"""System libraries that the installed wheels load are those that the set-up asks for."""

import re
import shutil
import struct
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: glibc's own, without which no Python runs.
GLIBC = r"(ld-linux.*|libc|libdl|libm|libpthread|librt|libutil|libresolv)\.so\.\d+"
#: Plug-ins of Open3D for frameworks that nothing here loads.
NOT_LOADED = ("open3d_tf_ops.so", "open3d_torch_ops.so")
DYNAMIC, NEEDED = 6, 1  # section type and tag of ELF


@cache
def listed():
    """Soname → package, as the set-up reads it."""
    lines = (ROOT / "tools" / "system_libraries.txt").read_text().splitlines()
    return {line.split()[0]: line.split()[1] for line in lines if line and line[0] != "#"}


@cache
def installed():
    """Shared libraries of this environment."""
    if sys.prefix == sys.base_prefix:
        pytest.skip("the tests do not run in a virtual environment: its libraries are the system's")
    found = [p for p in Path(sys.prefix).rglob("*.so*") if re.search(r"\.so(\.|$)", p.name)]
    return [p for p in found if p.is_file() and p.name not in NOT_LOADED]


def needed(path):
    """Sonames that a 64-bit ELF file names as needed (its DT_NEEDED entries)."""
    data = path.read_bytes()
    if data[:6] != b"\x7fELF\x02\x01":
        return
    (table,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + i * size) for i in range(count)]
    for section in sections:
        if section[1] != DYNAMIC:
            continue
        first, length, strings = section[4], section[5], sections[section[6]][4]
        for tag, value in struct.iter_unpack("<qQ", data[first : first + length]):
            if tag == NEEDED:
                yield data[strings + value : data.index(b"\0", strings + value)].decode()


@cache
def from_outside(path):
    """Sonames that a file needs from outside this environment, glibc's left out."""
    own = {p.name for p in installed()}
    names = {re.sub(r"(\.so\.\d+).*", r"\1", name) for name in needed(path) if name not in own}
    return {name for name in names if not re.fullmatch(GLIBC, name)}


def test_the_wheels_need_no_library_that_the_set_up_does_not_ask_for():
    wanted = {soname: path.name for path in installed() for soname in from_outside(path)}
    assert {"libEGL.so.1", "libgomp.so.1"} <= set(wanted)  # the walk saw Open3D and numba
    assert {s: by for s, by in wanted.items() if s not in listed()} == {}


def test_every_listed_library_is_loaded_by_a_wheel():
    assert set(listed()) <= set().union(*map(from_outside, installed()))


@pytest.mark.skipif(shutil.which("ldd") is None, reason="ldd is not installed")
def test_the_loader_finds_what_is_needed_beyond_the_runtime_of_c():
    common = {"libgcc_s.so.1", "libstdc++.so.6"}
    names = [str(p) for p in installed() if from_outside(p) - common]
    done = subprocess.run(["ldd", *names], capture_output=True, text=True)
    assert "libEGL.so.1" in done.stdout
    # a library that a wheel brings along is found from the module that loads it, not by itself
    own = {p.name for p in installed()}
    assert set(re.findall(r"(\S+) => not found", done.stdout)) - own == set()
