"""The house rules: who may import whom, who may touch files, clocks and ROS, and how large a module
grows.
"""

import ast
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "ladar_volume"
TESTS = Path(__file__).parent
BENCHMARKS = PACKAGE.parent / "benchmarks"
#: Rooms in the order of the data flow: each imports only from those before it (and itself).
CORE = [
    "math",
    "model",
    "georeference",
    "rmls",
    "ground",
    "tin",
    "mesh",
    "registration",
    "uncertainty",
    "volume",
    "change",
    "clouds",
    "piles",
    "planning",
    "calibration",
    "pipeline",
]
#: The version comes from package.xml; everything may print it. What the process is set up with
#: comes before everything that it is set up for.
ORDER = ["version", "process", *CORE, "simulation", "compile_kernels", "io", "tiles", "replay"]
ORDER += ["tiled_replay", "report", "page", "experiments", "nodes", "cli", "api"]
FILES = sorted(PACKAGE.rglob("*.py"))
#: Most modules in a folder, its face not counted.
MODULES = 20
#: Arguments of a function, ``self`` and ``cls`` not counted; how many functions have more, outside
#: ``clouds/`` and in the whole package; how many arguments are annotated as bare ``Any``. Lines of
#: a function, docstring included, and how many functions have more. All but 8 and 40 only go down.
ARGUMENTS, LONG_OUTSIDE_CLOUDS, LONG, ANY = 8, 2, 3, 63
LINES, TALL = 40, 6
#: Private members that tests reach into: of argparse, IPython and dask, and one seam of a node that
#: no ROS graph is started for. It only goes down. Characters of a line, and places
#: that are not formatted.
PRIVATE, WIDTH, UNFORMATTED = 14, 100, 20
#: Most lines of a room's face.
FACE = 26


def name_of(path):
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(
        ".__init__"
    )


NAMES = {name_of(p): p for p in FILES}


def room(path):
    parts = path.relative_to(PACKAGE).parts
    return parts[0].removesuffix(".py")


@cache
def nodes_of(path):
    """All that a file is made of, parsed once."""
    return tuple(ast.walk(ast.parse(path.read_text())))


@cache
def imports(path):
    """Modules a file imports, at any level; ``from package.room import module`` is that module."""
    found = []
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules = [f"{node.module}.{alias.name}" for alias in node.names]
            found += [m for m in modules if m in NAMES]
            if not all(m in NAMES for m in modules):
                found.append(node.module)
    return tuple(found)


def paths(found):
    """As a failed test should name them."""
    return [str(p.relative_to(PACKAGE.parent)) for p in found]


def own_rooms(path):
    return {name.split(".")[1] for name in imports(path) if name.startswith("ladar_volume.")}


def test_only_nodes_import_ros():
    ros = {
        "rclpy",
        "sensor_msgs",
        "std_msgs",
        "nav_msgs",
        "geometry_msgs",
        "std_srvs",
        "diagnostic_msgs",
        "visualization_msgs",
        "shape_msgs",
    }
    found = [p for p in FILES if {name.split(".")[0] for name in imports(p)} & ros]
    assert not paths(p for p in found if room(p) != "nodes")


def test_the_core_knows_no_files_no_clock_and_no_later_room():
    banned = {
        "time",
        "datetime",
        "pathlib",
        "os",
        "io",
        "open3d",
        "rosbags",
        "mcap",
        "matplotlib",
        "rich",
        "yaml",
    }
    core = [p for p in FILES if room(p) in CORE]
    assert not paths(p for p in core if {name.split(".")[0] for name in imports(p)} & banned)
    assert not paths(p for p in core if calls_of(p) & {"open", "print"})


def calls_of(path):
    """Functions that a file calls by their bare name."""
    return {
        n.func.id
        for n in nodes_of(path)
        if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
    }


def test_rooms_import_only_from_those_before_them():
    rooms = [p for p in FILES if room(p) != "__init__"]
    assert not paths(p for p in rooms if not own_rooms(p) <= set(ORDER[: ORDER.index(room(p)) + 1]))


def test_a_folder_can_be_held_in_the_head():
    modules = Counter(p.parent for p in FILES if p.name != "__init__.py")
    assert not paths(folder for folder, count in modules.items() if count > MODULES)


@pytest.mark.parametrize("name", [n for n in ORDER if (PACKAGE / n).is_dir()])
def test_the_face_of_a_room_says_what_is_public(name):
    face = ast.get_docstring(ast.parse((PACKAGE / name / "__init__.py").read_text())) or ""
    assert "Public" in face and 6 <= face.count("\n") <= FACE


def test_what_another_module_uses_is_public():
    private = [
        f"{path.relative_to(PACKAGE)}: {n.module}.{a.name}"
        for path in FILES
        for n in nodes_of(path)
        if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("ladar_volume")
        for a in n.names
        if a.name.startswith("_")
    ]
    assert not private


def functions():
    """File, name and arguments of every function of the package."""
    for path in FILES:
        for n in nodes_of(path):
            if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef):
                every = [*n.args.posonlyargs, *n.args.args, *n.args.kwonlyargs]
                yield path, n.name, [a for a in every if a.arg not in ("self", "cls")]


def test_few_functions_take_many_arguments():
    long = [
        (room(path), f"{path.relative_to(PACKAGE)}: {name} takes {len(arguments)}")
        for path, name, arguments in functions()
        if len(arguments) > ARGUMENTS
    ]
    outside = [words for where, words in long if where != "clouds"]
    assert len(outside) <= LONG_OUTSIDE_CLOUDS, "\n".join(outside)
    assert len(long) <= LONG, "\n".join(words for _, words in long)


def test_few_functions_are_longer_than_a_screen():
    tall = [
        f"{path.relative_to(PACKAGE)}: {n.name} has {n.end_lineno - n.lineno + 1} lines"
        for path in FILES
        for n in nodes_of(path)
        if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)
        and n.end_lineno - n.lineno + 1 > LINES
    ]
    assert len(tall) <= TALL, "\n".join(tall)


def test_few_arguments_are_annotated_as_any():
    found = [
        f"{path.relative_to(PACKAGE)}: {name}({a.arg})"
        for path, name, arguments in functions()
        for a in arguments
        if isinstance(a.annotation, ast.Name) and a.annotation.id == "Any"
    ]
    assert len(found) <= ANY, "\n".join(found)


def test_tests_touch_few_private_members():
    found = [
        f"{path.relative_to(TESTS)}:{n.lineno}: {ast.unparse(n)}"
        for path in sorted(TESTS.rglob("*.py"))
        for n in nodes_of(path)
        if isinstance(n, ast.Attribute) and n.attr.startswith("_") and not n.attr.startswith("__")
        if not (isinstance(n.value, ast.Name) and n.value.id in ("self", "cls"))
    ]
    assert len(found) <= PRIVATE, "\n".join(found)


def test_no_test_imports_another_or_changes_where_python_looks():
    """What tests share is in ``test/scenes``. The one path that is set is that of a process which a
    test starts.
    """
    for path in sorted(TESTS.rglob("*.py")):
        nodes = nodes_of(path)
        found = [n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module]
        found += [a.name for n in nodes if isinstance(n, ast.Import) for a in n.names]
        assert not [m for m in found if m.split(".")[-1].startswith("test_")], path
        members = [n for n in nodes if isinstance(n, ast.Attribute)]
        assert not [n for n in members if ast.unparse(n).startswith("sys.path.")], path


def test_lines_are_short_and_formatted():
    more = [p for folder in (TESTS, BENCHMARKS) for p in sorted(folder.rglob("*.py"))]
    texts = {p: p.read_text() for p in [*FILES, *more]}
    long = [p for p, text in texts.items() if any(len(t) > WIDTH for t in text.split("\n"))]
    assert not long
    assert sum(text.count("# fmt: " + "skip") for text in texts.values()) <= UNFORMATTED


def test_importing_the_package_changes_no_environment_variable():
    import subprocess

    code = (
        "import os\nbefore = dict(os.environ)\n"
        "import ladar_volume, ladar_volume.pipeline, ladar_volume.api.verbs\n"
        "assert dict(os.environ) == before"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGE.parent)


def test_parameters_of_users_stand_in_the_model():
    """The published filter calls its numbers by the names of the source; they are made from
    ``model.cloud_filter_parameters.PublishedFilterParameters``, whence the options come.
    """
    found = {
        n.name
        for path in FILES
        if room(path) != "model"
        for n in nodes_of(path)
        if isinstance(n, ast.ClassDef) and n.name.endswith(("Options", "Settings", "Parameters"))
    }
    assert found <= {"PublishedParameters"}


def test_no_basename_is_used_twice_in_the_core():
    names = [p.stem for p in FILES if room(p) in CORE and p.name != "__init__.py"]
    assert not {n for n in names if names.count(n) > 1}


def test_the_simulation_uses_nothing_of_the_pipeline():
    own = [p for p in FILES if room(p) == "simulation"]
    assert not paths(p for p in own if not own_rooms(p) <= {"math", "model", "simulation"})


def test_no_import_circle_between_modules():
    names = {
        ".".join(p.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): p
        for p in FILES
    }
    graph = {name: [i for i in imports(p) if i in names] for name, p in names.items()}
    done, path = set(), []

    def visit(name):
        assert name not in path, f"circle: {' -> '.join([*path[path.index(name) :], name])}"
        if name in done:
            return
        path.append(name)
        for other in graph[name]:
            visit(other)
        path.pop()
        done.add(name)

    for name in graph:
        visit(name)


def test_the_core_imports_without_ros():
    import subprocess

    code = (
        "import sys\n"
        "for name in ('rclpy', 'open3d', 'rosbags', 'mcap', 'matplotlib'): "
        "sys.modules[name] = None\n"
        "import ladar_volume.pipeline\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGE.parent)


def test_modules_stay_readable():
    assert not paths(p for p in FILES if p.read_text().count("\n") > 600)


def test_no_other_triangulation_in_the_package():
    for path in FILES:
        text = path.read_text()
        assert "scipy.spatial" not in text or "Delaunay" not in text, path
