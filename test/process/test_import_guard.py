"""A module that is left out counts as not installed, for as long as wanted and where it is not
loaded already.
"""

import importlib
import subprocess
import sys

import pytest

from ladar_volume.process.import_guard import hide_module

#: Part of the standard library, and of nothing else.
ONE = "this"


@pytest.fixture
def unloaded(monkeypatch):
    monkeypatch.delitem(sys.modules, ONE, raising=False)


def test_within_it_is_not_there_and_then_it_is(unloaded, capsys):
    with hide_module(ONE), pytest.raises(ImportError):
        importlib.import_module(ONE)
    assert ONE not in sys.modules and importlib.import_module(ONE).__name__ == ONE


def test_what_goes_wrong_within_leaves_nothing_behind(unloaded):
    with pytest.raises(KeyError), hide_module(ONE):
        raise KeyError
    assert ONE not in sys.modules


def test_what_is_loaded_stays():
    with hide_module("json"):
        assert importlib.import_module("json") is sys.modules["json"]
    assert sys.modules["json"].loads("1") == 1


def test_kernels_load_no_tool_for_coverage():
    code = (
        "import sys\n"
        "from ladar_volume.process.switch import own_process\n"
        "own_process()\n"
        "import ladar_volume.math.kernels\n"
        "sys.exit('coverage' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
