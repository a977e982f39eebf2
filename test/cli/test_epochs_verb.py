"""``ladar_volume epochs``: unchanged and changed surveys, misregistered ones, little overlap."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from volume_surfaces import cone, platform, surface_update

from ladar_volume.cli.main import main
from ladar_volume.io.results import result_dict
from ladar_volume.io.surveys import write_survey
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.registration.transform import Transform
from ladar_volume.volume.estimator import VolumeEstimator

#: A budget of a few millimetres: what is shifted by centimetres stands out.
SHARP = {
    "boresight_sigma_deg": [0.0, 0.0, 0.0],
    "lever_laser_sigma_m": [0.0, 0.0, 0.0],
    "lever_antenna_sigma_m": [0.0, 0.0, 0.0],
    "range_bias_sigma_m": 0.002,
    "beam_range_sigma_m": 0.0,
    "beam_vertical_sigma_deg": 0.0,
}
PIT = -math.pi * 16.0


def flat(x, y):
    return 3.0 + 0.02 * x


def pit(x, y):
    return flat(x, y) - cone(x, y)


def survey(path, height, move=None, navigation=0.002, half=10.0, seed=0):
    """A result of a synthetic survey on disk; ``move`` displaces its points."""
    p = Parameters.read(
        {
            "filter": {"nav_bin_s": 1.0},
            "volume": {"base": "level", "level_m": 0.0, "outline": "all"},
            "budget": SHARP,
        }
    )
    e = VolumeEstimator(p)
    e.add_platform(platform(position=navigation, attitude=0.0))
    update = surface_update(height, seed=seed, half=half, perturb=0.004)
    if move is not None:
        r = move(update.points.r_map)
        update = dataclasses.replace(update, points=dataclasses.replace(update.points, r_map=r))
    e.add(update)
    estimate = e.estimate()
    path.mkdir()
    result = result_dict(estimate, p, Losses(), None, {}, {"path": path.name})
    write_survey(path / "result.mcap", estimate, e.epoch(), result)
    return path


def raised(z, x=0.0):
    """Points moved by x and z, m."""
    return lambda r: r + np.array([x, 0.0, z])


def epochs(capsys, folder, *words):
    """Exit code and facts of the verb on ``folder``/a and ``folder``/b."""
    out = folder / "out"
    code = main(["epochs", *map(str, (folder / "a", folder / "b", "-o", out)), *words, "--json",
                 "--no-figure"])  # fmt: skip
    shown = capsys.readouterr()
    return code, json.loads(shown.out) if shown.out else shown.err


def names(facts):
    return {reason["name"] for reason in facts["verdict"]["reasons"]}


@pytest.fixture
def before(tmp_path):
    survey(tmp_path / "a", flat)
    return tmp_path


def test_unchanged_and_changed_ground_is_sound(before, capsys):
    survey(before / "b", pit, seed=1)
    code, facts = epochs(capsys, before, "--strict")
    assert code == 0 and facts["verdict"] == {"status": "sound", "reasons": []}
    assert abs(facts["volume_m3"] - PIT) < 3.0 * facts["sigma_m3"] + 1e-3 * abs(PIT)
    assert facts["stable_ground"]["share"] > 0.7 and "stable_ground" not in facts["budget_m6"]
    (before / "b" / "result.mcap").unlink()
    (before / "b").rmdir()
    survey(before / "b", flat, seed=2)
    _, facts = epochs(capsys, before)
    assert (
        abs(facts["volume_m3"]) < 3.0 * facts["sigma_m3"] and facts["stable_ground"]["share"] > 0.95
    )


@pytest.mark.parametrize("shift", [-0.05, 0.02, 0.1])
def test_a_shift_enters_sigma_and_the_verdict(before, capsys, shift):
    survey(before / "b", pit, move=raised(shift), seed=1)
    code, facts = epochs(capsys, before, "--strict")
    assert code == 3 and names(facts) == {"registration"}
    assert facts["stable_ground"]["offset_m"] == pytest.approx(shift, abs=0.004)
    assert abs(facts["volume_m3"] - PIT) < 3.0 * facts["sigma_m3"]
    assert facts["sigma_m3"] ** 2 == pytest.approx(sum(facts["budget_m6"].values()))
    rim = ["--stable", "-10,-10", "10,-10", "10,-6", "-10,-6"]
    _, facts = epochs(capsys, before, *rim)
    assert facts["stable_ground"]["named"] and names(facts) == {"registration"}
    assert facts["stable_ground"]["offset_m"] == pytest.approx(shift, abs=0.004)


def test_a_wide_budget_covers_the_shift(tmp_path, capsys):
    survey(tmp_path / "a", flat, navigation=0.03)
    survey(tmp_path / "b", flat, navigation=0.03, move=raised(0.04), seed=1)
    _, facts = epochs(capsys, tmp_path)
    assert facts["verdict"]["status"] == "sound"
    assert abs(facts["volume_m3"]) < 3.0 * facts["sigma_m3"]


def test_a_transform_brings_its_doubts(before, capsys):
    T = Transform(exp_so3(np.zeros(3)), np.zeros(3), np.zeros(3), 1.0, np.zeros((7, 7)))
    survey(before / "b", flat, seed=1)
    facts = {"matrix": T.matrix().tolist(), "pivot_m": [0, 0, 0], "scale": 1.0,
             "covariance": T.C.tolist(), "consistent": False}  # fmt: skip
    (before / "T.json").write_text(json.dumps(facts))
    _, found = epochs(capsys, before, "--transform", str(before / "T.json"))
    assert names(found) == {"inconsistent"}
    reason = {"name": "renumbered", "text": "spheres 2 and 3 were swapped", "value": 2}
    facts |= {"verdict": {"status": "doubtful", "reasons": [reason]}}
    (before / "T.json").write_text(json.dumps(facts))
    _, found = epochs(capsys, before, "--transform", str(before / "T.json"))
    assert names(found) == {"renumbered"} and "T.json" in found["verdict"]["reasons"][0]["text"]


def test_little_overlap_is_said_or_refused(before, capsys):
    survey(before / "b", flat, move=raised(0.26, 13.0), seed=1)
    _, facts = epochs(capsys, before)
    assert "overlap" in names(facts) and facts["stable_ground"]["overlap"] == pytest.approx(
        0.35, abs=0.05
    )
    code, text = epochs(capsys, before, "--stable", "-9,-9", "-8,-9", "-8,-8")
    assert code == 2 and "stable ground" in text and text.count("\n") == 1
