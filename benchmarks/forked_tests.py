"""Tests in a copy of the tree, each run in a process forked from one that has loaded what all of
them need: for a few tests that takes a tenth of the time of a process of its own.

The process that asks must not have imported ``ladar_volume``: its children take it from the copy.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
import time
from pathlib import Path

#: What tests import that does not belong to the tree.
LIBRARIES = (
    *("numpy", "scipy.linalg", "scipy.optimize", "scipy.sparse.linalg", "scipy.spatial"),
    *("scipy.special", "scipy.stats", "numba", "pytest", "hypothesis", "yaml"),
)
#: Packages of the tree.
OWN = ("ladar_volume", "benchmarks", "test")
#: Looks at a child, s apart.
LOOK_S = 0.02


def run_tests(tests: list[str], tree: Path, seconds: float, output: Path) -> int | None:
    """What pytest says of tests, by file or function, in the copy ``tree``: 0 where all pass; None
    where they take longer than so many seconds. Their words go to ``output``.
    """
    for name in LIBRARIES:
        importlib.import_module(name)
    sys.stdout.flush()
    child = os.fork()
    if not child:
        _run(tests, tree, output)
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(LOOK_S)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


def _run(tests: list[str], tree: Path, output: Path) -> None:
    """Run them in this process, and end it."""
    import pytest

    os.setsid()
    out, nothing = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), os.open(os.devnull, 0)
    for descriptor, stands_for in ((nothing, 0), (out, 1), (out, 2)):
        os.dup2(descriptor, stands_for)
    for name in [m for m in sys.modules if m.split(".")[0] in OWN]:
        del sys.modules[name]
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    paths = os.pathsep.join([str(tree), *filter(None, [os.environ.get("PYTHONPATH")])])
    os.environ |= {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    code = 9
    try:
        code = int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests]))
    finally:
        os._exit(code)
