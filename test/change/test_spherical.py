"""Spherical projection: empty circles on the sphere, any gap, turning, overhangs, and clouds that
are refused.
"""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.change.spherical_tin import (
    build_spherical,
    stereographic,
    unit_directions,
    widest_gap,
)
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.delaunay import is_valid

SCANNER = np.array([4.0, -3.0, 2.0])


def bowl(n, seed=0, highest=0.5, undercut=0.4):
    """Points on a cave about the scanner: range depends on direction, walls bend over the head
    where ``highest`` is above 0.
    """
    rng = np.random.default_rng(seed)
    z, a = rng.uniform(-1, highest, n), rng.uniform(0, 2 * np.pi, n)
    s = np.sqrt(1 - z * z)
    u = np.stack([s * np.cos(a), s * np.sin(a), z], axis=1)
    return SCANNER + (3 + undercut * np.sin(3 * a) + z)[:, None] * u


def test_delaunay_on_the_sphere():
    s = build_spherical(bowl(400), SCANNER)
    assert is_valid(s.projected, s.tin.triangles, s.tin.neighbours) and s.tin.duplicates == 0
    u, _ = unit_directions(s.tin.vertices, SCANNER)
    a, b, c = (u[s.tin.triangles[:, k]] for k in range(3))
    # no direction lies within the cap through the corners of any triangle
    axis = np.cross(b - a, c - a)
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    height = (axis * a).sum(axis=1)
    beyond = u @ axis.T - height
    side = np.sign(s.gap_map @ axis.T - height)
    assert (beyond * -side <= 1e-9).all()


def test_triangles_face_the_scanner_and_fill_all_but_the_gap():
    s = build_spherical(bowl(20_000), SCANNER)
    u, _ = unit_directions(s.tin.vertices, SCANNER)
    a, b, c = (u[s.tin.triangles[:, k]] for k in range(3))
    turn = np.einsum("ni,ni->n", a, np.cross(b, c))
    inner = (s.tin.neighbours >= 0).all(axis=1)
    assert (turn[inner] < 0).all()  # counter-clockwise from the inside
    solid = 2 * np.arctan2(-turn, 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1))
    assert solid[inner].sum() == pytest.approx(2 * np.pi * 1.5, rel=0.01)


def test_the_triangulation_turns_with_the_scan_and_does_not_depend_on_range():
    p, R = bowl(500), exp_so3(np.array([0.5, 1.0, -2.0]))
    one, other = (
        build_spherical(p, SCANNER),
        build_spherical((p - SCANNER) @ R.T + 1e3, np.full(3, 1e3)),
    )
    stretched = build_spherical(
        SCANNER + (p - SCANNER) * np.random.default_rng(1).uniform(1, 5, (500, 1)), SCANNER
    )

    def faces(tin, rows):
        return {tuple(sorted(t)) for t in tin.triangles[rows]}

    inner = (one.tin.neighbours >= 0).all(axis=1)
    assert faces(one.tin, inner) <= faces(other.tin, slice(None)) and faces(
        one.tin, inner
    ) <= faces(stretched.tin, slice(None))


def test_all_round_the_gap_moves_to_the_widest_hole():
    p = bowl(4000, highest=1.0)
    u, _ = unit_directions(p, SCANNER)
    hole = np.array([0.6, 0.0, 0.8])
    p = p[u @ hole < np.cos(0.3)]
    s = build_spherical(p, SCANNER)
    assert s.gap_map @ hole > np.cos(0.15) and len(s.tin.triangles) > 1.99 * len(p) - 200
    assert widest_gap(np.array([[0, 0, 1.0]])) == pytest.approx([0, 0, -1])
    image = stereographic(np.array([[0, 0, -1.0], [1, 0, 0]]), np.array([0, 0, 1.0]))
    assert image[0] == pytest.approx([0, 0]) and np.linalg.norm(image[1]) == pytest.approx(1.0)


def test_limits_of_angle_and_edge():
    p = bowl(2000)
    whole, angle, edge = (
        build_spherical(p, SCANNER),
        build_spherical(p, SCANNER, max_angle_rad=0.3),
        build_spherical(p, SCANNER, max_edge_m=0.8),
    )
    assert whole.tin.relevant.all() and 0 < angle.tin.relevant.sum() < len(p) * 2
    corner = edge.tin.vertices[edge.tin.triangles[edge.tin.relevant]]
    assert np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2).max() <= 0.8
    with pytest.raises(SurfaceError):
        build_spherical(p, SCANNER, max_edge_m=1e-6)


def test_points_in_one_direction_and_refusals():
    p = bowl(200)
    double = np.concatenate([p, SCANNER + 2.0 * (p[:7] - SCANNER)])
    s = build_spherical(double, SCANNER)
    assert len(s.tin.vertices) + s.tin.duplicates == 207 and s.tin.source[:7].tolist() == list(
        range(7)
    )
    for bad, scanner in (
        (p[:2], SCANNER),
        (np.concatenate([p, SCANNER[None]]), SCANNER),
        (p * np.nan, SCANNER),
        (p, np.full(3, np.nan)),
        (p[:, :2], SCANNER),
        (SCANNER + np.outer(np.arange(1.0, 9), [1, 2, 3]), SCANNER),
    ):
        with pytest.raises(SurfaceError):
            build_spherical(bad, scanner)
