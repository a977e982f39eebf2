"""Records are handed on by reference, between stages and threads: none may change under those who
hold them but those that are named here, which one owner fills.
"""

import dataclasses
import importlib
import pkgutil

import pytest

#: Filled by one owner, below ladar_volume.
FILLED = {
    "georeference.clock_restart": {"_Topic"},
    "io.mcap_recovery": {"_Contents"},
    "io.meshfiles.landxml": {"Definition"},
    "io.pointfiles.ply_elements": {"Element", "Header", "Property"},
    "io.recorder": {"TopicAccount"},
}


def loose_records(name):
    """Names of the module's own records whose fields may be written."""
    module = importlib.import_module(name)
    own = [c for c in vars(module).values() if dataclasses.is_dataclass(c)]
    return {c.__name__ for c in own if c.__module__ == name and not c.__dataclass_params__.frozen}


@pytest.mark.parametrize(
    "room",
    ["georeference", "rmls", "uncertainty", "volume", "model", "ground", "change", "tin", "io"],
)
def test_records_do_not_change(room):
    package = importlib.import_module(f"ladar_volume.{room}")
    modules = pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    found = {m.name.removeprefix("ladar_volume."): loose_records(m.name) for m in modules}
    found = {name: loose for name, loose in found.items() if loose}
    assert found == {k: v for k, v in FILLED.items() if k.startswith(f"{room}.")}
