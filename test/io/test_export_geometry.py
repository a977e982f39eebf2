"""Outlines with holes, contours, and surfaces cut along polygons, on random surfaces."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from ladar_volume.io.export.contour_lines import contours, interval_of
from ladar_volume.io.export.edge_rings import polygons_of, signed_area
from ladar_volume.io.export.outline_clip import clip_to_polygon, contains
from ladar_volume.model.errors import OutputError
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.represent import represent


def surface(seed, n=120):
    rng = np.random.default_rng(seed)
    r = np.add(rng.uniform(0.0, 10.0, (n, 3)), [5e5, 5e6, 100.0])
    return represent(r, SurfaceParameters(ratio=1.0)).tin


def star(rng, corners=9):
    """A simple polygon with notches, partly off the surface."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
    radius = rng.uniform(1.0, 8.0, corners)
    return np.add(np.c_[np.cos(angle), np.sin(angle)] * radius[:, None], [5e5 + 5.0, 5e6 + 5.0])


@pytest.mark.parametrize("seed", range(12))
def test_rings_hold_the_area_of_their_triangles_and_pass_no_vertex_twice(seed):
    tin = surface(seed)
    mask = np.random.default_rng(seed).random(len(tin.triangles)) < 0.6
    found = polygons_of(tin, mask)
    area = footprint_areas(tin.vertices, tin.triangles)[mask].sum()
    assert sum(p.area_m2 for p in found) == pytest.approx(area, rel=1e-9)
    assert [p.area_m2 for p in found] == sorted((p.area_m2 for p in found), reverse=True)
    for polygon in found:
        assert signed_area(polygon.outer) > 0 and all(signed_area(h) < 0 for h in polygon.holes)
        for ring in (polygon.outer, *polygon.holes):
            assert len(np.unique(ring, axis=0)) == len(ring) >= 3


@pytest.mark.parametrize("seed", range(12))
def test_pieces_are_what_the_polygon_and_the_surface_share(seed):
    tin, rng = surface(seed), np.random.default_rng(100 + seed)
    polygon = star(rng)
    if seed % 3 == 0:  # corners on vertices, edges along edges
        polygon = tin.vertices[rng.choice(len(tin.vertices), 3, replace=False), :2]
    points = np.column_stack([tin.vertices, 2.0 * tin.vertices[:, 0] - tin.vertices[:, 1]])
    cut = clip_to_polygon(points, tin.triangles, polygon)
    area = footprint_areas(tin.vertices, tin.triangles).sum()
    inside, outside = (footprint_areas(cut.points[:, :3], t) for t in (cut.inside, cut.outside))
    assert inside.sum() + outside.sum() == pytest.approx(area, rel=1e-9)
    assert inside.min(initial=1.0) > -1e-9 and outside.min(initial=1.0) > -1e-9
    # heights stay on the surface, and what is linear stays linear
    off = cut.points[:, 3] - (2.0 * cut.points[:, 0] - cut.points[:, 1])
    assert np.abs(off).max() < 1e-8
    # by chance places: inside is what both hold
    xy = np.add(rng.uniform(0.0, 10.0, (20_000, 2)), [5e5, 5e6])
    both = contains(polygon, xy) & (Delaunay(tin.vertices[:, :2] - [5e5, 5e6]).find_simplex(
        xy - [5e5, 5e6]) >= 0)  # fmt: skip
    assert inside.sum() == pytest.approx(both.mean() * 100.0, abs=1.6)


@pytest.mark.parametrize("seed", range(6))
def test_contours_lie_on_the_surface_and_end_at_its_edge_alone(seed):
    tin = surface(seed)
    r = tin.vertices - [5e5, 5e6, 0.0]
    if seed % 2:
        r[:, 2] = np.round(r[:, 2])  # vertices at the very heights of the contours
    hull = Delaunay(r[:, :2])
    lines = list(contours(r, tin.triangles, 1.0))
    length = 0.0
    for contour in lines:
        corners = r[tin.triangles]
        middle = 0.5 * (contour.line[:-1] + contour.line[1:])
        where = hull.find_simplex(middle)
        assert (where >= -1).all() and len(contour.line) >= 2
        length += float(np.linalg.norm(np.diff(contour.line, axis=0), axis=1).sum())
        assert contour.index == (round(contour.height_m) % 5 == 0)
    # each triangle has one segment for each height between its lowest and its highest vertex
    segments = sum(len(c.line) - 1 for c in lines)
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    assert segments == int((np.floor(high) - np.floor(low)).sum()) and length > 10.0


def test_intervals_are_round_and_too_many_contours_are_refused():
    assert interval_of(0.0, 12.0) == 1.0 and interval_of(100.0, 101.1) == pytest.approx(0.1)
    assert interval_of(3.0, 3.0) == 1.0
    tin = surface(0)
    with pytest.raises(OutputError, match="wider interval"):
        list(contours(tin.vertices, tin.triangles, 1e-3))
    with pytest.raises(OutputError, match="wider interval"):
        list(contours(tin.vertices, tin.triangles, 1e-320))
    far = np.array([[0.0, 0.0, 1e300], [1.0, 0.0, -1e300], [0.0, 1.0, 0.0]])
    with pytest.raises(OutputError, match="inf heights"):
        list(contours(far, np.array([[0, 1, 2]], np.int32), 1e-9))
