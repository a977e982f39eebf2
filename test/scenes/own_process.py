"""Scripts that need a Python process of their own, in a ROS graph of their own."""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

from ladar_volume.process.private_graph import private_graph

ROOT = Path(__file__).parents[2]


@contextlib.contextmanager
def own_graph():
    """The environment of processes with a ROS graph of their own: tests that run at once, in this
    clone or in another one, do not hear each other.
    """
    with private_graph() as graph:
        yield os.environ | graph | {"PYTHONPATH": python_path(ROOT, ROOT / "test" / "scenes")}


def python_path(*folders):
    """PYTHONPATH with these first; ROS from apt is found by what is in it already."""
    return os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])


def printed_by(*command, timeout_s=120):
    """What ``python COMMAND`` prints in the project's folder; a failure shows what it said."""
    with own_graph() as environment:
        done = subprocess.run(
            [sys.executable, *map(str, command)],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def result_of(script, *arguments, **how):
    """The JSON that a script prints as its last line."""
    return json.loads(printed_by("-c", script, *arguments, **how).splitlines()[-1])
