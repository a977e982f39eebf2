"""An import changes nothing outside the package; a program of the package sets its process up."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ladar_volume.process.switch import THREADS, children_of_one_thread

ROOT = Path(__file__).parents[2]

#: What the package could change in the process of who imports it.
STATE = """if True:
    import os, signal, sys, warnings
    import numpy as np

    def state():
        handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
        return (
            dict(os.environ),
            sorted(np.__all__),
            handlers,
            sys.getswitchinterval(),
            np.geterr(),
        )
"""
EVERYTHING = (
    STATE
    + """
    import importlib, pkgutil, ladar_volume
    before, count = state(), 0
    for found in pkgutil.walk_packages(ladar_volume.__path__, "ladar_volume."):
        importlib.import_module(found.name)
        count += 1
    assert count > 150, count
    assert state() == before
"""
)


def fresh(code, **environment):
    """What a new interpreter, in whose environment no thread is limited, prints."""
    clean = {k: v for k, v in os.environ.items() if k not in THREADS}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=clean | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_every_module_changes_nothing_outside():
    fresh(EVERYTHING, MAVLINK_DIALECT="all")  # pymavlink's log reader sets this one


PROGRAMS = {
    "command line": "from ladar_volume.cli import main\n"
    "assert 'numpy' not in sys.modules\n"
    "try: main.main(['--version'])\n"
    "except SystemExit: pass\n",
    "node": "from ladar_volume.nodes import programs\n"
    "assert 'numpy' not in sys.modules\n"
    "import types; here = types.ModuleType('here'); here.main = lambda words: 0\n"
    "sys.modules['ladar_volume.nodes.filter_node'] = here\n"
    "assert programs.filter_node() == 0\n",
}
PRINT = "import json, os; print(json.dumps(dict(os.environ)))\n"


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS)
def test_a_program_sets_its_threads_before_numpy_is_there(program):
    said = fresh("import sys\n" + program + PRINT).splitlines()[-1]
    assert json.loads(said).items() >= THREADS.items()


def test_what_the_user_has_set_stays():
    said = fresh("import sys\n" + PROGRAMS["node"] + PRINT, OPENBLAS_NUM_THREADS="2")
    assert json.loads(said)["OPENBLAS_NUM_THREADS"] == "2"


def test_children_of_one_thread_leave_the_environment_as_it_was(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = dict(os.environ)
    with pytest.raises(KeyError), children_of_one_thread():
        assert os.environ["NUMBA_NUM_THREADS"] == os.environ["OMP_NUM_THREADS"] == "1"
        raise KeyError
    assert dict(os.environ) == before


def test_an_unknown_node_is_refused():
    done = subprocess.run(
        [sys.executable, "-m", "ladar_volume.nodes.programs", "filer_node"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2 and "filter_node" in done.stderr
