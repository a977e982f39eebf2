"""A mesh through points of surfaces of any orientation."""

import numba
import numpy as np
import pytest
from scipy.spatial import Delaunay

from benchmarks.square import RING, Revolved
from benchmarks.truth import box_faces, rotation, sample_polygons
from ladar_volume.mesh.local_mesh import DUPLICATE, INSIDE, RIM, UNUSED, mesh_cloud
from ladar_volume.mesh.topology import check_closed, orient
from ladar_volume.model.body_parameters import LocalMeshParameters
from ladar_volume.model.errors import SurfaceError

#: A stem under a hat that overhangs, as radius and height.
MUSHROOM = np.array([(0, 0), (0.2, 0), (0.2, 0.8), (0.6, 0.9), (0.5, 1.2), (0, 1.3)])


def scattered(at, normals, rng, noise, signed=False):
    """Noise along the normal, signs of the normals lost."""
    sign = 1.0 if signed else rng.choice([-1.0, 1.0], (len(at), 1))
    return at + normals * rng.normal(0.0, noise, (len(at), 1)), normals * sign


def ball(count, rng, noise=0.003, **k):
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return scattered(n, n, rng, noise, **k)


def block(count, rng, noise=0.003, half=(0.5, 0.5, 0.5), faces=slice(None), **k):
    at, n = sample_polygons(box_faces(-np.array(half), np.array(half))[faces], count, rng)
    return scattered(at, n, rng, noise, **k)


def torus(count, rng, noise=0.004):
    v = rng.uniform(0, 2 * np.pi, 4 * count)
    v = v[rng.random(len(v)) < (1 + 0.4 * np.cos(v)) / 1.4][:count]
    u = rng.uniform(0, 2 * np.pi, count)
    n = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
    middle = np.stack([np.cos(u), np.sin(u), np.zeros(count)], axis=1)
    return scattered(middle + 0.4 * n, n, rng, noise)


def prism(outline, height):
    """Faces of an L drawn along z."""
    low, high = np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, height)]
    sides = [np.array([low[i], low[i - 5], high[i - 5], high[i]]) for i in range(6)]
    return [*sides, high[[0, 1, 2, 3]], high[[0, 3, 4, 5]], low[[3, 2, 1, 0]], low[[5, 4, 3, 0]]]


def ell(count, rng, noise=0.004):
    outline = np.array([(0, 0), (1, 0), (1, 0.5), (0.5, 0.5), (0.5, 1), (0, 1)])
    at, n = sample_polygons(prism(outline, 0.6), count, rng)
    return scattered(at, n, rng, noise)


def revolved(profile, count, rng, noise=0.004):
    at, n = Revolved(0, (0.0, 0.0), profile).sample(count, rng)
    return scattered(at, n, rng, noise)


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def as_set(triangles):
    t = np.asarray(triangles)
    low = np.argmin(t, axis=1)[:, None]
    return set(map(tuple, np.take_along_axis(t, (low + np.arange(3)) % 3, axis=1).tolist()))


def closed(mesh, parts=1):
    """A watertight manifold that needs no turning: its Euler characteristic."""
    whole = orient(mesh.vertices, mesh.triangles)
    check_closed(whole)
    assert mesh.watertight and not whole.flipped.any() and whole.part.max() == parts - 1
    return whole.euler


@pytest.mark.parametrize("given", [True, False])
def test_a_ball_is_closed_and_faces_outward(given):
    points, normals = ball(2200, np.random.default_rng(0))
    mesh = mesh_cloud(points, normals if given else None)
    assert closed(mesh) == 2 and len(mesh.triangles) == 2 * len(points) - 4
    assert np.all(mesh.status == INSIDE)
    assert np.mean(np.einsum("ni,ni->n", mesh.normals, points) > 0) == 1.0
    # what chords through 2,200 points cut off
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi * 0.9945, rel=0.003)


@pytest.mark.parametrize("seed", range(3))
def test_a_block_is_closed_across_its_edges(seed):
    mesh = mesh_cloud(*block(5800, np.random.default_rng(seed)))
    assert closed(mesh) == 2
    # chords across the twelve edges cut off a little
    assert 0.996 < volume(mesh) < 1.0


def test_bodies_with_dents_handles_and_overhangs_turned_anyhow():
    rng = np.random.default_rng(4)
    mushroom = (
        np.pi
        / 3
        * np.sum(
            np.diff(MUSHROOM[:, 1])
            * (MUSHROOM[1:, 0] ** 2 + MUSHROOM[:-1, 0] ** 2 + MUSHROOM[1:, 0] * MUSHROOM[:-1, 0])
        )
    )
    cases = [
        (ell(5000, rng), 0.45, 2),
        (torus(5000, rng), 2 * np.pi**2 * 0.16, 0),
        (revolved(MUSHROOM, 5000, rng), mushroom, 2),
    ]
    for (points, normals), true, euler in cases:
        R = rotation(rng)
        mesh = mesh_cloud(points @ R.T, normals @ R.T)
        assert closed(mesh) == euler
        assert 0.990 < volume(mesh) / true < 1.0


def test_the_unseen_bottom_stays_open_and_is_one_rim():
    points, normals = block(4800, np.random.default_rng(1), faces=slice(1, None))
    mesh = mesh_cloud(points, normals)
    whole = orient(mesh.vertices, mesh.triangles)
    assert whole.euler == 1 and len(mesh.rims) == 1 and len(mesh.rims[0]) == len(whole.boundary)
    rim = mesh.rims[0]
    assert np.all(points[rim, 2] < -0.4) and np.all(mesh.status[rim] == RIM)
    # the rim runs with the gap on its left: its edges are those of the boundary the other way round
    assert set(zip(np.roll(rim, -1).tolist(), rim.tolist(), strict=True)) == set(
        map(tuple, whole.boundary.tolist())
    )


def test_a_hole_is_closed_up_to_the_stated_size():
    points, normals = ball(3000, np.random.default_rng(2))
    keep = points[:, 2] < 0.95  # 62 cm across
    small, large = (
        mesh_cloud(points[keep], normals[keep], LocalMeshParameters(hole_m=h)) for h in (0.4, 1.0)
    )
    assert len(small.rims) == 1 and orient(small.vertices, small.triangles).euler == 1
    assert closed(large) == 2
    assert (
        large.report["closing_triangles"] >= len(small.rims[0]) - 2
        and np.sum(large.votes == 0) == large.report["closing_triangles"]
    )


def test_a_plate_is_not_bridged_but_closed_round_its_rim():
    points, normals = block(6000, np.random.default_rng(3), noise=0.002, half=(0.5, 0.5, 0.02))
    mesh = mesh_cloud(points, normals)
    assert closed(mesh) == 2
    assert volume(mesh) == pytest.approx(0.04, rel=0.03)


def test_two_sheets_one_over_the_other_stay_two():
    rng = np.random.default_rng(5)
    points = np.concatenate(
        [np.c_[rng.uniform(0, 1, (1000, 2)), z + rng.normal(0, 0.002, 1000)] for z in (0.0, 0.15)]
    )
    mesh = mesh_cloud(points, np.tile([0.0, 0.0, -1.0], (2000, 1)))
    whole = orient(mesh.vertices, mesh.triangles)
    assert whole.part.max() == 1 and whole.euler == 2 and len(mesh.rims) == 2
    level = mesh.triangles < 1000
    assert np.all(level.all(axis=1) | ~level.any(axis=1))


def test_bodies_apart_and_bodies_that_touch_with_trusted_normals():
    rng = np.random.default_rng(6)
    a, b = block(3000, rng, signed=True), ball(2200, rng, signed=True)
    apart = mesh_cloud(np.concatenate([a[0], a[0] + [1.12, 0, 0]]), np.concatenate([a[1], -a[1]]))
    assert closed(apart, 2) == 4 and volume(apart) == pytest.approx(2.0, rel=0.01)
    touching = mesh_cloud(
        np.concatenate([b[0], b[0] + [2, 0, 0]]),
        np.concatenate([b[1], b[1]]),
        LocalMeshParameters(signed=True),
    )
    assert closed(touching, 2) == 4 and volume(touching) == pytest.approx(8 / 3 * np.pi, rel=0.01)


def test_the_same_triangles_wherever_the_body_lies():
    rng = np.random.default_rng(7)
    points, normals = block(1500, rng)
    mesh = mesh_cloud(points, normals)
    R = rotation(rng)
    moved = mesh_cloud(points @ R.T + [4e5, -2e5, 300.0], normals @ R.T)
    assert as_set(moved.triangles) == as_set(mesh.triangles)
    order = rng.permutation(len(points))
    mixed = mesh_cloud(points[order], normals[order])
    assert as_set(order[mixed.triangles]) == as_set(mesh.triangles)


def test_the_same_bytes_on_one_thread():
    points, normals = revolved(RING, 3000, np.random.default_rng(8))
    both = mesh_cloud(points, normals)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = mesh_cloud(points, normals)
    finally:
        numba.set_num_threads(threads)
    assert (
        one.triangles.tobytes() == both.triangles.tobytes()
        and one.normals.tobytes() == both.normals.tobytes()
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_in_a_plane_it_is_the_delaunay_triangulation(seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 1.0, (600, 2))
    R = rotation(rng)
    points = np.column_stack([xy, np.zeros(600)]) @ R.T
    mesh = mesh_cloud(points, np.tile(R[:, 2], (600, 1)))
    inside = (np.abs(xy - 0.5) < 0.4).all(axis=1)  # slivers along the border are left out
    plain = Delaunay(xy).simplices
    of_mesh, of_plane = (t[inside[t].all(axis=1)] for t in (mesh.triangles, plain))
    corners = [set(map(tuple, np.sort(t, axis=1).tolist())) for t in (of_mesh, of_plane)]
    assert corners[0] == corners[1] and len(of_plane) > 600


def test_points_twice_and_points_alone_are_named():
    points, normals = ball(800, np.random.default_rng(10))
    points = np.concatenate([points, points[:5], [[9.0, 9.0, 9.0]]])
    normals = np.concatenate([normals, normals[:5], [[0.0, 0.0, 1.0]]])
    mesh = mesh_cloud(points, normals)
    assert closed(mesh) == 2 and mesh.report["duplicates"] == 5 and mesh.report["unused"] == 1
    assert np.all(mesh.status[800:805] == DUPLICATE) and mesh.status[805] == UNUSED
    assert not np.isin(mesh.triangles, np.arange(800, 806)).any()


def test_a_grid_in_which_four_points_lie_on_every_circle():
    points = np.array([(i, j, 0.0) for i in range(9) for j in range(7)])
    mesh = mesh_cloud(points)
    assert len(mesh.triangles) == 2 * 8 * 6 and len(mesh.rims) == 1 and len(mesh.rims[0]) == 28
    # flat parts face up
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    assert np.all(np.cross(b - a, c - a)[:, 2] > 0)


def test_three_points_are_one_triangle():
    mesh = mesh_cloud(np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0)]))
    assert as_set(mesh.triangles) == {(0, 1, 2)} and len(mesh.rims) == 1


LINE = np.linspace(0, 1, 20)[:, None] * [1.0, 2.0, 3.0]
FOUR = np.eye(4)[:, :3]


@pytest.mark.parametrize(
    ("points", "normals", "reason"),
    [
        (FOUR[:2], None, "surface_too_few_points"),
        (FOUR[[0, 1, 1, 0]], None, "mesh_points"),
        (LINE, None, "mesh_empty"),
        (FOUR * [1, 1, np.nan], None, "surface_not_finite"),
        (FOUR[:, :2], None, "surface_shape"),
        (FOUR, FOUR[:3], "mesh_normals"),
        (FOUR, FOUR, "mesh_normals"),
        (FOUR, FOUR + np.inf, "mesh_normals"),
    ],
)
def test_what_is_no_surface_is_refused(points, normals, reason):
    with pytest.raises(SurfaceError) as caught:
        mesh_cloud(points, normals)
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    "settings",
    [
        {"radius_m": -1.0},
        {"hole_m": np.nan},
        {"method": "ball"},
        {"repair": "all"},
        {"method": "published"},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(SurfaceError) as caught:
        LocalMeshParameters(**settings)
    assert caught.value.reason == "mesh_settings"


def test_points_farther_apart_than_the_radius_have_no_triangle():
    for method in ("agreement", "published"):
        with pytest.raises(SurfaceError) as caught:
            mesh_cloud(
                ball(50, np.random.default_rng(11))[0],
                None,
                LocalMeshParameters(1e-4, method=method),
            )
        assert caught.value.reason == "mesh_empty"
