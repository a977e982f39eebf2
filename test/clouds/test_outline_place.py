"""Where the sampled area ends: points alone beyond it, and the strip beyond it in sigma."""

import dataclasses

import numpy as np
import pytest

from ladar_volume.clouds.sampling.outline_place import FLAT, EdgeTriangles, outline_variance
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.boundary import boundary_sides
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.represent import represent
from ladar_volume.tin.sampled_area import sampled_area, sampled_without_isolated

FULL = SurfaceParameters(ratio=1.0, relevant="sampled")


def square(rng):
    return rng.uniform(-10, 10, (2500, 2)), 400.0


def band(rng):
    p = rng.uniform(-10, 10, (4000, 2))
    return p[np.abs(p[:, 1] - 3 * np.sin(p[:, 0])) < 4], 160.0


def grid(rng):
    side = np.arange(-9.75, 10, 0.5)
    p = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return p + rng.normal(0, 0.001, p.shape), 400.0


def lines(rng):
    return np.column_stack([rng.uniform(-10, 10, 5000), rng.integers(0, 20, 5000) - 9.5]), 400.0


def strip_of(xy, height=1.0):
    """Area of the sampled surface, and the standard deviation of its outline's place, m²."""
    tin, found = sampled_without_isolated(build_tin(np.c_[xy, np.zeros(len(xy))]))
    tin = dataclasses.replace(tin, relevant=found.mask)
    h = np.broadcast_to(height, (len(tin.vertices),))
    return found.area_m2, np.sqrt(outline_variance(tin, found.mask, h, [found]))


@pytest.mark.parametrize("made", [square, band, grid, lines])
def test_the_area_lost_at_the_edge_is_what_sigma_says(made):
    ratios = []
    for seed in range(3):
        xy, true = made(np.random.default_rng(seed))
        area, sigma = strip_of(xy)
        ratios.append((true - area) / sigma)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.4


def test_next_to_nothing_where_the_surface_meets_its_base():
    xy, _ = square(np.random.default_rng(1))
    rng = np.random.default_rng(2)
    tin, found = sampled_without_isolated(build_tin(np.c_[xy, np.zeros(len(xy))]))
    tin = dataclasses.replace(tin, relevant=found.mask)
    noise = rng.normal(0.0, 0.01, len(tin.vertices))
    assert outline_variance(tin, found.mask, noise, [found]) < 0.02**2
    inner = found.mask & (np.abs(tin.vertices[tin.triangles, :2]) < 5).all(axis=(1, 2))
    ones = np.ones(len(tin.vertices))
    assert outline_variance(tin, inner, ones, [found]) == 0.0  # no side of it is open
    assert outline_variance(tin, found.mask, ones, [None]) == 0.0
    # above and below the base: each direction alone, not nothing
    tilted = outline_variance(tin, found.mask, tin.vertices[:, 0] / 10.0, [found])
    assert 0.05 < tilted / outline_variance(tin, found.mask, ones, [found]) < 0.3


def test_flat_triangles_are_passed_over_as_a_walk_would():
    xy, _ = grid(np.random.default_rng(3))
    tin = build_tin(np.c_[xy, np.zeros(len(xy))])
    mask, area = np.ones(len(tin.triangles), bool), footprint_areas(tin.vertices, tin.triangles)
    cell, is_flat = np.full(len(tin.vertices), 0.25), 2 * area < FLAT * 0.25
    edge = EdgeTriangles(area, cell, is_flat, tin.neighbours == -1)
    found = {tuple(e) for e in edge.sides(tin, mask, edge.along(tin))}
    # the outline of what is left when flat triangles at it are taken off one after another
    left = mask.copy()
    while True:
        sides = boundary_sides(tin, left)[0]
        flat = [s for s in sides if 2 * area[s] < FLAT * 0.25]
        if not flat:
            break
        left[flat] = False
    t, k = boundary_sides(tin, left)
    true = set(zip(tin.triangles[t, (k + 1) % 3], tin.triangles[t, (k + 2) % 3], strict=True))
    assert true == found and len(left) - left.sum() > 20


def test_points_isolated_beyond_the_edge_change_nothing():
    rng = np.random.default_rng(4)
    xy, _ = band(rng)
    points = np.c_[xy, rng.normal(0, 0.01, len(xy))]
    angle = rng.uniform(0, 2 * np.pi, 30)
    far = 25.0 * np.c_[np.cos(angle), np.sin(angle), rng.uniform(-1, 1, 30)]
    clean, troubled = represent(points, FULL), represent(np.r_[far, points], FULL)
    assert troubled.sampled_area.beyond == 30 and clean.sampled_area.beyond == 0
    assert troubled.sampled_area.area_m2 == pytest.approx(clean.sampled_area.area_m2, rel=1e-12)
    assert np.array_equal(np.sort(troubled.tin.source), np.sort(clean.tin.source) + 30)
    # with the points in place the outline is bent
    bent = sampled_area(build_tin(np.r_[far, points])).area_m2
    assert bent < clean.sampled_area.area_m2
