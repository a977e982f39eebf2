"""The filter verb on small clouds: what goes in comes out or is named, in every format, and wrong
words are one line.
"""

import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.filter_cloud import REASONS, filter_cloud
from ladar_volume.clouds.published.filter_presets import PRESETS, preset
from ladar_volume.io.endings import ENCODINGS
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.model.cloud_filter_parameters import FilterParameters
from ladar_volume.model.parameter import write_section

SIGMA = 0.005
PLANE = np.array([0.2, -0.1])


@pytest.fixture(scope="module")
def points():
    """A noisy slope at map coordinates with 30 points floating high above it, shuffled."""
    rng = np.random.default_rng(0)
    xy = rng.random((3000, 2)) * 4.0
    z = xy @ PLANE + rng.normal(0.0, SIGMA, 3000)
    z[:30] += rng.uniform(0.5, 3.0, 30)
    return rng.permutation(np.column_stack([xy, z])) + np.array([499_000.0, 5_432_000.0, 250.0])


@pytest.fixture
def cloud(points, tmp_path):
    write_cloud(tmp_path / "cloud.ply", points)
    return tmp_path / "cloud.ply"


def height_above_truth(r):
    return r[:, 2] - 250.0 - (r[:, :2] - [499_000.0, 5_432_000.0]) @ PLANE


def run(capsys, *words):
    assert main(["filter", *map(str, words)]) == 0
    return capsys.readouterr()


def test_every_point_comes_out_or_is_named(cloud, points, capsys, tmp_path):
    out, rest = tmp_path / "out.ply", tmp_path / "rest.csv"
    facts = json.loads(
        run(
            capsys, cloud, "-o", out, "--radius", 0.3, "--degree", 1, "--outliers", rest, "--json"
        ).out
    )
    kept, taken = read_cloud(out), read_cloud(rest)
    index, lost = kept.columns["index"], taken.columns["index"].astype(int)
    assert len(set(index.tolist())) == len(index) and not set(index) & set(lost)
    assert np.array_equal(taken.r, points[lost]) and set(taken.columns["reason"]) <= set(
        REASONS[1:]
    )
    assert set(np.flatnonzero(height_above_truth(points) > 0.4)) <= set(lost)
    assert np.abs(height_above_truth(kept.r)).max() < 4 * SIGMA
    assert (
        np.abs(kept.r - points[index]).max() < 6 * SIGMA
    )  # a filtered point is the neighbour of its input point
    up = np.array([*-PLANE, 1.0]) / np.linalg.norm([*PLANE, 1.0])
    assert np.median(np.abs(kept.columns["normal"] @ up)) > 0.999
    assert (kept.columns["sigma"] > 0).all() and np.median(kept.columns["sigma"]) < SIGMA
    assert facts["input"] == {"path": "cloud.ply", "points": 3000} and facts["output"][
        "points"
    ] == len(kept)
    assert (
        sum(facts["outliers"].values()) == len(taken) and facts["reduction"] == 1 - len(kept) / 3000
    )
    names, counts = np.unique(taken.columns["reason"], return_counts=True)
    assert facts["outliers"] == dict(zip(names.tolist(), counts.tolist(), strict=True))
    assert (
        not facts["auto"]
        and facts["parameters"]["radius_m"] == 0.3
        and facts["parameters"]["degree"] == 1
    )
    assert facts["report"] and facts["version"]


def test_the_file_holds_what_the_function_gives(cloud, points, capsys, tmp_path):
    run(
        capsys,
        cloud,
        "-o",
        tmp_path / "out.npy",
        "--radius",
        0.3,
        "--set",
        "filter.trials=60",
        "--set",
        "filter.seed=7",
    )
    kept = read_cloud(tmp_path / "out.npy")
    result = filter_cloud(points, FilterParameters(radius_m=0.3, trials=60, seed=7))
    assert np.array_equal(kept.r, result.r) and np.array_equal(kept.columns["index"], result.index)
    assert np.array_equal(kept.columns["normal"], result.normal) and np.array_equal(
        kept.columns["sigma"], result.sigma
    )


@pytest.mark.parametrize("ending", list(ENCODINGS))
def test_every_format_in_and_out(ending, points, capsys, tmp_path):
    # coordinates of 0.1 mm, so that LAS rounds nothing and all formats hold the same cloud
    write_cloud(tmp_path / f"in{ending}", np.round(points, 4))
    out, rest = tmp_path / f"out{ending}", tmp_path / f"rest{ending}"
    facts = json.loads(
        run(
            capsys,
            tmp_path / f"in{ending}",
            "-o",
            out,
            "--radius",
            0.3,
            "--outliers",
            rest,
            "--json",
        ).out
    )
    kept, taken = read_cloud(out), read_cloud(rest)
    assert len(kept) + len(taken) == 3000
    assert set(kept.columns) >= {"normal", "sigma", "index"} and set(taken.columns) >= {
        "index",
        "reason",
    }
    assert len(kept) == facts["output"]["points"] and 30 <= len(taken) < 300
    reason = taken.columns["reason"]
    names = reason if reason.dtype.kind == "U" else np.array(REASONS)[reason.astype(int)]
    assert "outlier" in set(names.tolist())


def test_auto_is_the_default(cloud, points, capsys, tmp_path):
    one = json.loads(run(capsys, cloud, "-o", tmp_path / "a.npy", "--json").out)
    two = json.loads(run(capsys, cloud, "-o", tmp_path / "b.npy", "--auto", "--json").out)
    assert one["auto"] and one["report"] == two["report"]
    assert (tmp_path / "a.npy").read_bytes() == (tmp_path / "b.npy").read_bytes()
    assert np.array_equal(
        read_cloud(tmp_path / "a.npy").r, filter_cloud(points, FilterParameters(), auto=True).r
    )


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_presets_are_the_published_numbers_and_can_be_overridden(name, cloud, capsys, tmp_path):
    words = ("--preset", name, "--set", "filter.trials=30", "--json")
    facts = json.loads(run(capsys, cloud, "-o", tmp_path / "a.npy", *words).out)
    published = write_section(preset(name, "cover"))
    assert facts["parameters"] == {"order": "cover", **published, "trials": 30}
    assert not facts["auto"]
    assert published["outlier_floor_m"] == 0.05 and published["degree"] == (
        2 if name == "sphere" else 1
    )
    facts = json.loads(
        run(capsys, cloud, "-o", tmp_path / "a.npy", *words, "--radius", 0.5, "--degree", 2).out
    )
    assert facts["parameters"]["radius_m"] == 0.5 and facts["parameters"]["degree"] == 2


def test_a_person_sees_a_short_table(cloud, capsys, tmp_path):
    shown = run(capsys, cloud, "-o", tmp_path / "out.ply")
    assert (
        "points in" in shown.out
        and "3,000" in shown.out
        and "outlier" in shown.out
        and "radius" in shown.out
        and "out.ply" in shown.out
    )
    assert len(shown.out.splitlines()) < 30 and "Traceback" not in shown.err


def test_wrong_words_are_one_line_and_leave_no_file(cloud, capsys, tmp_path):
    out = tmp_path / "out.ply"
    few, bad = tmp_path / "few.csv", tmp_path / "bad.csv"
    few.write_text("x,y,z\n1,2,3\n")
    bad.write_text("x,y,z\n1,2,3\n1,2,nan\n")
    before = sorted(p.name for p in tmp_path.iterdir())
    cases = [
        ([tmp_path / "none.ply", "-o", out], "no such file"),
        ([tmp_path / "none.fls", "-o", out], "no known kind"),
        ([bad, "-o", out], "1 of 2 points"),
        ([few, "-o", out, "--radius", 0.3], "no point is left of 1"),
        ([cloud, "-o", tmp_path / "out.doc"], "no known kind"),
        ([cloud, "-o", tmp_path / "none" / "out.ply"], "cannot be written"),
        ([cloud, "-o", tmp_path], "no known kind"),
        ([cloud, "-o", cloud], "must be different"),
        ([cloud, "-o", out, "--outliers", out], "must be different"),
        ([cloud, "-o", out, "--auto", "--radius", 0.3], "choose one"),
        ([cloud, "-o", out, "--auto", "--preset", "box"], "choose one"),
        ([cloud, "-o", out, "--degree", 1], "give --radius too"),
        ([cloud, "-o", out, "--set", "filter.degree=1"], "give --radius too"),
        ([cloud, "-o", out, "--set", "filter.radus_m=1"], "did you mean 'radius_m'"),
        ([cloud, "-o", out, "--set", "volume.base=level"], "section 'filter'"),
        ([cloud, "-o", out, "--set", "filter.radius_m"], "not section.key=value"),
    ]
    for words, text in cases:
        assert main(["filter", *map(str, words)]) == 2, words
        err = capsys.readouterr().err
        assert text in err and "Traceback" not in err and err.count("\n") == 1, err
    for words in (
        [cloud],
        [cloud, "-o", out, "--preset", "none"],
        [cloud, "-o", out, "--degree", "3"],
        [cloud, "-o", out, "--radius", "-1"],
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["filter", *map(str, words)])
    assert "filter.radius_m: -1 m is out of range" in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == before
