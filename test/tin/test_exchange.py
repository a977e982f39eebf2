"""Triangulation adjustment: the valley of the source's figure, monotone measures, order of
exchanges, topology, an honest twin.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import Tin
from ladar_volume.tin import diagonal_exchange
from ladar_volume.tin.diagonal_exchange import (
    ListedSurface,
    exchange_diagonals,
    exchange_gain,
    exchange_one,
    list_residuals,
    point_lists,
)
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.locate import height_at, locate, triangle_index
from ladar_volume.tin.predicates import workspace


def sound(tin):
    """Mutual neighbours over equal edges, counter-clockwise triangles."""
    for t, row in enumerate(tin.neighbours):
        for k, o in enumerate(row):
            if o >= 0:
                j = list(tin.neighbours[o]).index(t)
                assert tin.triangles[o, (j + 1) % 3] == tin.triangles[t, (k + 2) % 3]
                assert tin.triangles[o, (j + 2) % 3] == tin.triangles[t, (k + 1) % 3]
    assert (footprint_areas(tin.vertices, tin.triangles) > 0).all()


def valley():
    """Two triangles whose common edge crosses a valley along y = 0, and points on the valley's
    sides.
    """
    vertices = np.array([[-3, 0, 0.0], [3, 0, 0], [0, -2, 2], [0, 2, 2]])
    triangles = np.array([[0, 2, 3], [1, 3, 2]], np.int32)
    neighbours = np.array([[1, -1, -1], [0, -1, -1]], np.int32)
    tin = Tin(vertices, triangles, neighbours, np.ones(2, bool), np.arange(4))
    xy = np.random.default_rng(0).uniform(-1, 1, (60, 2)) * [1.0, 0.6]
    return tin, np.r_[vertices, np.c_[xy, np.abs(xy[:, 1])]]


def scene(n=500, vertices=80, seed=0, noise=0.02):
    """A ridge along y = x, and a TIN of some of its points."""
    rng = np.random.default_rng(seed)
    xy = np.r_[[[0, 0], [10, 0], [10, 10], [0, 10]], rng.uniform(0, 10, (n - 4, 2))]
    points = np.c_[xy, -np.abs(xy[:, 0] - xy[:, 1]) + noise * rng.normal(size=n)]
    return build_tin(points[:vertices]), points


@pytest.mark.parametrize("measure", ["asd", "rms"])
def test_the_valley_is_retained(measure):
    tin, points = valley()
    e = exchange_diagonals(tin, points, measure)
    assert e.exchanges == 1 and e.asd_m == pytest.approx(0, abs=1e-15) and e.asd_before_m > 0.3
    assert {frozenset(t) for t in e.tin.triangles.tolist()} == {
        frozenset((0, 1, 2)),
        frozenset((0, 1, 3)),
    }
    sound(e.tin)
    again = exchange_diagonals(e.tin, points, measure)
    assert again.exchanges == 0 and np.array_equal(again.tin.triangles, e.tin.triangles)


@pytest.mark.parametrize("measure", ["asd", "rms"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_fit_improves_until_no_exchange_helps(measure, seed):
    tin, points = scene(seed=seed)
    e = exchange_diagonals(tin, points, measure)
    assert e.exchanges > 10
    sound(e.tin)
    assert getattr(e, f"{measure}_m") < getattr(e, f"{measure}_before_m")
    r = points[:, 2] - height_at(e.tin, points[:, :2])
    assert (e.rms_m, e.asd_m) == pytest.approx(
        (math.sqrt((r**2).mean()), np.abs(r).mean()), rel=1e-9
    )
    assert exchange_diagonals(e.tin, points, measure).exchanges == 0
    assert footprint_areas(e.tin.vertices, e.tin.triangles).sum() == pytest.approx(100.0, rel=1e-12)
    assert np.array_equal(e.tin.vertices, tin.vertices)


def brute(tin, points, square):
    """Biggest improvement first by trying every edge of the whole surface before each exchange."""
    tri, nb = tin.triangles.astype(np.int64), tin.neighbours.astype(np.int64)
    where, w, done = locate(triangle_index(tin), points[:, :2]), workspace(), 0
    first, after = point_lists(where, len(tri))
    surface = ListedSurface(tin.vertices, points, tri, nb, tin.relevant, first, after)
    sums = list_residuals(tin.vertices, points, tri, first, after)
    least = diagonal_exchange.LEAST_GAIN * float(np.sum(sums**2 if square else np.abs(sums)))
    while True:
        gains = [
            (
                -exchange_gain(surface, t, k, square, w),
                t,
                k,
            )
            for t in range(len(tri))
            for k in range(3)
        ]
        best = min(gains)
        if -best[0] <= least:
            return tri, done
        exchange_one(surface, best[1], best[2])
        done += 1


@pytest.mark.parametrize("square", [False, True])
def test_the_queue_keeps_the_order_of_trying_everything(square):
    tin, points = scene(300, 50, seed=4)
    tri, done = brute(tin, points, square)
    e = exchange_diagonals(tin, points, "rms" if square else "asd")
    assert e.exchanges == done
    assert {frozenset(t) for t in e.tin.triangles.tolist()} == {frozenset(t) for t in tri.tolist()}


def test_quadrangles_that_are_not_strictly_convex_are_left():
    # (0, 0) (2, 0) (4, 0) in line: exchanging would make a flat triangle
    vertices = np.array([[0, 0, 0.0], [4, 0, 0], [2, 2, 5], [2, 0, 9]])
    tin = Tin(
        vertices,
        np.array([[0, 3, 2], [3, 1, 2]], np.int32),
        np.array([[1, -1, -1], [-1, 0, -1]], np.int32),
        np.ones(2, bool),
        np.arange(4),
    )
    points = np.array([[2, 0.5, 0.0], [1.5, 0.3, 0], [2.5, 0.3, 0]])
    assert exchange_diagonals(tin, points).exchanges == 0
    drop = np.zeros((4, 3))
    drop[3, 1] = 0.2
    dented = dataclasses.replace(tin, vertices=vertices + drop)
    assert exchange_diagonals(dented, points).exchanges == 0
    pulled = dataclasses.replace(tin, vertices=vertices - drop)
    assert exchange_diagonals(pulled, points).exchanges == 1


def test_the_relevant_area_stays():
    tin, points = scene(seed=5)
    keep = (tin.vertices[tin.triangles, 0] < 6).all(axis=1)
    e = exchange_diagonals(dataclasses.replace(tin, relevant=keep), points)
    assert e.exchanges > 0 and np.array_equal(e.tin.triangles[~keep], tin.triangles[~keep])
    area = footprint_areas(tin.vertices, tin.triangles)[keep].sum()
    assert footprint_areas(e.tin.vertices, e.tin.triangles)[e.tin.relevant].sum() == pytest.approx(
        area, rel=1e-12
    )


def test_turning_the_scene_turns_the_result():
    tin, points = scene(seed=6)
    c, s = math.cos(1.1), math.sin(1.1)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moved = dataclasses.replace(tin, vertices=tin.vertices @ R.T + [50, 20, 5])
    a, b = exchange_diagonals(tin, points), exchange_diagonals(moved, points @ R.T + [50, 20, 5])
    assert np.array_equal(a.tin.triangles, b.tin.triangles) and b.asd_m == pytest.approx(
        a.asd_m, rel=1e-9
    )


def test_a_plane_needs_no_exchange():
    _, points = scene(seed=7)
    flat = points.copy()
    flat[:, 2] = 0.0
    assert exchange_diagonals(build_tin(flat[:80]), flat).exchanges == 0


def off_plane(vertices, triangle, p):
    """Height of p over the plane through three vertices, by solving for the plane."""
    at = vertices[list(triangle)]
    plane = np.linalg.solve(np.column_stack([np.ones(3), at[:, :2]]), at[:, 2])
    return p[2] - plane @ [1.0, *p[:2]]


def test_gains_and_residuals_are_those_of_planes():
    tin, points = scene(120, 25, seed=8)
    where, w = locate(triangle_index(tin), points[:, :2]), workspace()
    tri, nb = tin.triangles.astype(np.int64), tin.neighbours.astype(np.int64)
    lists = point_lists(where, len(tri))
    assert sorted(_walk(*lists)) == list(range(len(points)))
    r = np.array([off_plane(tin.vertices, tri[t], p) for t, p in zip(where, points, strict=True)])
    assert list_residuals(tin.vertices, points, tri, *lists) == pytest.approx(r, abs=1e-9)
    seen = 0
    for t in range(len(tri)):
        for k in range(3):
            surface = ListedSurface(tin.vertices, points, tri, nb, tin.relevant, *lists)
            lowered = exchange_gain(surface, t, k, True, w)
            if lowered == 0.0:
                continue
            two, one = [x.copy() for x in (tri, nb)], [x.copy() for x in lists]
            o = exchange_one(ListedSurface(tin.vertices, points, *two, tin.relevant, *one), t, k)
            mine = np.flatnonzero((where == t) | (where == o))
            new = list_residuals(tin.vertices, points, two[0], *one)[mine]
            after = np.array([int(i in set(_list(*one, t))) for i in mine])
            plane = [
                off_plane(tin.vertices, two[0][t if a else o], points[i])
                for i, a in zip(mine, after, strict=True)
            ]
            assert new == pytest.approx(plane, abs=1e-9)
            assert lowered == pytest.approx((r[mine] ** 2).sum() - (new**2).sum(), abs=1e-9)
            seen += 1
    assert seen > 10


def _list(first, after, t):
    p = first[t]
    while p >= 0:
        yield int(p)
        p = after[p]


def _walk(first, after):
    for p in first:
        while p >= 0:
            yield int(p)
            p = after[p]


@pytest.mark.parametrize(
    "points,measure,reason",
    [
        (np.zeros((4, 3)), "max", "surface_measure"),
        (np.zeros((4, 2)), "asd", "surface_shape"),
        (np.array([[1, 1, np.nan]]), "asd", "surface_not_finite"),
        (np.zeros((0, 3)), "rms", "surface_no_point"),
        (np.array([[99.0, 99, 0]]), "rms", "surface_no_point"),
    ],
)
def test_refusals(points, measure, reason):
    with pytest.raises(SurfaceError) as caught:
        exchange_diagonals(scene()[0], points, measure)
    assert caught.value.reason == reason
