"""The cloud filter on what scanners deliver: rings, rounded coordinates, points that come twice."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.clouds.filter.sparse_points import _on_sheet
from ladar_volume.clouds.filter.surface_misfit import misfit_variance
from ladar_volume.clouds.filter_cloud import REASONS, filter_cloud
from ladar_volume.clouds.sampling.distinct_points import distinct_rows
from ladar_volume.clouds.sampling.isolation import connected_to_known, second_neighbour_distance
from ladar_volume.clouds.sampling.rounding_step import dither, rounding_steps
from ladar_volume.clouds.sampling.sampling_lines import (
    find_lines,
    has_uneven_spacing,
    lies_along_lines,
)
from ladar_volume.clouds.sampling.trimmed_noise import trimmed_noise
from ladar_volume.model.parameters import FilterParameters

NOISE = 0.01


def sweep(seed=0, noise=NOISE, stray=0.01, rings=16, step_deg=0.6):
    """One turn of a scanner 1.5 m above the ground in a court of 18 m by 22 m: points (n, 3),
    distance (n,) from the nearest surface, which are strays (n,).
    """
    rng = np.random.default_rng(seed)
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-15, 15, rings)), np.radians(np.arange(0, 360, step_deg))
    )
    e, a = elevation.ravel(), azimuth.ravel()
    d = np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    with np.errstate(divide="ignore"):
        to = np.column_stack(
            [-1.5 / d[:, 2], 7 / d[:, 0], -11 / d[:, 0], 13 / d[:, 1], -9 / d[:, 1]]
        )
    to = np.where(to > 0, to, np.inf).min(axis=1)
    beam = to + noise * rng.normal(size=len(to))
    far = rng.random(len(to)) < stray
    beam[far] = rng.uniform(1.0, 1.0 + 0.7 * (to[far] - 1.0))
    r = beam[:, None] * d
    walls = np.abs([r[:, 2] + 1.5, r[:, 0] - 7, r[:, 0] + 11, r[:, 1] - 13, r[:, 1] + 9])
    off = walls.min(axis=0)
    return r, off, far & (off > 0.3)


def distance(r):
    """From the nearest surface of the court."""
    walls = [r[:, 2] + 1.5, r[:, 0] - 7, r[:, 0] + 11, r[:, 1] - 13, r[:, 1] + 9]
    return np.abs(walls).min(axis=0)


def figures(result, off, far):
    """Share of surface points taken out, of strays taken out, and printed over empirical sigma."""
    kept = np.zeros(len(off), bool)
    kept[result.index] = True
    good = off < 5 * NOISE
    use = good[result.index] & ~(False if result.sparse is None else result.sparse)
    error = distance(result.r[use])
    ratio = np.sqrt(np.mean(result.sigma[use] ** 2) / np.mean(error**2))
    return 1 - kept[good].mean(), 1 - kept[far].mean(), ratio


@pytest.fixture(scope="module")
def court():
    """A sweep and what the filter makes of it."""
    r, off, far = sweep()
    return r, off, far, filter_cloud(r, FilterParameters(), auto=True)


def test_one_sweep_is_kept_and_its_noise_is_not_zero(court):
    _, off, far, result = court
    lost, gone, ratio = figures(result, off, far)
    assert lost < 0.01 and gone >= 0.98 and 0.7 < ratio < 1.3
    assert 0.5 * NOISE < result.report["noise_m"] < 1.3 * NOISE
    assert result.verdict.sound


def test_what_is_too_sparse_stays_as_it_came(court):
    r, _, _, result = court
    assert result.report["sparse"] == np.count_nonzero(result.sparse) > 0
    sparse = result.sparse
    assert np.allclose(result.r[sparse], r[result.index[sparse]], atol=1e-12)
    assert (result.sigma[sparse] > 0.5 * NOISE).all()
    assert np.allclose(np.linalg.norm(result.normal, axis=1), 1.0)
    assert len(result.index) + len(result.outliers) == len(r)


def test_points_that_come_three_times_count_once(court):
    r, _, _, one = court
    order = np.random.default_rng(1).permutation(np.tile(np.arange(len(r)), 3))
    many = filter_cloud(r[order], FilterParameters(), auto=True)
    sigma = np.full(len(r), np.nan)
    sigma[one.index] = one.sigma
    assert len(many.index) == 3 * len(one.index)
    assert np.array_equal(many.sigma, sigma[order[many.index]])
    assert many.report["distinct_points"] == len(r)
    noise = np.full(len(r), np.nan)
    noise[one.index] = one.noise
    assert np.array_equal(many.noise, noise[order[many.index]])
    assert np.array_equal(many.independent_noise, np.sqrt(3) * many.noise)


def test_a_sweep_in_millimetres_turned_and_far_away_is_the_same(court):
    r, off, far, one = court
    turn = Rotation.random(random_state=1)
    two = filter_cloud(1e3 * turn.apply(r) + [4e8, 5e9, 1e5], FilterParameters(), auto=True)
    assert two.report["noise_m"] == pytest.approx(1e3 * one.report["noise_m"], rel=0.1)
    kept = np.isin(np.arange(len(r)), two.index)
    assert kept[off < 5 * NOISE].mean() > 0.99 and kept[far].mean() <= 0.02


def test_clutter_stays_on_request():
    rng = np.random.default_rng(3)
    r, _, _ = sweep(stray=0.0)
    leaves = rng.uniform([3, -2, -0.5], [6, 1, 2.5], (3000, 3))
    cloud = np.concatenate([r, leaves])
    result = filter_cloud(cloud, FilterParameters(), auto=True)
    kept = filter_cloud(cloud, FilterParameters(), auto=True, keep=frozenset({"clutter"}))
    assert result.report["clutter"] > 1000
    assert kept.report["clutter"] == 0
    assert len(kept.index) == len(result.index) + result.report["clutter"]
    taken = result.outliers[result.reason == REASONS.index("clutter")]
    assert np.mean(taken >= len(r)) > 0.95


def ball(centre, radius, rows=30, columns=14):
    """What a scanner at the origin sees of a ball: few columns of many rows."""
    away, wide = np.linalg.norm(centre), 0.95 * np.arcsin(radius / np.linalg.norm(centre))
    up, side = np.meshgrid(np.linspace(-wide, wide, rows), np.linspace(-wide, wide, columns))
    u = np.column_stack([np.cos(up.ravel()) * np.cos(side.ravel()), np.sin(side.ravel())])
    u = np.column_stack([u, np.sin(up.ravel())])
    u /= np.linalg.norm(u, axis=1)[:, None]
    axis = centre / away
    turn, _ = Rotation.align_vectors(axis[None], [[1.0, 0, 0]])
    u = turn.apply(u)
    along = u @ centre
    square = radius**2 - away**2 + along**2
    return u[square > 0] * (along - np.sqrt(np.maximum(square, 0.0)))[square > 0, None]


def test_a_ball_of_few_columns_is_no_clutter():
    rng = np.random.default_rng(5)
    seen = ball(np.array([5.0, 4.0, -0.3]), 0.9)
    seen = seen * (1.0 + 0.002 * rng.normal(size=len(seen)) / np.linalg.norm(seen, axis=1))[:, None]
    r, _, _ = sweep(rings=48, step_deg=1.2, noise=0.002, stray=0.0)
    result = filter_cloud(np.concatenate([r, seen]), FilterParameters(), auto=True)
    own = result.outliers >= len(r)
    assert np.count_nonzero(own) < 0.25 * len(seen)  # the rim


def test_a_sheet_that_bends_is_told_from_leaves():
    rng = np.random.default_rng(6)
    seen = ball(np.array([6.0, 0.0, 0.0]), 1.0)
    leaves = rng.uniform([9, -1, -1], [11, 1, 1], (600, 3))
    r = np.concatenate([seen, leaves])
    own, noise = np.arange(len(r)) < len(seen), np.full(len(r), 0.002)
    for which in (np.ones(len(r), bool), ~own):
        found = _on_sheet(r, which, noise)
        assert not found[~own].any() and not found[~which].any()
    assert np.mean(_on_sheet(r, own, noise)[own]) > 0.7
    assert not _on_sheet(r, np.arange(len(r)) < 20, noise).any()  # too few to tell


def test_a_single_ring_is_kept_and_its_noise_is_said_to_be_unknown():
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    r = np.column_stack([8 * np.cos(angle), 8 * np.sin(angle), np.full(400, -1.0)])
    r += 0.01 * np.random.default_rng(0).normal(size=r.shape)
    r = np.concatenate([r, [[0.0, 0.0, 30.0]]])
    result = filter_cloud(r, FilterParameters(), auto=True)
    assert np.array_equal(result.index, np.arange(400)) and result.sparse.all()
    assert result.verdict.doubts[0].name == "filter_noise_unknown"
    assert (result.sigma > 0).all()


@pytest.mark.parametrize("step", [0.005, 0.01])
def test_rounded_noise_is_told_with_what_rounding_adds(step):
    rng = np.random.default_rng(6)
    xy = rng.uniform(-2, 2, (6000, 2))
    r = np.column_stack([xy, 0.3 * xy[:, 0] + 0.005 * rng.normal(size=6000)])
    r = np.round(r / step) * step
    result = filter_cloud(r, FilterParameters(), auto=True)
    expected = np.sqrt(0.005**2 / (1 + 0.3**2) + step**2 / 12)
    assert result.report["noise_m"] == pytest.approx(expected, rel=0.12)
    assert len(result.index) > 0.98 * len(r)


def test_a_quiet_plane_along_the_grid_may_be_off_by_half_a_step():
    rng = np.random.default_rng(7)
    xy = rng.uniform(-2, 2, (4000, 2))
    r = np.round(np.column_stack([xy, 0.104 + 1e-4 * rng.normal(size=4000)]) / 0.01) * 0.01
    result = filter_cloud(r, FilterParameters(), auto=True)
    assert np.sqrt(np.mean((result.r[:, 2] - 0.104) ** 2)) < 2 * np.sqrt(np.mean(result.sigma**2))


@pytest.mark.parametrize("step", [1e-6, 0.001, 0.0025, 0.01, 0.01 * 0.3048])
def test_the_step_of_rounding_is_found(step):
    x = np.random.default_rng(0).uniform(-50, 50, (3000, 3)) + np.array([4e5, 0, 100])
    found = rounding_steps(np.round(x / step) * step)
    assert found[1:] == pytest.approx([step, step], rel=1e-6)
    assert (rounding_steps(x) == 0.0).all()


@pytest.mark.parametrize(("apart", "axis"), [(1.0, 1), (0.5, 0)])
def test_the_distance_of_scan_lines_is_no_step_of_rounding(apart, axis):
    rng = np.random.default_rng(2)
    r = rng.uniform(0, 30, (20000, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0]
    r[:, axis] = np.round(r[:, axis] / apart) * apart
    r[:, 2] += 0.02 * rng.normal(size=len(r))
    assert (rounding_steps(r) == 0.0).all()
    rounded = np.column_stack([np.round(r[:, :2], 3), np.round(r[:, 2], 2)])
    assert rounding_steps(rounded)[2] == pytest.approx(0.01)


def test_single_precision_of_map_coordinates_is_a_step():
    x = np.random.default_rng(0).uniform(-50, 50, (3000, 3)) + np.array([4e5, 5.4e6, 100])
    found = rounding_steps(x.astype(np.float32).astype(np.float64))
    assert found[:2] == pytest.approx([2.0**-5, 0.5])
    moved = dither(x, np.array([0.1, 0.0, 0.0]), 1) - x
    assert np.abs(moved[:, 0]).max() <= 0.05 and not moved[:, 1:].any()
    assert np.std(moved[:, 0]) == pytest.approx(0.1 / np.sqrt(12), rel=0.05)


def test_distinct_points_say_whose_copies_they_are():
    r = np.array([[1.0, 2, 3], [0, 0, 0], [1, 2, 3], [-0.0, 0, 0], [5, 5, 5]])
    once = distinct_rows(r)
    assert np.array_equal(np.sort(once.index), [0, 1, 4]) and np.array_equal(once.r, r[once.index])
    assert np.array_equal(once.r[once.cell], r)
    assert np.array_equal(once.count, np.bincount(once.cell)) and once.count.sum() == len(r)


def test_lines_come_together_at_their_distance():
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(np.arange(12) * 1.0, np.arange(0, 12, 0.02))
    r = np.column_stack([x.ravel(), y.ravel(), 1e-3 * rng.normal(size=x.size)])
    r -= r.mean(axis=0)
    distance_m = np.linalg.norm(r[:40, None] - r[None], axis=2)
    assert lies_along_lines(r, np.argsort(distance_m, axis=1)[:, :60])
    reach = find_lines(r, 0.04).reach_m
    assert 0.9 < np.nanmedian(reach) < 1.9


def test_lines_off_each_other_by_the_noise_tell_it():
    """A fit to the best half of the points would choose the lines that agree."""
    rng = np.random.default_rng(5)
    each = []
    for _ in range(40):
        y = np.repeat(np.arange(7.0), 20)
        z = np.repeat(rng.normal(size=7), 20) + 0.3 * rng.normal(size=140)
        r = np.column_stack([10 * rng.uniform(0, 7, 140), 10 * y, z])
        each.append(trimmed_noise(r, np.arange(140)[None])[0])
    assert np.median(each) == pytest.approx(np.hypot(1.0, 0.3) * np.sqrt(5 / 7), rel=0.25)


@pytest.mark.parametrize(("off", "low", "high"), [(0.0, 0.0, 0.05), (1.0, 0.7, 1.1)])
def test_a_surface_beside_its_points_is_refuted(off, low, high):
    rng = np.random.default_rng(4)
    q = np.column_stack([rng.uniform(0, 10, (8000, 2)), np.zeros(8000)])
    wave = off * np.sqrt(2) * np.sin(2 * q[:, 0])
    r = q + np.outer(0.01 * (rng.normal(size=8000) + wave), [0, 0, 1])
    normal = np.tile([0.0, 0.0, 1.0], (8000, 1)) * rng.choice([-1.0, 1.0], (8000, 1))
    noise = np.full(8000, 0.01 * np.hypot(1, off))
    found = np.sqrt(np.mean(misfit_variance(r, q, normal, noise))) / 0.01
    assert low <= found <= high


def test_a_band_of_one_line_is_no_surface():
    """A ring told at one elevation that scatters along the ground covers an area of its cone."""
    rng = np.random.default_rng(8)
    ground = np.column_stack([rng.uniform(-10, 10, (6000, 2)), np.zeros(6000)])
    angle = rng.uniform(-0.6, 0.6, 900)
    far = 60 + rng.normal(size=900)
    band = np.column_stack([far * np.cos(angle), far * np.sin(angle), 0.02 * (60 - far)])
    reach = find_lines(np.concatenate([ground, band]) - [30.0, 0, 0], 0.15).reach_m
    assert np.mean(np.isfinite(reach[:6000])) > 0.95
    assert np.mean(np.isfinite(reach[6000:])) < 0.1


def test_few_lines_that_lie_far_apart_are_remote():
    rng = np.random.default_rng(3)

    def patch(x, y):
        xy = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        return np.column_stack([xy + rng.normal(0, 1e-3, xy.shape), rng.normal(0, 2e-3, len(xy))])

    near = patch(np.arange(-2, 2, 0.05), np.arange(-2, 2, 0.1))
    far = patch(np.arange(-15, 15, 0.1), np.arange(20, 44, 3.0))
    r, k = np.vstack([near, far]), len(near)
    lines = find_lines(r - r.mean(axis=0), 0.05)
    assert not lines.remote[:k].any()
    assert lines.remote[k:].mean() > 0.9
    np.testing.assert_allclose(np.nanmedian(lines.reach_m[k:]), 3.2)


def test_noisy_lines_are_lines_though_their_noise_is_wider_than_their_spacing():
    rng = np.random.default_rng(3)
    along, line = np.meshgrid(np.arange(0, 3, 0.01), np.arange(0, 3, 0.1))
    r = np.column_stack([along.ravel(), line.ravel(), np.zeros(along.size)])
    r[:, :2] += 0.003 * rng.normal(size=(len(r), 2))
    r[:, 2] = 0.02 * rng.normal(size=len(r))
    some = r[:: len(r) // 300]
    near = np.argsort(np.linalg.norm(some[:, None] - r[None], axis=2), axis=1)[:, :130]
    assert lies_along_lines(r, near)
    even = np.column_stack([rng.uniform(0, 3, (9000, 2)), 0.02 * rng.normal(size=9000)])
    some = even[:300]
    near = np.argsort(np.linalg.norm(some[:, None] - even[None], axis=2), axis=1)[:, :130]
    assert not lies_along_lines(even, near)


def test_strays_are_not_taken_for_places_of_another_spacing():
    rng = np.random.default_rng(11)
    r = np.column_stack([rng.uniform(-2, 2, (4000, 2)), 0.01 * rng.normal(size=4000)])
    bad = rng.random(4000) < 0.5
    r[bad, 2] = rng.uniform(-2, 2, bad.sum())
    distance = np.linalg.norm(r[:400, None] - r[None], axis=2)
    near = np.argsort(distance, axis=1)[:, :40]
    around = np.argsort(distance[:, :400], axis=1)[:, :60]
    assert not has_uneven_spacing(r, near, np.take_along_axis(distance, near, axis=1), around)


def test_strays_do_not_pass_one_another_on():
    rng = np.random.default_rng(9)
    ring = np.column_stack([np.arange(0, 40, 0.1), np.zeros(400), np.zeros(400)])
    strays = rng.uniform([0, -20, -20], [40, 20, 20], (400, 3))
    r = np.concatenate([ring, ring + np.array([0.0, 3.0, 0.0]), strays])
    known = np.arange(len(r)) < 400
    stays = connected_to_known(r, known, second_neighbour_distance(r), ~known, 4.0)
    assert stays[400:800].mean() > 0.99 and stays[800:].mean() < 0.05


@pytest.mark.filterwarnings("error")
def test_drawn_points_without_noise_are_no_division_by_zero():
    rng = np.random.default_rng(90)
    angle, z = rng.uniform(0.0, 2.0 * np.pi, 1500), rng.uniform(0.0, 2.0, 1500)
    ground = rng.uniform(-6.0, 6.0, (2250, 2))
    ground = ground[np.hypot(*ground.T) > 0.8]
    side = np.column_stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), z])
    cloud = np.concatenate([side, np.column_stack([ground, np.zeros(len(ground))])])
    cloud = cloud[(cloud[:, 0] > -0.2) | (cloud[:, 2] == 0.0)]
    done = filter_cloud(cloud, FilterParameters(), auto=True)
    assert len(done.r) > 0.7 * len(cloud) and np.isfinite(done.r).all()
