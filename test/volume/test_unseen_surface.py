"""The surface of a gap: against another way to krige, by laws of scale, and at its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist, pdist

from ladar_volume.volume.field_checks import unseen_surface as unseen
from ladar_volume.volume.field_checks.gap_kriging import (
    LONG,
    MORE,
    REACH,
    SEEN,
    SPACINGS,
    ObservedPoints,
    Prediction,
    above_film,
    diameter,
    predict_heights,
    predict_integral,
    rim_points,
)
from ladar_volume.volume.field_checks.unseen_surface import (
    CELLS,
    FALLS,
    TRIALS,
    GapTrial,
    scale_from_trials,
    swing_m6,
    trial_places,
    try_gap,
    unseen_surface,
    within_repose,
)


def gap(side=2.0, count=6):
    """Places of a square gap about the origin and their areas."""
    step = (np.arange(count) + 0.5) / count * side - side / 2.0
    place = np.stack([a.ravel() for a in np.meshgrid(step, step)], axis=1)
    return place, np.full(count**2, (side / count) ** 2)


def seen_around(seed=1, side=2.0, far=7.0, count=1500, height=None, sigma_m=0.01):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-far, far, (count, 2))
    xy = xy[np.abs(xy).max(axis=1) > side / 2.0]
    z = np.sin(1.1 * xy[:, 0]) + np.cos(0.9 * xy[:, 1]) if height is None else height(xy)
    return ObservedPoints.of(np.column_stack([xy, z]), np.full(len(xy), sigma_m**2), 0.35)


def plain_rim(seen, xy, weight, apart, wide):
    """:func:`rim_points` by trees and sorted squares."""
    size = min(diameter(weight.sum()), LONG * wide)
    most = min(MORE * SEEN, SEEN * diameter(weight.sum()) / size)
    reach = max(REACH * size, SPACINGS * seen.spacing_m) + apart.max()
    middle = (weight @ xy) / weight.sum()
    far = np.hypot(*(xy - middle).T).max() + reach
    rows = np.array(seen.tree.query_ball_point(middle, far, return_sorted=True), np.int64)
    if not len(rows):
        return rows
    d, at = cKDTree(xy).query(seen.r[rows, :2])
    rows, side = rows[(d >= apart[at]) & (d <= reach)], seen.spacing_m
    rows = np.array(sorted(rows, key=lambda i: (*seen.r[i, :2], i)), np.int64)
    while len(rows) > most:
        best = {}
        for i in rows:
            u = seen.r[i, :2] / side
            off = float(((u - np.floor(u) - 0.5) ** 2).sum())
            if off < best.get(tuple(np.floor(u)), (np.inf,))[0]:
                best[tuple(np.floor(u))] = off, i
        keep = {i for _, i in best.values()}
        rows, side = np.array([i for i in rows if i in keep], np.int64), 1.3 * side
    return rows


@pytest.mark.parametrize("seed", range(40))
def test_the_rim_is_that_of_trees_and_sorted_squares(seed):
    rng = np.random.default_rng(seed)
    r = rng.uniform(-20.0, 20.0, (int(rng.integers(0, 4000)), 3))
    if seed % 4 == 0:
        r = np.round(2.0 * r) / 2.0  # many in one place
    xy = rng.uniform(-10.0, 10.0, 2) + rng.normal(0.0, rng.uniform(0.1, 4.0), (30, 2))
    weight, apart = rng.uniform(0.01, 1.0, 30), rng.uniform(0.0, 1.0, 30) * (seed % 2)
    seen = ObservedPoints.of(r, np.ones(len(r)), rng.uniform(0.05, 1.0))
    wide = math.inf if seed % 3 == 0 else rng.uniform(0.1, 3.0)
    found = rim_points(seen, xy, weight, apart, wide)
    assert np.array_equal(found, plain_rim(seen, xy, weight, apart, wide))


def test_the_integral_of_a_gap_is_the_best_of_all_that_know_nothing_of_planes():
    """Weights of the points that keep planes, with the least variance: found within the null space
    of the planes, not by Lagrange's equations.
    """
    seen, (place, weight) = seen_around(), gap()
    rim = rim_points(seen, place, weight, np.zeros(len(place)), math.inf)
    p = seen.r[rim, :2]
    planes = np.column_stack([np.ones(len(p)), p])
    held = np.linalg.lstsq(planes.T, np.array([4.0, 0.0, 0.0]), rcond=None)[0]
    free = null_space(planes.T)
    K, k = cdist(p, p) ** 3, cdist(p, place) ** 3 @ weight
    by_point = held + free @ np.linalg.solve(free.T @ K @ free, free.T @ (k - K @ held))
    variance = weight @ cdist(place, place) ** 3 @ weight - 2.0 * by_point @ k
    variance += by_point @ K @ by_point
    found = predict_integral(seen, rim, place, weight)
    assert found.volume_m3 == pytest.approx(by_point @ seen.r[rim, 2], abs=1e-7)
    assert found.unit_m6 == pytest.approx(variance, rel=1e-6)
    assert found.noise_m6 == pytest.approx(1e-4 * by_point @ by_point, rel=1e-6)
    heights = predict_heights(seen, rim, place)
    assert weight @ heights == pytest.approx(found.volume_m3, abs=1e-7)


def test_chords_are_as_tight_as_a_soap_film_at_points():
    """With the distance itself the surface goes through the points and keeps planes, and lies
    within what surrounds it.
    """
    seen, (place, weight) = seen_around(), gap()
    rim = rim_points(seen, place, weight, np.zeros(len(place)), math.inf)
    at_points = predict_heights(seen, rim, seen.r[rim, :2], 1)
    np.testing.assert_allclose(at_points, seen.r[rim, 2], atol=1e-8)
    z = predict_heights(seen, rim, place, 1)
    assert seen.r[rim, 2].min() < z.min() and z.max() < seen.r[rim, 2].max()


@pytest.mark.parametrize("s", [0.01, 30.0])
def test_a_gap_in_other_units_is_the_same_gap(s):
    place, weight = gap()
    apart = np.full(len(place), 0.2)
    one = seen_around()
    two = ObservedPoints.of(s * one.r, s * s * one.variance, s * one.spacing_m)
    chord = np.full(len(place), 0.75)
    a = unseen_surface(one, place, weight, apart, chord)
    b = unseen_surface(two, s * place, s * s * weight, s * apart, s * chord)
    assert a.trials == b.trials > 0
    assert b.volume_m3 == pytest.approx(s**3 * a.volume_m3)
    assert b.variance_m6 == pytest.approx(s**6 * a.variance_m6, rel=1e-6)


def test_rim_points_lie_around_the_gap_beyond_what_is_apart_and_within_reach():
    seen, (place, weight) = seen_around(count=300), gap(count=10)
    for apart in (0.0, 0.6):
        rim = rim_points(seen, place, weight, np.full(len(place), apart), math.inf)
        # a circle of the gap's area, or four spacings, whichever is more
        reach = max(0.6 * math.sqrt(4.0 * 4.0 / math.pi), 4.0 * 0.35) + apart
        d = cdist(seen.r[:, :2], place).min(axis=1)
        assert sorted(rim) == np.flatnonzero((d >= apart) & (d <= reach)).tolist()
    many = seen_around(count=20_000)
    rim = rim_points(many, place, weight, np.zeros(len(place)), math.inf)
    assert SEEN / 3 < len(rim) <= SEEN and len(set(rim)) == len(rim)
    sectors = np.bincount((np.arctan2(*many.r[rim, :2].T) // (math.pi / 4)).astype(int) + 4)
    assert sectors.min() > len(rim) / 24  # from all sides
    nothing = rim_points(many, place + 1000.0, weight, np.zeros(len(place)), math.inf)
    assert len(nothing) == 0


def test_a_gap_is_laid_all_around_once_in_each_place():
    seen, (place, weight) = seen_around(), gap()
    shift = trial_places(seen, place, weight)
    assert len(shift) == 8 * TRIALS  # of which most are not wholly seen
    size = math.sqrt(4.0 * 4.0 / math.pi)
    r = np.hypot(*shift.T)
    assert (np.diff(r) >= 0.0).all() and r[-1] == pytest.approx(2.5 * size)
    # evenly over the disc: half of them within the circle of half its area, alike in all quarters
    assert np.count_nonzero(r <= 2.5 * size / math.sqrt(2.0) + 1e-9) == len(shift) // 2
    quarter = np.bincount((np.arctan2(*shift.T) // (math.pi / 2)).astype(int) + 2, minlength=4)
    assert np.ptp(quarter) <= 3
    each = math.pi * (2.5 * size) ** 2 / len(shift)
    assert pdist(shift).min() > 0.9 * math.sqrt(each)


def test_trials_are_errors_of_what_was_seen_and_predicted():
    """Where a surface is a plane with noise, a trial has no error beyond its noise."""
    rng = np.random.default_rng(4)
    place, weight = gap()
    plane = seen_around(height=lambda p: 0.3 * p[:, 0] + 1.0)
    for trial in try_gap(plane, place, weight, np.full(len(place), 0.2)):
        assert trial.error_m2 < 0.1 and trial.bulge_m2 < 1e-12
    own = seen_around(height=lambda p: rng.normal(0.0, 0.3, len(p)), sigma_m=0.3)
    found = try_gap(own, place, weight, np.full(len(place), 0.2))
    assert len(found) >= 6 and np.median([t.error_m2 for t in found]) < 0.3**2 / 20.0
    sure = ObservedPoints.of(own.r, 1e-12 * own.variance, own.spacing_m)
    again = try_gap(sure, place, weight, np.full(len(place), 0.2))
    assert all(a.error_m2 <= b.error_m2 for a, b in zip(found, again, strict=True))
    assert sum(b.error_m2 for b in again) > sum(a.error_m2 for a in found) + 1e-4


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_a_trial_is_of_mean_heights_whatever_the_size_of_the_gap(size):
    """c |h|³ over a gap of twice the width: of the mean height eight times the variance."""
    one, (place, weight) = seen_around(count=4000, far=14.0), gap(1.0)
    two = ObservedPoints.of(one.r * [size, size, 1.0], one.variance, size * one.spacing_m)
    apart = np.full(len(place), 0.3)
    a, b = (
        try_gap(one, place, weight, apart),
        try_gap(two, size * place, size**2 * weight, size * apart),
    )
    assert len(a) == len(b) > 0
    for s, t in zip(a, b, strict=True):
        assert t.unit_m2 == pytest.approx(size**3 * s.unit_m2)
        assert (t.error_m2, t.bulge_m2) == pytest.approx((s.error_m2, s.bulge_m2))


def test_a_circle_as_large_as_a_gap():
    assert diameter(math.pi * 1.5**2) == pytest.approx(3.0)


def test_the_factor_and_the_share_that_trials_tell():
    assert scale_from_trials([], 0.0) == (0.0, 0.0)
    assert scale_from_trials([], 2.0) == (0.0, pytest.approx(0.25))  # half of it, squared
    trials = [GapTrial(4.0, 2.0, 0.0), GapTrial(3.0, 3.0, 0.0)]
    assert scale_from_trials(trials, 1.0) == (pytest.approx(1.5), pytest.approx(0.25))
    # errors as large as the bulges: all of it, the more so the more trials there are
    few, many = (
        scale_from_trials(count * [GapTrial(9.0, 1.0, 4.0)], 1.0)[1] for count in (1, 1000)
    )
    assert 0.25 < few < many < 1.0 and many == pytest.approx(1.0, abs=1e-3)
    # and half of what four like the gap itself would tell, where as many tell of no error
    four = scale_from_trials(4 * [GapTrial(0.0, 1.0, 1.0)], 1.0)[1]
    assert four == pytest.approx(0.125)


@pytest.fixture
def told(monkeypatch):
    """A gap whose prediction is known: 5 m³ with 0.3 m⁶ for c = 1 and noise of 0.02 m⁶; trials as
    asked; calls of the trials.
    """
    place, weight = gap()
    calls, trials = [], []

    def lay(seen, xy, weight, apart):
        calls.append((xy, weight, apart))
        return list(trials)

    monkeypatch.setattr(unseen, "try_gap", lay)
    monkeypatch.setattr(unseen, "predict_integral", lambda *given: Prediction(5.0, 0.3, 0.02))
    monkeypatch.setattr(unseen, "predict_heights", lambda *given: np.full(len(place), 1.25))
    monkeypatch.setattr(unseen, "above_film", lambda *given: (0.0 * weight, 0.0 * weight))

    def of(height, chord_m3, *given):
        calls.clear(), trials.clear(), trials.extend(given)
        seen = seen_around(height=height)
        chord = np.full(len(place), chord_m3 / 4.0)
        return unseen_surface(seen, place, weight, np.full(len(place), 0.2), chord)

    return of, calls


def steep(p):
    return 3.0 * np.abs(p[:, 0]) + 1.0


def level(p):
    return np.full(len(p), 1.25)


def test_the_variance_of_a_gap_is_of_its_roughness_its_noise_and_its_bulge(told):
    of, _ = told
    six = 6 * [GapTrial(0.4, 0.2, 0.0)]
    assert of(steep, 5.0, *six).variance_m6 == pytest.approx(2.0 * 0.3 + 0.02)
    found = of(steep, 5.6, *six)
    assert found.variance_m6 == pytest.approx(2.0 * 0.3 + 0.02 + 0.25 * 0.6**2)
    assert found.volume_m3 == pytest.approx(5.0) and found.trials == 6
    assert of(steep, 5.0) is None


def test_slopes_of_loose_material_bound_a_gap(told):
    of, _ = told
    seen, (place, weight) = seen_around(height=level), gap()
    rim = rim_points(seen, place, weight, np.zeros(len(place)), unseen.width_of(np.array([0.2])))
    room = 2.0 * weight @ cdist(place, seen.r[rim, :2]).min(axis=1)  # at 45 degrees, up and down
    bound = room**2 / 12.0  # anywhere between, with the same probability
    assert of(level, 5.0).variance_m6 == pytest.approx(bound)
    assert of(level, 5.0, *6 * [GapTrial(1e6, 1.0, 0.0)]).variance_m6 == pytest.approx(bound)
    assert of(level, 5.0, *6 * [GapTrial(0.1, 1.0, 0.0)]).variance_m6 == pytest.approx(0.05)
    high = np.full(len(place), 50.0)
    z, volume = within_repose(seen.r[rim], place, weight, high)
    assert weight @ (z - 1.25) == pytest.approx(room / 2.0) and volume == pytest.approx(room)
    low, _ = within_repose(seen.r[rim], place, weight, -high)
    np.testing.assert_allclose(z + low, 2.5)


def test_the_heights_around_bound_a_gap_beside_a_wall(told):
    """One trial that was next to certain and wrong says nothing of metres beyond the rim."""
    of, _ = told
    seen, (place, weight) = seen_around(height=steep), gap()
    rim = rim_points(seen, place, weight, np.zeros(len(place)), unseen.width_of(np.array([0.2])))
    bound = (4.0 * np.ptp(seen.r[rim, 2])) ** 2 / 12.0
    found = of(steep, 5.0, *5 * [GapTrial(0.1, 1.0, 0.0)], GapTrial(0.1, 1e-6, 0.0))
    assert found.variance_m6 == pytest.approx(bound)


def test_smaller_gaps_of_the_same_shape_are_laid_until_there_are_enough(told):
    of, calls = told
    of(steep, 5.0, *5 * [GapTrial(0.4, 0.2, 0.0)])
    assert len(calls) == 2  # five are too few, ten are not
    place, weight = gap()
    of(steep, 5.0, GapTrial(0.4, 0.2, 0.0))
    assert len(calls) == 4
    for xy, area, apart in calls:
        size = float(np.ptp(xy[:, 0]) / np.ptp(place[:, 0]))
        np.testing.assert_allclose(xy, size * place, atol=1e-12)
        np.testing.assert_allclose(area, size**2 * weight)
        np.testing.assert_allclose(apart, size * 0.2)
    assert np.diff([len(c[0]) for c in calls]).tolist() == [0, 0, 0] and CELLS > 36


def test_where_a_surface_falls_between_two_levels_is_not_known():
    """A step of 45 degrees that begins anywhere in a long gap: its standard deviation is what the
    smooth surface's differences from the chords tell, in the mean over points at random.
    """
    place, weight = gap(2.0, 24)
    place, weight = place * [1.0, 6.0], 6.0 * weight

    def told(height, seed):
        xy = np.random.default_rng(seed).uniform(-7.0, 7.0, (4000, 2))
        xy = xy[(np.abs(xy[:, 0]) > 1.0) | (np.abs(xy[:, 1]) > 6.0)]
        r = np.column_stack([xy, height(xy[:, 0])])
        seen = ObservedPoints.of(r, np.full(len(r), 1e-8), 0.2)
        rim = rim_points(seen, place, weight, np.zeros(len(place)), math.inf)
        return FALLS * swing_m6(seen, rim, place, weight) ** 0.5

    ratios = []
    for high in (0.9, 1.15):
        first, last = (np.clip(place[:, 0] - at, 0.0, high) @ weight for at in (-1.0, 1.0 - high))
        each = [told(lambda x, h=high: np.where(x > 0.0, h, 0.0), seed) for seed in range(12)]
        ratios += [one / ((first - last) / 12.0**0.5) for one in each]
    assert 0.85 < np.mean(ratios) < 1.25 and min(ratios) > 0.5 and max(ratios) < 2.5
    # a fold lies on one side of its chords, a plane on none
    assert told(lambda x: 0.3 * x + 2.0, 2) < 1e-6
    assert told(np.abs, 2) < 0.3 * min(each)


def test_noise_is_no_fall():
    rng = np.random.default_rng(7)
    place, weight = gap()
    noisy = seen_around(
        height=lambda p: 0.2 * p[:, 0] + rng.normal(0.0, 0.05, len(p)), sigma_m=0.05
    )
    rim = rim_points(noisy, place, weight, np.zeros(len(place)), math.inf)
    assert swing_m6(noisy, rim, place, weight) == 0.0
    sure = ObservedPoints.of(noisy.r, 1e-12 * noisy.variance, noisy.spacing_m)
    assert swing_m6(sure, rim, place, weight) > 1e-5


def test_a_film_is_below_the_smooth_surface_by_what_both_predict():
    seen, (place, weight) = seen_around(), gap()
    rim = rim_points(seen, place, weight, np.zeros(len(place)), math.inf)
    above, noise = above_film(seen, rim, place)
    smooth, film = (predict_heights(seen, rim, place, power) for power in (3, 1))
    np.testing.assert_allclose(above, smooth - film, atol=1e-9)
    rng, drawn = np.random.default_rng(1), []
    for _ in range(300):
        r = seen.r + np.column_stack([0.0 * seen.r[:, :2], rng.normal(0.0, 0.01, len(seen.r))])
        other = ObservedPoints.of(r, seen.variance, seen.spacing_m)
        drawn.append(above_film(other, rim, place)[0])
    np.testing.assert_allclose(np.std(drawn, axis=0), noise, rtol=0.2)


def test_too_few_points_or_points_on_a_line_tell_nothing():
    place, weight = gap()
    apart = np.zeros(len(place))
    ring = 1.2 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.arange(6) * math.pi / 3])
    for r, some in ((ring, True), (ring[:5], False)):
        seen = ObservedPoints.of(r, np.ones(len(r)), 1.0)
        rim = np.arange(len(r))
        assert (predict_integral(seen, rim, place, weight) is not None) == some
        assert np.isfinite(predict_heights(seen, rim, place)).all() == some
    line = np.column_stack([np.arange(8.0), np.zeros(8), np.zeros(8)])
    seen = ObservedPoints.of(line, np.ones(8), 1.0)
    assert predict_integral(seen, np.arange(8), place, weight) is None
    assert unseen_surface(seen, place + 900.0, weight, apart, apart) is None


@pytest.mark.parametrize("arc", [math.pi, 2.0 * math.pi])
def test_a_moat_around_a_pile_is_seen_by_its_width(arc):
    """The slopes at either side of a long gap tell where the toe is; points taken as far apart as
    the gap is long made errors of up to 16 standard deviations.
    """
    rng = np.random.default_rng(70)
    xy = rng.uniform(-15.0, 15.0, (14_000, 2))
    radius, angle = np.hypot(*xy.T), np.abs(np.arctan2(xy[:, 1], xy[:, 0]))
    true = np.maximum(0.0, 5.0 - 0.625 * radius)
    moat = (np.abs(radius - 8.0) < 1.75) & (angle <= arc / 2.0)
    seen = ObservedPoints.of(
        np.column_stack([xy, true + rng.normal(0.0, 0.015, len(xy))])[~moat],
        np.full(np.count_nonzero(~moat), 0.015**2),
        0.25,
    )
    place = xy[moat][::20]
    weight = np.full(len(place), 3.5 * 8.0 * arc / len(place))
    apart = unseen.APART * seen.tree.query(place)[0]
    z = np.maximum(0.0, 5.0 - 0.625 * np.hypot(*place.T))
    chord = 1.09 - (np.hypot(*place.T) - 6.25) * 1.09 / 3.5
    found = unseen_surface(seen, place, weight, apart, chord)
    error = found.volume_m3 - float(weight @ z)
    assert abs(error) < 2.5 * math.sqrt(found.variance_m6)
    assert abs(error) < 0.6 * float(weight @ (chord - z))
