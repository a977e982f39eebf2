"""Slivers whose area rounds to nothing: valid triangles to the exact predicates, zero to every
product.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.records import Tin
from ladar_volume.tin.diagonal_exchange import exchange_diagonals
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.locate import barycentric, height_at, locate, triangle_index
from ladar_volume.tin.relevant import edge_lengths
from ladar_volume.volume.field_checks.cut_bodies import cut_at_boundary
from ladar_volume.volume.overlay import volumes_between


def surface():
    """A square with a fold along its diagonal: the middle vertex is next to the line between two
    corners by less than rounding.
    """
    tiny = np.nextafter(0.5, 0.0)
    xy = np.array([[0, 0], [1, 1], [0.5, tiny], [1, 0], [0, 1]]) + 1e6
    xy[2, 1] = np.nextafter(xy[2, 0], 0.0)
    triangles = np.array([[0, 2, 1], [0, 3, 2], [3, 1, 2], [0, 1, 4]], np.int32)
    neighbours = np.array([[2, 3, 1], [2, 0, -1], [0, 1, -1], [-1, -1, 0]], np.int32)
    vertices = np.c_[xy, [1.0, 2, 3, 4, 5]]
    return Tin(vertices, triangles, neighbours, np.ones(4, bool), np.arange(5))


def test_slivers_neither_break_nor_hold_volume():
    tin = surface()
    flat = Tin(
        tin.vertices[[0, 3, 1, 4]] * [1, 1, 0],
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        np.array([[-1, 1, -1], [-1, -1, 0]], np.int32),
        np.ones(2, bool),
        np.arange(4),
    )
    for zero in (
        tin,
        Tin(
            tin.vertices,
            np.r_[tin.triangles, [[0, 1, 1]]].astype(np.int32),
            np.full((5, 3), -1, np.int32),
            np.ones(5, bool),
            tin.source,
        ),
    ):
        areas = footprint_areas(zero.vertices, zero.triangles)
        r = volumes_between(zero, flat)
        assert np.isfinite(r.gradient_net).all() and np.isfinite(r.lower_net).all()
        expected = (areas * zero.vertices[:, 2][zero.triangles].mean(axis=1)).sum()
        assert abs(r.net_m3 - expected) < 1e-8 and abs(r.area_m2 - 1.0) < 1e-8
        back = volumes_between(flat, zero)
        assert abs(back.net_m3 + r.net_m3) < 1e-8
    xy = tin.vertices[:, :2]
    assert np.isfinite(barycentric(tin, np.zeros(5, np.int64), xy)).all()
    assert (locate(triangle_index(tin), xy) >= 0).all() and np.isfinite(height_at(tin, xy)).all()


def test_points_in_slivers_have_residuals():
    tin = surface()
    e = exchange_diagonals(tin, np.r_[tin.vertices, [[1e6 + 0.25, 1e6 + 0.25, 9.0]]], "rms")
    assert np.isfinite([e.rms_m, e.asd_m, e.rms_before_m, e.asd_before_m]).all()


def test_a_cut_is_seen_where_one_long_side_passes_below_the_body():
    rng = np.random.default_rng(5)
    xy = rng.uniform((0.0, -10.0), (10.0, 10.0), (4000, 2))
    # two points beyond the others, on either side: the hull goes from ground to ground
    xy = np.r_[xy, [[10.02, -8.0], [10.02, 8.0]]]
    z = np.maximum(0.0, 2.0 - 0.4 * np.hypot(xy[:, 0] - 9.0, xy[:, 1]))
    tin = build_tin(np.c_[xy, z])
    level, inside = design_surface([0.0]), np.ones(len(tin.triangles), bool)
    longest = edge_lengths(tin)[tin.neighbours < 0].max()
    found = cut_at_boundary(tin, level, inside, 0.1)
    assert longest > 15.0 and found is not None and 6.0 < found.length_m < 10.5
    assert abs(found.x_m - 10.0) < 0.2 and abs(found.y_m) < 0.5
    inside[:] = False
    assert cut_at_boundary(tin, level, inside, 0.1) is None
