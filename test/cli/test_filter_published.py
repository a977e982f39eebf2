"""The filter verb in the published order: presets, reductions and what the files then hold."""

import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.published.filter_presets import preset
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud


@pytest.fixture(scope="module")
def points():
    """A slope at map coordinates with noise of 5 cm either way and 40 points floating above it."""
    rng = np.random.default_rng(0)
    xy = rng.random((6000, 2)) * 1.5
    z = 0.2 * xy[:, 0] + rng.uniform(-0.05, 0.05, 6000)
    z[:40] += rng.uniform(0.3, 0.8, 40)
    return np.round(np.column_stack([xy, z]), 4) + np.array([499_000.0, 5_432_000.0, 250.0])


@pytest.mark.parametrize("ending", [".ply", ".pcd", ".csv", ".npy", ".las"])
def test_a_preset_in_the_published_order(ending, points, capsys, tmp_path):
    write_cloud(tmp_path / "in.npy", points)
    out, rest = tmp_path / f"out{ending}", tmp_path / f"rest{ending}"
    words = [
        str(tmp_path / "in.npy"),
        "-o",
        str(out),
        "--outliers",
        str(rest),
        "--preset",
        "bench",
        "--set",
        "filter.order=published",
        "--json",
    ]
    assert main(["filter", *words]) == 0
    facts = json.loads(capsys.readouterr().out)
    kept, taken = read_cloud(out), read_cloud(rest)
    assert kept.columns["count"].sum() + len(taken) == len(points)
    assert set(range(40)) <= set(taken.columns["index"].astype(int).tolist())
    assert len(kept) == facts["output"]["points"] < 0.6 * len(points)
    report = facts["report"]
    assert report["order"] == facts["parameters"]["order"] == "published" and not facts["auto"]
    # the published 5 cm is less than three times the noise, and the printed sigma says what that
    # costs
    assert (
        report["threshold_m"] == 0.05
        and report["threshold_over_noise"] < 3
        and report["variance_inflation"] > 1.05
    )
    result = filter_cloud(points, preset("bench"))
    assert np.allclose(kept.r, result.r, atol=1e-4) and np.array_equal(
        kept.columns["index"], result.index
    )


def test_the_published_order_with_what_the_cloud_says_and_a_table(points, capsys, tmp_path):
    write_cloud(tmp_path / "in.ply", points)
    words = [
        str(tmp_path / "in.ply"),
        "-o",
        str(tmp_path / "out.ply"),
        "--set",
        "filter.order=published",
        "--set",
        "filter.edge=remove",
    ]
    assert main(["filter", *words]) == 0
    shown = capsys.readouterr().out
    assert (
        "published" in shown
        and "variance inflation" in shown
        and "(estimated)" in shown
        and len(shown.splitlines()) < 30
    )
    assert "count" not in read_cloud(tmp_path / "out.ply").columns
    for wrong in (
        "filter.order=sideways",
        "filter.edge=keep",
        "filter.reduce=half",
        "filter.grid_before_m=-1",
        "filter.trials=0",
    ):
        assert (
            main(
                [
                    "filter",
                    str(tmp_path / "in.ply"),
                    "-o",
                    str(tmp_path / "x.ply"),
                    "--radius",
                    "0.2",
                    "--set",
                    wrong,
                ]
            )
            == 2
        )
        assert "allowed" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words, says",
    [
        (["filter.confidence=0.9"], "filter.order=published"),
        (["filter.start=ransac"], "filter.order=published"),
        (["filter.cap_per_voxel=8"], "the live filter alone"),
        (["filter.order=published", "filter.nav_bin_s=1"], "the live filter alone"),
        (["filter.order=published", "filter.confidence=2"], "allowed"),
        (["filter.outlier_sigmas=4"], "--radius"),
    ],
)
def test_a_key_that_the_filter_does_not_read_is_refused(words, says, points, capsys, tmp_path):
    write_cloud(tmp_path / "in.ply", points)
    out = ["-o", str(tmp_path / "x.ply")]
    radius = [] if says == "--radius" else ["--radius", "0.2"]
    sets = [word for key in words for word in ("--set", key)]
    assert main(["filter", str(tmp_path / "in.ply"), *out, *radius, *sets]) == 2
    said = capsys.readouterr().err.strip()
    assert says in said and "\n" not in said
