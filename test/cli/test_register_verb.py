"""``ladar_volume register`` on files of sphere points."""

import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.math.se3 import exp_so3

CENTRES = np.array([[10, 0, 1], [4, 9, 3.0], [-6, 8, 0.5], [-11, -1, 2], [-5, -9, 4], [6, -8, 1.5]])
R, T = exp_so3(np.array([0, 0, 1.2])), np.array([500_000.0, 5_600_000.0, 120.0])


def sphere_file(path, centres, seed, sigma=0.002, times=True):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((len(centres), 60, 3))
    u[:, :, 2] = np.abs(u[:, :, 2])
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    p = (centres[:, None] + (0.1 + sigma * rng.standard_normal((len(centres), 60, 1))) * u).reshape(
        -1, 3
    )
    columns = {"sphere": np.repeat(np.arange(len(centres)), 60)}
    write_cloud(
        path,
        p,
        columns | ({"t": np.tile(np.linspace(0.0, 900.0, 60), len(centres))} if times else {}),
    )
    return path


@pytest.fixture
def files(tmp_path):
    moved = CENTRES @ R.T + T
    moved[3] += [0.05, 0.02, 0]
    return sphere_file(tmp_path / "a.csv", CENTRES, 1), sphere_file(
        tmp_path / "b.csv", moved[:5], 2, times=False
    )


def test_the_transform_the_outlier_and_the_cloud(files, tmp_path, capsys):
    cloud = tmp_path / "scan.ply"
    write_cloud(cloud, CENTRES, {"normal": np.repeat([[1.0, 0, 0]], 6, axis=0)})
    words = [
        "register",
        *map(str, files),
        "--radius",
        "0.1",
        "--levelled",
        "--apply",
        str(cloud),
        "-o",
        str(tmp_path / "out.ply"),
        "--json",
    ]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [s["used"] for s in facts["spheres"]] == [True, True, True, False, True] and facts[
        "unmatched"
    ] == [5]
    assert (
        np.array(facts["matrix"])[:3, :3] == pytest.approx(R, abs=1e-3)
        and facts["scale"] == 1.0
        and facts["consistent"]
    )
    assert all(s["still"] == [True, None] for s in facts["spheres"])
    out = read_cloud(tmp_path / "out.ply")
    assert out.r == pytest.approx(CENTRES @ R.T + T, abs=0.005) and out.columns["normal"][
        0
    ] == pytest.approx(R[:, 0], abs=1e-3)
    assert (
        main(
            [
                "register",
                *map(str, files),
                "--noise-a",
                "0.002",
                "--noise-b",
                "0.002",
                "--free-scale",
            ]
        )
        == 0
    )
    assert "sphere" in capsys.readouterr().out


def test_errors_are_one_line(files, tmp_path, capsys):
    bare = tmp_path / "bare.csv"
    write_cloud(bare, CENTRES, {})
    two = sphere_file(tmp_path / "two.csv", CENTRES[:2], 3)
    row, mast = (
        np.outer(np.arange(4.0), [3, 4, 1]),
        np.outer(np.arange(3.0), [0, 0, 2]) + np.array([5.0, 5, 1]),
    )
    lines = [sphere_file(tmp_path / f"row{k}.csv", row + k, 4 + k) for k in range(2)]
    masts = [sphere_file(tmp_path / f"mast{k}.csv", mast + k, 6 + k) for k in range(2)]
    few = tmp_path / "few.csv"
    write_cloud(few, CENTRES, {"sphere": np.zeros(6, int)})
    for pair, extra, text in (
        ((files[0], bare), [], "column 'sphere'"),
        ((files[0], two), [], "needs 3 common spheres"),
        ((files[0], few), [], "sphere 0: 6 points"),
        (files, ["--apply", str(bare)], "go together"),
        (lines, [], "line"),
        (masts, ["--levelled"], "one line"),
        ((tmp_path / "none.csv", files[1]), [], "no such file"),
        (files, ["--radius", "-1"], "radius"),
    ):
        assert main(["register", *map(str, pair), *extra]) == 2
        error = capsys.readouterr().err
        assert text in error and error.count("\n") == 1


def run(capsys, *words):
    code = main(["register", *map(str, words), "--json"])
    out = capsys.readouterr().out
    return code, json.loads(out) if out else None


def numbered(path, centres, seed, numbers, radius=0.1):
    """Points on spheres with the given numbers."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((len(centres), 60, 3))
    u[:, :, 2] = np.abs(u[:, :, 2])
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    r = radius * (1.0 + 0.02 * rng.standard_normal((len(centres), 60, 1)))
    write_cloud(path, (centres[:, None] + r * u).reshape(-1, 3), {"sphere": np.repeat(numbers, 60)})
    return path


def names(facts):
    return {reason["name"] for reason in facts["verdict"]["reasons"]}


@pytest.mark.parametrize("seed", range(5))
def test_swapped_numbers_are_found_and_named(tmp_path, capsys, seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 7))
    i, j = rng.choice(n, 2, replace=False)
    number = np.arange(n)
    number[[i, j]] = number[[j, i]]
    a = numbered(tmp_path / "a.csv", CENTRES[:n], seed, np.arange(n))
    b = numbered(tmp_path / "b.csv", CENTRES[:n] @ R.T + T, seed + 50, number)
    code, facts = run(capsys, a, b)
    assert code == 0 and facts["verdict"]["status"] == "doubtful" and names(facts) == {"renumbered"}
    assert (
        f"spheres {min(i, j)} and {max(i, j)} were swapped"
        in facts["verdict"]["reasons"][0]["text"]
    )
    M = np.array(facts["matrix"])
    assert CENTRES @ M[:3, :3].T + M[:3, 3] == pytest.approx(CENTRES @ R.T + T, abs=0.008)
    assert run(capsys, a, b, "--strict")[0] == 3
    assert main(["register", str(a), str(b)]) == 0
    assert "were swapped" in " ".join(capsys.readouterr().out.split())


def test_the_verdict_of_good_and_of_bad_spheres(files, tmp_path, capsys):
    good = numbered(tmp_path / "good.csv", CENTRES @ R.T + T, 9, np.arange(6))
    code, facts = run(capsys, files[0], good, "--strict")
    assert code == 0 and facts["verdict"] == {"status": "sound", "reasons": []}
    code, facts = run(capsys, *files, "--strict")
    assert code == 3 and names(facts) == {"left_out"} and facts["consistent"]
    line = np.outer(np.linspace(-10.0, 10.0, 5), [1.0, 0.3, 0.05])
    line[:, 1] += np.array([0.1, -0.2, 0.15, -0.1, 0.12])
    pair = [numbered(tmp_path / f"l{k}.csv", line + k, k, np.arange(5)) for k in range(2)]
    assert "near_line" in names(run(capsys, *pair)[1])


def test_a_wrong_radius_and_wrong_units_are_named(files, tmp_path, capsys):
    other = numbered(tmp_path / "r.csv", CENTRES @ R.T + T, 9, np.arange(6), radius=0.12)
    assert "radii" in names(run(capsys, files[0], other)[1])
    mm = numbered(tmp_path / "mm.csv", 1e3 * CENTRES, 9, np.arange(6), radius=100.0)
    for words, text in (
        ((files[0], other, "--radius", "0.1"), "radius of 0.12"),
        ((files[0], mm), "millimetres"),
    ):
        assert main(["register", *map(str, words)]) == 2
        error = capsys.readouterr().err
        assert text in error and error.count("\n") == 1
