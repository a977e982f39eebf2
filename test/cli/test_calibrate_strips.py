"""``ladar_volume calibrate strips``: a simulated flight in lanes, calibrated and replayed."""

import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.config import read_config

BUDGET = """/**:
  ros__parameters:
    budget:
      boresight_sigma_deg: [0.1563055, 0.08494642, 0.26614251]
      clock_sigma_s: 0.02
      attitude_sigma_deg: [0.004, 0.004, 0.01]
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lanes")
    (folder / "budget.yaml").write_text(BUDGET)
    words = [
        "simulate",
        "stockpile",
        "--platform",
        "lanes",
        "--seed",
        "2",
        "--duration",
        "60",
        "--thin",
        "40",
        "--mixed",
        "0",
    ]
    assert main([*words, "--config", str(folder / "budget.yaml"), "-o", str(folder / "bag")]) == 0
    return folder / "bag"


def test_a_flight_over_a_stockpile(bag, tmp_path, capsys):
    out = tmp_path / "calibration.yaml"
    assert main(["calibrate", "strips", str(bag), "-o", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    truth = json.loads((bag / "truth.json").read_text())
    p, base = read_config(out), read_config(bag / "config.yaml")
    c = facts["constants"]
    true = [*truth["boresight_error_rad"], truth["clock_error_s"]]
    sigma = np.array(
        [c[k]["sigma"] for k in ("boresight_x", "boresight_y", "boresight_z", "clock")]
    )
    error = np.append(p.calibration.boresight_correction_rad, p.calibration.clock_offset_s) - true
    assert (np.abs(error) < 3.5 * sigma).all()
    assert np.degrees(sigma[:3]).max() < 0.01 and sigma[3] < 0.5e-3 and abs(error[3]) < 0.5e-3
    assert facts["after_m"] < 0.3 * facts["before_m"] and facts["chi2"] / facts[
        "freedom"
    ] == pytest.approx(1.0, abs=0.2)
    assert (
        c["boresight_x"]["status"] == "estimated"
        and c["lever_laser_z"]["status"] == "held at its prior"
    )
    assert (
        p.budget.boresight_sigma_rad == pytest.approx(sigma[:3])
        and len(p.budget.calibration_correlation) == 43 * 42 // 2
    )
    assert p.georeference == base.georeference and p.filter == base.filter


def test_the_calibrated_file_is_replayed_with_one_line_for_the_calibration(bag, tmp_path, capsys):
    out = tmp_path / "calibration.yaml"
    assert (
        main(
            ["calibrate", "strips", str(bag), "-o", str(out), "--returns", "40000", "--edge", "1.5"]
        )
        == 0
    )
    text = capsys.readouterr().out
    assert "estimated" in text and "worst determined" in text and "strips agree" in text
    assert (
        main(
            [
                "replay",
                str(bag),
                "--config",
                str(out),
                "--json",
                "--no-figure",
                "-o",
                str(tmp_path / "out"),
            ]
        )
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert "calibration" in result["budget_m6"] and "boresight" not in result["budget_m6"]
    assert {"boresight", "clock", "lever_laser"} <= result["budget_within_m6"].keys()
    assert sum(result["budget_m6"].values()) == pytest.approx(result["sigma_m3"] ** 2)


def test_what_cannot_be_calibrated_is_one_line(bag, tmp_path, capsys):
    cases = [
        (["--returns", "5"], "1000 or more"),
        (["--duration", "4"], "strips must overlap"),
        (["--start", "60.5"], "georeferenced"),
    ]
    for extra, words in cases:
        assert main(["calibrate", "strips", str(bag), "-o", str(tmp_path / "x.yaml"), *extra]) == 2
        error = capsys.readouterr().err
        assert words in error and not (tmp_path / "x.yaml").exists()
