"""Synthetic sets for the cloud filter, as in seed 002 section 9.1, and the figures by which a
filter is judged on them.

A set is a true surface, points sampled uniformly by area from it with uniform noise of 5 cm either
way, and 100 outliers uniform in the bounding box of the noisy points. Surfaces are a sphere or a
union of convex polygons. Where a surface is open (the rim of a ground), the truth goes on beyond
what was sampled: the rim is where the scan ends, not a feature, and is neither an edge nor an
error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.truth import (
    F64,
    I64,
    Mask,
    Truth,
    box_faces,
    rotation,
    sample_polygons,
    sides_of,
    to_polygons,
    to_segments,
    to_sphere,
)

NOISE_M = 0.05
OUTLIERS = 100
FAR_M = 0.087
NEAR_EDGE_M = 0.10
OPEN_M = 0.5


class Result(Protocol):
    """What ``score`` reads of a filter's answer: points (k, 3) m, the input index of each (k,),
    input indices taken out (m,).
    """

    @property
    def r(self) -> F64: ...
    @property
    def index(self) -> I64: ...
    @property
    def outliers(self) -> I64: ...


@dataclass(frozen=True)
class Shape:
    """One set: points (n, 3) m; which came from the surface (n,), the rest being outliers; which
    lie within 10 cm of a true edge (n,); the outward unit normal at each point's foot (n, 3); the
    truth.
    """

    name: str
    points: F64
    from_surface: Mask
    near_edge: Mask
    normal: F64
    foot: Truth

    def distance(self, points: F64) -> F64:
        """Exact distance (k,) m of points (k, 3) to the true surface."""
        out: F64 = np.linalg.norm(points - self.foot(points)[0], axis=1)
        return out

    def signed(self, points: F64) -> F64:
        """The same, negative inside."""
        foot, normal = self.foot(points)
        offset = points - foot
        out: F64 = np.copysign(
            np.linalg.norm(offset, axis=1), np.einsum("ni,ni->n", offset, normal)
        )
        return out


def finish(name: str, surface: F64, truth: Truth, edges: F64, rng: np.random.Generator) -> Shape:
    """Outliers into the box of the noisy surface points, everything in random order, labels."""
    points = np.concatenate(
        [surface, rng.uniform(surface.min(axis=0), surface.max(axis=0), (OUTLIERS, 3))]
    )
    order = rng.permutation(len(points))
    points = points[order]
    near = (
        to_segments(points, edges)[0] <= NEAR_EDGE_M if len(edges) else np.zeros(len(points), bool)
    )
    return Shape(name, points, order < len(surface), near, truth(points)[1], truth)


def noisy(at: F64, normals: F64, rng: np.random.Generator) -> F64:
    """Uniform noise along the normal."""
    out: F64 = at + rng.uniform(-NOISE_M, NOISE_M, (len(at), 1)) * normals
    return out


def sphere(seed: int, count: int = 2200, radius: float = 1.0) -> Shape:
    """A sphere about the origin."""
    rng = np.random.default_rng([seed, 1])
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return finish(
        "sphere",
        noisy(radius * normals, normals, rng),
        to_sphere(np.zeros(3), radius),
        np.zeros((0, 2, 3)),
        rng,
    )


def cube(seed: int, count: int = 5800, edge: float = 1.0) -> Shape:
    """A cube about the origin, all six faces, no ground."""
    rng = np.random.default_rng([seed, 2])
    faces = box_faces(np.full(3, -edge / 2), np.full(3, edge / 2))
    return finish(
        "cube",
        noisy(*sample_polygons(faces, count, rng), rng),
        to_polygons(faces),
        sides_of(faces[:2] + faces[2:4]),
        rng,
    )


def frame_faces(half: float, outer: float) -> list[F64]:
    """The level ground between the squares of half edges ``half`` and ``outer``: four trapezia
    meeting on the diagonals.
    """
    inner = half * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], dtype=float)
    wide = inner * outer / half
    return [np.array([wide[i], wide[(i + 1) % 4], inner[(i + 1) % 4], inner[i]]) for i in range(4)]


def cube_on_ground(seed: int, count: int = 5800) -> Shape:
    """A cube of 1 m in the middle of 3 x 3 m of ground, hollow below; noise in x, y and z each; the
    edges at its foot are concave.
    """
    rng = np.random.default_rng([seed, 3])
    faces = box_faces(np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 1.0]))[1:]
    at, _ = sample_polygons([*faces, *frame_faces(0.5, 1.5)], count, rng)
    truth = to_polygons([*faces, *frame_faces(0.5, 1.5 + OPEN_M)])
    return finish(
        "cube on ground", at + rng.uniform(-NOISE_M, NOISE_M, at.shape), truth, sides_of(faces), rng
    )


def strips(profile: F64, half: float, open_m: float) -> tuple[list[F64], F64]:
    """A profile (k, 2) in (x, z) drawn along y from -half to half: faces, and the edges at its
    inner corners. The two ends of the profile and both ends of the strips go on by ``open_m``.
    """
    line = profile.copy()
    for end, inner in ((0, 1), (-1, -2)):
        line[end] += open_m * (line[end] - line[inner]) / np.linalg.norm(line[end] - line[inner])
    y = half + open_m
    low = np.insert(line, 1, -y, axis=1)
    high = np.insert(line, 1, y, axis=1)
    faces = [np.array([low[i], low[i + 1], high[i + 1], high[i]]) for i in range(len(line) - 1)]
    return faces, np.stack([low[1:-1], high[1:-1]], axis=1)


def dihedral(seed: int, angle_deg: float, count: int = 2000) -> Shape:
    """Two squares of 1 m that enclose ``angle_deg`` of material, in a random orientation."""
    rng = np.random.default_rng([seed, 4, round(angle_deg)])
    half = np.radians(angle_deg) / 2
    leg = np.array([np.sin(half), -np.cos(half)])
    profile = np.array([leg * (-1, 1), (0.0, 0.0), leg])
    R = rotation(rng)
    faces, _ = strips(profile, 0.5, 0.0)
    wide, edges = strips(profile, 0.5, OPEN_M)
    at = noisy(*sample_polygons([face @ R.T for face in faces], count, rng), rng)
    return finish(
        f"dihedral {angle_deg:g} deg",
        at,
        to_polygons([face @ R.T for face in wide]),
        edges @ R.T,
        rng,
    )


def kerb(seed: int, count: int = 5800, step: float = 0.2) -> Shape:
    """A street and a pavement, each 1.5 x 2 m, and the vertical kerb between them, turned about the
    vertical.
    """
    rng = np.random.default_rng([seed, 5])
    turn = rng.uniform(0, 2 * np.pi)
    R = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    profile = np.array([(-1.5, 0.0), (0.0, 0.0), (0.0, step), (1.5, step)])
    faces, _ = strips(profile, 1.0, 0.0)
    wide, edges = strips(profile, 1.0, OPEN_M)
    at = noisy(*sample_polygons([face @ R.T for face in faces], count, rng), rng)
    return finish("kerb", at, to_polygons([face @ R.T for face in wide]), edges @ R.T, rng)


def apex(seed: int, count: int = 3200, planes: int = 5, height: float = 0.8) -> Shape:
    """A pyramid without its base over a regular polygon of radius 1 m, in a random orientation."""
    rng = np.random.default_rng([seed, 6, planes])
    angle = 2 * np.pi * np.arange(planes) / planes
    rim = (
        np.stack([np.cos(angle), np.sin(angle), np.full(planes, -height)], axis=1) @ rotation(rng).T
    )
    wide = rim * (1 + OPEN_M)
    top = np.zeros(3)
    faces = [np.array([top, rim[i], rim[(i + 1) % planes]]) for i in range(planes)]
    truth = to_polygons([np.array([top, wide[i], wide[(i + 1) % planes]]) for i in range(planes)])
    edges = np.stack([np.zeros((planes, 3)), wide], axis=1)
    return finish(
        f"apex of {planes}", noisy(*sample_polygons(faces, count, rng), rng), truth, edges, rng
    )


def every(seed: int) -> list[Shape]:
    """All the small sets for one seed."""
    angles = (60.0, 90.0, 120.0, 150.0)
    return [
        sphere(seed),
        cube(seed),
        cube_on_ground(seed),
        *(dihedral(seed, a) for a in angles),
        kerb(seed),
        apex(seed),
    ]


def rms_mm(distance: F64) -> float:
    """Root mean square, m to mm; NaN of nothing."""
    return float(1e3 * np.sqrt(np.mean(distance**2))) if len(distance) else float("nan")


def score(shape: Shape, result: Result) -> dict[str, float]:
    """The figures of one filtered set.

    RMS and bias (mean signed distance; on the sphere the radius bias) in mm over the kept points
    that came from the surface, to that surface; the same RMS over inputs within 10 cm of an edge;
    the share of surface points taken out; the share of far outliers (those beyond 87 mm) taken out;
    points neither kept nor taken out (reductions).
    """
    n = len(shape.points)
    if len(result.r) != len(result.index):
        raise ValueError("every filtered point needs its input index")
    out, left = np.zeros(n, bool), np.ones(n, bool)
    out[result.outliers], left[result.outliers], left[result.index] = True, False, False
    if np.any(out[result.index]) or len(np.unique(result.index)) != len(result.index):
        raise ValueError("a point is kept and taken out, or kept twice")
    mine = shape.from_surface[result.index]
    error, near = shape.signed(result.r[mine]), shape.near_edge[result.index[mine]]
    raw = shape.distance(shape.points)
    far = ~shape.from_surface & (raw > FAR_M)
    return {
        "raw_rms_mm": rms_mm(raw[shape.from_surface]),
        "rms_mm": rms_mm(error),
        "edge_rms_mm": rms_mm(error[near]),
        "bias_mm": float(1e3 * np.mean(error)) if len(error) else float("nan"),
        "false_removed_pct": float(100 * np.mean(out[shape.from_surface])),
        "far_removed_pct": float(100 * np.mean(~np.isin(np.flatnonzero(far), result.index))),
        "kept": float(len(result.index)),
        "unaccounted": float(left.sum()),
    }
