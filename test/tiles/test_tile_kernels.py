"""Kernels that go over the triangles and vertices of a tile, against plain NumPy."""

import numpy as np
import pytest

from ladar_volume.clouds.between_points import middles_of
from ladar_volume.mesh.topology import edge_table
from ladar_volume.tiles.joined_triangles import distinct_triangles
from ladar_volume.tiles.tile_fit import binned, bins_of, blocks_of
from ladar_volume.tiles.tile_patch import ascending, rows_at
from ladar_volume.tiles.tile_stars import FLAT, MARGIN, circle_boxes, open_sides, rows_reached
from ladar_volume.tiles.tile_surface import UNKNOWN, star_kernel
from ladar_volume.tiles.unseen.tile_spacing import distinct_cells, first_of_cells
from ladar_volume.tiles.unseen.tiled_layers import first_at
from ladar_volume.tin.full_tin import across_sides, build_tin, corners_of


def neighbours_of(triangles):
    """What :func:`across_sides` gives, from a table of edges."""
    order, start, _ = edge_table(triangles)
    pair = start[:-1][np.diff(start) == 2]
    i, j = order[pair], order[pair + 1]
    out = np.full((len(triangles), 3), -1, np.int32)
    out[i // 3, (i % 3 + 2) % 3], out[j // 3, (j % 3 + 2) % 3] = j // 3, i // 3
    return out


def mixed(seed, n=400):
    """A surface, and its triangles, some of them several times with turned corners."""
    rng = np.random.default_rng(seed)
    tin = build_tin(rng.uniform(0, 10, (n, 3)))
    t = tin.triangles
    more = t[rng.integers(0, len(t), n)]
    more = np.stack([np.roll(one, k) for one, k in zip(more, rng.integers(0, 3, n), strict=True)])
    return tin, np.concatenate([t, more])[rng.permutation(len(t) + n)].astype(np.int32)


@pytest.mark.parametrize("seed", range(4))
def test_triangles_are_taken_once_and_know_their_neighbours(seed):
    tin, corners = mixed(seed)
    rows, found = distinct_triangles(corners, len(tin.vertices))
    turned = np.stack([np.roll(one, -int(np.argmin(one))) for one in corners])
    first = np.sort(np.unique(turned, axis=0, return_index=True)[1])
    assert np.array_equal(rows, first)
    assert np.array_equal(found, turned[first])
    assert np.array_equal(across_sides(found, len(tin.vertices)), neighbours_of(found))
    some = found[:: seed + 2]  # with holes
    assert np.array_equal(across_sides(some, len(tin.vertices)), neighbours_of(some))


def test_a_side_of_three_triangles_has_no_other_side():
    t = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.int32)
    assert np.array_equal(across_sides(t, 5), neighbours_of(t))
    assert (across_sides(t, 5) == -1).all()


def test_corners_of_triangles():
    _, corners = mixed(9)
    some = corners[::11]
    assert np.array_equal(corners_of(some, 400), np.unique(some))
    assert len(corners_of(some[:0], 400)) == 0


@pytest.mark.parametrize("seed", range(3))
def test_circles_lie_in_their_boxes(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 10.0**seed, (300, 3, 2)) + 1e5 * seed
    corners[::7, 2] = 0.5 * (corners[::7, 0] + corners[::7, 1])  # flat
    box = circle_boxes(corners)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v = b - a, c - a
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    longest = np.max([(u**2).sum(1), (v**2).sum(1), ((u - v) ** 2).sum(1)], axis=0)
    assert np.array_equal(np.isnan(box).any(axis=1), ~(twice > FLAT * longest))
    good = twice > 1e-3 * longest
    A = 2.0 * np.stack([u, v], axis=1)[good]
    middle = np.linalg.solve(A, np.stack([(u**2).sum(1), (v**2).sum(1)], axis=1)[good][..., None])
    middle = a[good] + middle[..., 0]
    radius = np.hypot(*(middle - a[good]).T)
    low, high = middle - radius[:, None], middle + radius[:, None]
    slack = 4.0 * MARGIN * radius + 1e-9
    assert ((box[good, :2] <= low + 1e-9) & (box[good, 2:] >= high - 1e-9)).all()
    assert (np.abs(box[good, :2] - low) < slack[:, None] + 1e-6).all()


@pytest.mark.parametrize("step", [1, 3, 40])
def test_blocks_are_those_of_a_search(step):
    rng = np.random.default_rng(step)
    size = 16
    begin = np.unique(rng.integers(0, 100, 60) * step * size)
    row = rng.integers(-30, begin[-1] + 3 * size, 5000)
    at = np.searchsorted(begin, row, side="right") - 1
    expected = np.where((at >= 0) & (row < begin[at] + size), at, -1)
    assert np.array_equal(blocks_of(row, begin, size), expected)
    assert (blocks_of(row, begin[:0], size) == -1).all()
    some = np.unique(rng.choice(row, 900))
    assert np.array_equal(blocks_of(row, some, 1) >= 0, np.isin(row, some))
    whole = np.arange(0, 4000, size)
    assert np.array_equal(blocks_of(np.arange(4000), whole, size), np.arange(4000) // size)


def test_cells_are_told_once():
    rng = np.random.default_rng(2)
    cells = rng.integers(4, 30, 900) * 1000 + rng.integers(500, 530, 900)
    assert np.array_equal(distinct_cells(cells, 1000), np.unique(cells))
    assert len(distinct_cells(cells[:0], 1000)) == 0


def test_one_vertex_of_each_cell():
    rng = np.random.default_rng(5)
    name = np.column_stack([rng.integers(0, 3, 800), rng.integers(-4, 9, (800, 2))])
    off, row = rng.integers(0, 5, 800) / 8.0, rng.permutation(800)
    order = np.lexsort((row, off, name[:, 2], name[:, 1], name[:, 0]))
    new = np.r_[True, (np.diff(name[order], axis=0) != 0).any(axis=1)]
    assert np.array_equal(first_of_cells(name, off, row), order[new])
    assert len(first_of_cells(name[:0], off[:0], row[:0])) == 0


def test_middles_do_not_depend_on_the_order_of_corners():
    corners = np.random.default_rng(6).normal(size=(200, 3, 2)) + 5e6
    found = middles_of(corners)
    assert np.array_equal(found, np.sort(corners, axis=1).mean(axis=1))
    for order in ([1, 2, 0], [2, 1, 0]):
        assert np.array_equal(middles_of(np.ascontiguousarray(corners[:, order])), found)


def test_the_first_point_of_the_file_at_each_place():
    rng = np.random.default_rng(4)
    points = np.round(rng.uniform(0.0, 3.0, (500, 3)), 1)  # many with one x, some at one place
    own = points[rng.permutation(500)[:60]]
    plain = [next(k for k, p in enumerate(points) if tuple(p[:2]) == tuple(at[:2])) for at in own]
    assert first_at(points, own).tolist() == plain


@pytest.mark.parametrize("spread", [0.3, 40.0])  # bins near together are counted, others sorted
def test_values_are_counted_in_bins(spread):
    rng = np.random.default_rng(7)
    value = np.exp(rng.normal(0.0, spread, 700))
    bins, count = binned(None, None, lambda of, tile: np.r_[value, value[:90]])
    assert np.array_equal(bins, np.unique(bins_of(value)))
    assert [int(n) for n in count] == [
        int(np.sum(bins_of(np.r_[value, value[:90]]) == one)) for one in bins
    ]
    none, zero = binned(None, None, lambda of, tile: value[:0])
    assert len(none) == len(zero) == 0


def half(seed, n=500):
    """A surface, which of its vertices lie to the left, and the triangles that meet one of them."""
    tin = build_tin(np.random.default_rng(seed).uniform(0.0, 10.0, (n, 3)))
    own = tin.vertices[:, 0] < 5.0
    return tin, own, own[tin.triangles].any(axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_triangles_of_a_tile_know_what_lies_beyond_them(seed):
    tin, own, star = half(seed)
    kept = np.flatnonzero(star)
    corners = np.unique(tin.triangles[star])
    number, place = np.full(len(star), -1, np.int32), np.full(len(own), -1, np.int32)
    number[kept], place[corners] = np.arange(len(kept)), np.arange(len(corners))
    triangles, across = star_kernel(tin.triangles, tin.neighbours, number, place, own)
    assert np.array_equal(corners[triangles], tin.triangles[kept])
    for i, t in enumerate(kept):
        for k in range(3):
            beyond = tin.neighbours[t, k]
            sides = own[np.delete(tin.triangles[t], k)].any()
            expected = (-1 if sides else UNKNOWN) if beyond < 0 else int(number[beyond])
            assert across[i, k] == (UNKNOWN if beyond >= 0 and expected < 0 else expected)


@pytest.mark.parametrize("seed", range(3))
def test_open_sides_are_those_whose_circles_leave_the_box_and_the_hull(seed):
    tin, own, star = half(seed)
    safe = (-30.0, -30.0, 6.0, 30.0)
    whole = np.array([[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]])
    found = open_sides(tin, star, own, safe, whole)
    corners = tin.vertices[tin.triangles[star]][..., :2]
    reach = circle_boxes(np.ascontiguousarray(corners))
    inside = (reach[:, :2] > safe[:2]).all(axis=1) & (reach[:, 2:] < safe[2:]).all(axis=1)
    assert 0 < inside.sum() < len(inside)
    assert np.array_equal(found.corners, corners[~inside])
    assert np.array_equal(found.reach, reach[~inside])
    sides = [
        tuple(np.roll(t, -k)[1:])
        for t, beyond in zip(tin.triangles, tin.neighbours, strict=True)
        for k in range(3)
        if beyond[k] < 0 and own[np.roll(t, -k)[1:]].any()
    ]
    assert {tuple(map(tuple, e)) for e in found.ends.tolist()} == {
        tuple(map(tuple, tin.vertices[list(s), :2].tolist())) for s in sides
    }
    all_known = open_sides(tin, star, own, safe, tin.vertices[:, :2])
    assert len(all_known.ends) == 0  # no point lies beyond the hull of all


def test_rows_in_the_box_around_all_circles():
    rng = np.random.default_rng(1)
    points, reach = rng.uniform(0.0, 10.0, (300, 4)), rng.uniform(2.0, 6.0, (5, 2))
    reach = np.column_stack([reach, reach + 1.0])
    low, high = reach[:, :2].min(axis=0), reach[:, 2:].max(axis=0)
    inside = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
    assert np.array_equal(rows_reached(points, reach), np.flatnonzero(inside))
    reach[3] = np.nan  # of a flat triangle: it may reach anywhere
    assert len(rows_reached(points, reach)) == 300


def test_places_in_order_are_told_from_others():
    xy = np.round(np.random.default_rng(2).uniform(0.0, 2.0, (200, 2)), 1)
    order = np.lexsort((xy[:, 1], xy[:, 0]))
    assert ascending(xy[order]) and ascending(xy[:1]) and not ascending(xy)
    assert not ascending(xy[order][::-1])
    for places in (xy[order], xy):  # rows are found either way
        places = places[np.sort(np.unique(places, axis=0, return_index=True)[1])]
        rows = rows_at(places, np.r_[places[::7], [[9.0, 9.0]]])
        assert rows.tolist() == [*range(0, len(places), 7), -1]
