"""``ladar_volume plan``: its numbers, its refusals, and the bundled survey predicted before it was
flown.
"""

from __future__ import annotations

import json
import math

import pytest

from ladar_volume.cli import main as cli

BUNDLED = "bags/stockpile"


def run(capsys, *words):
    code = cli.main(["plan", *words, "--json"])
    return code, json.loads(capsys.readouterr().out) if code == 0 else None


def test_more_fixes_make_the_position_better_and_too_few_are_refused(capsys):
    pile = ("--pile", "22", "18", "4", "--set", "budget.position_white_fraction=0.5")
    rare, usual, many = (
        run(capsys, *pile, *given)[1]["budget_m6"]["position"]
        for given in (("--fix-rate", "2"), (), ("--fix-rate", "50"))
    )
    # white errors are all there is within a tenth, and a mean of n has an n-th of their variance
    white = [v - many for v in (rare, usual)]
    assert white[0] / white[1] == pytest.approx((1 / 2 - 1 / 50) / (1 / 10 - 1 / 50), rel=0.02)
    assert run(capsys, *pile, "--fix-rate", "1")[0] == 2
    assert cli.main(["plan", *pile, "--fix-rate", "1"]) == 2
    error = capsys.readouterr().err
    assert "1.67 Hz or more" in error and "max_position_gap_s" in error


def test_the_bundled_survey_is_predicted(capsys, tmp_path):
    # the true scene and path of the recording: what a planner knows
    height = 9.0 * math.tan(math.radians(35.0)) * 0.75
    pile = (
        "--pile",
        "22",
        "18",
        f"{height}",
        "--top",
        "0.25",
        "--rough",
        "0.01",
        "--rough-length",
        "1.414",
    )
    code, plan = run(
        capsys,
        *pile,
        "--eight",
        "36",
        "--length",
        "45",
        "--rate",
        "50000",
        "--config",
        f"{BUNDLED}/config.yaml",
    )
    assert code == 0 and plan["true_volume_m3"] == pytest.approx(643.12, abs=0.01)
    assert cli.main(["replay", BUNDLED, "--json", "--no-figure", "-o", str(tmp_path)]) == 0
    survey = json.loads(capsys.readouterr().out)
    # the survey tells the ground's roughness and how far it is alike from the ground it sees: that
    # line scatters from survey to survey, and so does what readings of that ground differ by
    ground = ("base_surface", "base_model")
    known, found = (
        f["sigma_m3"] ** 2 - sum(f["budget_m6"].get(line, 0.0) for line in ground)
        for f in (plan, survey)
    )
    assert math.sqrt(known) == pytest.approx(math.sqrt(found), rel=0.15)
    assert (
        0.5
        < math.sqrt(plan["budget_m6"]["base_surface"] / survey["budget_m6"]["base_surface"])
        < 2.0
    )
    # nearly all of the rest; what the base cancels to a hundredth depends on single triangles of
    # the outline
    for source in ("position", "attitude", "noise", "beam_vertical"):
        assert math.sqrt(plan["budget_m6"][source]) == pytest.approx(
            math.sqrt(survey["budget_m6"][source]), rel=0.15
        ), source
    assert plan["largest_source"] == "base_surface" and survey["largest_source"] in ground
    for facts in (plan, survey):
        total = sum(facts["budget_m6"].values())
        assert total == pytest.approx(facts["sigma_m3"] ** 2, rel=1e-9)
        for source, sigma in facts["sigma_if_halved_m3"].items():
            assert sigma == pytest.approx(
                math.sqrt(total - 0.75 * facts["budget_m6"][source]), rel=1e-9
            )


def test_a_cone_compared_and_its_greatest_height(capsys):
    words = (
        "--volume",
        "30",
        "--rate",
        "30000",
        "--set",
        "volume.base=level",
        "--set",
        "volume.ground_ring_m=0.5",
        "--set",
        "filter.cap_per_voxel=6",
        "--lanes",
        "1",
    )
    code, plan = run(
        capsys, *words, "--compare", "--wanted", "0.02", "--budget", "survey", "--imu", "tactical"
    )
    assert code == 0 and plan["true_volume_m3"] == pytest.approx(30.0)
    assert [row["name"] for row in plan["sensors"]] == [
        f"{s} + {i}" for s in ("vlp16", "line") for i in ("survey", "tactical", "mems")
    ]
    assert len(plan["heights"]) == 8
    below = [
        float(r["name"])
        for r in plan["heights"]
        if r["sigma_share"] is not None and r["sigma_share"] <= 0.02
    ]
    assert (
        plan["maximum_height_m"] is None
        if not below
        else plan["maximum_height_m"] >= max(below) - 0.05
    )
    assert cli.main(["plan", *words, "--wanted", "1e-9"]) == 0
    text = capsys.readouterr().out
    assert "at no height tried" in text and "largest source" in text and "if halved" in text


@pytest.mark.parametrize(
    "words",
    [
        ("--imu", "best"),
        ("--scanner", "best"),
        ("--budget", "best"),
        ("--volume", "-5"),
        ("--lanes", "0"),
        ("--set", "volume.bse=level"),
    ],
)
def test_refusals_are_one_line(words, capsys):
    assert cli.main(["plan", *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
