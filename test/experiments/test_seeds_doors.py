"""The doors of docs/seeds.md are opened: real commands of the real program on small data, which
together use every verb, flag and key that the page names.
"""

import json
import re
from collections import Counter

import numpy as np
import pytest

from benchmarks.pits import pit
from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from test.scenes.seeds_page import DOORS, ROOT

#: What takes too long here is opened by the tests named.
ELSEWHERE = {
    "study thesis --large": "test/experiments/test_thesis.py",
    "study thesis -o": "test/experiments/test_thesis.py",
    "plan --compare --scanner --imu": "test/cli/test_plan_verb.py",
    "volume.kind": "test/nodes/test_bodies_node.py",
}

PLANE = "filter.order=published"
CASES = {
    "tin steps": (
        "tin {hill} -o {out}/t.ply --json --vertices 0.3 --criterion residual --bins 3 --adjust "
        "rms-iterated --iterations 5 --height-tolerance 1e-9 --exchange asd --exchange-last",
        lambda f: (
            (f["options"]["criterion"], f["vertices"], f["vertices_from_bins"])
            == ("residual", 120, 10)
            and f["exchanges"] > 0
        ),
    ),
    "tin tolerance": (
        "tin {hill} -o {out}/t.ply --json --tolerance 0.2 --window 1 1 9 5 --duplicates 0.1 "
        "--all-triangles --relevant edge --max-edge 3",
        lambda f: 4 < f["vertices"] < 120 and f["options"]["relevant"] == "edge",
    ),
    "tin boundary": (
        "tin {hill} -o {out}/t.ply --json --relevant circumcircle --max-circle 4 --max-ear 2 "
        "--min-island 0.1 --max-hole 0.5",
        lambda f: f["options"]["relevant"] == "circumcircle",
    ),
    "tin screen": (
        "tin {spikes} -o {out}/t.ply --json --clean off --screen 0.5 --cleaned {out}/kept.ply",
        lambda f: len(read_cloud(f["folder"] / "kept.ply").r) == 394,
    ),
    "tin median": (
        "tin {spikes} -o {out}/t.ply --json --clean off --median 0.5 --cleaned {out}/kept.ply",
        lambda f: len(r := read_cloud(f["folder"] / "kept.ply").r) == 400 and r[:, 2].max() < 2.5,
    ),
    "tin places": (
        "tin {hill} -o {out}/t.ply --json --at {places} --sigma 0.02 --vertices 1",
        lambda f: (
            0.0 < f["heights"][0]["sigma_m"] < 0.02
            and f["heights"][0]["height_m"] == pytest.approx(1.7, abs=0.1)
        ),
    ),
    "tin frame": (
        "tin {hill} -o {out}/t.ply --json --frame scan --scanner 5 3 30",
        lambda f: f["vertices"] > 100,
    ),
    "tin direction": (
        "tin {hill} -o {out}/t.ply --json --frame scan --direction 0.1 0 -1",
        lambda f: f["vertices"] > 100,
    ),
    "volume level": (
        "volume {hill} --level 0.2 --json --vertices 0.4 --exchange rms --exchange-last",
        lambda f: f["cut_m3"] == pytest.approx(8.7, rel=0.05),
    ),
    "volume floor": (
        "volume {hill} --json --base floor --levels -0.5 2 0.1 --outline all --clean off",
        lambda f: f["base"].startswith("floor") and len(f["sequences"]) > 0,
    ),
    "volume preset": (
        "volume {hill} --json --base ground --ground-preset box",
        lambda f: f["net_m3"] > 5.0,
    ),
    "methods": (
        "volume {hill} {lower} --json --footprint own --method 1",
        lambda f: len(f["pairs"]) > 0,
    ),
    "offset": (
        "volume {hill} {lower} --json --footprint own --method 2 --offset 0.1 "
        "--levels -1.5 -0.5 0.5",
        lambda f: len(f["pairs"]) > 0,
    ),
    "filter published": (
        f"filter {{ball}} -o {{out}}/f.ply --json --preset sphere --set {PLANE} --set "
        "filter.sample_size=20 --set filter.trials=50 --set filter.start=ransac --set "
        "filter.ransac_threshold_m=0.05 --set filter.edges_threshold=0.2 --set filter.edge=remove "
        "--set filter.sort=false --set filter.min_share=0.3 --set filter.reduce=mean --set "
        "filter.grid_before_m=0.01 --set filter.grid_after_m=0.01 --set "
        "filter.outlier_sigmas=3.5 --set filter.outlier_floor_m=0.04 --set filter.degree=1",
        lambda f: 500 < f["output"]["points"] <= 1500,
    ),
    "filter radius": (
        f"filter {{ball}} -o {{out}}/f.ply --json --radius 0.4 --set {PLANE} --set "
        "filter.radius_m=0.35",
        lambda f: f["parameters"]["radius_m"] == 0.35,
    ),
    "body ground": (
        "body {block} -o {out}/b.ply --json --no-filter --ground 0 --close 0.3 --pole=1,2,3",
        lambda f: f["volume_m3"] == pytest.approx(1.0, abs=0.05),
    ),
    "body preset": (
        "body {block} -o {out}/b.ply --json --no-filter --ground-preset box --pick 0,0,1",
        lambda f: f["volume_m3"] == pytest.approx(1.0, abs=0.05),
    ),
    "body outline": (
        "body {block} -o {out}/b.ply --json --no-filter --polygon -0.9,-0.9 "
        "0.9,-0.9 0.9,0.9 -0.9,0.9",
        lambda f: f["volume_m3"] == pytest.approx(1.0, abs=0.05),
    ),
    "body box": (
        "body {block} -o {out}/b.ply --json --no-filter --box -1,-1,0.02,1,1,2",
        lambda f: f["volume_m3"] == pytest.approx(1.0, abs=0.05),
    ),
    "body repair": (
        "body {shell} -o {out}/b.ply --json --no-filter --repair both --mesh-radius 0.5",
        lambda f: f["volume_m3"] == pytest.approx(4.19, rel=0.1),
    ),
    "diff": (
        "diff {before} {after} --json --pole 0,0,6 --sigma 0.01 --polygon {rim} --margin 1 "
        "--published --offset 0.02 --mass 5000 --mass-sigma 50 --resolution 0.5 0.8",
        lambda f: (
            f["volume_m3"] == pytest.approx(2.5 / 6.0 * 38.0)
            and f["published_m3"] > 0.0
            and len(f["resolution"]["volume_m3"]) == 2
            and f["density"]["density_kg_m3"] == pytest.approx(5000.0 / f["volume_m3"])
        ),
    ),
    "diff selection": (
        "diff {before} {after} --json --pole 0,0,6 --sigma 0.01 --selection {picked} --margin 1",
        lambda f: f["volume_m3"] == pytest.approx(2.5 / 6.0 * 38.0),
    ),
    "register": (
        "register {spheres} {moved} --json --radius 0.1 --levelled --free-scale",
        lambda f: len(f["spheres"]) == 6,
    ),
    "repeats": (
        "calibrate repeats {repeats} --json -o {out}/budget.yaml",
        lambda f: f != {},
    ),
    "plan": (
        "plan --json --volume 300 --budget table1_low --scanner vlp16 --imu mems --wanted 0.05 "
        "--rate 3000",
        lambda f: f["sigma_m3"] > 0.0,
    ),
    "stockpile": (
        "study stockpile --json --volume 250 --repose 30 --share 0.1",
        lambda f: f != {},
    ),
}


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Small files: a hill and the same lower, one with spikes, a ball, a block on its ground,
    spheres, repeated calibrations.
    """
    folder, rng = tmp_path_factory.mktemp("doors"), np.random.default_rng(5)
    xy = rng.uniform((0, 0), (10, 6), (396, 2))
    xy = np.r_[xy, [[0, 0], [10, 0], [10, 6], [0, 6]]]

    def hill(top):
        d = np.hypot(xy[:, 0] - 5, xy[:, 1] - 3)
        return np.c_[xy, np.maximum(top * (1 - d / 2.4), 0) + 0.01 * rng.normal(size=len(xy))]

    spikes = hill(2.0)
    spikes[:6, 2] += 5.0
    unit = rng.normal(size=(1500, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    before, after, _ = pit((-1.5, 1.5, -1.5, 1.5), (-1.0, 1.0, -1.0, 1.0), 2.5, 0.25, 2.5)
    files = {
        "hill": (hill(2.0), None),
        "lower": (hill(1.6), None),
        "spikes": (spikes, None),
        "before": (before, None),
        "after": (after, None),
        "picked": (np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0.0]]), None),
        "ball": (unit * (1.0 + 0.02 * rng.uniform(-1, 1, (1500, 1))), None),
        "shell": (unit, {"normal": unit, "sigma": np.full(1500, 0.001)}),
        "block": block(rng),
    }
    for name, (points, columns) in files.items():
        write_cloud(folder / f"{name}.ply", points, columns)
    spheres(folder, rng)
    rows = "\n".join(
        f"m{k // 3}," + ",".join(f"{v:.4f}" for v in 0.01 * rng.normal(size=3)) for k in range(30)
    )
    head = "mounting,lever_laser_x_m,lever_laser_y_m,lever_laser_z_m\n"
    (folder / "rim.txt").write_text("-2 -2\n2 -2\n2 2\n-2 2\n")
    (folder / "places.txt").write_text("5.0 3.0\n4.0 2.0\n")
    (folder / "repeats.csv").write_text(head + rows + "\n")
    return folder


def block(rng):
    """A cube of 1 m on its ground, with normals, every 4 cm."""
    u, v = (a.ravel() for a in np.meshgrid(*2 * [np.arange(-0.48, 0.5, 0.04)]))
    parts, one = [np.c_[u, v, np.ones(len(u))]], np.ones(len(u))
    parts += [np.c_[s * 0.5 * one, u, v + 0.5] for s in (-1, 1)]
    parts += [np.c_[u, s * 0.5 * one, v + 0.5] for s in (-1, 1)]
    normal = np.repeat(np.array([[0, 0, 1], [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]]), 625, 0)
    xy = rng.uniform(-1.8, 1.8, (5000, 2))
    xy = xy[(np.abs(xy) > 0.5).any(axis=1)]
    floor = np.c_[xy, np.zeros(len(xy))]
    normal = np.r_[normal, np.tile([0, 0, 1], (len(floor), 1))].astype(float)
    points = np.concatenate([*parts, floor])
    return points, {"normal": normal, "sigma": np.full(len(points), 0.001)}


def spheres(folder, rng):
    """Six spheres as two instruments see them, the second turned about the vertical."""
    at = np.array([[10, 0, 1], [4, 9, 3], [-6, 8, 0.5], [-11, -1, 2], [-5, -9, 4], [6, -8, 1.5]])
    u = rng.standard_normal((6, 60, 3))
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    p = (at[:, None] + (0.1 + 0.001 * rng.standard_normal((6, 60, 1))) * u).reshape(-1, 3)
    c, s = np.cos(0.7), np.sin(0.7)
    for name, r in (("spheres", p), ("moved", p @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))):
        write_cloud(folder / f"{name}.csv", r, {"sphere": np.repeat(np.arange(6), 60)})


def words_of(command, data, out):
    """A command with its files."""
    names = {p.stem: str(p) for p in data.iterdir()}
    return command.format(**names, out=out).split()


@pytest.mark.parametrize("case", CASES)
def test_the_door_opens(case, data, tmp_path, capsys):
    command, holds = CASES[case]
    code = main(words_of(command, data, tmp_path))
    said = capsys.readouterr()
    assert code == 0, said.err
    facts = json.loads(said.out)
    if isinstance(facts, dict):
        facts["folder"] = tmp_path
    assert holds(facts), {k: v for k, v in facts.items() if not isinstance(v, list | dict)}


def test_keys_of_a_survey_change_its_surface(tmp_path, capsys):
    """Section tin and the ground's keys in replay: read, used, and in the result."""
    keys = {
        "tin.adjust": "rms-iterated",
        "tin.bins_per_row": 3,
        "tin.criterion": "residual",
        "tin.exchange": "rms",
        "tin.height_tolerance_m": 0.01,
        "tin.max_ear_edge_m": 5.0,
        "tin.max_hole_m2": 0.5,
        "tin.max_iterations": 3,
        "tin.median_m": 0.5,
        "tin.min_island_m2": 0.1,
        "tin.readjust": "false",
        "tin.screen_m": 0.5,
        "volume.relevant": "corners",
        "volume.vertex_ratio": 0.33,
        "ground.below_weight": 0.0,
        "ground.degree": 2,
        "ground.trials": 300,
    }
    bag = tmp_path / "bag"
    survey = ["simulate", "cone", "--duration", "8", "--thin", "24", "-o", str(bag)]
    assert main(survey) == 0
    results = []
    for more in ([], [f"{k}={v}" for k, v in keys.items()]):
        words = ["replay", str(bag), "--json", "--no-figure", "-o", str(tmp_path / "out")]
        capsys.readouterr()
        assert main([*words, *(w for one in more for w in ("--set", one))]) == 0
        results.append(json.loads(capsys.readouterr().out))
    plain, other = results
    assert other["vertices"] < 0.7 * plain["vertices"]
    assert other["volume_m3"] != plain["volume_m3"]
    page = {door for door in DOORS if re.match(r"(tin|volume|ground)\.", door)}
    assert page - set(keys) - set(ELSEWHERE) == set()


def used():
    """Verbs with their flags, and keys of the filter, of all the cases."""
    verbs, keys = {}, set()
    for command, _ in CASES.values():
        words = command.split()
        flags = {re.sub(r"=.*", "", w) for w in words if w.startswith("--")}
        verbs.setdefault(words[0], set()).update(flags, words[1:2])
        keys.update(w.split("=")[0] for w in words if w.startswith("filter."))
    return verbs, keys


def test_every_verb_flag_and_key_of_the_page_is_opened():
    verbs, keys = used()
    verbs["replay"], verbs["simulate"] = {"--set"}, set()  # the test of keys
    closed = []
    for door in DOORS:
        if door in ELSEWHERE:
            flag = door.split()[-1]
            assert flag in (ROOT / ELSEWHERE[door]).read_text(encoding="utf-8")
        elif door.startswith("filter."):
            closed += [door] * (door not in keys)
        elif ".py" not in door and "." not in door.split()[0] and not door.startswith("study_"):
            verb, *flags = door.split()
            closed += [door] * (not set(flags) <= verbs.get(verb, set()))
    assert closed == []


def test_every_function_of_the_page_is_in_use():
    """Somewhere in the package or its tests, beside where it is defined."""
    texts = [p.read_text(encoding="utf-8") for p in (ROOT / "ladar_volume").rglob("*.py")]
    texts += [p.read_text(encoding="utf-8") for p in (ROOT / "test").rglob("*.py")]
    words = re.findall(r"(?<!def )(?<!class )\b\w+\b", " ".join(texts))
    count = Counter(words)
    doors = [door.partition(":") for door in DOORS if ".py" in door]
    names = [name or path.removesuffix(".py").rpartition("/")[2] for path, _, name in doors]
    assert [name for name in names if not count[name]] == []
