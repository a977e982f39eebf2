"""What a node loads: no compiler where there is nothing to compile, no other stage than its own."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("node", "banned"),
    [
        ("logger_node", ("numba", "scipy", "ladar_volume.rmls")),
        ("mavlink_node", ("numba", "scipy", "ladar_volume.rmls")),
        (
            "georeference_node",
            ("scipy", "ladar_volume.rmls", "ladar_volume.volume", "ladar_volume.uncertainty"),
        ),
        ("filter_node", ("pyproj", "ladar_volume.volume", "ladar_volume.tin")),
        (
            "volume_node",
            (
                "open3d",
                "matplotlib",
                "rich",
                "scipy.optimize",
                "rosbags",
                "mcap",
                "numpy.f2py",
                "numpy.testing",
            ),
        ),
    ],
)
def test_a_node_loads_no_more_than_its_stage(node, banned):
    code = (
        "import sys\n"
        f"for name in {banned!r}: sys.modules[name] = None\n"
        "from ladar_volume.nodes import programs\n"
        "programs.own_process()\n"
        "programs.hide_numpy_tools()\n"
        f"import ladar_volume.nodes.{node}\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def kernels(path):
    """The compiled functions of a module."""
    for node in ast.walk(ast.parse(path.read_text())):
        marks = getattr(node, "decorator_list", [])
        if any(
            isinstance(mark, ast.Name) and mark.id in ("kernel", "parallel_kernel")
            for mark in marks
        ):
            yield node


def test_no_kernel_takes_matrix_products_from_scipy():
    # numba would load all of SciPy's linear algebra for them: nodes do without
    found = [
        f"{path.name}:{node.lineno}"
        for path in (ROOT / "ladar_volume").rglob("*.py")
        for function in kernels(path)
        for node in ast.walk(function)
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult))
        or (isinstance(node, ast.Attribute) and node.attr in ("dot", "vdot", "linalg"))
    ]
    assert found == []


def test_what_numpy_does_not_load_unasked_is_there_for_who_asks():
    code = (
        "from ladar_volume.nodes import programs; programs.own_process(); "
        "programs.hide_numpy_tools(); import numpy as np; assert np.testing.assert_equal and "
        "np.f2py.get_include and 'f2py' not in np.__all__"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
