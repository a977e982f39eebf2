"""What chords do to a volume: exact on a quadratic, and on average over all places of a kink."""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.volume.chord_bias import chord_volumes, cut_and_fill_chords
from ladar_volume.volume.prismoids import positive_part


def normals(slope):
    n = np.c_[-slope, np.ones(len(slope))]
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def quadratic(xy):
    """Heights and slopes of a surface that is a hollow along x and a crest along y."""
    x, y = xy.T
    return 0.3 + 0.1 * x - 0.2 * y + 0.07 * x**2 - 0.04 * y**2 + 0.05 * x * y, np.c_[
        0.1 + 0.14 * x + 0.05 * y, -0.2 - 0.08 * y + 0.05 * x
    ]


def test_exact_on_a_quadratic():
    xy = np.random.default_rng(1).uniform(-5, 5, (200, 2))
    z, slope = quadratic(xy)
    tin = build_tin(np.c_[xy, z])
    v, t = tin.vertices, tin.triangles
    area = footprint_areas(v, t)
    middle = [
        quadratic(0.5 * (v[t[:, a], :2] + v[t[:, b], :2]))[0] for a, b in ((0, 1), (1, 2), (2, 0))
    ]
    excess = area * (
        v[t, 2].mean(axis=1) - np.mean(middle, axis=0)
    )  # midpoints of sides integrate a quadratic exactly
    normal = normals(slope)[tin.source]
    assert chord_volumes(tin, normal, area) == pytest.approx(excess, abs=1e-12)
    assert chord_volumes(tin, -normal, area) == pytest.approx(excess, abs=1e-12)
    half = chord_volumes(tin, normal, np.where(np.arange(len(t)) % 2, 0.5 * area, 0.0))
    assert half == pytest.approx(np.where(np.arange(len(t)) % 2, 0.5 * excess, 0.0), abs=1e-12)
    above, below = cut_and_fill_chords(tin, normal, design_surface([1e3]), area)
    assert above == 0.0 and below == pytest.approx(excess.sum(), abs=1e-12)


def test_exact_on_average_over_all_places_of_a_kink():
    rng = np.random.default_rng(2)
    for _ in range(5):
        xy, s, angle = rng.uniform(-1, 1, (3, 2)), rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
        n = np.array([np.cos(angle), np.sin(angle)])
        u = xy @ n
        excess, chord = [], []
        steps = 1000
        for c in u.min() + (np.arange(steps) + 0.5) / steps * np.ptp(u):
            z = s * np.maximum(u - c, 0.0)
            tin = build_tin(np.c_[xy, z])
            area = footprint_areas(tin.vertices, tin.triangles)
            true = s * positive_part((u - c)[tin.source][tin.triangles])[0]
            excess.append(float(area[0] * (z.mean() - true[0])))
            chord.append(
                float(chord_volumes(tin, normals(s * np.outer(u > c, n))[tin.source], area)[0])
            )
        assert np.mean(chord) == pytest.approx(np.mean(excess), rel=2e-3)


def test_plane_and_wall():
    xy = np.random.default_rng(3).uniform(-5, 5, (50, 2))
    tin = build_tin(np.c_[xy, xy @ [0.3, -0.4]])
    area, normal = (
        footprint_areas(tin.vertices, tin.triangles),
        np.tile(normals(np.array([[0.3, -0.4]])), (50, 1)),
    )
    assert chord_volumes(tin, normal, area) == pytest.approx(np.zeros(len(area)), abs=1e-15)
    normal[7] = [1.0, 0.0, 0.0]
    assert chord_volumes(tin, normal, area) == pytest.approx(np.zeros(len(area)), abs=1e-15)
