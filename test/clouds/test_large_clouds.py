"""What large clouds are spared: each shortcut against the long way."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ladar_volume.clouds import between_points, cloud_cleaning, cloud_noise
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.sampling import plain_places
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.adjustment_adjoint import triangle_slopes
from ladar_volume.tin.full_tin import build_tin, footprint_areas


def points(seed, n=12_000):
    """A round plateau on waves, 20 m wide."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 20.0, (n, 2))
    z = np.where(np.hypot(*(xy - 10.0).T) < 6.0, 2.0, 0.0)
    z += 0.3 * np.sin(2.0 * xy[:, 0]) * np.cos(2.0 * xy[:, 1]) + rng.normal(0.0, 0.005, n)
    return np.c_[xy, z]


@pytest.mark.parametrize("seed", [1, 2])
def test_some_squares_stand_for_all(seed, monkeypatch):
    surface = cloud_surface(points(seed), SurfaceParameters(relevant="sampled"))
    tin = surface.representation.tin
    area, height = footprint_areas(tin.vertices, tin.triangles), tin.vertices[:, 2]
    whole = between_points.between_points(surface, area, height)
    monkeypatch.setattr(between_points, "ENOUGH", 8_000)
    part = between_points.between_points(surface, area, height)
    assert 0.7 < part.random_m6 / whole.random_m6 < 1.8


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.5, 0.25)])
def test_the_raster_takes_what_sorting_takes(shift, monkeypatch):
    p = points(3, 3000)
    p[::7, :2] = np.round(p[::7, :2])  # several on the same place, and on the cells' edges
    chosen = p[:, 0] > np.median(p[:, 0])
    own = np.flatnonzero(chosen)
    fast = cloud_noise.thin_by_cells(p, 0.5, shift)
    some = cloud_noise.thin_by_cells(p, 0.5, shift, chosen)
    assert np.array_equal(some, own[cloud_noise.thin_by_cells(p[own], 0.5, shift)])
    monkeypatch.setattr(cloud_noise, "RASTER", -10.0)
    assert np.array_equal(fast, cloud_noise.thin_by_cells(p, 0.5, shift))
    assert np.array_equal(some, cloud_noise.thin_by_cells(p, 0.5, shift, chosen))


def test_rare_cells_take_the_size_of_the_nearest():
    cells = np.r_[np.full(500, 1.0), np.full(500, 3.0), 1.2, 5.0, np.inf]
    out = cloud_noise.common_cells(cells)
    assert out[1000] == 1.0 and out[1001] == 5.0 and np.isinf(out[1002])
    assert np.array_equal(out[:1000], cells[:1000])


def test_slopes_are_those_of_planes_solved_one_by_one():
    tin = build_tin(points(4, 300))
    heights = np.random.default_rng(1).normal(size=len(tin.vertices))
    for slope, corner in zip(triangle_slopes(tin, heights), tin.triangles, strict=True):
        plane = np.linalg.solve(np.c_[tin.vertices[corner, :2], np.ones(3)], heights[corner])
        assert slope == pytest.approx(plane[:2], rel=1e-6, abs=1e-9)


def test_strays_do_not_depend_on_order():
    rng = np.random.default_rng(6)
    p = points(6, 4000)
    off = rng.choice(len(p), 40, replace=False)
    p[off, 2] += rng.uniform(0.5, 6.0, 40)
    whole = cloud_cleaning.clean(p)
    assert len(np.intersect1d(whole.strays, off)) > 30
    order = rng.permutation(len(p))
    again = order[cloud_cleaning.clean(p[order]).strays]
    # the noise is told from the same points here, whatever their order
    assert set(again.tolist()) == set(whole.strays.tolist())


@pytest.mark.parametrize("seed", range(4))
def test_isolated_points_are_those_of_every_point_among_its_neighbours(seed):
    rng = np.random.default_rng(seed)
    p = points(seed, 3000)
    if seed % 2:  # dense here, sparse there, and copies of a footprint
        p[:, 0] = 40.0 * (p[:, 0] / 40.0) ** 4
        p[:300, :2] = p[300:600, :2]
    p[:60, 2] += rng.uniform(-8, 8, 60)
    distance = cKDTree(p).query(p, cloud_cleaning.COMPANY + 1)[0][:, -1]
    around = cKDTree(p[:, :2]).query(p[:, :2], cloud_cleaning.AROUND)[1]
    usual = np.sort(distance[around], axis=1)[:, cloud_cleaning.AROUND // 4]
    wanted = distance > cloud_cleaning.ISOLATED * usual
    found = cloud_cleaning.isolated_points(p, p * [1.0, 1.0, 0.0], np.arange(len(p)))
    # of neighbours equally far any may be taken
    assert np.count_nonzero(found != wanted) <= (6 if seed % 2 else 0)
    assert 20 < np.count_nonzero(wanted) < 600


def test_isolated_points_of_a_few_are_those_of_all_among_these():
    p = points(9, 3000)
    p[:60, 2] += np.random.default_rng(9).uniform(-8, 8, 60)
    flat = p * [1.0, 1.0, 0.0]
    every = cloud_cleaning.isolated_points(p, flat, np.arange(len(p)))
    some = np.r_[0:40, 500:700]
    found = cloud_cleaning.isolated_points(p, flat, some)
    assert 10 < found.sum() and np.array_equal(np.flatnonzero(found), some[every[some]])
    assert not cloud_cleaning.isolated_points(p, flat, some[:0]).any()


@pytest.mark.parametrize("seed", [1, 2])
def test_plain_points_lie_on_the_plane_of_their_block(seed):
    """Against least squares by NumPy, block by block."""
    rng = np.random.default_rng(seed)
    r = points(seed, 8000)
    r[:80, 2] += rng.uniform(-2.0, 2.0, 80)
    r = r[(r[:, 0] < 15.0) | (r[:, 1] < 9.0)]  # a corner is empty
    r[:, 2] *= 0.1
    sigma = 0.008  # waves bend within a block by more, here and there
    found = plain_places.plain_points(r, sigma)
    low, high = r[:, :2].min(axis=0), r[:, :2].max(axis=0)
    size = np.sqrt(np.prod(high - low) * plain_places.MEAN / len(r))
    cell = np.floor((r[:, :2] - low) / size)
    wanted = np.zeros(len(r), np.bool_)
    for one in np.unique(cell, axis=0):
        block = r[(np.abs(cell - one) <= 1.0).all(axis=1)]
        own = (cell == one).all(axis=1)
        X = np.c_[np.ones(len(block)), block[:, :2] - low]
        beta = np.linalg.lstsq(X, block[:, 2], rcond=None)[0]
        rough = np.sqrt(((block[:, 2] - X @ beta) ** 2).sum() / max(len(block) - 3, 1))
        spread = np.linalg.eigvalsh(np.cov(block[:, :2].T, bias=True)).min() / size**2
        off = np.abs(r[own, 2] - beta[0] - (r[own, :2] - low) @ beta[1:])
        good = len(block) >= plain_places.FEWEST and spread > plain_places.SPREAD
        good = good and rough <= plain_places.ROUGH * sigma
        wanted[own] = good & (off <= plain_places.WITHIN * sigma)
    assert 0.2 < wanted.mean() < 0.9
    assert np.array_equal(found, wanted)


def test_plain_points_hide_no_stray(monkeypatch):
    p = points(11, 20_000)
    rng = np.random.default_rng(11)
    off = rng.choice(len(p), 150, replace=False)
    p[off, 2] += rng.choice([-1.0, 1.0], 150) * rng.uniform(0.05, 3.0, 150)
    found = cloud_cleaning.clean(p)
    none = np.zeros(len(p), np.bool_)
    monkeypatch.setattr(cloud_cleaning, "plain_points", lambda r, sigma_m: none)
    every = cloud_cleaning.clean(p)
    assert len(every.strays) > 100 and np.array_equal(found.strays, every.strays)


def test_the_noise_of_stretches_is_that_of_all(monkeypatch):
    p = points(12, 40_000)
    whole = cloud_cleaning.clean(p)
    monkeypatch.setattr(cloud_cleaning, "STRETCHES", 8)
    monkeypatch.setattr(cloud_cleaning, "STRETCH", 1000)
    part = cloud_cleaning.clean(p)
    assert part.noise.sigma_m == pytest.approx(whole.noise.sigma_m, rel=0.05)
    assert part.noise.sigma_m != whole.noise.sigma_m


def test_the_surface_does_not_depend_on_the_order_of_the_points():
    p = points(13, 5000)
    one = cloud_surface(p, SurfaceParameters(relevant="sampled"), how="auto")
    order = np.random.default_rng(1).permutation(len(p))
    two = cloud_surface(p[order], SurfaceParameters(relevant="sampled"), how="auto")
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.index, order[two.index])
    assert np.array_equal(one.representation.tin.triangles, two.representation.tin.triangles)
    assert np.array_equal(p[one.index], one.points)


def test_few_strays_do_not_move_the_noise():
    rng = np.random.default_rng(8)
    lifted = np.c_[rng.uniform(0.0, 20.0, (30_000, 2)), rng.normal(0.0, 0.01, 30_000)]
    lifted[[7, 20_001], 2] += 3.0
    found = cloud_surface(lifted, SurfaceParameters(), how="auto")
    assert {7, 20_001} <= set(found.strays.tolist()) and len(found.strays) <= 3
    assert np.array_equal(found.stray_points, lifted[found.strays])
    again = cloud_noise.cloud_noise(lifted[found.index]).sigma_m
    assert found.sigma_m[0] == pytest.approx(again, rel=0.02)  # of some 20,000 fits each
