"""Triangles that pierce each other: against a plain search, touching bodies, turned meshes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, grid_mesh, torus

from ladar_volume.math.se3 import exp_so3
from ladar_volume.mesh.intersections import corners_beyond, crossings
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.model.errors import SurfaceError


def check_simple(v, t):
    pairs = crossings(v, t)
    if len(pairs):
        raise SurfaceError(f"{len(pairs)} pairs of triangles cross")


def two(shift, turn=(0, 0, 0)):
    v = np.concatenate([CUBE_V, CUBE_V @ exp_so3(np.array(turn, float)).T + shift])
    return v, np.concatenate([CUBE_T, CUBE_T + 8])


def test_overlapping_bodies_are_refused_and_told_why():
    v, t = two([0.5, 0.4, 0.3])
    with pytest.raises(SurfaceError, match="cross") as caught:
        closed_volume(v, t)
    assert caught.value.reason == "mesh_self_intersecting" and len(caught.value.value) == len(
        crossings(v, t)
    )
    assert closed_volume(v, t, allow_crossings=True).volume_m3 == pytest.approx(2.0)


@pytest.mark.parametrize(
    "shift",
    [[0.5, 0.5, 0.5], [0.4, 0.4, 0.4], [0.5, 0.5, -0.5], [0.5, 0.25, 0.25], [-0.3, 0.3, 0.3]],
)
def test_edges_that_meet_the_edges_of_the_other_body_pierce_it(shift):
    v, given = two(shift)
    for t in (given, given[:, [0, 2, 1]]):
        for scale, at in ((1.0, 0.0), (1.0, np.array([5e5, 5.6e6, 300.0])), (1e-3, 0.0)):
            with pytest.raises(SurfaceError, match="cross"):
                check_simple(v * scale + at, t)


def test_the_corner_beyond_each_edge():
    beyond = corners_beyond(CUBE_T.astype(np.int32))
    edges = {(t[k], t[(k + 1) % 3]): t[(k + 2) % 3] for t in CUBE_T.tolist() for k in range(3)}
    assert beyond.tolist() == [
        [edges[t[(k + 1) % 3], t[k]] for k in range(3)] for t in CUBE_T.tolist()
    ]
    assert (corners_beyond(CUBE_T[:1].astype(np.int32)) == -1).all()


@pytest.mark.parametrize(
    "shift",
    [
        [1, 0, 0],
        [1, 0, 0.5],
        [1, 0.5, 0.5],
        [0.5, 0.5, 1],
        [1, 0, -0.25],
        [1, 1, 0],
        [1, 1, 1],
        [1, 0.3, 0.2],
        [3, 0, 0],
    ],
)
def test_touching_is_not_crossing(shift):
    v, t = two(shift)
    check_simple(v, t)
    check_simple(v + np.array([5e5, 5.6e6, 300.0]), t)


def test_against_a_plain_search_and_turned():
    rng = np.random.default_rng(1)
    v = rng.uniform(0, 1, (90, 3))
    t = np.arange(90, dtype=np.int32).reshape(-1, 3)
    t[20:, 0] = t[:10, 1]  # some share a vertex

    def pierces(one, other):
        """Whether an edge goes through: p + s (q − p) = a + u (b − a) + w (c − a)."""
        a, b, c = v[other]
        for i, j in zip(one, np.roll(one, -1), strict=True):
            if not {i, j} & set(other):
                s, u, w = np.linalg.solve(np.c_[v[i] - v[j], b - a, c - a], v[i] - a)
                if 0 < s < 1 and u > 0 and w > 0 and u + w < 1:
                    return True
        return False

    plain = {
        (i, j)
        for i, j in itertools.combinations(range(30), 2)
        if pierces(t[i], t[j]) or pierces(t[j], t[i])
    }
    assert {tuple(p) for p in crossings(v, t).tolist()} == plain and len(plain) > 20
    R = exp_so3(np.array([1.0, 2, 3]))
    assert {tuple(p) for p in crossings(v @ R.T, t).tolist()} == plain
    assert len(crossings(v, t, most=5)) == 5


def tube(rows=120, columns=12, lift=0.0):
    """A tube of 0.15 m radius along a figure of eight, lifted where it would cross itself."""

    def place(i, j):
        a, b = 2 * np.pi * i / rows, 2 * np.pi * j / columns
        along = np.array([np.cos(a), 2 * np.cos(2 * a), 0])
        across = np.array([-along[1], along[0], 0]) / np.linalg.norm(along)
        return 2 * np.array([np.sin(a), np.sin(2 * a), lift * np.cos(a)]) + 0.15 * (
            np.cos(b) * across + np.sin(b) * np.array([0, 0, 1])
        )

    return grid_mesh(rows, columns, place)


def test_a_tube_that_passes_through_itself():
    check_simple(*torus(60, 40))
    check_simple(*tube(lift=0.4))
    with pytest.raises(SurfaceError):
        check_simple(*tube())
