"""The command line on the bundled recordings: the truth within the interval, the same bytes every
time, errors in one line.
"""

import json
import shutil
from pathlib import Path

import numba
import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from ladar_volume.cli.main import main
from ladar_volume.cli.tables.result_table import show_result
from ladar_volume.io.bags import BagReader

BAGS = Path(__file__).parents[2] / "bags"


def replayed(capsys, bag, out, *words):
    assert main(["replay", str(bag), "--json", "--no-figure", "-o", str(out), *words]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("name", ["stockpile", "box"])
def test_the_true_volume_lies_in_the_interval_of_the_bundled_surveys(name, capsys, tmp_path):
    result = replayed(capsys, BAGS / name, tmp_path)
    truth = json.loads((BAGS / name / "truth.json").read_text())["volume_m3"]
    low, high = result["interval_m3"]
    assert low <= truth <= high
    assert abs(result["volume_m3"] - truth) <= 0.015 * truth
    assert result["sigma_m3"] <= 0.02 * truth
    assert sum(result["budget_m6"].values()) == pytest.approx(result["sigma_m3"] ** 2, rel=1e-9)
    assert ("edges" in result["budget_m6"]) == (name == "box")  # a pile has no steep faces
    assert result["verdict"]["status"] == "sound"
    assert result["base_same_survey"] and result["version"] and result["input"]["sha256"]
    points, lost = result["points"], result["losses"]
    assert points["returns"] == points["mapped"] + sum(
        v for k, v in lost.items() if k in GEOREFERENCE_LOSSES
    )
    assert (tmp_path / "mesh.ply").stat().st_size > 1000 and (
        tmp_path / "result.mcap"
    ).stat().st_size > 1000
    check_surface_in(tmp_path / "result.mcap", result)
    show_result(Console(width=200), result)
    printed, chords = " ".join(capsys.readouterr().out.split()), result["chord_m3"]
    assert f"{result['volume_m3']:.3f} ±" in printed
    assert (
        (f"({result['volume_m3'] + chords:.3f} m³ with them)" in printed)
        == (abs(chords) >= 5e-4)
        == (name == "stockpile")
    )


def check_surface_in(file, result):
    """The MCAP holds what a viewer shows: triangles, the whole mesh, the base as a pose."""
    with BagReader(file) as bag:
        shown = {raw.topic: bag.message(raw) for raw in bag.raw({"tin", "mesh", "ground_plane"})}
    corners = np.array([[v.x, v.y, v.z] for v in shown["mesh"].vertices])
    faces = np.array([t.vertex_indices for t in shown["mesh"].triangles])
    a, b, c = corners[faces].swapaxes(0, 1)
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()  # seen from above
    points = len(shown["tin"].points)  # a large surface is shown coarser
    assert points == len(shown["tin"].colors)
    assert points == 3 * len(faces) or (len(faces) > 100_000 and 100_000 < points < 3 * len(faces))
    ground, pose = result["grounds"][0], shown["ground_plane"].pose
    at = pose.pose.position
    assert [at.x, at.y, at.z] == pytest.approx([*ground["origin_xy_m"], ground["beta"][0]])
    turn = Rotation.from_quat([getattr(pose.pose.orientation, k) for k in "xyzw"])
    x, y, z = turn.apply([0.0, 0.0, 1.0])
    assert [-x / z, -y / z] == pytest.approx(ground["beta"][1:3])
    variance = np.asarray(pose.covariance).reshape(6, 6).diagonal()
    assert variance[[0, 1, 5]].tolist() == [0.0, 0.0, 0.0] and (variance[2:5] > 0.0).all()


GEOREFERENCE_LOSSES = {
    "point_region",
    "point_range",
    "point_vehicle",
    "point_intensity",
    "point_pose_gap",
    "point_before_trajectory",
    "point_trajectory_end",
    "point_pose_timeout",
}


def test_replay_is_deterministic_whatever_the_number_of_threads(capsys, tmp_path):
    words = ("--duration", "12")
    one = replayed(capsys, BAGS / "stockpile", tmp_path / "a", *words)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        two = replayed(capsys, BAGS / "stockpile", tmp_path / "b", *words)
    finally:
        numba.set_num_threads(threads)
    assert one == two


def test_the_truth_is_never_read(capsys, tmp_path):
    bag = tmp_path / "copy"
    shutil.copytree(BAGS / "stockpile", bag)
    (bag / "truth.json").unlink()
    words = ("--duration", "8")
    assert (
        replayed(capsys, bag, tmp_path / "a", *words)["volume_m3"]
        == replayed(capsys, BAGS / "stockpile", tmp_path / "b", *words)["volume_m3"]
    )


def test_the_real_recording_replays_and_unknown_covariances_are_refused_without_the_budget(
    capsys, tmp_path
):
    result = replayed(capsys, BAGS / "leo_cut", tmp_path)
    assert result["points"]["mapped"] > 50_000 and np.isfinite(result["volume_m3"])
    assert (
        main(
            [
                "replay",
                str(BAGS / "leo_cut"),
                "--set",
                "georeference.unknown_covariance=refuse",
                "-o",
                str(tmp_path),
            ]
        )
        == 2
    )
    assert "fix_unknown_covariance" in capsys.readouterr().err


def test_errors_are_one_line_and_a_code(capsys, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    cases = [
        (["replay", str(tmp_path / "none")], "no such recording"),
        (
            ["replay", str(BAGS / "stockpile"), "--set", "filter.radus_m=1"],
            "did you mean 'radius_m'",
        ),
        (["replay", str(BAGS / "stockpile"), "-o", str(blocked / "out")], "cannot be written"),
        (["replay", str(BAGS / "stockpile"), "--topic", "cloud=other"], "no topic 'other'"),
        (["info", str(blocked)], "not a readable recording"),
        (["check-config", str(tmp_path / "none.yaml")], "cannot be read"),
    ]
    for words, text in cases:
        assert main(words) == 2
        err = capsys.readouterr().err
        assert text in err and "Traceback" not in err and err.count("\n") == 1


def test_a_truncated_recording_keeps_its_good_beginning(capsys, tmp_path):
    whole = (BAGS / "stockpile" / "stockpile.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    code = main(
        [
            "replay",
            str(cut),
            "--config",
            str(BAGS / "stockpile" / "config.yaml"),
            "-o",
            str(tmp_path / "out"),
        ]
    )
    shown = capsys.readouterr()
    assert code == 2 and "Traceback" not in shown.err and "cut.mcap" in shown.err


def test_info_and_check_config_speak_plainly(capsys):
    assert main(["info", str(BAGS / "stockpile"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    with BagReader(BAGS / "stockpile") as bag:
        assert facts["duration_s"] == bag.duration_s
    assert facts["roles"]["cloud"] == "velodyne_points"
    assert main(["check-config", str(BAGS / "stockpile" / "config.yaml")]) == 0
    assert "good" in capsys.readouterr().out


def test_a_pile_that_the_region_cuts_is_doubtful(capsys, tmp_path):
    words = ("--set", "georeference.region_m=[-2,-18,-10,20,18,30]", "--strict", "--no-figure")
    code = main(["replay", str(BAGS / "stockpile"), "-o", str(tmp_path), "--json", *words])
    result = json.loads(capsys.readouterr().out)
    assert code == 3 and result["verdict"]["status"] == "doubtful"
    (cut,) = (r for r in result["verdict"]["reasons"] if r["name"] == "cut")
    assert "georeference.region_m" in cut["text"] and 5.0 < cut["value"] < 643.1 - 425.7


def test_the_report_shows_how_the_volume_came_about(tmp_path, capsys):
    words = ["replay", str(BAGS / "box"), "--duration", "6", "--convergence", "3"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    stations = result["convergence"]
    assert len(stations) == 4 and stations[-1]["volume_m3"] == result["volume_m3"]
    assert [s["share"] for s in stations[:3]] == pytest.approx([0.25, 0.5, 0.75], abs=0.05)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert 'id="figure-convergence"' in page and "after 100 % of the recording" in page
    assert "boresight_roll_deg" in page
    assert 'id="figure-residuals"' in page


@pytest.mark.parametrize("words", [("--start", "1e308"), ("--start", "nan"), ("--duration", "-1")])
def test_a_start_or_a_duration_that_is_none_is_refused(words, capsys, tmp_path):
    assert main(["replay", str(BAGS / "box"), *words, "-o", str(tmp_path / "out")]) == 2
    assert "give a start of 0 or more" in capsys.readouterr().err
