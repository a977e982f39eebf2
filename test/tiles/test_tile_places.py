"""Footprints and the hull of all points, each told another way."""

from fractions import Fraction

import numpy as np
import pytest

from ladar_volume.clouds.between_points import places_in_triangles
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull, off_hull
from ladar_volume.tin.duplicates import places_and_rows
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import locate_in_delaunay


def side(a, b, p):
    """Twice the area of a triangle, without rounding."""
    (ax, ay), (bx, by), (px, py) = ([Fraction(float(v)) for v in q] for q in (a, b, p))
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


CLOUDS = {
    "random": lambda rng: rng.random((60, 2)),
    "lattice": lambda rng: rng.integers(0, 6, (60, 2)).astype(float),
    "line": lambda rng: np.outer(rng.integers(0, 9, 20), [0.1, 0.3]),
    "one": lambda rng: np.full((3, 2), 0.7),
    "map": lambda rng: rng.integers(0, 9, (50, 2)) * 1e-3 + [5e5, 5e6],
}


@pytest.mark.parametrize("kind", CLOUDS)
def test_the_hull_has_all_places_to_its_left_and_no_corner_too_many(kind):
    rng = np.random.default_rng(3)
    xy = np.unique(CLOUDS[kind](rng), axis=0)
    hull = hull_of_places(xy)
    assert {tuple(h) for h in hull} <= {tuple(p) for p in xy}
    for k in range(len(hull) if len(hull) > 2 else 0):
        a, b, c = hull[k], hull[(k + 1) % len(hull)], hull[(k + 2) % len(hull)]
        assert all(side(a, b, p) >= 0 for p in xy) and side(a, b, c) > 0
    if len(hull) < 3:  # all on one line: both ends of it
        assert {tuple(h) for h in hull} == {tuple(xy[0]), tuple(xy[-1])}
    parts = [hull_of_places(xy[k::3]) for k in range(3) if len(xy[k::3])]
    np.testing.assert_array_equal(joined_hull(parts), hull)
    ends = xy[rng.integers(0, len(xy), (40, 2))]
    plain = [any(side(a, b, p) < 0 for p in xy) for a, b in ends]
    assert off_hull(ends, hull).tolist() == plain


def test_footprints_are_those_of_a_dictionary():
    rng = np.random.default_rng(5)
    r = rng.integers(0, 4, (200, 3)) * 0.5 - 0.5
    rows = rng.permutation(1000)[:200]
    heights, first = {}, {}
    for p, row in zip(r.tolist(), rows.tolist(), strict=True):
        heights.setdefault((p[0], p[1]), set()).add(p[2])
        first[p[0], p[1]] = min(row, first.get((p[0], p[1]), row))
    found, least = places_and_rows(r, rows)
    assert [tuple(p[:2]) for p in found.tolist()] == sorted(heights)
    for (x, y, z, count), row in zip(found.tolist(), least.tolist(), strict=True):
        assert count == len(heights[x, y]) and row == first[x, y]
        assert z == pytest.approx(np.mean(list(heights[x, y])))
    none, no_rows = places_and_rows(np.zeros((0, 3)), np.zeros(0, np.int64))
    assert none.shape == (0, 4) and len(no_rows) == 0


def test_a_place_on_an_edge_is_in_the_same_triangle_from_either_side():
    x, y = (a.ravel() for a in np.meshgrid(np.arange(6.0), np.arange(5.0)))
    tin = build_tin(np.column_stack([x, y, np.sin(x) + y]))
    t, k = np.nonzero(tin.neighbours >= 0)
    a, b = (tin.vertices[tin.triangles[t, (k + s) % 3]] for s in (1, 2))
    middle = 0.5 * (a + b)
    own = places_in_triangles(tin, middle, t.astype(np.int64))
    other = places_in_triangles(tin, middle, tin.neighbours[t, k].astype(np.int64))
    np.testing.assert_array_equal(own.where, other.where)
    corners = tin.vertices[tin.triangles[own.where], 2]
    np.testing.assert_allclose((own.coarse * corners).sum(axis=1), middle[:, 2], atol=1e-12)
    inner = tin.vertices[tin.triangles].mean(axis=1)  # none on an edge: nothing moves
    where = locate_in_delaunay(tin, inner[:, :2])
    np.testing.assert_array_equal(places_in_triangles(tin, inner, where).where, where)
