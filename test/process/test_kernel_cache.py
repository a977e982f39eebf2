"""A damaged or unwritable cache of compiled kernels costs a compilation and one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
from adding import one_more
print(one_more(1.5))
print(sum(one_more.stats.cache_hits.values()))
"""
MODULE = """
from ladar_volume.math.kernels import kernel
@kernel
def one_more(x):
    return x + 1.0
"""


def run(folder, **settings):
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | settings
    environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, sys.path)])
    command = [sys.executable, "-c", SCRIPT, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    value, hits = done.stdout.split()
    assert value == "2.5"
    return int(hits), done.stderr.splitlines()


def test_a_damaged_cache_is_built_again(tmp_path):
    (tmp_path / "adding.py").write_text(MODULE)
    cache = str(tmp_path / "cache")
    assert run(tmp_path, NUMBA_CACHE_DIR=cache) == (0, [])
    for ending, damage in (
        (".nbc", lambda data: data[: len(data) // 2]),
        (".nbi", lambda data: data[: len(data) // 2]),
        (".nbi", lambda data: b""),
        (".nbc", lambda data: bytes(len(data))),
        (".nbi", lambda data: b"garbage"),
    ):
        (file,) = (tmp_path / "cache").rglob(f"*{ending}")
        file.write_bytes(damage(file.read_bytes()))
        hits, lines = run(tmp_path, NUMBA_CACHE_DIR=cache)
        assert hits == 0 and len(lines) == 1 and "damaged cache" in lines[0], (ending, lines)
    assert run(tmp_path, NUMBA_CACHE_DIR=cache) == (1, [])


def test_without_a_folder_that_can_be_written_kernels_are_compiled_anew(tmp_path):
    (tmp_path / "adding.py").write_text(MODULE)
    (tmp_path / "__pycache__").write_text("a file where the folder would be")
    home = tmp_path / "file"
    home.write_text("no folder")
    hits, lines = run(tmp_path, HOME=str(home), XDG_CACHE_HOME=str(home), NUMBA_CACHE_DIR="")
    assert hits == 0 and len(lines) == 1 and "no folder" in lines[0]


APART = """
import sys
sys.path.insert(0, sys.argv[1])
from ladar_volume.process.compile_apart import compiled_apart
from ladar_volume.process.compile_progress import COMPILE_PROGRESS
from adding import one_more
with compiled_apart([sys.executable, "-c", sys.argv[2], sys.argv[1]]):
    one_more(1.5)
print(sum(one_more.stats.cache_hits.values()), COMPILE_PROGRESS.count)
"""
HELPER = """
import sys
sys.path.insert(0, sys.argv[1])
from ladar_volume.process.compile_progress import COMPILE_PROGRESS
COMPILE_PROGRESS.ticks = True
from adding import one_more
one_more(1.5)
"""


@pytest.mark.parametrize(
    ("helper", "said"),
    [
        (HELPER, "1 1"),
        ("raise SystemExit(3)", "0 1"),
        (HELPER.replace("one_more(1", "abs(1"), "0 1"),
    ],
    ids=["compiles", "fails", "leaves it"],
)
def test_another_process_compiles_and_this_one_loads(tmp_path, helper, said):
    (tmp_path / "adding.py").write_text(MODULE)
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)]),
    }
    done = subprocess.run(
        [sys.executable, "-c", APART, str(tmp_path), helper],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == said  # from the cache or compiled here; once, and counted
