"""``ladar_volume calibrate repeats``: tables in, parameter files out."""

import json
import re

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.config import read_config


def table(
    path,
    rows,
    header="mounting,boresight_roll_deg,boresight_pitch_deg,boresight_yaw_deg,lever_laser_x_m",
):
    path.write_text(
        "# a comment\n"
        + header
        + "\n"
        + "\n".join(",".join(str(v) for v in row) for row in rows)
        + "\n"
    )
    return path


@pytest.fixture
def archive(tmp_path):
    rng, rows = np.random.default_rng(1), []
    for m in range(12):
        put_on = rng.normal(0, 0.15, 3)
        rows += [
            [f"m{m}", *(put_on + rng.normal(0, 0.03, 3) + [0, 20, 0]), 0.12 + rng.normal(0, 4e-4)]
            for _ in range(3)
        ]
    return table(tmp_path / "archive.csv", rows)


def test_the_budget_file_is_what_replay_reads(archive, tmp_path, capsys):
    out = tmp_path / "budget.yaml"
    base = tmp_path / "base.yaml"
    base.write_text(
        "/**:\n  ros__parameters:\n    calibration: {boresight_pitch_deg: 20.0}\n    "
        "filter: {radius_m: 0.3}\n"
    )
    assert (
        main(
            ["calibrate", "repeats", str(archive), "--config", str(base), "-o", str(out), "--json"]
        )
        == 0
    )
    facts = json.loads(capsys.readouterr().out)
    p = read_config(out)
    assert p.filter.radius_m == 0.3 and p.calibration.boresight_correction_rad == (0.0, 0.0, 0.0)
    assert np.degrees(p.budget.boresight_sigma_rad) == pytest.approx(
        0.03, rel=0.4
    )  # within one mounting
    assert p.budget.lever_laser_sigma_m[0] == pytest.approx(
        4e-4, rel=0.4
    ) and p.budget.lever_laser_sigma_m[1:] == (0.002, 0.003)
    x = facts["constants"]["boresight_x_deg"]
    assert (
        x["count"] == 36
        and x["by_mounting"]["mountings"] == 12
        and x["by_mounting"]["sigma_between"] == pytest.approx(0.15, rel=0.5)
    )
    assert facts["budget"]["boresight_sigma_deg"][0] == x["by_mounting"]["sigma_within"]


def test_a_mean_is_written_with_its_sigma(archive, tmp_path, capsys):
    out = tmp_path / "budget.yaml"
    base = tmp_path / "base.yaml"
    base.write_text("/**:\n  ros__parameters:\n    calibration: {boresight_pitch_deg: 20.0}\n")
    assert (
        main(
            [
                "calibrate",
                "repeats",
                str(archive),
                "--config",
                str(base),
                "--uses",
                "remounted",
                "-o",
                str(out),
            ]
        )
        == 0
    )
    p = read_config(out)
    assert np.degrees(p.budget.boresight_sigma_rad) == pytest.approx(0.15, rel=0.5)
    assert p.calibration.lever_laser_m[0] == pytest.approx(0.12, abs=3e-4)
    assert (
        np.abs(np.degrees(p.calibration.boresight_correction_rad)).max() < 0.15
    )  # the mean of twelve mountings
    text = capsys.readouterr().out
    assert "between" in text and "remounted" in text


def test_the_mean_of_angles_is_their_angles(tmp_path, capsys):
    rows = [[0.12, 0.51, 0.90], [0.10, 0.50, 0.93], [0.13, 0.49, 0.91], [0.11, 0.52, 0.92]]
    names = "boresight_roll_deg,boresight_pitch_deg,boresight_yaw_deg"
    file = table(tmp_path / "angles.csv", rows, names)
    assert main(["calibrate", "repeats", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    mean = dict(zip(names.split(","), [0.115, 0.505, 0.915], strict=True))  # small: as numbers
    assert facts["mean_angles_deg"] == pytest.approx(mean, abs=1e-5)
    assert main(["calibrate", "repeats", str(file)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "boresight_pitch_deg 0.5050" in printed and not re.search(r"\de-\d", printed)


def test_small_rotations_add_to_the_base(tmp_path):
    file = table(tmp_path / "x.csv", [[0.1], [0.3]], "boresight_y_deg")
    out = tmp_path / "x.yaml"
    assert main(["calibrate", "repeats", str(file), "--uses", "mean", "-o", str(out)]) == 0
    p = read_config(out)
    assert np.degrees(p.calibration.boresight_correction_rad) == pytest.approx([0, 0.2, 0])
    assert np.degrees(p.budget.boresight_sigma_rad) == pytest.approx([0.02, 0.1, 0.04])


def test_bad_tables_are_one_line_and_leave_no_file(tmp_path, capsys):
    out = tmp_path / "out.yaml"
    cases = {
        "a.csv": ("speed\n1\n2\n", "expected are some of"),
        "b.csv": ("lever_laser_x_m\n1\nx\n", "row 2, lever_laser_x_m: 'x'"),
        "c.csv": ("lever_laser_x_m\n1\n", "two values"),
        "d.csv": ("lever_laser_x_m\n", "rows of numbers"),
        "e.csv": ("lever_laser_x_m\n0.1\n0.1\n", "copies of one value"),
        "f.csv": ("boresight_roll_deg\n1\n2\n", "come together"),
        "g.csv": ("lever_laser_x_m,lever_laser_y_m\n1,2\n1\n", "row 2 has 1 cells"),
        "h.csv": ("lever_laser_x_m\n1\n99\n", "out of range"),
        "i.csv": ("mounting,clock_offset_s\na,1\n,2\n", "names no mounting"),
        "j.csv": ("mounting,clock_offset_s\na,1\nb,2\n", "measured twice"),
    }
    for name, (text, words) in cases.items():
        (tmp_path / name).write_text(text)
        assert main(["calibrate", "repeats", str(tmp_path / name), "-o", str(out)]) == 2
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1, name
        assert not out.exists()
    assert main(["calibrate", "repeats", str(tmp_path / "none.csv")]) == 2
