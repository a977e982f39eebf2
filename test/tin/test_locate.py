"""Points in triangles: the tree against asking every triangle, edges, holes, and what lies
outside.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import (
    barycentric,
    centres_of,
    corners_of,
    curve_keys,
    height_at,
    locate,
    locate_in_delaunay,
    locate_plain,
    search_boxes,
    triangle_index,
)


def surface(n=200, seed=0, integer=False):
    rng = np.random.default_rng(seed)
    xy = rng.integers(0, 12, (n, 2)).astype(float) if integer else rng.normal(0, 3, (n, 2))
    return build_tin(np.c_[xy, rng.normal(size=n)])


@pytest.mark.parametrize("integer", [False, True])
def test_the_tree_equals_asking_every_triangle(integer):
    tin = surface(integer=integer)
    rng = np.random.default_rng(1)
    xy = np.r_[
        rng.uniform(-12, 13, (150, 2)), tin.vertices[:, :2], rng.integers(-1, 13, (100, 2)) / 2.0
    ]
    index = triangle_index(tin)
    found = locate(index, xy)
    assert np.array_equal(found, locate_plain(index, xy))
    if integer:
        inside = ((xy >= 0) & (xy <= 11)).all(axis=1)
        assert np.array_equal(found >= 0, inside)


def test_every_vertex_and_edge_point_is_inside_and_keeps_its_height():
    tin = surface(seed=2)
    p = tin.vertices[tin.triangles]
    assert height_at(tin, tin.vertices[:, :2]) == pytest.approx(tin.vertices[:, 2], abs=1e-12)
    third = p.mean(axis=1)
    assert height_at(tin, third[:, :2]) == pytest.approx(third[:, 2], abs=1e-12)
    assert np.isnan(height_at(tin, np.array([[1e3, 0.0], [-1e3, 5.0]]))).all()


def test_irrelevant_triangles_are_holes():
    tin = surface(seed=3)
    keep = np.random.default_rng(0).random(len(tin.triangles)) < 0.5
    holes = dataclasses.replace(tin, relevant=keep)
    centre = tin.vertices[tin.triangles].mean(axis=1)[:, :2]
    assert np.array_equal(np.isnan(height_at(holes, centre)), ~keep)
    assert np.array_equal(locate(triangle_index(holes, keep), centre)[keep], np.flatnonzero(keep))
    with pytest.raises(SurfaceError):
        triangle_index(tin, np.zeros(len(tin.triangles), bool))


def test_barycentric_coordinates():
    tin = surface(seed=4)
    xy = np.random.default_rng(1).normal(0, 2, (80, 2))
    where = locate(triangle_index(tin), xy)
    w = barycentric(tin, where, xy)
    assert w.sum(axis=1) == pytest.approx(np.ones(80)) and w.min() > -1e-12
    assert np.einsum("nk,nkc->nc", w, tin.vertices[tin.triangles[where], :2]) == pytest.approx(
        xy, abs=1e-12
    )


def plain_barycentric(tin, triangle, xy):
    """By areas, all places at once."""
    p = tin.vertices[:, :2][tin.triangles[triangle]]
    a, b, c = (p[:, k] - xy for k in range(3))
    area = np.stack([np.linalg.det(np.stack(q, axis=1)) for q in ((b, c), (c, a), (a, b))], axis=1)
    weights = area / area.sum(axis=1, keepdims=True)
    weights[triangle < 0] = np.nan
    return weights


def test_barycentric_coordinates_are_shares_of_area():
    tin, rng = surface(), np.random.default_rng(6)
    xy = rng.uniform(-12, 13, (300, 2))
    where = locate(triangle_index(tin), xy)
    assert 0 < np.count_nonzero(where < 0) < 300
    found = barycentric(tin, where, xy)
    np.testing.assert_allclose(found, plain_barycentric(tin, where, xy), rtol=1e-12, atol=1e-15)
    # three corners in a line: the nearest has all the weight
    line = build_tin(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    flat = dataclasses.replace(line, vertices=np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]))
    corner = flat.vertices[flat.triangles[0], :2]
    assert barycentric(flat, np.array([0]), corner[1:2] + 0.2).tolist() == [[0.0, 1.0, 0.0]]


def test_one_triangle_and_no_points():
    tin = build_tin(np.array([[0, 0, 1.0], [1, 0, 2], [0, 1, 3]]))
    index = triangle_index(tin)
    assert locate(index, np.array([[0.2, 0.2], [0.5, 0.5], [0.6, 0.6]])).tolist() == [0, 0, -1]
    assert locate(index, np.zeros((0, 2))).shape == (0,)


def test_the_kernels_equal_their_plain_twins():
    tin = surface(40, seed=5)
    index = triangle_index(tin)
    xy = np.random.default_rng(3).normal(0, 3, (30, 2))
    assert np.array_equal(locate(index, xy), locate_plain(index, xy))
    centres = index.corners.mean(axis=1)
    for f, expected in ((centres_of, centres), (corners_of, index.corners)):
        compiled = f(tin.vertices, tin.triangles, index.order)
        assert compiled == pytest.approx(expected, abs=1e-15)
    assert np.array_equal(curve_keys(centres), np.sort(curve_keys(centres)))
    # a box holds those of its two halves
    half = len(index.boxes) // 2
    for k in range(1, half):
        both = index.boxes[2 * k : 2 * k + 2]
        assert np.array_equal(index.boxes[k, :2], both[:, :2].min(axis=0))
        assert np.array_equal(index.boxes[k, 2:], both[:, 2:].max(axis=0))
    box = np.array([-1.0, -1, 1, 1])
    a = np.full(200, -1, np.int64)
    n = search_boxes(index.boxes, len(centres), box, np.empty(128, np.int64), a)
    low, high = index.corners.min(axis=1), index.corners.max(axis=1)
    meets = np.flatnonzero((low <= 1).all(axis=1) & (high >= -1).all(axis=1))
    assert set(meets) <= set(a[:n])
    assert (
        search_boxes(index.boxes, len(centres), box, np.empty(128, np.int64), np.empty(1, np.int64))
        == n
    )


@pytest.mark.parametrize("integer", [False, True])
def test_a_walk_finds_the_triangle_that_the_tree_finds(integer):
    rng = np.random.default_rng(12)
    xy = rng.uniform(0, 30, (800, 2))
    tin = build_tin(np.c_[np.round(xy) if integer else xy, np.zeros(800)])
    places = np.r_[rng.uniform(-3, 33, (3000, 2)), tin.vertices[:, :2], tin.vertices[::2, :2] + 0.5]
    index = triangle_index(tin)
    assert np.array_equal(locate_in_delaunay(tin, places), locate(index, places))
    some = places[::60]
    assert np.array_equal(locate_in_delaunay(tin, some), locate_plain(index, some))
    assert len(locate_in_delaunay(tin, places[:0])) == 0


#: Points a unit of the last place off edges: the exact stage is asked, and counts that it was.
NEAR_EDGES = """
import numpy as np
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import locate, locate_in_delaunay, locate_plain, triangle_index

rng = np.random.default_rng(5)
tin = build_tin(np.c_[rng.uniform(0.0, 9.0, (12, 2)), np.zeros(12)])
p = tin.vertices[tin.triangles, :2]
share = rng.uniform(0.2, 0.8, (len(p), 3, 1))
on = (share * p + (1.0 - share) * np.roll(p, 1, axis=1)).reshape(-1, 2)
xy = np.concatenate([np.nextafter(on, side) for side in (-99.0, 99.0)])
index = triangle_index(tin)
assert np.array_equal(locate(index, xy), locate_plain(index, xy))
found = locate_in_delaunay(tin, xy)
assert np.array_equal(found, locate_plain(index, xy))
"""


def test_places_near_edges_write_nothing_beyond_the_scratch_rows():
    """Compiled code writes beyond an array without a word; Python does not."""
    done = subprocess.run(
        [sys.executable, "-c", NEAR_EDGES],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-800:]
