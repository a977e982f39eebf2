"""A mesh through points of surfaces of any orientation."""

import numpy as np
import pytest

from benchmarks.truth import box_faces, sample_polygons
from ladar_volume.surface.local import mesh_cloud
from ladar_volume.surface.topology import check_closed, orient


def ball(count, seed=0, noise=0.003):
    rng = np.random.default_rng(seed)
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return n * (1.0 + rng.normal(0.0, noise, (count, 1))), n * rng.choice([-1.0, 1.0], (count, 1))


def block(count, seed=0, noise=0.003, half=(0.5, 0.5, 0.5)):
    rng = np.random.default_rng(seed)
    at, n = sample_polygons(box_faces(-np.array(half), np.array(half)), count, rng)
    return at + n * rng.normal(0.0, noise, (count, 1)), n * rng.choice([-1.0, 1.0], (count, 1))


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def as_set(triangles):
    t = np.asarray(triangles)
    low = np.argmin(t, axis=1)[:, None]
    return set(map(tuple, np.take_along_axis(t, (low + np.arange(3)) % 3, axis=1).tolist()))


def closed(mesh):
    """A watertight manifold that needs no turning: its Euler characteristic."""
    whole = orient(mesh.vertices, mesh.triangles)
    check_closed(whole)
    assert mesh.watertight and not whole.flipped.any() and whole.part.max() == 0
    return whole.euler


@pytest.mark.parametrize("given", [True, False])
def test_a_ball_is_closed_and_faces_outward(given):
    points, normals = ball(2200)
    mesh = mesh_cloud(points, normals if given else None)
    assert closed(mesh) == 2 and len(mesh.triangles) == 2 * len(points) - 4
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_a_block_is_closed_across_its_edges(seed):
    mesh = mesh_cloud(*block(5800, seed))
    assert closed(mesh) == 2
    # chords across the twelve edges cut off a little
    assert 0.994 < volume(mesh) < 1.0
