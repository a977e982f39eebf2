"""The tin verb end to end: what is written, what is said, every format, and wrong words in one
line.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.endings import ENCODINGS
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.tin.adaptive import adaptive_tin
from ladar_volume.tin.elevation_adjustment import adjust_rms


def cloud(n=3000, sigma=0.02, seed=0):
    """Waves over a map of 10 by 6 m with points at its corners."""
    rng = np.random.default_rng(seed)
    xy = np.r_[[[0, 0], [10, 0], [10, 6], [0, 6]], rng.uniform((0, 0), (10, 6), (n - 4, 2))]
    return np.c_[xy, np.sin(xy[:, 0]) + 0.2 * xy[:, 1] + sigma * rng.normal(size=n)]


def faces(path):
    """Faces (m, 3) of a PLY as the verb writes it, and their marks."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    rows = {line.split()[1]: int(line.split()[2]) for line in lines if line.startswith("element")}
    sizes = {"double": 8, "int": 4}
    width = sum(
        sizes[line.split()[1]]
        for line in lines
        if line.startswith("property") and line.split()[1] in sizes
    )
    dtype = [("n", "u1"), ("v", "<i4", 3)] + (
        [("relevant", "u1")] if "property uchar relevant" in lines else []
    )
    table = np.frombuffer(body, dtype, rows["face"], rows["vertex"] * width)
    return table["v"], table["relevant"] if "relevant" in table.dtype.names else None


@pytest.fixture
def tin(capsys, tmp_path):
    def call(*words):
        assert main(["tin", *map(str, words), "-o", str(tmp_path / "tin.ply"), "--json"]) == 0
        return (
            json.loads(capsys.readouterr().out),
            read_cloud(tmp_path / "tin.ply"),
            *faces(tmp_path / "tin.ply"),
        )

    return call


@pytest.fixture
def save(tmp_path):
    def write(r, name="cloud.ply", columns=None):
        write_cloud(tmp_path / name, r, columns)
        return tmp_path / name

    return write


def area(r, f):
    u, v = r[f[:, 1], :2] - r[f[:, 0], :2], r[f[:, 2], :2] - r[f[:, 0], :2]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def test_a_third_of_the_points_with_adjusted_heights_by_default(save, tin):
    points = cloud()
    facts, out, f, _ = tin(save(points))
    assert (
        facts["vertices"] == len(out) == 1000
        and facts["adjust"] == "rms"
        and facts["options"]["criterion"] == "residual-area"
    )
    expected = adjust_rms(adaptive_tin(points, ratio=1 / 3).tin, points).tin
    rank = np.argsort(out.columns["source"])
    assert np.array_equal(np.sort(expected.source), out.columns["source"][rank])
    assert out.r[rank] == pytest.approx(expected.vertices[np.argsort(expected.source)], abs=1e-9)
    assert np.array_equal(out.r[:, :2], points[out.columns["source"], :2])
    assert (area(out.r, f) > 0).all() and area(out.r, f).sum() == pytest.approx(60.0) == facts[
        "area_m2"
    ]
    assert facts["rms_m"] < facts["rms_before_m"] and facts["fitted_points"] == 3000
    # a vertex stands for three points: its height is better than a point's on average
    assert facts["sigma_point_m"] == pytest.approx(0.02, rel=0.1)
    assert (
        np.median(out.columns["sigma_z"]) == facts["sigma_z_median_m"]
        and 0 < facts["sigma_z_median_m"] < 0.02
    )
    assert (
        facts["output"] == {"path": "tin.ply", "vertices": 1000, "faces": len(f)}
        and facts["version"]
    )


@pytest.mark.parametrize("ending", list(ENCODINGS))
def test_every_kind_of_file(ending, save, tin):
    points = np.round(cloud(300), 4)
    facts, out, f, _ = tin(save(points, f"in{ending}"), "--vertices", 1)
    assert (
        facts["points"] == facts["vertices"] == 300
        and facts["adjust"] == "none"
        and facts["rms_m"] == 0.0
    )
    assert (
        out.r == pytest.approx(points[out.columns["source"]], abs=1e-9)
        and len(f) == facts["triangles"]
    )


@pytest.mark.parametrize("criterion", ["residual", "residual-area", "residual-sigma"])
def test_vertices_criteria_and_tolerance(criterion, save, tin):
    path = save(cloud(sigma=0.0))
    facts, out, _, _ = tin(path, "--vertices", 250, "--criterion", criterion, "--sigma", 0.01)
    assert facts["vertices"] == len(out) == 250
    tolerance = 5 if criterion == "residual-sigma" else 0.05
    facts, _, _, _ = tin(
        path,
        "--tolerance",
        tolerance,
        "--criterion",
        criterion,
        "--sigma",
        0.01,
        "--adjust",
        "none",
    )
    assert (
        facts["vertices"] < 400
        and facts["rms_m"] < 0.05
        and facts["options"]["tolerance"] == tolerance
    )


def test_adjustments_and_exchange_fit_ever_better(save, tin):
    path = save(cloud(1500))
    fits = {
        a: tin(path, "--vertices", 0.1, "--adjust", a)[0]
        for a in ("none", "rms", "rms-iterated", "asd")
    }
    assert fits["rms"]["rms_m"] < fits["asd"]["rms_m"] < fits["none"]["rms_m"]
    assert fits["asd"]["asd_m"] < fits["rms"]["asd_m"] < fits["none"]["asd_m"]
    assert fits["rms-iterated"]["rms_m"] == pytest.approx(fits["rms"]["rms_m"], rel=1e-3)
    # the published stopping rules: so many steps, or no height changed by as much
    once = tin(path, "--vertices", 0.1, "--adjust", "rms-iterated", "--iterations", 1)[0]
    coarse = tin(path, "--vertices", 0.1, "--adjust", "rms-iterated", "--height-tolerance", 0.01)[0]
    assert not once["converged"] and coarse["converged"] and once["options"]["max_iterations"] == 1
    assert fits["none"]["rms_m"] > once["rms_m"] > coarse["rms_m"] > fits["rms"]["rms_m"]
    assert (
        fits["asd"]["sigma_factor"] == pytest.approx(math.sqrt(math.pi / 2))
        and fits["rms"]["sigma_factor"] == 1.0
    )
    assert fits["rms"]["sigma_held_fixed"] == ["triangulation", "choice of vertices"]
    turned = tin(path, "--vertices", 0.1, "--exchange", "rms")[0]
    assert turned["exchanges"] > 0 and turned["sigma_held_fixed"][-1] == "exchanged diagonals"
    assert tin(path, "--vertices", 1)[0]["sigma_held_fixed"] == ["triangulation"]
    assert fits["none"]["rms_m"] == fits["none"]["rms_before_m"] == fits["rms"]["rms_before_m"]
    assert fits["asd"]["sigma_z_median_m"] == pytest.approx(
        math.sqrt(math.pi / 2) * fits["rms"]["sigma_z_median_m"], rel=1e-6
    )
    better = tin(path, "--vertices", 0.1, "--exchange", "rms")[0]
    assert (
        better["exchanges"] > 0
        and better["rms_m"] < fits["rms"]["rms_m"]
        and better["area_m2"] == pytest.approx(60.0)
    )


def test_relevant_triangles_and_the_boundary(save, tin):
    points = cloud(2000)
    hole = np.hypot(points[:, 0] - 5, points[:, 1] - 3) > 1.0
    path = save(points[hole])
    every, _, f, mark = tin(path, "--vertices", 1, "--max-edge", 0.8, "--all-triangles")
    assert mark.sum() == every["relevant_triangles"] < len(f) == every["triangles"]
    # slivers along the hull go with the hole, whose rim is as rough as the points are apart
    assert 54 < every["area_m2"] < 60 - math.pi + 0.5 and every["options"]["relevant"] == "edge"
    filled = tin(path, "--vertices", 1, "--max-edge", 0.8, "--max-hole", 10)[0]
    assert filled["area_m2"] == pytest.approx(every["area_m2"] + math.pi, abs=0.6)
    assert 54 < tin(path, "--vertices", 1, "--max-circle", 0.9)[0]["area_m2"] < 60 - math.pi + 0.5
    rough, smooth = (
        tin(path, "--vertices", 1, "--max-edge", 0.35, *ear)[0] for ear in ((), ("--max-ear", 0.1))
    )
    assert smooth["area_m2"] < rough["area_m2"]
    assert (
        tin(path, "--vertices", 1, "--max-edge", 0.3, "--min-island", 0.5)[0]["area_m2"]
        < tin(path, "--vertices", 1, "--max-edge", 0.3)[0]["area_m2"]
    )
    inner = points[(points[:, 0] > 1) & (np.abs(points[:, 1] - 3) < 2)]
    corners, whole = (tin(save(inner), "--relevant", r)[0] for r in ("corners", "all"))
    assert whole["area_m2"] > corners["area_m2"] and whole["triangles"] > corners["triangles"]


def test_screen_median_window_and_duplicates(save, tin):
    points = cloud(2000, 0.005)
    spikes = np.arange(100, 110)
    points[spikes, 2] += 5.0
    path = save(points)
    cleaned, out, _, _ = tin(path, "--vertices", 1)
    assert 10 <= cleaned["clean"]["strays"] <= 11 and not set(spikes) & set(
        out.columns["source"].tolist()
    )
    screened, out, _, _ = tin(path, "--vertices", 1, "--clean", "off", "--screen", 2.0)
    # ten spikes, and perhaps a point half of whose neighbours are spikes
    assert (
        10 <= screened["outliers"] <= 11
        and not set(spikes) & set(out.columns["source"].tolist())
        and out.r[:, 2].max() < 3
    )
    # rows of the file, though some of them are gone
    assert np.array_equal(out.r, points[out.columns["source"]])
    levelled, out, _, _ = tin(path, "--vertices", 1, "--clean", "off", "--median", 2.0)
    assert (
        levelled["outliers"] == screened["outliers"]
        and levelled["vertices"] == 2000
        and out.r[:, 2].max() < 3
    )
    for ratio in (1, 0.5):
        cut, out, _, _ = tin(path, "--clean", "off", "--vertices", ratio, "--window", 2, 1, 8, 5)
        inside = (np.abs(points[:, 0] - 5) <= 3) & (np.abs(points[:, 1] - 3) <= 2)
        assert cut["cropped"] == 2000 - inside.sum() and cut["used"] == inside.sum()
        assert out.r[:, 0].min() >= 2 and out.r[:, 1].max() <= 5
    thinned = tin(path, "--clean", "off", "--vertices", 1, "--duplicates", 0.1)[0]
    assert (
        thinned["duplicates"] > 100
        and thinned["vertices"] == 2000 - thinned["duplicates"]
        and thinned["adjust"] == "rms"
    )
    twice = tin(
        save(np.r_[points, points + np.array([0, 0, 0.1])]), "--clean", "off", "--vertices", 1
    )
    assert twice[0]["duplicates"] == 2000 and twice[0]["rms_m"] == pytest.approx(0.05, rel=1e-6)
    own = np.argsort(twice[1].columns["source"])
    assert twice[1].r[own, 2] == pytest.approx(
        points[:, 2] + 0.05, abs=1e-9
    )  # the mean of two at one footprint


def test_a_wall_in_its_scan_frame_comes_back_in_the_map(save, tin):
    p = cloud(1000)
    wall = np.c_[p[:, 0], p[:, 2], p[:, 1]] + np.array([10.0, 20.0, 30.0])
    facts, out, _, _ = tin(save(wall), "--vertices", 1, "--frame", "scan", "--direction", 0, 1, 0)
    assert facts["frame"]["name"] == "scan" and out.r == pytest.approx(
        wall[out.columns["source"]], abs=1e-9
    )
    assert facts["area_m2"] == pytest.approx(60.0) and facts["sigma_point_m"] == pytest.approx(
        0.02, rel=0.2
    )
    found = tin(save(wall), "--vertices", 1, "--frame", "scan")[0]
    assert abs(np.array(found["frame"]["axes_map"])[2, 1]) > 0.3


def test_a_person_sees_a_short_table_and_the_run_repeats_to_the_byte(save, tmp_path, capsys):
    path = save(cloud(1000))
    for name in ("a.ply", "b.ply"):
        assert main(["tin", str(path), "-o", str(tmp_path / name)]) == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    shown = capsys.readouterr().out
    assert (
        "vertices" in shown
        and "333" in shown
        and "RMS" in shown
        and "residuals of local quadrics" in shown
        and "written to" in shown
    )


def test_wrong_words_are_one_line_and_leave_no_file(save, tmp_path, capsys):
    path, out = save(cloud(100)), tmp_path / "out.ply"
    two = save(cloud(100)[:2], "two.csv")
    before = sorted(p.name for p in tmp_path.iterdir())
    cases = [
        ([tmp_path / "none.ply", "-o", out], "no such file"),
        ([path, "-o", tmp_path / "out.foo"], "written as .ply"),
        ([path, "-o", tmp_path / "none" / "out.ply"], "cannot be written"),
        ([path, "-o", path], "must be different"),
        ([two, "-o", out], "two.csv"),
        ([path, "-o", out, "--vertices", -1], "whole number"),
        ([path, "-o", out, "--vertices", 0.5, "--relevant", "circumcircle"], "go together"),
        ([path, "-o", out, "--iterations", 5], "belong to --adjust rms-iterated"),
        ([path, "-o", out, "--tolerance", -1], "0 or more"),
        ([path, "-o", out, "--bins", 0], "one or more"),
        ([path, "-o", out, "--vertices", 10, "--bins", 9], "use fewer bins"),
        ([path, "-o", out, "--duplicates", -1], "0 or more"),
        ([path, "-o", out, "--window", 5, 5, 1, 1], "no area"),
        ([path, "-o", out, "--frame", "scan", "--direction", 0, 0, 0], "not all zero"),
        (
            [path, "-o", out, "--frame", "scan", "--direction", 0, 0, 1, "--scanner", 0, 0, 0],
            "choose one",
        ),
        (
            [path, "-o", out, "--criterion", "residual-sigma", "--sigma", 0],
            "positive standard deviation",
        ),
    ]
    for words, text in cases:
        assert main(["tin", *map(str, words)]) == 2, words
        err = capsys.readouterr().err
        assert text in err and "Traceback" not in err and err.count("\n") == 1, (words, err)
    for words in (
        [path],
        [path, "-o", out, "--adjust", "best"],
        [path, "-o", out, "--vertices", "some"],
        [path, "-o", out, "--adjust", "rms-iterated", "--iterations", -1],
        [path, "-o", out, "--screen", -1],
        [path, "-o", out, "--max-ear", -1],
    ):
        with pytest.raises(SystemExit) as refused:
            main(["tin", *map(str, words)])
        assert refused.value.code == 2 and capsys.readouterr().err.count("\n") == 1, words
    assert sorted(p.name for p in tmp_path.iterdir()) == before


def test_heights_at_places_with_their_sigma(tin, save, tmp_path, capsys):
    path, places = save(cloud()), tmp_path / "places.csv"
    places.write_text("2.0,3.0\n7.5,1.0\n50.0,3.0\n")
    facts, *_ = tin(path, "--at", places, "--sigma", 0.02)
    near, far, off = facts["heights"]
    for place in (near, far):
        true = math.sin(place["x_m"]) + 0.2 * place["y_m"]
        assert abs(place["height_m"] - true) < 4 * place["sigma_m"] + 0.02
        assert 0.002 < place["sigma_m"] < 0.02  # averaged over the points of its triangles
    assert off["height_m"] is None and off["sigma_m"] is None
    assert main(["tin", str(path), "-o", str(tmp_path / "t.ply"), "--at", str(places)]) == 0
    shown = capsys.readouterr().out
    assert "at 2.000 3.000" in shown and "mm" in shown and "no surface" in shown


def test_the_cleaned_cloud_keeps_its_attributes(tin, save, tmp_path):
    r = cloud()
    r[100, 2] += 3.0
    path = save(r, "c.las", {"intensity": np.arange(len(r)) % 500})
    for option, left in (("--screen", len(r) - 1), ("--median", len(r))):
        out = tmp_path / f"clean{option}.las"
        facts, *_ = tin(path, option, 1.0, "--clean", "off", "--cleaned", out)
        kept = read_cloud(out)
        assert len(kept.r) == left == facts["cleaned"]["points"]
        rows = np.asarray(kept.columns["index"])
        assert (np.asarray(kept.columns["intensity"]) == rows % 500).all()
        assert np.abs(kept.r[:, 2] - r[rows, 2]).max() == pytest.approx(
            0.0 if option == "--screen" else 3.0, abs=0.3
        )


def test_wrong_places_and_outputs(save, tmp_path, capsys):
    path, bad = save(cloud(200)), tmp_path / "bad.txt"
    bad.write_text("north east\n")
    out = ["-o", str(tmp_path / "t.ply")]
    for words in (
        ["--at", bad],
        ["--at", tmp_path / "none.txt"],
        ["--cleaned", path],
        ["--cleaned", tmp_path / "x.unknown"],
        ["--at", bad, "--frame", "scan"],
    ):
        assert main(["tin", str(path), *out, *map(str, words)]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
