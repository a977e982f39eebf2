"""Notches that are taken off a triangulation: against a plain search, whatever the order of the
triangles.
"""

import dataclasses

import numpy as np
import pytest
from whole_and_tiles import SHAPES, scattered, thinning_out

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import has_selected_vertices
from ladar_volume.clouds.sampling.stray_effect import stray_effect
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.sampled_area import DEEP, LONG, peel_gaps, sampled_area, spacings


def plain_peel(tin, spacing, area):
    """Sets of triangles joined through long sides, one after the other."""
    xy, t, beyond = tin.vertices[:, :2], tin.triangles, tin.neighbours
    at = np.where(np.isfinite(spacing), spacing, 0.0)[t].min(axis=1)
    ends = xy[t[:, [[1, 2], [2, 0], [0, 1]]]]
    length = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    long = length > LONG * at[:, None]
    out, left = np.zeros(len(t), bool), set(range(len(t)))
    while left:
        part, new = set(), {left.pop()}
        while new:
            one = new.pop()
            part.add(one)
            for k in range(3):
                o = int(beyond[one, k])
                if o >= 0 and long[one, k] and length[one, k] > LONG * at[o] and o in left:
                    left.remove(o)
                    new.add(o)
        own = np.array(sorted(part))
        hull = (length[own] * (long[own] & (beyond[own] < 0))).sum()
        total, by_spacing = area[own].sum(), (area[own] * at[own]).sum()
        out[own] = hull > 0 and total * total > DEEP * by_spacing * hull
    return out


def surveyed(kind, shape, seed):
    rng = np.random.default_rng(seed)
    xy = kind(3000, rng)
    return np.column_stack([xy[SHAPES[shape](*xy.T)], np.zeros(SHAPES[shape](*xy.T).sum())])


@pytest.mark.parametrize("shape", ["L", "notch", "ellipse", "two"])
@pytest.mark.parametrize("kind", [scattered, thinning_out], ids=lambda k: k.__name__)
def test_what_is_taken_off_is_what_a_plain_search_takes(kind, shape):
    tin = build_tin(surveyed(kind, shape, 1))
    area, spacing = footprint_areas(tin.vertices, tin.triangles), spacings(tin.vertices[:, :2])
    found = peel_gaps(tin, spacing, area)
    assert np.array_equal(found, plain_peel(tin, spacing, area))
    if kind is scattered and shape != "ellipse":
        assert 200.0 < area[found].sum() < 500.0


def test_the_order_of_the_triangles_does_not_matter():
    tin = build_tin(surveyed(thinning_out, "notch", 2))
    order = np.random.default_rng(3).permutation(len(tin.triangles))
    number = np.append(np.argsort(order), -1).astype(np.int32)
    other = dataclasses.replace(
        tin,
        triangles=tin.triangles[order],
        neighbours=number[tin.neighbours[order]],
        relevant=tin.relevant[order],
    )
    one, two = sampled_area(tin), sampled_area(other)
    assert np.array_equal(one.mask[order], two.mask)
    assert one.parts == two.parts and one.area_m2 == pytest.approx(two.area_m2, rel=1e-12)


def test_a_point_alone_beyond_does_not_count_as_a_choice_of_vertices():
    rng = np.random.default_rng(4)
    points = surveyed(scattered, "box", 5)
    points[:, 2] = rng.normal(0, 0.02, len(points))
    alone = np.vstack([points, [[140.0, 20.0, 0.0]]])
    options = SurfaceParameters(ratio=1.0, relevant="sampled")
    surface = cloud_surface(alone, options)
    assert surface.representation.sampled_area.beyond == 1
    assert not has_selected_vertices(surface)
    assert has_selected_vertices(cloud_surface(alone, SurfaceParameters(ratio=0.2)))


def test_strays_beyond_the_surface_change_nothing_within_it():
    points = surveyed(scattered, "box", 6)
    tin = build_tin(points)
    area = footprint_areas(tin.vertices, tin.triangles)
    beyond = np.array([[90.0, 20.0, 5.0], [-20.0, 3.0, -7.0]])
    assert stray_effect(tin, area, beyond) == 0.0
    over = np.array([[30.0, 20.0, 3.0]])
    one = stray_effect(tin, area, over)
    assert one < -0.1  # it lifts the surface around it
    assert stray_effect(tin, area, np.vstack([beyond, over])) == one
