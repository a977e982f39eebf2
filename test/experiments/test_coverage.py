"""The coverage study: its sites and surveys against closed forms, its file against interruption,
its statistics against known samples.
"""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ladar_volume.cli.main import main
from ladar_volume.experiments.coverage import coverage, coverage_flight
from ladar_volume.experiments.coverage.coverage_box import BOX, body_on_ground, one_per_cube
from ladar_volume.experiments.coverage.coverage_cases import (
    CLOSED,
    DEFAULT,
    GROUND,
    LEVEL,
    SITES,
    VARIANTS,
    at_vertex_level,
    believed_parameters,
    by_source,
    measure_survey,
    net_volumes,
    scale_budget,
    truth,
    volume_changes_by_source,
)
from ladar_volume.experiments.coverage.coverage_engine import measure_by_engine
from ladar_volume.experiments.coverage.coverage_flight import (
    DURATION_S,
    hits_of,
    pulses_of,
    rotation_of_angles,
)
from ladar_volume.experiments.coverage.coverage_scene import FIELDS, level_truth, march
from ladar_volume.experiments.coverage.coverage_survey import (
    SOURCES,
    SurveyErrors,
    budget_of_lines,
    fly,
    nominal,
    platform_states,
    survey,
)
from ladar_volume.experiments.coverage.coverage_tables import tables
from ladar_volume.georeference.error_budget import attitude_covariance_from_euler
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.errors import ConfigurationError, SurfaceError
from ladar_volume.model.parameters import BudgetParameters, Parameters
from ladar_volume.simulation.drawn_errors import markov
from ladar_volume.simulation.platforms import uav
from ladar_volume.volume.estimator import VolumeEstimator

SMALL = dataclasses.replace(SITES["stockpile_100"], pulses=2500)
PIT = dataclasses.replace(SITES["pit"], pulses=1500)


def test_the_volume_of_a_site_is_the_integral_of_its_heights():
    for site in FIELDS.values():
        x, y = (np.linspace(-h, h, 1201) for h in (site.a + 1.0, site.b + 1.0))
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        body = site.smooth(grid) - grid @ np.array([0.012, -0.008])
        cell = (x[1] - x[0]) * (y[1] - y[0])
        assert body.sum() * cell == pytest.approx(site.volume_m3, rel=2e-4)


@pytest.mark.parametrize("name", FIELDS)
def test_rays_end_on_the_surface_and_not_behind_it(name):
    site, rng = SITES[name], np.random.default_rng(1)
    ground = site.ground(3)
    origin = np.concatenate([rng.uniform(-10, 10, (400, 2)), rng.uniform(20, 30, (400, 1))], axis=1)
    target = np.concatenate([rng.uniform(-5, 5, (400, 2)), np.zeros((400, 1))], axis=1)
    ray = (target - origin) / np.linalg.norm(target - origin, axis=1, keepdims=True)
    t = site.ranges(origin, ray, ground)
    seen = np.isfinite(t)
    assert seen.mean() > 0.9

    def above(share):
        at = origin[seen] + (share * t[seen])[:, None] * ray[seen]
        return at[:, 2] - ground(at[:, :2]) - site.smooth(at[:, :2])

    assert np.abs(above(1.0)).max() < 2e-3 and np.median(np.abs(above(1.0))) < 2e-5
    for share in np.linspace(0.5, 0.995, 40):
        assert above(share).min() > -0.03


def test_pulses_left_out_would_not_have_hit(monkeypatch):
    def clear():
        pulses_of.cache_clear()
        hits_of.cache_clear()

    for site in (SMALL, PIT, dataclasses.replace(BOX, pulses=4000)):
        clear()
        few, near = (
            len(pulses_of(site, 3)[0].time_s),
            fly(site, budget_of_lines(DEFAULT), DEFAULT, 3).points.r_map,
        )
        clear()
        with monkeypatch.context() as patched:
            patched.setattr(coverage_flight, "NEAR_M", 1e6)
            assert few < 0.95 * len(pulses_of(site, 3)[0].time_s)
            assert np.array_equal(
                near, fly(site, budget_of_lines(DEFAULT), DEFAULT, 3).points.r_map
            )
        clear()


def test_kernels_of_a_flight_by_other_formulas():
    rng = np.random.default_rng(4)
    angles = rng.uniform(-3.0, 3.0, (50, 3))
    assert rotation_of_angles(angles).as_matrix() == pytest.approx(
        Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    )
    keep, steps = rng.uniform(0.5, 1.0, 20), rng.standard_normal((20, 3))
    new = np.sqrt(1.0 - np.r_[0.0, keep[1:]] ** 2)
    share = [
        [np.prod(keep[j + 1 : i + 1]) if j <= i else 0.0 for j in range(20)] for i in range(20)
    ]
    assert markov(keep, steps) == pytest.approx(share @ (new[:, None] * steps), rel=1e-12)
    origin, ray = (
        np.c_[rng.uniform(-8, 8, (40, 2)), np.full(40, 20.0)],
        np.c_[rng.uniform(-0.3, 0.3, (40, 2)), np.full(40, -1.0)],
    )
    found, shape = np.zeros(40), np.array([5.0, 4.0, 2.0, 0.3, 0.01, -0.02])
    march(origin, ray, np.full(40, 2.0), shape, found)

    def above(t, o, r):
        x, y, z = o + t * r
        stump = np.interp(np.hypot(x / 5.0, y / 4.0), [0.3, 1.0], [2.0, 0.0])
        return z - 0.01 * x + 0.02 * y - stump

    expected = [brentq(above, 0.0, 40.0, args=at) for at in zip(origin, ray, strict=True)]
    assert found == pytest.approx(expected, abs=5e-3) and np.ptp(found) > 1.5


def test_the_table_of_the_ground_is_its_sinusoids():
    ground, rng = SITES["pit"].ground(4), np.random.default_rng(6)
    xy = rng.uniform(-6, 6, (500, 2))
    exact = sum(part(xy[:, 0], xy[:, 1]) for part in ground.parts)
    assert np.abs(ground(xy) - exact).max() < 3e-5
    dense = np.stack(
        np.meshgrid(np.linspace(-4, 4, 401), np.linspace(-3, 3, 401), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    assert ground.mean_over_box(4.0, 3.0) == pytest.approx(ground(dense).mean(), abs=1e-5)
    assert np.std([SITES["pit"].ground(k)(xy[:50]) for k in range(60)]) == pytest.approx(
        0.010, rel=0.1
    )


def test_normals_are_the_gradient():
    site, rng = SITES["stockpile_5000"], np.random.default_rng(2)
    xy = rng.uniform(-15, 15, (300, 2))
    h = 1e-6
    slope = np.stack(
        [
            (site.smooth(xy + d) - site.smooth(xy - d)) / (2 * h)
            for d in (np.array([h, 0]), np.array([0, h]))
        ],
        axis=1,
    )
    n = site.normals(xy)
    smooth = np.abs(np.hypot(xy[:, 0] / site.a, xy[:, 1] / site.b) - site.top) > 1e-3
    assert np.allclose((-n[:, :2] / n[:, 2:])[smooth], slope[smooth], atol=1e-6)


def test_rays_end_on_the_box():
    rng, ground = np.random.default_rng(1), BOX.ground(3)
    half, roof = 0.5 * np.array(BOX.size_m[:2]), ground.mean_over_box(3.0, 1.25) + 2.5
    faces = {
        (0, 0, 1): np.c_[rng.uniform(-half, half, (50, 2)), np.full(50, roof)],
        (1, 0, 0): np.c_[
            np.full(50, half[0]), rng.uniform(-1.2, 1.2, 50), rng.uniform(0.2, 2.4, 50)
        ],
        (0, -1, 0): np.c_[
            rng.uniform(-2.9, 2.9, 50), np.full(50, -half[1]), rng.uniform(0.2, 2.4, 50)
        ],
    }
    eye = np.array([5.0, -6.0, 9.0])
    for face, at in faces.items():
        ray = (at - eye) / np.linalg.norm(at - eye, axis=1, keepdims=True)
        t = BOX.ranges(np.tile(eye, (50, 1)), ray, ground)
        assert t == pytest.approx(np.linalg.norm(at - eye, axis=1), abs=1e-6)
        assert np.array_equal(
            BOX.normals_at(eye + t[:, None] * ray), np.tile(np.array(face, float), (50, 1))
        )
    beside = np.c_[rng.uniform(-4.0, 4.0, 50), rng.uniform(-3.6, -1.6, 50)]
    at = np.c_[beside, beside @ np.array([0.012, -0.008]) + ground(beside)]
    ray = (at - eye) / np.linalg.norm(at - eye, axis=1, keepdims=True)
    t = BOX.ranges(np.tile(eye, (50, 1)), ray, ground)
    assert t == pytest.approx(np.linalg.norm(at - eye, axis=1), abs=1e-3)
    assert np.isnan(BOX.ranges(eye[None], np.array([[0.99, 0.0, -0.1]]), ground)).all()
    assert one_per_cube(
        np.array([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.6, 0.0, 0.0]]), 0.5
    ).tolist() == [0, 2]


def test_the_gradient_of_a_closed_box_is_that_of_its_volume():
    site = dataclasses.replace(BOX, pulses=60_000)
    points = survey(site, budget_of_lines(DEFAULT), Parameters(), 3).update.points
    body, gradient, _ = body_on_ground(points)
    assert body.volume_m3 == pytest.approx(site.volume_m3, rel=0.003)
    assert (
        np.abs(gradient.sum(axis=0)).max() < 1e-2
    )  # a common shift changes nothing: ground and walls move too
    rng = np.random.default_rng(5)
    wave = 1e-3 * np.sin(points.r_map @ rng.standard_normal((3, 3)))
    up, down = (
        body_on_ground(dataclasses.replace(points, r_map=points.r_map + s * wave))[0].volume_m3
        for s in (1.0, -1.0)
    )
    assert up - down == pytest.approx(2.0 * float((gradient * wave).sum()), rel=0.05)


def test_a_closed_box_with_all_sources():
    row = measure_survey(SITES["box"], *VARIANTS["all"], 11)[CLOSED]
    assert abs(row.error_m3) < 4.0 * row.sigma_m3
    assert sum(row.budget_m6.values()) == pytest.approx(row.sigma_m3**2)
    assert (
        row.naive_m3 < row.sigma_m3
        and min(row.budget_m6["position"], row.budget_m6["base_surface"]) > row.budget_m6["noise"]
    )


def test_without_errors_a_survey_finds_the_volume():
    for base, volume in net_volumes(SITES["stockpile_100"], budget_of_lines(DEFAULT), 7).items():
        site = SITES["stockpile_100"]
        exact = (
            site.volume_m3
            if base == GROUND
            else level_truth(site, site.ground(7), (site.a + 1.5, site.b + 1.5), 0.0)
        )
        assert volume == pytest.approx(exact, rel=0.02 if base == GROUND else 0.005)


def test_without_errors_points_lie_on_the_surface():
    site = dataclasses.replace(SMALL, rough_m=0.0)
    r = survey(site, budget_of_lines(DEFAULT), Parameters(), 3).update.points.r_map
    assert (
        np.abs(r[:, 2] - site.smooth(r[:, :2])).max() < 1e-3
    )  # the sinusoids are there, with an amplitude of zero
    assert len(r) > 800


def test_budgets_of_the_variants():
    assert budget_of_lines(DEFAULT, *SOURCES) == DEFAULT
    assert (
        budget_of_lines(DEFAULT).position_sigma_m == (0.0, 0.0, 0.0)
        and budget_of_lines(DEFAULT, "clock").clock_sigma_s == DEFAULT.clock_sigma_s
    )
    larger = scale_budget(DEFAULT, sigmas=1.3, tau=3.0)
    assert larger.boresight_sigma_rad == pytest.approx(
        [1.3 * v for v in DEFAULT.boresight_sigma_rad]
    )
    assert (
        larger.tau_attitude_s == 60.0
        and larger.position_bias_fraction == DEFAULT.position_bias_fraction
    )
    assert all(isinstance(pair[0], BudgetParameters) for pair in VARIANTS.values())


def test_the_believed_covariance_is_that_of_the_georeferencing():
    site = SITES["stockpile_100"]
    mount = mounting(nominal(uav(*site.flight_m, DURATION_S)))
    states = platform_states(site, SurveyErrors.draw(DEFAULT, 1, 1), mount, DEFAULT)
    for k in (0, 700, 1500):
        assert states.C_nav[k, 3:, 3:] == pytest.approx(
            attitude_covariance_from_euler(states.q_map_body[k], DEFAULT.attitude_sigma_rad)
        )


def test_one_instrument_flies_twice():
    one, two, other = (SurveyErrors.draw(DEFAULT, i, f) for i, f in ((1, 5), (1, 6), (2, 5)))
    assert np.array_equal(one.boresight, two.boresight) and not np.array_equal(
        one.boresight, other.boresight
    )
    assert not np.array_equal(one.position, two.position) and np.array_equal(
        one.position, other.position
    )


def test_a_common_height_bias_needs_a_design_level_to_matter():
    site = dataclasses.replace(SMALL, pulses=4000)
    P = at_vertex_level(DEFAULT)
    one = survey(site, budget_of_lines(DEFAULT), P, 5)
    volumes = {}
    for lift in (0.0, 0.05):
        r = one.update.points.r_map + np.array([0.0, 0.0, lift])
        update = dataclasses.replace(
            one.update, points=dataclasses.replace(one.update.points, r_map=r)
        )
        for base in (GROUND, LEVEL):
            estimator = VolumeEstimator(believed_parameters(DEFAULT, site, base))
            estimator.add_platform(one.states)
            estimator.add(update)
            volumes[base, lift] = estimator.estimate().volume
    base = volumes[GROUND, 0.0]
    assert abs(volumes[GROUND, 0.05].volume_m3 - base.volume_m3) < 1e-6 * base.volume_m3
    level = volumes[LEVEL, 0.0]
    assert volumes[LEVEL, 0.05].volume_m3 - level.volume_m3 == pytest.approx(
        0.05 * level.area_m2, rel=1e-9
    )


@pytest.mark.parametrize("site", [SMALL, PIT], ids=["stockpile", "pit"])
def test_a_survey_is_repeatable_and_its_budget_adds_up(site):
    one, two = (measure_survey(site, *VARIANTS["all"], 11) for _ in range(2))
    assert one == two
    for row in one.values():
        assert sum(row.budget_m6.values()) == pytest.approx(row.sigma_m3**2)
        assert row.tau_m3[0] <= row.sigma_m3 <= row.tau_m3[1] * 1.001
        assert abs(row.error_m3) < 6.0 * row.sigma_m3


@pytest.mark.parametrize("site", [SMALL, PIT], ids=["stockpile", "pit"])
def test_the_volume_alone_is_that_with_a_budget(site):
    alone_m3 = net_volumes(site, DEFAULT, 12)
    for base, row in measure_survey(site, *VARIANTS["all"], 12).items():
        assert alone_m3[base] - truth(site, base, 12) == pytest.approx(row.error_m3, abs=1e-9)


def test_each_source_alone():
    found = volume_changes_by_source(PIT, 4)["two epochs"]
    assert set(found) == set(SOURCES)
    printed = measure_survey(PIT, *VARIANTS["all"], 4)["two epochs"].budget_m6
    for line, changed in found.items():
        assert len(set(changed)) == (1 if line == "noise" else 2)  # over another ground
        assert np.abs(changed).max() < 8.0 * math.sqrt(printed[line]) + 1e-3 * abs(PIT.volume_m3), (
            line
        )  # the triangulation changes too


def test_lines_of_one_source_are_added():
    lines = {
        "noise": 1.0,
        "noise_tangential": 2.0,
        "noise_previous": 4.0,
        "noise_tangential_previous": 8.0,
        "boresight": 16.0,
        "boresight_second_order": 32.0,
        "clock": 64.0,
    }
    assert by_source(lines) == {"noise": 15.0, "boresight": 48.0, "clock": 64.0}


def test_statistics_of_a_known_sample():
    rows = [
        {
            "error_m3": e,
            "sigma_m3": 2.0,
            "naive_m3": 1.0,
            "tau_m3": [1.0, 3.0],
            "budget_m6": {"noise": 4.0},
        }
        for e in np.random.default_rng(3).normal(0.5, 2.0, 4000)
    ]
    s = coverage.statistics(rows, 10.0)
    assert s["ratio"] == pytest.approx(1.0, abs=0.03) and s["ratio_naive"] == pytest.approx(
        0.5, abs=0.02
    )
    assert s["bias_m3"] == pytest.approx(0.5, abs=0.1) and s["holds_95"] == pytest.approx(
        0.94, abs=0.015
    )
    assert s["budget_m3"] == {"noise": 2.0} and s["tau_m3"] == [1.0, 3.0]
    assert coverage.limits(200)["ratio"] == (0.85, 1.15) and coverage.limits(2000)["ratio"] == (
        0.9,
        1.1,
    )


def test_the_line_of_a_source_is_what_it_does_over_either_ground():
    rng = np.random.default_rng(7)
    source, one, two = rng.standard_normal((3, 4000)) * np.array([[0.5], [0.8], [0.8]])
    changes = [
        {line: [s + a, s + b] for line in ("clock", "noise")}
        for s, a, b in zip(source, one, two, strict=True)
    ]
    lines = coverage.line_statistics(
        [(change, {"clock": 0.25, "noise": 0.25}) for change in changes]
    )
    assert lines["clock"]["ratio"] == pytest.approx(1.0, abs=4.0 * lines["clock"]["ratio_sigma"])
    assert lines["clock"]["ratio_sigma"] == pytest.approx(
        0.5 * math.sqrt((0.25**2 + 0.89**2) / 4000) / 0.25, rel=0.1
    )
    assert (
        lines["clock"]["with_ground_m3"]
        == lines["noise"]["empirical_m3"]
        == pytest.approx(math.sqrt(0.89), rel=0.03)
    )
    single = [
        ({"clock": change["clock"][:1]}, variance)
        for change, variance in zip(changes, [{"clock": 0.25}] * 4000, strict=True)
    ]
    assert coverage.line_statistics(single)["clock"]["empirical_m3"] == pytest.approx(
        math.sqrt(0.89), rel=0.03
    )
    nothing = coverage.line_statistics([({"clock": [0.0, 0.0]}, {"clock": 0.0})])["clock"]
    assert nothing["empirical_m3"] == 0.0 and math.isnan(nothing["ratio"])


def test_normals_go_where_the_points_go():
    site = dataclasses.replace(SMALL, rough_m=0.0)
    shift = dataclasses.replace(
        budget_of_lines(DEFAULT),
        position_sigma_m=(0.4, 0.4, 0.4),
        position_bias_fraction=1.0,
        position_white_fraction=0.0,
    )
    moved, still = (
        net_volumes(site, budget, 7)[GROUND] for budget in (shift, budget_of_lines(DEFAULT))
    )
    assert moved == pytest.approx(still, rel=1e-6)  # a survey that is shifted as one


def test_a_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(
        coverage, "do", lambda t: {**dataclasses.asdict(t), **coverage.provenance(), "result": {}}
    )
    todo, path, told = coverage.tasks(["pit"], (3, 2, 1)), tmp_path / "s.jsonl", []
    assert len(todo) == 3 + 2 + (len(VARIANTS) - 1)
    coverage.run(todo[:4], path, 1, told.append)
    path.write_text(path.read_text()[:-20])  # broken off within the last line
    coverage.run(todo, path, 1, told.append)
    assert told == [0, 1, 2, 3, 4, *range(3, len(todo) + 1)]
    rows = coverage.read_rows(path)
    assert coverage.finished_tasks(rows) == set(todo) and len(rows) == len(todo)
    old = [
        {**json.loads(json.dumps(rows[0])), **other}
        for other in ({"version": "0.0"}, {"method": 1})
    ]
    del (last := dict(rows[0]))["method"]
    path.write_text("".join(json.dumps(row) + "\n" for row in (*old, last)))
    assert coverage.sorted_rows(path) == ([], 3)
    with pytest.raises(ConfigurationError):
        coverage.tasks(["moon"], (1, 1, 1))


def test_a_survey_that_is_refused_is_counted(monkeypatch):
    def measured_but(site, drawn, believed, seed):
        if seed % 2:
            raise SurfaceError("a gap", reason="closing_gap")
        return measure_survey(site, drawn, believed, seed)

    monkeypatch.setitem(SITES, "pit", dataclasses.replace(PIT, pulses=500))
    monkeypatch.setattr(coverage, "measure_survey", measured_but)
    rows = [coverage.do(coverage.Task("pit", "all", seed)) for seed in (1, 2, 3, 4)]
    assert [r.get("refused") for r in rows] == ["a gap", None, "a gap", None]
    found = coverage.summary(rows, ["pit"])
    assert (
        found["pit"]["two epochs"]["variants"]["all"]["surveys"]
        == found["pit"]["two epochs"]["variants"]["all"]["refused"]
        == 2
    )
    assert "(2 refused)" in tables(found)


def test_the_verb_writes_tables_and_json(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(SITES, "pit", dataclasses.replace(PIT, pulses=500))
    for name in list(VARIANTS)[2:]:
        monkeypatch.delitem(VARIANTS, name)
    words = [
        "study",
        "coverage",
        "--scenario",
        "pit",
        "--surveys",
        "2",
        "--workers",
        "1",
        "--json",
        "-o",
        str(tmp_path / "c"),
    ]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["scenarios"]["pit"]["two epochs"]["variants"]["all"]["surveys"] == 2
    assert (tmp_path / "c" / "tables.md").read_text() == tables(facts["scenarios"])
    assert main(words) == 0  # nothing is left to do
    assert json.loads(capsys.readouterr().out) == facts
    assert main(["study", "coverage", "--scenario", "moon", "-o", str(tmp_path / "d")]) != 0


def test_what_is_terminated_leaves_no_process(tmp_path):
    """Workers end with the study, and it goes on where it was."""
    words = [
        "study",
        "coverage",
        "--scenario",
        "pit",
        "--surveys",
        "100000",
        "--workers",
        "2",
        "-o",
        str(tmp_path),
    ]
    with subprocess.Popen(
        [sys.executable, "-m", "ladar_volume.cli.main", *words], stderr=subprocess.PIPE, text=True
    ) as study:
        deadline, rows = time.monotonic() + 200.0, tmp_path / coverage.FILE
        while (
            not (rows.is_file() and rows.stat().st_size)
            and study.poll() is None
            and time.monotonic() < deadline
        ):
            time.sleep(0.1)
        workers = [
            Path("/proc", pid)
            for pid in Path(f"/proc/{study.pid}/task/{study.pid}/children").read_text().split()
        ]
        assert len(workers) >= 2
        study.terminate()
        _, said = study.communicate(timeout=100.0)
    assert study.returncode == 143 and said.splitlines()[-1] == "ladar_volume: terminated"
    while any(w.exists() for w in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(w.exists() for w in workers)
    assert coverage.read_rows(rows)


def test_a_survey_from_messages_through_the_engine():
    found = measure_by_engine("stockpile_100", 80_000, thin=60)
    for row in found.values():
        assert abs(row.error_m3) < 5.0 * row.sigma_m3
        assert sum(row.budget_m6.values()) == pytest.approx(row.sigma_m3**2)
    assert found[LEVEL].budget_m6["position"] > 100.0 * found[GROUND].budget_m6["position"]
    both = coverage.tasks(["stockpile_100", "pit"], (0, 0, 0), 2)
    assert both == [
        coverage.Task(name, coverage.ENGINE, 80_000 + k)
        for name in ("stockpile_100", "pit")
        for k in range(2)
    ]


def test_a_pit_from_messages_through_the_engine():
    (row,) = measure_by_engine("pit", 80_000, thin=60).values()
    assert abs(row.error_m3) < 5.0 * row.sigma_m3
    assert sum(row.budget_m6.values()) == pytest.approx(row.sigma_m3**2)
    # each flight has its own instrument: what both lift alike does not cancel
    area = 4.0 * math.prod(SITES["pit"].half_m)
    assert math.sqrt(row.budget_m6["range_bias"]) == pytest.approx(
        math.sqrt(2.0) * area * DEFAULT.range_bias_sigma_m, rel=0.1
    )


def test_a_box_from_messages_through_the_engine():
    (row,) = measure_by_engine("box", 80_000, thin=40).values()
    assert abs(row.error_m3) < 4.0 * row.sigma_m3 < 0.02 * BOX.volume_m3
    assert (
        sum(row.budget_m6.values()) == pytest.approx(row.sigma_m3**2)
        and row.budget_m6["closing"] > 0.0
    )
