"""What strays would change, against volumes of whole triangulations with and without them."""

import numpy as np
import pytest

from ladar_volume.clouds.sampling.stray_effect import stray_effect
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.tin.full_tin import build_tin, footprint_areas


def net(points, base):
    tin = build_tin(points)
    area = footprint_areas(tin.vertices, tin.triangles)
    return float((area * (tin.vertices[tin.triangles, 2].mean(axis=1) - base)).sum())


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [1, 7, 150])
def test_effect_is_the_difference_of_whole_surfaces(seed, count):
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-1, 2)
    xy = scale * rng.uniform(-10, 10, (3000, 2))
    p = np.c_[xy, 300.0 + 0.1 * xy[:, 0] + 0.05 * scale * rng.normal(size=3000)]
    # within the hull, many close together
    at = scale * rng.uniform(-9, 9, (count, 2)) * (1.0 if seed % 2 else 0.1)
    strays = np.c_[at, rng.uniform(290, 320, count)]
    tin = build_tin(p)
    area = footprint_areas(tin.vertices, tin.triangles)
    exact = net(p, 299.0) - net(np.vstack([p, strays]), 299.0)
    for base in (None, design_surface([299.0])):
        assert stray_effect(tin, area, strays, base) == pytest.approx(exact, rel=1e-9)


def test_effect_on_a_lattice_where_four_points_lie_on_one_circle():
    rng = np.random.default_rng(7)
    xy = np.stack(np.meshgrid(np.arange(40.0), np.arange(30.0)), -1).reshape(-1, 2)
    p = np.c_[xy, 0.05 * rng.normal(size=len(xy))]
    out = rng.choice(len(p), 60, replace=False)
    out = out[((p[out, :2] > 0.0) & (p[out, :2] < [39.0, 29.0])).all(axis=1)]
    strays, p = p[out] + [0.0, 0.0, 3.0], np.delete(p, out, axis=0)
    tin = build_tin(p)
    area = footprint_areas(tin.vertices, tin.triangles)
    exact = net(p, 0.0) - net(np.vstack([p, strays]), 0.0)
    assert stray_effect(tin, area, strays) == pytest.approx(exact, rel=1e-9)
    assert exact < -100.0


def test_only_what_lies_within_the_outline_counts():
    rng = np.random.default_rng(3)
    p = np.c_[rng.uniform(-10, 10, (4000, 2)), np.zeros(4000)]
    tin = build_tin(p)
    area = footprint_areas(tin.vertices, tin.triangles)
    middle = tin.vertices[tin.triangles, 0].mean(axis=1)
    inside = np.where(middle > 0.0, area, 0.0)
    left, right = np.array([[-5.0, 1.0, 3.0]]), np.array([[5.0, 1.0, 3.0]])
    assert stray_effect(tin, inside, left) == 0.0
    alone = stray_effect(tin, area, right)
    assert alone < 0.0
    assert stray_effect(tin, inside, np.vstack([left, right])) == pytest.approx(alone)


def test_strays_beyond_the_surface_count_nothing():
    rng = np.random.default_rng(4)
    tin = build_tin(np.c_[rng.uniform(0, 1, (500, 2)), np.zeros(500)])
    area = footprint_areas(tin.vertices, tin.triangles)
    far = np.array([[50.0, 50.0, 9.0], [-70.0, 0.5, 9.0]])
    assert stray_effect(tin, area, far) == 0.0
