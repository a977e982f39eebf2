"""Where another pass helps most: the fall of the variance against surveys flown again, and gaps."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from volume_surfaces import BIN_NS, T0, cone, platform, surface_update, take_patches

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilterUpdate, select
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.uncertainty.navigation_sum import markov_sum
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.more_data import SOURCES, enclosed_triangles, markov_product, relief

LEVEL = {"base": "level", "level_m": 0.0, "outline": "all"}


def estimator(update, volume=LEVEL, **sections):
    e = VolumeEstimator(
        Parameters.read({"filter": {"nav_bin_s": 1.0}, "volume": volume, **sections})
    )
    e.add_platform(platform())
    e.add(update)
    return e


def hill(x, y):
    return 3.0 + cone(x, y)


def without(update, drop):
    """The survey without the patches of a mask (m,)."""
    patches = take_patches(update.patches, np.flatnonzero(~drop))
    return FilterUpdate(
        update.t_ns,
        update.removed,
        select(update.points, np.isin(update.points.patch, patches.key)),
        patches,
    )


def test_needs_an_estimate_first():
    with pytest.raises(VolumeError) as caught:
        estimator(surface_update(hill)).more_data()
    assert caught.value.reason == "volume_no_estimate"


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9, 1.0])
def test_what_is_enclosed(share):
    """Against the connected parts of a graph: those without a triangle at the hull."""
    rng = np.random.default_rng(6)
    tin = build_tin(rng.random((400, 3)))
    inside = rng.random(len(tin.triangles)) < share
    t, side = np.nonzero(~inside[:, None] & (tin.neighbours >= 0))
    joined = ~inside[tin.neighbours[t, side]]
    graph = coo_matrix(
        (np.ones(joined.sum()), (t[joined], tin.neighbours[t, side][joined])),
        shape=(len(inside),) * 2,
    )
    label = connected_components(graph, directed=False)[1]
    open_ended = label[~inside & (tin.neighbours < 0).any(axis=1)]
    assert np.array_equal(enclosed_triangles(tin, inside), ~inside & ~np.isin(label, open_ended))


def test_one_cell_for_all_is_a_second_survey():
    t, y = np.array([0.0, 1.0, 4.0, 4.5, 9.0]), np.random.default_rng(0).standard_normal((5, 3))
    for tau in (0.5, 20.0):
        K = np.exp(-np.abs(t[:, None] - t) / tau)
        assert np.allclose(markov_product(t, y, tau), K @ y)
        assert float((y * markov_product(t, y, tau)).sum()) == pytest.approx(markov_sum(t, y, tau))


def test_a_cell_with_noisy_returns_is_where_to_fly_and_by_how_much():
    update = surface_update(hill, noise=0.01)
    noisy = (np.abs(update.patches.centre[:, :2] - [6.0, -4.0]) < 1.6).all(axis=1)

    def with_noise(factor):
        cross = np.where(noisy[:, None, None], factor * update.patches.cross, update.patches.cross)
        return estimator(
            dataclasses.replace(update, patches=dataclasses.replace(update.patches, cross=cross))
        )

    e = with_noise(4e6)
    before = e.estimate().volume
    found = e.more_data()
    first = found.best_cells(1)[0]
    assert (
        abs(first["x_m"] - 6.0) < 2.0 and abs(first["y_m"] + 4.0) < 2.0 and first["why"] == "noise"
    )
    # flown again, the independent variance of all those patches is half of what it was
    after = with_noise(2e6).estimate().volume
    cells = (np.abs(found.centre_map[:, :2] - [6.0, -4.0]) < 2.6).all(axis=1)
    fall = found.falls_m6[cells, SOURCES.index("noise")].sum()
    assert fall == pytest.approx(before.budget_m6["noise"] - after.budget_m6["noise"], rel=1e-3)
    assert (
        found.sigma_m3 == before.sigma_m3
        and found.sigma_gaps_m3 == 0.0
        and len(found.best_cells()) == 3
    )
    assert (found.sigma_m > 0.02).all()  # what one position's sigma does to every height


def test_falls_of_navigation_against_the_closed_form():
    budget = {
        "position_bias_fraction": 0.0,
        "position_white_fraction": 1.0,
        "attitude_bias_fraction": 1.0,
        "attitude_white_fraction": 0.0,
    }
    e = estimator(surface_update(hill), budget=budget)
    v = e.estimate().volume
    found = e.more_data().falls_m6
    # cells share time bins across the flight, so what one pass takes is more than half of the
    # cell's own; all cells together, a second survey, would take half of the variance: Σ Cov(T, a)
    # = Var(T)
    share = found[:, SOURCES.index("position")].sum()
    assert 0.5 * v.budget_m6["position"] < share < v.budget_m6["position"]
    assert np.allclose(
        found[:, SOURCES.index("attitude")], 0.0
    )  # constant over the survey: no pass takes it away


def test_a_gap_is_found_and_its_size_is_that_of_the_relief():
    def waves(x, y):
        return 3.0 + 0.4 * np.sin(0.9 * x + 0.3) * np.cos(0.8 * y)

    update, wide = surface_update(waves, spacing=0.25), {**LEVEL, "max_edge_m": 10.0}
    full = estimator(update, wide)
    full.estimate()
    assert full.more_data().sigma_gaps_m3 == 0.0
    hole = np.hypot(*(update.patches.centre[:, :2] - [4.0, 5.0]).T) < 1.5
    e = estimator(without(update, hole), wide)
    e.estimate()
    found = e.more_data()
    # the nearest other holes of the same size tell what interpolation across costs
    errors = []
    for x, y in ((-5, -5), (-5, 5), (5, -5), (0, 0), (-2, 6), (6, 1), (1, -6), (-7, 0)):
        drop = np.hypot(*(update.patches.centre[:, :2] - [x, y]).T) < 1.5
        errors.append(
            estimator(without(update, drop), wide).estimate().volume.volume_m3
            - full.estimate().volume.volume_m3
        )
    rms = math.sqrt(np.mean(np.square(errors)))
    assert rms / 4.0 < found.sigma_gaps_m3 < 4.0 * rms
    quiet = dataclasses.replace(found, falls_m6=found.falls_m6 * [0.0, 0.0, 0.0, 1.0])
    best = quiet.best_cells(1)[0]
    assert math.hypot(best["x_m"] - 4.0, best["y_m"] - 5.0) < 2.0 and best["why"] == "gap"
    # too wide for triangles that count, but enclosed by them: bridged all the same
    narrow = estimator(without(update, hole))
    assert narrow.estimate().volume.area_m2 == pytest.approx(e.estimate().volume.area_m2)
    assert narrow.more_data().sigma_gaps_m3 == pytest.approx(found.sigma_gaps_m3, rel=0.3)


def test_relief_of_known_surfaces():
    g = np.arange(0.0, 20.0, 0.25)
    x, y = (a.ravel() for a in np.meshgrid(g, g))
    quadric = np.c_[x, y, 0.5 * 0.3 * (x**2 + y**2)]
    lengths = np.array([1.0, 2.0, 4.0])
    assert relief(quadric, np.zeros(len(x)), lengths) == pytest.approx(
        0.3 * lengths**2 / 8.0, rel=0.02
    )  # neighbours within a tenth
    plane = np.c_[x, y, 0.1 * x]
    assert relief(plane, np.zeros(len(x)), lengths) == pytest.approx(0.0, abs=1e-9)
    rough = plane + np.c_[np.zeros((len(x), 2)), np.random.default_rng(1).normal(0.0, 0.05, len(x))]
    assert relief(rough, np.full(len(x), 0.05**2), lengths).max() < 0.02
    assert np.isnan(relief(quadric, np.zeros(len(x)), np.array([100.0]))).all()


def test_every_point_of_few_tells_the_relief_whatever_its_number():
    rng, lengths = np.random.default_rng(4), np.array([1.0, 3.0])
    points = np.c_[rng.uniform(0.0, 10.0, (400, 2)), rng.normal(0.0, 1.0, 400)]
    exact = relief(points, np.zeros(400), lengths)
    for first in (np.roll(np.arange(400), 1), np.arange(400)[::-1], rng.permutation(400)):
        assert relief(points[first], np.zeros(400), lengths) == pytest.approx(exact, rel=1e-12)


def test_above_the_surveys_own_ground_the_places_are_where_it_counts():
    e = estimator(surface_update(hill), volume={})
    v = e.estimate().volume
    found = e.more_data()
    assert (
        (found.gain_m3 >= 0.0).all()
        and found.gain_m3.max() < v.sigma_m3
        and len(found.best_cells(5)) == 5
    )
    assert T0 // BIN_NS > 0 and found.cell_m < 3.0
