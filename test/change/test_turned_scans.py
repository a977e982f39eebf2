"""The region and the volume between two scans are the same when both are turned about the vertical,
moved, and given in another unit.
"""

import numpy as np
import pytest

from ladar_volume.change.excavation import Scan, region_of
from ladar_volume.change.ring_budget import checked_excavation
from ladar_volume.model.records import F64

MOTIONS = ((33.0, 1.0, 0.0), (90.0, 1.0, 4e5), (250.0, 0.05, 0.0), (200.0, 20.0, 4e5))


def scans(seed: int) -> tuple[F64, F64]:
    """Rolling ground of 7 by 5 m before and after a smooth pit was dug; B reaches beyond A."""
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 1, (1200, 2)) * [7, 5], rng.uniform(-0.05, 1.05, (1400, 2)) * [7, 5]

    def up(xy: F64) -> F64:
        return np.column_stack([xy, 0.15 * np.sin(0.7 * xy[:, 0]) + 0.1 * np.cos(xy[:, 1])])

    q = np.linalg.norm(b - [3.4, 2.6], axis=1)
    before, after = up(a), up(b)
    after[:, 2] -= np.where(q < 1.0, 0.5 * np.cos(0.5 * np.pi * q) ** 2, 0.0)
    return tuple(r + rng.normal(0, 0.004, r.shape) for r in (before, after))


def moved(r: F64, degrees: float, scale: float, shift: float) -> F64:
    """Turned, moved, and in another unit."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return scale * (r @ turn + shift * np.array([1.0, 13.0, 0.0005]))


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("kind", ["outline", "triangle", "wall"])
def test_region(kind: str, motion: tuple[float, float, float]) -> None:
    a, _ = scans(1)
    corners = None
    if kind == "triangle":
        corners = np.array([[1.0, 1.0, 0.0], [6.0, 1.5, 0.0], [2.0, 4.0, 0.0]])
    elif kind == "wall":
        corners = np.array([[1.0, 1.0, 0.0], [4.0, 1.5, 0.1], [4.0, 1.5, 2.0], [1.1, 1.0, 1.8]])
    other = None if corners is None else moved(corners, *motion)
    if kind == "triangle":
        corners, other = corners[:, :2], other[:, :2]
    spacing = 0.3 if kind == "wall" else None
    one = region_of(a, corners, spacing_m=spacing)
    two = region_of(moved(a, *motion), other, spacing_m=spacing)
    assert two.margin_m == pytest.approx(motion[1] * one.margin_m, rel=1e-6)
    if kind != "wall":
        assert two.spacing_m == pytest.approx(motion[1] * one.spacing_m, rel=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_volume_and_sigma(seed: int) -> None:
    a, b = scans(seed)
    eye = np.array([[3.5, 2.5, 4.0]])

    def found(degrees: float, scale: float, shift: float) -> F64:
        one, two = (moved(r, degrees, scale, shift) for r in (a, b))
        at = moved(eye, degrees, scale, shift)[0]
        first, second = (Scan(r, at, 0.004 * scale) for r in (one, two))
        made = checked_excavation(first, second, region_of(one), "none").excavation
        return np.array([made.removed_m3, made.sigma_m3]) / scale**3

    here = found(0.0, 1.0, 0.0)
    for motion in MOTIONS:
        there = found(*motion)
        assert there[0] == pytest.approx(here[0], rel=1e-6)
        assert there[1] == pytest.approx(here[1], rel=0.02)  # the box of B's points has axes
