"""The options of seed 000 in a survey's surface: each has its effect and its key, sigma holds, and
what cannot be combined is refused.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from volume_surfaces import cone, platform, surface_update

from ladar_volume.io.config import read_config
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import TinParameters
from ladar_volume.tin.elevation_adjustment import fit_of, measures
from ladar_volume.tin.median_screen import tin_filter, tin_screen
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.field_checks.surface_choice import with_choice
from ladar_volume.volume.field_checks.survey_surface import survey_surface

CONE = math.pi * 16.0
THIRD = {"vertex_ratio": 1 / 3}
SQUARE = {"outline": "polygon", "polygon_m": [-6, -6, 6, -6, 6, 6, -6, 6]}


def sloped(x, y):
    return cone(x, y, slope=(0.02, -0.05)) + 3.0


def estimator(update, volume=None, **tin):
    sections = {"volume": volume or {}, "tin": tin, "filter": {"nav_bin_s": 1.0}}
    e = VolumeEstimator(Parameters.read(sections))
    e.add_platform(platform())
    e.add(update)
    return e


def spiked(update, rows, by_m):
    r = update.points.r_map.copy()
    r[rows, 2] += by_m
    return dataclasses.replace(update, points=dataclasses.replace(update.points, r_map=r))


def misfit(update, tin):
    """Root mean square, m, of the residuals of all filtered points."""
    return measures(fit_of(tin, update.points.r_map, None).residuals(tin.vertices[:, 2]))[0]


@pytest.fixture(scope="module")
def update():
    return surface_update(sloped, spacing=0.25, perturb=0.01)


@pytest.fixture(scope="module")
def third(update):
    return estimator(update, THIRD).estimate()


@pytest.mark.parametrize(
    "options",
    [
        {"criterion": "residual"},
        {"criterion": "residual-sigma"},
        {"bins_per_row": 20},
        {"adjust": "asd"},
        {"adjust": "none"},
        {"exchange": "rms"},
        {"exchange": "asd", "readjust": False},
    ],
    ids=lambda o: "-".join(map(str, o.values())),
)
def test_another_surface_and_the_same_volume(update, third, options):
    found = estimator(update, THIRD, **options).estimate()
    one, two = found.tin.vertices, third.tin.vertices
    assert len(one) == pytest.approx(len(two), rel=0.01)
    assert one.shape != two.shape or not np.array_equal(one, two) or options.get("exchange")
    assert found.volume.volume_m3 != third.volume.volume_m3
    assert abs(found.volume.volume_m3 - CONE) < 2.0 * found.volume.sigma_m3
    assert 0.8 < found.volume.sigma_m3 / third.volume.sigma_m3 < 1.5
    lacking = "exchange" in options or options.get("criterion") == "residual-sigma"
    assert ("surface_choice" in found.volume.budget_m6) == lacking
    assert "surface_held_fixed" not in [d.name for d in found.volume.verdict.doubts]


def test_what_a_choice_by_the_noise_adds_is_a_line(update, third):
    for options in ({"exchange": "rms"}, {"criterion": "residual-sigma"}):
        v = estimator(update, THIRD, **options).estimate().volume
        off = v.volume_m3 - third.volume.volume_m3
        assert v.budget_m6["surface_choice"] == pytest.approx(off**2) and off != 0.0
        assert v.sigma_m3 == pytest.approx(math.sqrt(sum(v.budget_m6.values())), rel=1e-6)
    (doubted,) = with_choice((v,), TinParameters(exchange="rms"), lambda: ())
    assert "surface_held_fixed" in [d.name for d in doubted.verdict.doubts]
    assert with_choice((v,), TinParameters(), lambda: pytest.fail("not asked")) == (v,)


def test_exchange_lowers_the_misfit_and_adjustment_too(update, third):
    plain, none, best, last = (
        estimator(update, THIRD, **o)
        for o in (
            {},
            {"adjust": "none"},
            {"exchange": "rms"},
            {"exchange": "rms", "readjust": False},
        )
    )
    rms, raw, both, published = (
        misfit(update, e.estimate().tin) for e in (plain, none, best, last)
    )
    assert both < published < rms < raw


def test_the_iterated_adjustment_ends_where_the_solve_does_or_says_that_it_did_not(update, third):
    slow = {"adjust": "rms-iterated", "height_tolerance_m": 1e-9, "max_iterations": 5000}
    found = estimator(update, THIRD, **slow).estimate()
    assert found.volume.volume_m3 == pytest.approx(third.volume.volume_m3, rel=1e-6)
    assert found.volume.sigma_m3 == pytest.approx(third.volume.sigma_m3, rel=1e-6)
    short = estimator(update, THIRD, adjust="rms-iterated", max_iterations=1).estimate().volume
    assert "adjustment_unfinished" in [d.name for d in short.verdict.doubts]


def test_screen_and_filter_take_spikes_out_and_say_how_many(update):
    rows = np.random.default_rng(3).choice(len(update.points), 12, replace=False)
    bad = spiked(update, rows, 1.5)
    for option, count, by in (
        ("screen_m", "point_screened", tin_screen),
        ("median_m", "point_levelled", tin_filter),
    ):
        e = estimator(bad, {**SQUARE, "objects": "count"}, **{option: 0.6})
        found, alike = e.estimate(), by(bad.points.r_map, 0.6)
        assert e.screen_losses[count] == alike.count == 12
        order = np.argsort(found.tin.source)
        expected = alike.points_map[np.argsort(alike.index)]
        assert np.array_equal(found.tin.vertices[order], expected)
        clean = estimator(update, {**SQUARE, "objects": "count"}).estimate().volume
        assert found.volume.volume_m3 == pytest.approx(clean.volume_m3, abs=0.03)
        assert found.volume.sigma_m3 == pytest.approx(clean.sigma_m3, rel=0.1)
        with_spikes = estimator(bad, {**SQUARE, "objects": "count"}).estimate().volume
        assert abs(with_spikes.volume_m3 - clean.volume_m3) > 0.1
    sharp = estimator(update, screen_m=0.004).estimate().volume  # below the noise
    assert "screened" in [d.name for d in sharp.verdict.doubts]


def test_a_screened_partial_tin_adjusts_by_the_rows_of_all_points(update):
    rows = np.random.default_rng(4).choice(len(update.points), 12, replace=False)
    options = Parameters.read({"volume": THIRD, "tin": {"screen_m": 0.6, "exchange": "rms"}})
    made = survey_surface(spiked(update, rows, 1.5).points, options)
    assert not set(rows) & set(made.fit.point) and not set(rows) & set(made.tin.source)
    # a lift of all points lifts the heights as much: gradients meet the points they belong to
    G = made.by_heights(np.ones((len(made.tin.vertices), 1)), len(update.points))
    assert G[rows].tolist() == [[0.0]] * len(rows)
    assert G.sum() == pytest.approx(len(made.tin.vertices), rel=1e-9)


def test_boundary_editing_reaches_the_surface(update):
    r = update.points.r_map
    hole = (np.abs(r[:, 0] - 8.0) < 0.9) & (np.abs(r[:, 1] - 8.0) < 0.9)
    points = type(update.points)(*(np.asarray(c)[~hole] for c in vars(update.points).values()))
    counts = []
    for tin in ({"max_hole_m2": 6.0}, {}, {"max_ear_edge_m": 0.2}):
        options = Parameters.read({"volume": {"max_edge_m": 0.6}, "tin": tin})
        counts.append(int(survey_surface(points, options).tin.relevant.sum()))
    assert counts[0] > counts[1] > counts[2]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["tin.exchange=rms"], "tin.exchange is for a partial TIN"),
        (["tin.bins_per_row=5"], "volume.vertex_ratio below 1"),
        (["tin.adjust=none"], "partial TIN"),
        (["volume.vertex_ratio=0.3", "tin.max_iterations=5"], "rms-iterated"),
        (["volume.vertex_ratio=0.3", "tin.readjust=false"], "tin.exchange asd or rms"),
        (["volume.vertex_ratio=0.3", "volume.relevant=all"], "nobody measured"),
        (["tin.screen_m=-1"], "out of range"),
    ],
)
def test_what_has_no_effect_or_no_sigma_is_refused(overrides, words):
    with pytest.raises(ConfigurationError, match=words):
        read_config(None, overrides)


def test_an_exchange_is_accepted_with_its_ratio_in_any_order():
    for order in (1, -1):
        given = ["tin.exchange=rms", "volume.vertex_ratio=0.3"][::order]
        assert read_config(None, given).tin.exchange == "rms"
