"""Seed 004 section 5 and Table 2: printed values reproduced, corrected ones by independent
arithmetic.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from ladar_volume.cli import main as cli
from ladar_volume.experiments.stockpile import (
    ACROSS,
    ALONG,
    COAL,
    HEIGHTS_M,
    INTERPOLATED,
    PRINTED,
    PRINTED_POSITION_M,
    PRINTED_TABLE_2,
    READINGS,
    SOURCES,
    Cone,
    ToleranceRule,
    budget_of_source,
    point_sigmas,
    position_sigmas,
    summary,
)
from ladar_volume.experiments.stockpile_tables import TABLES, tables, write_figure
from ladar_volume.georeference.error_budget import PRESETS
from ladar_volume.model.errors import OutputError


def test_the_six_printed_sigmas():
    for height, printed in zip(HEIGHTS_M, PRINTED, strict=True):
        assert np.abs(READINGS[0].sigmas(height) - printed).max() < 0.0013
    assert READINGS[2].sigmas(150.0) == pytest.approx([0.399, 0.355, 0.206], abs=5e-4)


def test_position_added_and_in_quadrature():
    assert position_sigmas(False) == pytest.approx(PRINTED_POSITION_M, abs=6e-6)
    corrected = position_sigmas(True)
    assert math.hypot(*corrected) == pytest.approx(0.05, rel=1e-15)
    assert corrected[0] == pytest.approx(0.02425, abs=5e-6)
    assert corrected == pytest.approx(PRESETS["survey_corrected"].position_sigma_m, rel=1e-12)
    change = READINGS[1].sigmas(150.0) ** 2 - READINGS[0].sigmas(150.0) ** 2
    assert change == pytest.approx(np.square(corrected) - np.square(PRINTED_POSITION_M), rel=1e-9)


@pytest.mark.parametrize("beam", [ALONG, ACROSS])
def test_sources_add_up_and_follow_plane_geometry(beam):
    budget, r = PRESETS["survey"], 150.0
    each = {s: point_sigmas(budget_of_source(budget, s), beam, r) for s in SOURCES}
    assert sum(v**2 for v in each.values()) == pytest.approx(
        point_sigmas(budget, beam, r) ** 2, rel=1e-12
    )
    # by hand: a rotation w moves a point at v by w x v
    w, v = np.array(budget.boresight_sigma_rad), np.asarray(beam) * r
    by_hand = np.sqrt(
        [
            (w[1] * v[2]) ** 2 + (w[2] * v[1]) ** 2,
            (w[2] * v[0]) ** 2 + (w[0] * v[2]) ** 2,
            (w[0] * v[1]) ** 2 + (w[1] * v[0]) ** 2,
        ]
    )
    assert each["boresight"] == pytest.approx(by_hand, rel=1e-12)
    assert each["range"] == pytest.approx(np.abs(beam) * budget.range_noise_m, rel=1e-12, abs=1e-15)


def test_the_cone():
    assert math.pi * COAL.width_m**3 * math.tan(math.radians(35.0)) / 24.0 == pytest.approx(
        100.0, rel=1e-14
    )
    assert COAL.area_m2 * COAL.height_m / 3.0 == pytest.approx(100.0, rel=1e-14)
    change = COAL.changes(0.05)
    # the printed 0.086 m "width" is the change of the radius; the width changes by twice that
    assert (
        round(change["radius"], 4) == 0.0858
        and round(change["width"], 3) == 0.172
        and round(change["height"], 4) == 0.0601
    )
    assert change["common_shift"] == pytest.approx(change["height"], rel=1e-14)
    grown = (
        math.pi
        * (COAL.width_m + change["width_exact"]) ** 2
        * (COAL.height_m + change["height_exact"])
        / 12.0
    )
    assert grown == pytest.approx(105.0, rel=1e-14)


def test_the_formula_that_table_2_did_not_apply():
    facts = summary()
    assert facts["interpolated_z_m"]["printed"] == pytest.approx([0.080, 0.106], abs=5e-4)
    rng = np.random.default_rng(0)
    # mean variance of a height between three independent nodes is half of theirs (Zhu et al. 2005)
    p = rng.dirichlet([1, 1, 1], 200_000)
    assert (p**2).sum(axis=1).mean() == pytest.approx(INTERPOLATED**2, abs=0.001)
    # Table 2 prints the points' own sigmas
    for column, row in enumerate(PRINTED):
        assert [PRINTED_TABLE_2[k][column] for k in range(3)] == pytest.approx(row, abs=7e-4)


def test_tables_figure_and_verb(tmp_path, capsys):
    text = tables()
    assert all(f"## {title}" in text for title in TABLES)
    for number in ("0.02425", "0.1716", "0.0858", "0.0601", "0.080", "0.106", "0.3986"):
        assert number in text
    assert cli.main(["study", "stockpile", "-o", str(tmp_path / "out"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (
        facts["figures"] == ["precision.png"]
        and (tmp_path / "out" / "precision.png").stat().st_size > 10_000
    )
    assert json.loads((tmp_path / "out" / "study.json").read_text()) == facts
    assert (tmp_path / "out" / "tables.md").read_text() == text
    assert cli.main(["study", "stockpile"]) == 0 and "in quadrature" in capsys.readouterr().out
    with pytest.raises(OutputError):
        write_figure(tmp_path / "nowhere")


def test_equations_5_and_6_and_the_rule_for_any_pile(capsys):
    given = ["--volume", "2500", "--repose", "40", "--share", "0.02"]
    assert cli.main(["study", "stockpile", *given, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    # by hand: V = π W³ tan / 24 and H = W / 2 tan, before and after
    tan = math.tan(math.radians(40.0))
    width = [(24.0 * v / (math.pi * tan)) ** (1.0 / 3.0) for v in (2500.0, 2550.0)]
    assert facts["rule"]["needed_width_m"] == pytest.approx(width[1] - width[0], rel=1e-9)
    height = 0.5 * tan * (width[1] - width[0])
    assert facts["rule"]["needed_height_m"] == pytest.approx(height, rel=1e-9)
    for at in next(iter(facts["rule"]["readings"].values())):
        assert at["holds"] == (at["sigma_z_m"] <= height)
        least = ToleranceRule(Cone(at["smallest_m3"], math.radians(40.0)), 0.02)
        assert least.needed_m[1] == pytest.approx(at["sigma_z_m"], rel=1e-9)
    assert "| width | 0.086 |" in tables()
    assert "| width |  |" in tables(ToleranceRule(Cone(2500.0, 0.7), 0.02))
    for wrong in (["--volume", "0"], ["--repose", "90"], ["--share", "1"]):
        assert cli.main(["study", "stockpile", *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1
