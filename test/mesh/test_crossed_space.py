"""How much a mesh that crosses itself counts wrongly: closed forms, and where it is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere

from ladar_volume.math.se3 import exp_so3
from ladar_volume.mesh.crossed_space import crossing_of, winding_kernel
from ladar_volume.mesh.intersections import crossings
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.model.errors import SurfaceError

TURN = exp_so3(np.array([0.4, 1.1, -0.7]))


def outward(n):
    v, t = sphere(n)
    return v, closed_volume(v, t).mesh.triangles


def joined(*meshes):
    start = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return np.concatenate([v for v, _ in meshes]), np.concatenate(
        [t + at for (_, t), at in zip(meshes, start, strict=False)]
    ).astype(np.int32)


@pytest.mark.parametrize("apart", [1.9, 1.5, 1.0])
def test_what_two_balls_have_in_common(apart):
    ball = outward(1200)
    for at in (np.zeros(3), np.array([5e5, 5.6e6, 300.0])):
        v, t = joined(ball, (ball[0] @ TURN.T + [apart, 0, 0], ball[1]))
        found = crossing_of(v + at, t)
        lens = math.pi / 12 * (4 + apart) * (2 - apart) ** 2
        assert found.volume_m3 == pytest.approx(lens, rel=0.08, abs=0.004) and len(found.pairs) > 20


def test_a_fine_mesh_has_shallow_crossings_and_is_refused_all_the_same():
    ball = outward(1200)
    v, t = joined(ball, (ball[0] @ TURN.T + [1.0, 0, 0], ball[1]))
    with pytest.raises(SurfaceError, match="twice or not at all") as error:
        closed_volume(v, t)
    assert error.value.reason == "mesh_self_intersecting"
    assert closed_volume(v, t, allow_crossings=True).crossing is None


def dented(depth, n=24):
    """A cube of n x n x 2 triangles a face, of whose top one vertex is pushed down."""
    g = np.linspace(0, 1, n + 1)
    x, y = np.meshgrid(g, g, indexing="ij")
    top = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    top[k[n // 2, n // 2], 2] -= depth
    ring = np.concatenate([k[:-1, 0], k[-1, :-1], k[:0:-1, -1], k[0, :0:-1]])
    low = len(top)
    v = np.concatenate([top, top[ring] - [0, 0, 1], [[0.5, 0.5, 0.0]]])
    j = np.arange(len(ring))
    i = (j + 1) % len(ring)
    walls = [
        np.stack([ring[j], low + j, low + i], axis=1),
        np.stack([ring[j], low + i, ring[i]], axis=1),
        np.stack([low + i, low + j, np.full(len(j), len(v) - 1)], axis=1),
    ]
    return v, np.concatenate([faces, *walls]).astype(np.int32)


def test_a_small_fold_is_measured_and_not_refused():
    v, t = dented(0.5)
    assert closed_volume(v, t).crossing.volume_m3 == 0.0
    pierced, t = dented(1.02)  # the vertex comes out below the bottom
    body = closed_volume(pierced, t)
    # the tip of the dent, a pyramid on the six triangles round a vertex, cut off by the bottom
    whole = 1.02 / 24**2
    tip = whole * (0.02 / 1.02) ** 3
    assert len(body.crossing.pairs) > 0
    assert body.volume_m3 == pytest.approx(1.0 - whole, rel=1e-9)
    assert body.crossing.volume_m3 < 1e-2 * body.volume_m3
    assert tip < 1e-7  # less than the pieces' size can show


def test_vertices_that_lie_in_one_plane_within_their_last_digits_touch():
    rng = np.random.default_rng(2)
    for at in (0.0, 100.0, np.array([5e5, 5.6e6, 300.0])):
        # a block that stands on another: its corners are in the other's top, as rounding has it
        v, t = joined((CUBE_V, CUBE_T), (0.5 * CUBE_V + [0.2, 0.3, 1.0], CUBE_T))
        turned = v @ exp_so3(rng.normal(size=3)).T + at
        assert len(crossings(turned, t)) == 0
        deeper = v - np.where(np.arange(16) < 8, 0.0, 1e-6)[:, None] * [0, 0, 1]
        assert len(crossings(deeper @ TURN.T + at, t)) > 0


def test_winding_against_plain_solid_angles():
    v, t = outward(200)
    inside = np.array([[0.1, 0.2, 0.3], [2.0, 0, 0], [0, 0, -0.5]])
    none = np.full(3, -1)
    assert winding_kernel(v, t, inside, none) == pytest.approx([1.0, 0.0, 1.0], abs=1e-12)
    own = np.arange(3)
    middles = v[t[:3]].mean(axis=1)
    assert winding_kernel(v, t, middles, own) == pytest.approx([0.5] * 3, abs=1e-9)
    points = np.concatenate([inside, middles])
    plain = []
    for p in points:
        a, b, c = (v[t[:, k]] - p for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
        up = np.einsum("ij,ij->i", a, np.cross(b, c))
        low = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        plain.append(2 * np.arctan2(up, low) / (4 * np.pi))
    for k, own_k in enumerate([-1, -1, -1, 0, 1, 2]):
        rows = np.arange(len(t)) != own_k
        assert winding_kernel(v, t, points[k : k + 1], np.array([own_k]))[0] == pytest.approx(
            plain[k][rows].sum(), abs=1e-12
        )


def test_few_probes_give_nearly_the_same(monkeypatch):
    ball = outward(1200)
    v, t = joined(ball, (ball[0] @ TURN.T + [1.5, 0, 0], ball[1]))
    whole = crossing_of(v, t).volume_m3
    monkeypatch.setattr("ladar_volume.mesh.crossed_space.WORK", 0)
    assert crossing_of(v, t).volume_m3 == pytest.approx(whole, rel=0.15)
