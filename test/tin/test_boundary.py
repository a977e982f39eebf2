"""Boundary editing: closed forms on a grid, plain twins, and that nothing is lost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.adaptive import adaptive_tin
from ladar_volume.tin.boundary import (
    ears,
    edit_boundary,
    holes,
    islands,
    open_sides,
    part_numbers,
)
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.relevant import (
    artificial_vertices,
    circumdiameters,
    edge_lengths,
    relevant_triangles,
    with_relevant,
)


def grid_tin(n=9):
    x, y = np.meshgrid(np.arange(float(n)), np.arange(float(n)))
    return build_tin(np.column_stack([x.ravel(), y.ravel(), np.zeros(n * n)]))


def centres(tin):
    return tin.vertices[tin.triangles, :2].mean(axis=1)


def in_box(tin, x0, y0, x1, y1):
    c = centres(tin)
    return (c[:, 0] > x0) & (c[:, 0] < x1) & (c[:, 1] > y0) & (c[:, 1] < y1)


def ears_plain(tin, mask, limit, rng):
    """One ear after the other, any of them."""
    left, lengths = mask.copy(), edge_lengths(tin)
    while True:
        is_open = (tin.neighbours < 0) | ~left[tin.neighbours]
        found = np.flatnonzero(
            left
            & (is_open.sum(axis=1) >= 2)
            & (np.where(is_open, lengths, 0.0).max(axis=1) > limit)
        )
        if len(found) == 0:
            return mask & ~left
        left[rng.choice(found)] = False


def parts_plain(neighbours, mask):
    part = np.where(mask, np.arange(len(mask)), -1)
    changed = True
    while changed:
        changed = False
        for t in np.flatnonzero(mask):
            for o in neighbours[t]:
                if o >= 0 and mask[o] and part[o] < part[t]:
                    part[t], changed = part[o], True
    return np.where(mask, np.unique(part, return_inverse=True)[1] - (not mask.all()), -1)


@pytest.mark.parametrize("seed", range(4))
def test_plain_twins(seed):
    rng = np.random.default_rng(seed)
    tin = build_tin(rng.random((120, 3)))
    mask = rng.random(len(tin.triangles)) < 0.7
    for limit in (0.0, 0.1, 0.2, np.inf):
        expected = ears_plain(tin, mask, limit, rng)
        assert np.array_equal(ears(tin, mask, limit), expected)
    part = part_numbers(tin.neighbours, mask)
    assert np.array_equal(part, parts_plain(tin.neighbours, mask))
    # sides towards no triangle, or one that does not count, and the longest of them
    open_ = (tin.neighbours < 0) | ~mask[tin.neighbours]
    lengths = np.where(open_, edge_lengths(tin), 0.0).max(axis=1)
    for t in range(len(mask)):
        found = open_sides(tin.neighbours, mask, edge_lengths(tin), t)
        assert found == (open_[t].sum(), lengths[t])


def test_islands_and_holes_by_area():
    tin = grid_tin()
    mask = in_box(tin, 0, 0, 5, 8) & ~in_box(tin, 1, 1, 3, 2) & ~in_box(tin, 1, 4, 4, 7) | in_box(
        tin, 6, 6, 8, 7
    )
    area = footprint_areas(tin.vertices, tin.triangles)
    assert area[islands(tin, mask, 2.0)].sum() == 0.0 and area[islands(tin, mask, 2.1)].sum() == 2.0
    assert (
        area[holes(tin, mask, 1.9)].sum() == 0.0
        and area[holes(tin, mask, 2.0)].sum() == 2.0
        and area[holes(tin, mask, 9.0)].sum() == 11.0
    )
    # what reaches the hull is no hole, however small
    assert area[holes(tin, mask, 1e9)].sum() == 11.0
    out = edit_boundary(dataclasses.replace(tin, relevant=mask), min_island_m2=3.0, max_hole_m2=4.0)
    assert area[out.tin.relevant].sum() == area[mask].sum() - 2.0 + 2.0
    assert area[out.islands].sum() == 2.0 and area[out.holes].sum() == 2.0 and not out.ears.any()
    assert np.array_equal(out.tin.triangles, tin.triangles) and np.array_equal(
        mask ^ out.islands ^ out.holes, out.tin.relevant
    )


def test_ears_by_edge_length():
    x, y = np.meshgrid(np.arange(6.0), np.arange(2.0))
    strip = build_tin(np.column_stack([x.ravel(), y.ravel(), np.zeros(12)]))
    # a strip is peeled from its ends, all of it or nothing
    assert ears(strip, strip.relevant, 0.99).all() and not ears(strip, strip.relevant, 1.0).any()
    one = np.arange(10) == 4
    assert ears(strip, one, 1.4).sum() == 1 and not ears(strip, one, 1.5).any()
    spike = build_tin(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 9.0, 0]]))
    assert (
        ears(spike, spike.relevant, 3.0).sum() == 1
        and centres(spike)[ears(spike, spike.relevant, 3.0)][0, 1] > 1.0
    )


def test_by_default_nothing_changes_and_limits_are_checked():
    tin = build_tin(np.random.default_rng(0).random((60, 3)))
    tin = dataclasses.replace(tin, relevant=np.arange(len(tin.triangles)) % 3 > 0)
    out = edit_boundary(tin)
    assert (
        np.array_equal(out.tin.relevant, tin.relevant)
        and not (out.ears | out.islands | out.holes).any()
    )
    assert edit_boundary(tin, max_hole_m2=np.inf).tin.relevant.sum() >= tin.relevant.sum()
    for options in ({"max_ear_edge_m": -1.0}, {"min_island_m2": np.nan}, {"max_hole_m2": -0.1}):
        with pytest.raises(SurfaceError) as caught:
            edit_boundary(tin, **options)
        assert caught.value.reason == "surface_limit"
    with pytest.raises(SurfaceError) as caught:
        edit_boundary(tin, max_ear_edge_m=0.0, min_island_m2=1e9)
    assert caught.value.reason == "surface_no_relevant"
    everything = dataclasses.replace(tin, relevant=np.ones(len(tin.triangles), bool))
    assert edit_boundary(everything, max_hole_m2=1.0).tin.relevant.all()


def test_map_corners_are_known_by_their_source_and_never_filled():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.random((400, 2)) * 10.0, np.zeros(400)])
    points = points[(np.abs(points[:, 0] - 5.0) > 1.0) | (np.abs(points[:, 1] - 5.0) > 1.0)]
    out = adaptive_tin(points, ratio=1.0)
    tin = out.tin
    assert np.array_equal(artificial_vertices(tin), out.artificial)
    assert (
        np.array_equal(relevant_triangles(tin, "corners"), tin.relevant)
        and relevant_triangles(tin, "all").all()
    )
    by_edge = with_relevant(tin, "edge", 1.2, np.inf)
    hole = by_edge.relevant != tin.relevant
    assert (
        hole.any()
        and not by_edge.relevant[np.isin(tin.triangles, out.artificial).any(axis=1)].any()
    )
    filled = edit_boundary(by_edge, max_hole_m2=1e9)
    assert not np.isin(filled.tin.triangles[filled.tin.relevant], out.artificial).any()
    shadow = in_box(tin, 4.4, 4.4, 5.6, 5.6)
    assert not by_edge.relevant[shadow].any() and filled.tin.relevant[shadow].all()


def test_limits_of_the_options_and_flat_triangles():
    tin = grid_tin(3)
    for option, edge, circle in (
        ("edge", 0.0, 1.0),
        ("edge", np.nan, 1.0),
        ("circumcircle", 1.0, -1.0),
    ):
        with pytest.raises(SurfaceError) as caught:
            relevant_triangles(tin, option, edge, circle)
        assert caught.value.reason == "surface_limit"
    flat = build_tin(np.array([[0.0, 0, 0], [1e-300, 1e-200, 0], [1.0, 0, 0], [0.5, 1.0, 0]]))
    assert (circumdiameters(flat.vertices, flat.triangles) > 0).all() and not np.isnan(
        circumdiameters(flat.vertices, flat.triangles)
    ).any()
