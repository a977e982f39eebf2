"""A body on a slab that the outline takes in: two readings of the base differ."""

import math

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.field_checks.terrace import terrace_height, terrace_points

CONE = math.pi * 6.0**3 * 0.65 / 3.0


def cloud(ledge_m, high_m, noise=0.01, squared=False, seed=1):
    """A cone of 6 m on a slab that reaches so far beyond its toe, on sloping ground."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-12.0, 12.0, (30_000, 2))
    r = np.hypot(*xy.T)
    z = 3.0 * np.clip(1.0 - r / 6.0, 0.0, 1.0) ** 2 if squared else np.maximum(6.0 - r, 0.0) * 0.65
    z += np.where(r < 6.0 + ledge_m, high_m, 0.0) + 0.02 * xy[:, 0]
    return np.c_[xy, z + rng.normal(0.0, noise, len(xy))]


def names(answer):
    return {reason["name"] for reason in answer.facts["verdict"]["reasons"]}


@pytest.mark.parametrize(("ledge_m", "high_m"), [(0.6, 0.25), (1.2, 0.1), (1.5, 0.4)])
def test_a_slab_is_a_reading_of_the_base_and_in_sigma(ledge_m, high_m):
    found = lv.volume(cloud(ledge_m, high_m), base="ground", units="m")
    assert "base_toe" in names(found)
    assert abs(found.net_m3 - CONE) < 2.0 * found.sigma_m3
    assert found.sigma_m3 < 2.0 * (found.net_m3 - CONE)


@pytest.mark.parametrize("more", [{}, {"noise": 0.05}, {"squared": True}])
def test_a_cone_and_a_toe_that_runs_out_are_no_terrace(more):
    assert "base_toe" not in names(lv.volume(cloud(0.0, 0.0, **more), base="ground", units="m"))


def test_the_height_is_where_far_more_area_lies_than_next_to_it():
    flank = np.linspace(0.0, 4.0, 4001)
    area = np.full(len(flank), 0.05)
    assert terrace_height(flank, area, 0.02) == 0.0
    ledge = np.full(200, 0.30)
    height, areas = np.concatenate([flank, ledge]), np.concatenate([area, np.full(200, 0.05)])
    assert terrace_height(height, areas, 0.02) == pytest.approx(0.30, abs=0.02)
    assert terrace_height(height + 0.9, areas, 0.02) == 0.0  # a berm, which is the pile's own


def test_a_ledge_whose_edges_the_filter_rounded_is_found():
    """A slab of 23 cm, 1 to 3 m wide under filtered points: 1014 ± 1.1 m³ were told of 904."""
    flank = np.linspace(0.0, 4.0, 4001)
    ledge = np.random.default_rng(1).normal(0.23, 0.04, 4000)
    height = np.concatenate([flank, ledge])
    area = np.concatenate([np.full(4001, 0.05), np.full(4000, 0.01)])
    assert terrace_height(height, area, 0.02) == pytest.approx(0.23, abs=0.03)
    runs_out = 4.0 * np.linspace(0.0, 1.0, 4001) ** 3
    assert terrace_height(runs_out, np.full(4001, 0.05), 0.02) == 0.0


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_triangles_over_what_was_not_seen_are_no_terrace(seed):
    """No returns on a strip from a flank to the edge."""
    rng = np.random.default_rng(seed)
    side = np.arange(-12.0, 12.01, 0.25)
    x, y = (c.ravel() + rng.uniform(-0.1, 0.1, c.size) for c in np.meshgrid(side, side))
    z = np.maximum(4.0 - 0.5 * np.hypot(x, y), 0.0)
    seen = (np.abs(y) > rng.uniform(1.5, 4.0)) | (x < rng.uniform(4.0, 7.2))
    tin = build_tin(np.column_stack([x, y, z])[seen])
    high = tin.vertices[tin.triangles, 2].max(axis=1) > 0.05
    inside_m2 = np.where(high, footprint_areas(tin.vertices, tin.triangles), 0.0)
    bridged, left = (terrace_points(tin, ZERO, inside_m2, 0.005, r) for r in (100.0, 0.5))
    assert len(bridged) and not len(left)


@pytest.mark.parametrize(("high_m", "is_found"), [(0.30, True), (0.0, False)])
def test_a_slab_hardly_higher_than_its_ground_is_uneven_is_found(high_m, is_found):
    """Ground and slab of 8.5 cm of waves: 573 ± 6 m³ were told of 444, in silence."""
    rng = np.random.default_rng(2)
    xy = rng.uniform(-14.0, 14.0, (20_000, 2))
    r = np.hypot(*xy.T)
    way = rng.uniform(0.0, 2.0 * np.pi, 12)
    long = 1.2 * np.column_stack([np.cos(way), np.sin(way)])
    waves = 0.085 / math.sqrt(6.0) * np.sin(xy @ long.T + 7.0 * way).sum(axis=1)
    z = waves + np.where(r < 8.5, high_m, 0.0) + np.maximum(6.0 - r, 0.0) * 0.65
    tin = build_tin(np.c_[xy, z])
    corner = np.hypot(*tin.vertices[:, :2].T)[tin.triangles].max(axis=1)
    inside_m2 = np.where(corner < 9.5, footprint_areas(tin.vertices, tin.triangles), 0.0)
    found = terrace_points(tin, ZERO, inside_m2, 0.085, 1.0)
    assert (len(found) > 0) == is_found
    if is_found:
        assert tin.vertices[found, 2].mean() == pytest.approx(high_m, abs=0.06)
