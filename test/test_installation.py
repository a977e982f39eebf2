"""What the set-up installs, rosdep installs, and the code imports are the same packages."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
from packaging.requirements import Requirement

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
#: Their versions in Ubuntu 24.04.
UBUNTU = {
    "numpy": "1.26.4",
    "scipy": "1.11.4",
    "pyproj": "3.6.1",
    "matplotlib": "3.6.3",
    "pyyaml": "6.0.1",
    "jinja2": "3.1.2",
}


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


def test_nothing_of_scipy_that_ubuntu_lacks_is_used():
    # SciPy 1.11 has classes of sparse arrays, and none of these functions; cg had "tol"
    young = re.compile(r"sparse\.(?:diags|eye|block|random)_array\b|\bcg\([^)]*\brtol=")
    files = [path for folder in ("ladar_volume", "test") for path in (ROOT / folder).rglob("*.py")]
    others = [path for path in files if path != Path(__file__)]
    assert not [path.name for path in others if young.search(path.read_text())]


def declared():
    """What setup.py declares, by package: its requirement; extras but the tests' among it."""
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


def test_no_package_asks_for_another_version_than_ubuntus():
    """Else pip would lay a second NumPy over the one for which ROS was compiled."""
    where = {"python_version": "3.12", "python_full_version": "3.12.3", "extra": ""}
    others, seen = [], 0
    for name in pins("requirements-apt.txt"):
        try:
            needs = metadata.requires(name) or []
        except metadata.PackageNotFoundError:  # of another machine
            continue
        for wish in map(Requirement, needs):
            version = UBUNTU.get(wish.name.lower().replace("_", "-"))
            if version and (not wish.marker or wish.marker.evaluate(where)):
                seen += 1
                others += [f"{name}: {wish}"] if version not in wish.specifier else []
    assert not others and seen > 10


def test_every_pinned_package_has_a_wheel_for_arm64():
    done = subprocess.run(
        ["bash", str(ROOT / "tools" / "check_arm64.sh"), "--pins"],
        cwd=ROOT,
        env=os.environ | {"PYTHON": sys.executable},
        capture_output=True,
        text=True,
        timeout=600,
    )
    said = done.stderr.lower()
    if done.returncode and ("connection" in said or "timed out" in said or "resolution" in said):
        pytest.skip("no package index can be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    assert "packages have a wheel for arm64" in done.stdout
