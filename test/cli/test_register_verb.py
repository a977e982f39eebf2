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
