"""Variance components of what passes differ by, from errors that are drawn."""

import dataclasses
import math

import numpy as np
import pytest
from volume_surfaces import T0, normal_frame

from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import Patches, PlatformStates, select
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.pass_agreement import pass_agreement, patch_scatter
from ladar_volume.uncertainty.pass_differences import (
    Residuals,
    UnitErrors,
    asked_patches,
    between_bins,
    bin_covariances,
    bin_residuals,
    likeness,
    pass_differences,
    scatter_of_looks,
    scatter_within_bins,
    steady_looks,
    told_by,
)
from ladar_volume.uncertainty.variance_components import scores, variance_components

BUDGET, BINS, BEAMS, BIN_NS = BudgetParameters(), 16, 8, 1_000_000_000
FIRST = T0 // BIN_NS


def flight():
    """Bins, of ten states each, of a platform at 20 m that flies to and fro, and their poses."""
    t = np.arange(BINS)
    back = t % 2 == 1
    p = np.stack([np.zeros(BINS), np.linspace(-12.0, 12.0, BINS), np.full(BINS, 20.0)], axis=1)
    q = np.where(back[:, None], (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    C = np.zeros((BINS, 6, 6))
    C[:, range(3), range(3)] = np.square(BUDGET.position_sigma_m)
    C[:, range(3, 6), range(3, 6)] = np.square(BUDGET.attitude_sigma_rad)
    nav = NavigationBins(1.0)
    still, segment = np.zeros((BINS, 3)), np.zeros(BINS, np.int64)
    states = PlatformStates((FIRST + t) * BIN_NS, p, q, still, still, C, segment)
    every = select(states, np.repeat(t, 10))
    nav.add(dataclasses.replace(every, t_ns=FIRST * BIN_NS + np.arange(10 * BINS) * BIN_NS // 10))
    return nav, p, np.where(back, -1.0, 1.0)


def patches(seed=0, m=200, returns=160):
    """Patches of any slope up to 30 degrees, all seen in every bin by every beam, with their
    sensitivities written out; residuals of noise alone.
    """
    rng = np.random.default_rng(seed)
    _, place, sign = flight()
    xy = rng.uniform(-12.0, 12.0, (m, 2))
    n = np.stack([*rng.uniform(-0.5, 0.5, (2, m)), np.ones(m)], axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t, side = normal_frame(n)
    centre = np.concatenate([xy, np.zeros((m, 1))], axis=1)
    M_nav = np.zeros((m, BINS, 5, 4))
    M_cal = np.zeros((m, 5, 11 + 2 * BEAMS))
    turn = np.stack([sign, sign, np.ones(BINS)], axis=1)  # half a turn about the vertical
    arm = (centre[:, None] - place) * turn
    unit = (centre - [0.0, 0.0, 20.0]) / np.linalg.norm(centre - [0.0, 0.0, 20.0], axis=1)[:, None]
    for row, axis in ((0, n), (3, t), (4, side)):
        M_nav[:, :, row, 0] = 1.0 / BINS
        M_nav[:, :, row, 1:] = np.cross(arm, axis[:, None] * turn) / BINS
        M_cal[:, row, 11 : 11 + BEAMS] = (axis * unit).sum(axis=1)[:, None] / BEAMS
    noise, each = 0.012, returns / BINS
    made = Patches(
        np.arange(m),
        centre,
        n,
        t,
        np.zeros((m, 3)),
        np.full(m, noise),
        np.full(m, returns, np.int32),
        np.full(m, T0),
        np.arange(m + 1),
        np.arange(m),
        np.zeros((m, 3, 3), np.float32),
        M_cal.astype(np.float32),
        BINS * np.arange(m + 1),
        np.tile(FIRST + np.arange(BINS), m),
        M_nav.reshape(m * BINS, 5, 4).astype(np.float32),
        nav_residual=rng.normal(0.0, noise / math.sqrt(each), m * BINS).astype(np.float32),
        beam_residual=rng.normal(0.0, noise / math.sqrt(returns / BEAMS), (m, BEAMS)).astype(
            np.float32
        ),
    )
    return made, arm, turn


def shifted(made, rise, by_beam):
    """The patches with rises (m, bins) m of what was seen in each bin, and (m, beams) of each
    beam.
    """
    rise = rise - rise.mean(axis=1, keepdims=True)
    by_beam = by_beam - by_beam.mean(axis=1, keepdims=True)
    square = made.sigma**2 + (rise**2).mean(axis=1) + (by_beam**2).mean(axis=1)
    return dataclasses.replace(
        made,
        sigma=np.sqrt(square),
        nav_residual=made.nav_residual + rise.ravel().astype(np.float32),
        beam_residual=made.beam_residual + by_beam.astype(np.float32),
    )


def drawn_rise(group, factor, seed):
    """Patches with errors of the whole budget, of one group that many times the sigma."""
    rng = np.random.default_rng([seed, 7])
    made, arm, turn = patches(seed)
    times = {
        g: factor if g == group else 1.0 for g in ("position", "attitude", "boresight", "beams")
    }
    apart = np.abs(np.subtract.outer(np.arange(BINS), np.arange(BINS)))

    def walk(constant, tau, sigma):
        C = constant + (0.9 - constant) * np.exp(-apart / tau) + 0.01 * np.eye(BINS)
        return np.linalg.cholesky(C) @ rng.normal(size=(BINS, 3)) * sigma

    b = BUDGET
    place = walk(b.position_bias_fraction, b.tau_position_s, b.position_sigma_m)
    angle = walk(b.attitude_bias_fraction, b.tau_attitude_s, b.attitude_sigma_rad)
    angle = times["attitude"] * angle + times["boresight"] * rng.normal(0.0, b.boresight_sigma_rad)
    # a turn w of the body moves what it sees by w x arm, in its own axes
    moved = np.cross(angle, arm) * turn + times["position"] * place
    rise = (moved * made.normal[:, None]).sum(axis=2)
    ranges = times["beams"] * rng.normal(0.0, b.beam_range_sigma_m, BEAMS)
    return shifted(made, rise, BEAMS * made.M_cal[:, 0, 11 : 11 + BEAMS] * ranges)


def components(made):
    out = {}
    for found in pass_differences(made, flight()[0], BUDGET, 0.1):
        out |= variance_components(found)
    return out


def test_effects_are_those_of_the_lidar_equation():
    made, arm, turn = patches()
    nav, b = flight()[0], BUDGET
    rows = asked_patches(made)
    looks = steady_looks(made, rows, nav)
    found, sizes = bin_residuals(made, rows, looks, nav, b)
    assert len(rows) == 200 and len(looks.bins) == BINS
    by_turn = np.cross(arm, made.normal[:, None] * turn).reshape(-1, 3)
    assert found.A[:, :3] == pytest.approx(by_turn * b.boresight_sigma_rad, abs=1e-6)
    bin_of = np.tile(np.arange(BINS), 200)
    for e in (0, 5):
        own = bin_of == e
        seen = found.A[own, 7 + 3 * e : 10 + 3 * e]
        assert seen == pytest.approx(made.normal * b.position_sigma_m)
        assert not found.A[~own, 7 + 3 * e : 10 + 3 * e].any()
    assert found.returns == pytest.approx(10.0) and sizes.position_m < 0.022
    white = np.full(BINS, 10.0), np.full(BINS, 1.0)
    C = bin_covariances(looks.bins, 1.0, white, sizes, b)["position"][7:, 7:]
    assert C[0, 3] == pytest.approx(0.2 + 0.7 * math.exp(-1.0 / 300.0))
    assert C[0, 0] == pytest.approx(0.2 + 0.7 + 0.01)


def test_scatter_within_bins_leaves_out_what_differs_between_them():
    made = drawn_rise("position", 5.0, 3)
    quiet = patches(3)[0]
    own = scatter_within_bins(made, np.arange(200))
    assert np.median(own) == pytest.approx(np.median(quiet.sigma) ** 2, rel=0.25)
    assert np.median(made.sigma) > 1.5 * np.median(quiet.sigma)


def test_passes_lie_apart_by_what_their_bins_are_off():
    made = drawn_rise("position", 5.0, 3)
    by_bin = made.nav_residual.astype(np.float64).reshape(200, BINS)
    rows = np.array([7, 3, 150])
    assert between_bins(made, rows) == pytest.approx((by_bin[rows] ** 2).mean(axis=1), rel=1e-5)


def test_true_budgets_stand():
    freed = [c.freed for seed in range(12) for c in components(drawn_rise("", 1.0, seed)).values()]
    assert len(freed) == 12 * 6 and not any(freed)


@pytest.mark.parametrize("group", ["position", "attitude", "beams"])
def test_a_group_that_is_worse_is_found_with_its_size(group):
    found = [components(drawn_rise(group, 4.0, seed)) for seed in range(6)]
    assert all(c[group].freed and c[group].p_value < 1e-3 for c in found)
    others = [c.freed for one in found for name, c in one.items() if name != group]
    assert np.mean(others) < 0.05
    assert np.mean([c[group].factor for c in found]) == pytest.approx(16.0, rel=0.4)


def test_a_boresight_twenty_sigmas_off_is_found():
    found = components(drawn_rise("boresight", 20.0, 4))
    assert found["boresight"].freed and found["boresight"].factor > 50.0


def test_agreement_takes_the_components():
    made, nav = drawn_rise("attitude", 5.0, 2), flight()[0]
    found = pass_agreement(patch_scatter(made, nav, BUDGET), made, nav, BUDGET, 0.1)
    by_name = {s.name: s for s in found.sources}
    assert found.refuted and by_name["attitude"].scale > 8.0 and by_name["position"].scale == 1.0
    assert by_name["attitude"].sigma > 0.0 and by_name["noise"].scale == 1.0
    rough = dataclasses.replace(made, sigma=np.sqrt(made.sigma**2 + 0.03**2))
    found = pass_agreement(patch_scatter(rough, nav, BUDGET), rough, nav, BUDGET, 0.1)
    assert {s.name: s.scale > 1.0 for s in found.sources}["noise"]


def test_old_patches_tell_nothing():
    made = patches()[0]
    none = dataclasses.replace(
        made, nav_residual=np.zeros(0, np.float32), beam_residual=np.zeros(0, np.float32)
    )
    assert pass_differences(none, flight()[0], BUDGET, 0.1) == []
    assert scatter_within_bins(none, np.arange(5)) is None
    assert between_bins(none, np.arange(5)) is None


def test_scores_are_derivatives_of_the_likelihood():
    rng = np.random.default_rng(3)
    A, B = rng.normal(size=(2, 9, 9))
    found = UnitErrors(rng.normal(size=9), 0.7, {"a": A @ A.T, "b": B @ B.T})

    def likelihood(s):
        V = 0.7 * np.eye(9) + s[0] * A @ A.T + s[1] * B @ B.T
        return -np.linalg.slogdet(V)[1] - found.y @ np.linalg.solve(V, found.y)

    at, s, h = scores(found, np.array([1.3, 0.8])), np.array([1.3, 0.8]), 1e-6
    assert at.likelihood == pytest.approx(likelihood(s))
    for g in range(2):
        d = h * np.eye(2)[g]
        slope = (likelihood(s + d) - likelihood(s - d)) / (2 * h)
        assert at.first[g] == pytest.approx(slope, rel=1e-5)
    # the score is a quadratic form of normal numbers: its mean and its freedom, by drawing
    V = 0.7 * np.eye(9) + 1.3 * A @ A.T + 0.8 * B @ B.T
    y = np.linalg.cholesky(V) @ rng.normal(size=(9, 40_000))
    P = np.linalg.inv(V)
    square = np.einsum("ik,ij,jk->k", P @ y, A @ A.T, P @ y)
    assert np.trace(P @ A @ A.T) == pytest.approx(square.mean(), rel=0.02)
    assert at.freedom[0] == pytest.approx(2.0 * square.mean() ** 2 / square.var(), rel=0.05)


def test_a_group_without_effect_tells_nothing_of_itself_nor_of_others():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(12, 12))
    y = np.linalg.cholesky(36.0 * A @ A.T + 0.5 * np.eye(12)) @ rng.normal(size=12)
    alone = variance_components(UnitErrors(y, 0.5, {"a": A @ A.T}))
    parts = {"a": A @ A.T, "none": np.zeros((12, 12))}
    with np.errstate(invalid="raise", divide="raise"):
        both = variance_components(UnitErrors(y, 0.5, parts))
        at = scores(UnitErrors(y, 0.5, parts), np.ones(2))
    assert alone["a"].freed and alone["a"].factor > 3.0
    # the order of sums in BLAS depends on where arrays lie in memory
    assert both["a"] == pytest.approx(alone["a"], rel=1e-9)
    assert both["none"].factor == 1.0 and not both["none"].freed
    assert at.first[1] == at.ratio[1] == at.freedom[1] == 0.0


def test_residuals_that_no_group_explains_are_still_a_doubt():
    nav, rng = flight()[0], np.random.default_rng(1)
    apart = shifted(patches(1)[0], rng.normal(0.0, 0.05, (200, BINS)), np.zeros((200, BEAMS)))
    found = pass_agreement(patch_scatter(apart, nav, BUDGET), apart, nav, BUDGET, 0.1)
    assert found.refuted and all(s.scale == 1.0 for s in found.sources)


def test_noise_that_neighbours_share_is_no_group_to_blame():
    freed = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 9])
        made = drawn_rise("", 1.0, seed)
        alike = np.repeat(rng.normal(0.0, 0.03, (20, BINS)), 10, axis=0)  # ten in a row
        freed += [
            c.freed for c in components(shifted(made, alike, np.zeros((200, BEAMS)))).values()
        ]
    assert len(freed) == 12 * 6 and not any(freed)


def test_likeness_is_how_much_larger_the_noise_of_sums_is():
    rng = np.random.default_rng(5)
    for same, expected in ((1, 1.0), (4, 4.0)):
        d = np.repeat(rng.normal(size=3200 // same), same)
        A = np.repeat(rng.normal(size=(3200 // same, 25)), same, axis=0)
        unit = np.linalg.qr(A)[0]
        left = d - unit @ (unit.T @ d)
        block = np.arange(3200) * 16 // 3200
        found = likeness(unit, np.ones(3200), left, block, float(left @ left) / 3175.0)
        assert found == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("scatter_m", [0.03, 0.05, 0.15])
def test_a_surface_that_scatters_within_each_pass_is_rough_and_no_doubt_of_the_budget(scatter_m):
    made, nav = drawn_rise("", 1.0, 1), flight()[0]
    rng = np.random.default_rng(2)
    # the mean of ten returns in a bin is off by what they scatter
    off = rng.normal(0.0, scatter_m / math.sqrt(10.0), (200, BINS))
    rough = shifted(made, off, np.zeros((200, BEAMS)))
    rough = dataclasses.replace(rough, sigma=np.sqrt(rough.sigma**2 + 0.9 * scatter_m**2))
    found = pass_agreement(patch_scatter(rough, nav, BUDGET), rough, nav, BUDGET, 0.1)
    assert not found.refuted
    (noise,) = (s for s in found.sources if s.name == "noise")
    assert noise.factor == pytest.approx(1.0 + (scatter_m / 0.01) ** 2, rel=0.3)
    assert noise.scale == noise.factor


def test_sigma_of_a_factor_is_its_spread():
    """Of errors that are drawn with nine times the variance of the first group."""
    rng, k = np.random.default_rng(6), 40
    A, B = rng.normal(size=(2, k, k)) / math.sqrt(k)
    part = {"a": A @ A.T, "b": B @ B.T}
    root = np.linalg.cholesky(0.2 * np.eye(k) + 9.0 * part["a"] + part["b"])
    found = [
        variance_components(UnitErrors(root @ rng.normal(size=k), 0.2, part)) for _ in range(150)
    ]
    freed = [one["a"] for one in found if one["a"].freed and not one["b"].freed]
    assert len(freed) > 140
    # of the estimate itself: that of its own spread, the factor being in the information
    scaled = [(c.factor - 9.0) / c.sigma for c in freed]
    assert np.std(scaled) == pytest.approx(1.0, abs=0.25)
    assert np.mean([c.factor for c in freed]) == pytest.approx(9.0, rel=0.1)
    others = [one["b"] for one in found if not one["b"].freed]
    assert np.mean([c.factor for c in others]) == pytest.approx(1.0, abs=0.3)


def test_bins_of_which_no_pose_is_known_are_left_out():
    made = patches()[0]
    nav, rows = flight()[0], np.arange(200)
    late = dataclasses.replace(made, nav_bin=made.nav_bin + 3)  # the last three are past the flight
    looks = steady_looks(late, rows, nav)
    assert looks.bins.tolist() == (FIRST + np.arange(3, BINS)).tolist()
    np.testing.assert_array_equal(looks.state, looks.slot + 3)
    np.testing.assert_array_equal(late.nav_bin[looks.entry], looks.bins[looks.slot])


def parts_of_patches(rng, each=4, patches=60, errors=5):
    """Patches in parts, with effects of some errors, and their noise of 20 mm a return."""
    l = each * patches
    returns = rng.integers(80, 120, l).astype(float)
    return Residuals(
        np.zeros(l),
        returns,
        np.repeat(np.arange(patches), each),
        rng.normal(0.0, 0.01, (l, errors)),
        np.zeros(l),
        np.full(patches, 0.02**2),
    )


def with_residuals(made, d):
    """The parts with mean residuals d (l,), which widen the scatter of their patches."""
    between = [
        np.average((d[own] - np.average(d[own], weights=w)) ** 2, weights=w)
        for own, w in (
            (made.patch == k, made.returns[made.patch == k]) for k in range(len(made.scatter))
        )
    ]
    return Residuals(d, *made[1:-1], made.scatter + between)


def test_residuals_of_noise_and_errors_have_the_covariance_that_is_told_of_them():
    rng = np.random.default_rng(8)
    root = rng.normal(size=(5, 5)) / 2.0
    C, made = root @ root.T, parts_of_patches(rng)
    square, noises = 0.0, []
    for _ in range(300):
        noise = 0.02 / np.sqrt(made.returns) * rng.normal(size=len(made.d))
        drawn = with_residuals(made, noise + made.A @ root @ rng.normal(size=5))
        found = told_by(drawn, {"all": C})
        # the directions of y turn with the weights, which the residuals touch a little
        expected = found.noise * np.eye(5) + found.part["all"]
        square += found.y @ np.linalg.solve(expected, found.y) / 300.0
        noises.append(found.noise)
    assert square == pytest.approx(5.0, rel=0.08)  # a chi-square of five, to 4 %
    # what neighbours share is told by chance, and is never less than nothing
    assert np.median(noises) == pytest.approx(1.0, abs=0.05) and 1.0 < np.mean(noises) < 1.1
    moved = with_residuals(made, noise + np.repeat(rng.normal(size=60), 4))
    one, two = told_by(with_residuals(made, noise), {"all": C}), told_by(moved, {"all": C})
    np.testing.assert_allclose(one.y, two.y, rtol=1e-6, atol=1e-9)  # a patch's own height is free


@pytest.mark.parametrize(("patches", "told"), [(11, False), (12, True), (0, False)])
def test_thirty_residuals_more_than_there_are_unknowns_tell_something(patches, told):
    rng = np.random.default_rng(9)
    made = parts_of_patches(rng, 4, patches, 6)  # 12 of 4 parts: 36 but for their means, 6 errors
    if patches == 12:
        made = Residuals(rng.normal(0.0, 0.002, len(made.d)), *made[1:])
    assert (told_by(made, {"all": np.eye(6)}) is not None) == told


def test_what_passes_and_beams_differ_by_is_no_scatter_of_a_return():
    """Beams three times worse than their budget hid grass of 8 cm: 22 m³ of an error were told as
    0.5 of sigma.
    """
    rng, rows = np.random.default_rng(3), np.arange(200)
    made, *_ = patches()
    own = scatter_of_looks(made, rows)
    # returns of 16 bins and 8 beams lose 23 of 160 degrees of freedom
    assert np.median(own) == pytest.approx(0.012**2 * 160 / 137, rel=0.15)
    worse = shifted(made, rng.normal(0.0, 0.05, (200, BINS)), rng.normal(0.0, 0.04, (200, BEAMS)))
    assert np.median(scatter_of_looks(worse, rows)) == pytest.approx(np.median(own), rel=0.15)
    assert np.median(scatter_within_bins(worse, rows)) > 8.0 * np.median(own)
    unknown = dataclasses.replace(made, nav_residual=np.zeros(0, np.float32))
    assert scatter_of_looks(unknown, rows) is None
