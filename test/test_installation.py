"""What the set-up installs, rosdep installs, and the code imports are the same packages."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
#: Packages by the rosdep key that installs them (rosdep's python.yaml for Ubuntu 24.04), or "" for
#: those that have none.
KEYS = {
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "numba": "python3-numba",
    "open3d": "python3-open3d-pip",
    "open3d-cpu": "python3-open3d-pip",
    "rosbags": "python3-rosbags-pip",
    "mcap": "",
    "zstandard": "",
    "pymavlink": "python3-pymavlink-pip",
    "velodyne-decoder": "",
    "pyproj": "python3-pyproj",
    "laspy": "",
    "matplotlib": "python3-matplotlib",
    "rich": "python3-rich",
    "PyYAML": "python3-yaml",
    "jinja2": "python3-jinja2",
    "starlette": "",
    "uvicorn": "",
    "foxglove-sdk": "",
    "shtab": "",
    "rasterio": "",
    "ezdxf": "",
    "pye57": "",
    "pyogrio": "",
    "shapely": "",
    "geopandas": "",
    "xarray": "",
    "dask": "",
    "distributed": "",
    "pyarrow": "",
}
#: Packages that ROS from apt was compiled for, or that come with it: never a second time by pip.
OF_THE_SYSTEM = {"numpy", "scipy", "pyproj", "matplotlib", "PyYAML", "jinja2"}


def pins(name: str) -> dict[str, str]:
    """Versions by package, of a file of requirements, without ROS."""
    lines = (ROOT / name).read_text().splitlines()
    found = (re.match(r"([A-Za-z0-9-]+)(?:\[\w+\])?==([\w.]+)", line) for line in lines)
    return {m[1]: m[2] for m in found if m and not m[1].startswith("ros-jazzy-")}


def test_every_runtime_package_has_its_rosdep_key_in_the_manifest():
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    named = {str(tag.text) for tag in manifest.iter("exec_depend")}
    wanted = pins("requirements.txt")
    assert set(wanted) == set(KEYS)
    assert {KEYS[name] for name in wanted} - {""} <= named
    assert {key for key in named if key.startswith("python3-")} <= set(KEYS.values())


def test_with_ros_from_apt_pip_installs_what_apt_does_not():
    runtime, apt, tests = (pins(f"requirements{kind}.txt") for kind in ("", "-apt", "-dev"))
    assert set(apt) >= set(runtime) - OF_THE_SYSTEM
    assert not set(apt) & OF_THE_SYSTEM
    assert all(version == {**tests, **runtime}[name] for name, version in apt.items())


def test_no_constructor_of_sparse_arrays_that_ubuntu_lacks_is_used():
    # SciPy 1.11 has classes of sparse arrays, and none of these functions
    young = re.compile(r"sparse\.(?:diags|eye|block|random)_array\b")
    package = (ROOT / "ladar_volume").rglob("*.py")
    assert not [path.name for path in package if young.search(path.read_text())]


def declared():
    """What setup.py declares, by package: its requirement; extras but the tests' among it."""
    from packaging.requirements import Requirement

    names = {}
    for node in ast.parse((ROOT / "setup.py").read_text()).body:
        if isinstance(node, ast.Assign):
            target = node.targets[0].id
            if target in ("NEEDED", "EXTRAS"):
                names[target] = ast.literal_eval(node.value)
    extras = [line for name, lines in names["EXTRAS"].items() if name != "test" for line in lines]
    wanted = map(Requirement, [*names["NEEDED"], *extras])
    return {wish.name: wish for wish in wanted if not wish.name.startswith("ros-jazzy-")}


def test_pip_installs_what_the_set_up_pins():
    wanted, pinned = declared(), pins("requirements.txt")
    assert set(wanted) == set(pinned)
    assert not [name for name, wish in wanted.items() if pinned[name] not in wish.specifier]
