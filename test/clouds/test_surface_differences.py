"""Differences of a surface and a coarser one, against a plain sum over places."""

import numpy as np
import pytest

from ladar_volume.clouds.between_points import Part, number_vertices, surface_differences
from ladar_volume.tin.full_tin import build_tin, footprint_areas


def plain_differences(tin, corners, area, coarse, kept):
    """The same, triangle by triangle, with every place looked up by itself."""
    plane = [np.linalg.solve(np.c_[p[:, :2], np.ones(3)], p[:, 2]) for p in
             coarse.vertices[coarse.triangles]]  # fmt: skip
    flat = coarse.vertices[:, :2][coarse.triangles]

    def height(xy):
        for p, beta in zip(flat, plane, strict=True):
            turn = np.roll(p, -1, axis=0) - p
            to = xy - p
            if (turn[:, 0] * to[:, 1] - turn[:, 1] * to[:, 0] >= -1e-12).all():
                return beta @ (*xy, 1.0)
        return None

    out = []
    for t, size in zip(corners, area, strict=True):
        p, total = tin.vertices[t], 0.0
        for place, weight in ((p.mean(axis=0), 9 / 12), *((q, 1 / 12) for q in p)):
            below = height(place[:2])
            total += 0.0 if below is None else weight * size * (place[2] - below)
        out.append(total)
    return np.array(out)


def test_differences_are_those_of_a_plain_sum():
    rng = np.random.default_rng(4)
    xy = rng.random((150, 2)) * 10.0
    tin = build_tin(np.c_[xy, np.sin(xy[:, 0]) + 0.1 * xy[:, 1] ** 2])
    kept = np.sort(rng.choice(len(tin.vertices), 60, replace=False))
    corners = tin.triangles[::2]
    area = footprint_areas(tin.vertices, corners)
    coarse = build_tin(tin.vertices[kept])
    none = np.zeros(len(tin.vertices))
    part = Part(tin.vertices, tin.vertices[:, :2], none, corners, area)
    found = surface_differences(part, coarse, kept)
    expected = plain_differences(tin, corners, area, coarse, kept)
    assert found.volume == pytest.approx(expected, abs=1e-9)
    # the gradient is that of the sum, which is linear in the heights
    assert found.gradient @ tin.vertices[:, 2] == pytest.approx(expected.sum(), abs=1e-9)
    assert found.covered.sum() <= 0.75 * area.sum() + 1e-12


def test_vertices_are_numbered_as_they_come():
    corners = np.array([[4, 2, 7], [2, 4, 0], [9, 0, 2]], np.int32)
    rows, place = number_vertices(corners, 10, np.array([7]))
    assert rows.tolist() == [4, 2, 0, 9]
    assert place.tolist() == [2, -1, 1, -1, 0, -1, -1, -1, -1, 3]
