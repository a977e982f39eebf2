"""Exact recovery, outliers and degenerate input."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import MappedPoints, select
from ladar_volume.rmls.patch_fit import OK
from ladar_volume.rmls.surface_filter import SurfaceFilter

ORIENTATIONS = [
    Rotation.identity(),
    Rotation.from_euler("x", 90, degrees=True),
    Rotation.from_euler("y", 90, degrees=True),
    *Rotation.random(3, random_state=7),
]
SHIFT = np.array([412.3, -777.1, 35.2])


@pytest.mark.parametrize("turn", ORIENTATIONS)
@pytest.mark.parametrize("degree", [1, 2])
def test_plane_without_noise_is_recovered_in_any_orientation(scene, turn, degree):
    flat = np.column_stack([scene.sheet(1500), np.zeros(1500)])
    f, u = scene.filtered(scene.mapped(turn.apply(flat) + SHIFT), degree=degree)
    back = turn.inv().apply(u.points.r_map - SHIFT)
    assert len(u.points) > 100
    assert np.abs(back[:, 2]).max() < 1e-9
    assert np.abs(np.abs(turn.inv().apply(u.points.normal)[:, 2]) - 1).max() < 1e-12
    assert not f.losses["point_outlier"]


@pytest.mark.parametrize("turn", ORIENTATIONS)
@pytest.mark.parametrize("bend", ["sphere", "cylinder", "saddle"])
def test_curved_surface_without_noise_is_recovered_in_the_patch_frame(scene, turn, bend):
    # one patch whose plane is horizontal by symmetry; spheres and cylinders are exact, other shapes
    # to the fourth order
    a = np.linspace(-0.22, 0.22, 7)
    xy = np.stack(np.meshgrid(a, a), -1).reshape(-1, 2)
    true = {
        "sphere": lambda x, y: np.sqrt(1.0 - x * x - y * y),
        "cylinder": lambda x, y: np.sqrt(1.0 - (0.8 * x + 0.6 * y) ** 2),
        "saddle": lambda x, y: 0.3 * x**2 - 0.2 * y**2 + 0.1 * x * y,
    }[bend]
    # the rotated cloud must lie in one voxel, about its centre, whatever the turn
    r = turn.apply(np.column_stack([xy, true(*xy.T) - true(0.0, 0.0)]) * 0.7) + np.array(
        [100.25, 200.25, 10.25]
    )
    _, u = scene.filtered(scene.mapped(r), cap_per_voxel=100, outlier_floor_m=0.2)
    assert len(u.patches) == 1
    back = turn.inv().apply(u.points.r_map - np.array([100.25, 200.25, 10.25])) / 0.7
    truth = true(back[:, 0], back[:, 1]) - true(0.0, 0.0)
    assert np.abs(back[:, 2] - truth).max() < (2e-5 if bend == "saddle" else 1e-9)


def test_normals_face_the_sensor(scene):
    for height in (20.0, -20.0):
        r = np.column_stack([scene.sheet(800), np.zeros(800)])
        _, u = scene.filtered(scene.mapped(r), states=scene.platform(height=height))
        assert (u.points.normal[:, 2] * np.sign(height) > 0.99).all()


@pytest.mark.parametrize("share", [0.2, 0.35, 0.45])
@pytest.mark.parametrize("start", ["lmeds", "ransac"])
def test_outliers_leave_the_surface_in_its_noise(scene, share, start):
    rng = np.random.default_rng(11)
    n = 4000
    z = 0.01 * rng.normal(size=n)
    bad = rng.random(n) < share
    z[bad] = rng.uniform(-0.9, 0.9, bad.sum())
    r = np.column_stack([scene.sheet(n), z])
    f, u = scene.filtered(scene.mapped(r), start=start, cap_per_voxel=200, trials=200)
    inside = (np.abs(u.points.r_map[:, :2]) < 1.2).all(axis=1) & (
        np.abs(u.points.r_map[:, 2]) < 0.3
    )
    error = u.points.r_map[inside, 2]
    assert inside.sum() > 80
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert f.losses["point_outlier"] + f.losses["point_few_neighbours"] > 0.6 * bad.sum()


def test_two_sheets_nearer_than_the_radius_keep_to_points_of_one(scene):
    xy = scene.sheet(6000)
    top = np.arange(6000) < 4000
    r = np.column_stack(
        [xy, np.where(top, 0.1, 0.3) + 0.001 * np.random.default_rng(2).normal(size=6000)]
    )
    f, u = scene.filtered(scene.mapped(r), cap_per_voxel=300, trials=100)
    distance = np.minimum(np.abs(u.points.r_map[:, 2] - 0.1), np.abs(u.points.r_map[:, 2] - 0.3))
    assert distance.max() < 0.005
    assert f.losses["point_outlier"] > 0


def test_degenerate_input_is_counted_not_fitted(scene):
    line = np.column_stack([np.linspace(-0.4, 0.4, 60), np.zeros(60), np.zeros(60)])
    for r, n in ((np.zeros((1, 3)), 1), (np.zeros((50, 3)) + 0.1, 50), (line, 60)):
        f, u = scene.filtered(scene.mapped(r), cap_per_voxel=100)
        assert len(u.patches) == 0 and len(u.points) == 0
        assert f.losses["point_few_neighbours"] == n


def test_duplicated_points_do_not_bend_the_surface(scene):
    r = np.column_stack([scene.sheet(600), np.zeros(600)])
    points = scene.mapped(np.repeat(r, 3, axis=0))
    once = scene.mapped(r)
    points = MappedPoints(
        np.repeat(once.t_ns, 3),
        points.r_map,
        points.C_ind,
        np.repeat(once.ring, 3),
        points.intensity,
    )
    _, u = scene.filtered(points)
    assert len(u.points) and np.abs(u.points.r_map[:, 2]).max() < 1e-9
    assert len(scene.filtered(select(points, slice(0, 0)))[0].losses.as_dict()) == 0


def test_points_not_finite_or_far_away_are_counted(scene):
    r = np.column_stack([scene.sheet(500), np.zeros(500)])
    points = scene.mapped(r)
    points.r_map[:3, 1] = np.nan
    points.r_map[3, 0] = np.inf
    points.r_map[4, 2] = 1e9
    points.C_ind[5, 0] = np.nan
    f, u = scene.filtered(points)
    assert f.losses["point_nan"] == 5 and f.losses["point_too_far"] == 1
    assert f.stats["points_offered"] == 494 and np.isfinite(u.points.r_map).all()


def test_points_wait_for_the_platform_and_are_lost_without_it(scene):
    r = np.column_stack([scene.sheet(500), np.zeros(500)])
    points, states = scene.mapped(r), scene.platform()
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5}}))
    f.add(points)
    assert f.stats["points_waiting"] == 500 and f.update() is None
    f.add_platform(select(states, slice(0, 500)))
    assert f.stats["points_waiting"] == 500
    f.add_platform(select(states, slice(500, None)))
    assert f.stats["points_waiting"] == 0 and f.update() is not None
    late = MappedPoints(
        points.t_ns + 60 * scene.SECOND, points.r_map, points.C_ind, points.ring, points.intensity
    )
    f.add(late)
    f.finish()
    assert f.losses["point_platform_gap"] == 500 and f.stats["points_waiting"] == 0


def test_points_in_a_gap_of_the_platform_are_counted(scene):
    r = np.column_stack([scene.sheet(1000), np.zeros(1000)])
    points, states = scene.mapped(r), scene.platform()
    states.segment[states.t_ns >= 5 * scene.SECOND] = 1
    states = select(states, (states.t_ns <= 4 * scene.SECOND) | (states.t_ns >= 5 * scene.SECOND))
    f, _ = scene.filtered(points, states=states)
    between = (points.t_ns > 4 * scene.SECOND) & (points.t_ns < 5 * scene.SECOND)
    assert f.losses["point_platform_gap"] == between.sum() > 0
    assert f.stats["points_offered"] == 1000 - between.sum()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("height", [-0.04, -0.02, 0.01, 0.03])
def test_rough_ground_along_a_border_of_voxels_is_not_drawn_over_it(scene, axis, height):
    """Of two layers of full voxels each holds as many points, however few lie beyond the border:
    unweighted ones would lift this plane by 4 to 10 mm.
    """
    rng = np.random.default_rng(7)
    plane, rough = scene.sheet(8000, half=2.0), 0.02
    r = np.insert(plane, axis, height + rough * rng.normal(size=len(plane)), axis=1)
    f, update = scene.filtered(scene.mapped(r, variance=rough**2))
    inner = (np.abs(np.delete(update.points.r_map, axis, axis=1)) < 1.5).all(axis=1)
    off = update.points.r_map[inner, axis] - height
    assert inner.sum() > 150 and f.store.kept_count < 0.6 * len(r)
    assert abs(off.mean()) < 0.0015


def test_a_column_of_voxels_counts_as_before_whatever_it_was_offered(scene):
    """Dense places beside sparse ones gain no weight: only the layers of a column are balanced."""
    dense, sparse = scene.sheet(6000, half=0.75), scene.sheet(2000, half=2.5, seed=3)
    r = np.insert(np.concatenate([dense, sparse]), 2, 0.2, axis=1)
    f, _ = scene.filtered(scene.mapped(r))
    weights = f.fits.with_inliers(np.flatnonzero(f.fits.fits.status == OK), f.store).weights
    assert len(weights) > 1000 and (weights == 1.0).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_along_a_border_of_voxels_are_as_dense_as_elsewhere(scene, axis):
    """Two layers of voxels have a patch each of the same surface; both patches' points would be
    twice as dense where the surface crosses the border.
    """

    def count(height):
        rng = np.random.default_rng(7)
        plane = scene.sheet(8000, half=2.0)
        r = np.insert(plane, axis, height + 0.02 * rng.normal(size=len(plane)), axis=1)
        points = scene.filtered(scene.mapped(r, variance=4e-4))[1].points
        inner = (np.abs(np.delete(points.r_map, axis, axis=1)) < 1.5).all(axis=1)
        return np.count_nonzero(inner)

    within = count(0.25)
    assert within > 100
    for height in (-0.02, 0.0, 0.01):
        assert count(height) == pytest.approx(within, rel=0.25)
