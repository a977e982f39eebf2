"""The thesis's data sets (seed 002 chapter 9), simulated: points even over a surface, uniform noise
of 5 cm along its normal, 100 outliers.

Printed are the counts, the noise, the outliers, and the volumes 1 m³ and 4/3 pi m³. The square is
the simulation's scene of that name; bench and fountain are a window of it, with the printed number
of points at the printed density.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import SimulationError
from ladar_volume.model.records import F64, I32
from ladar_volume.simulation.scenes import make_scene

NOISE_M, OUTLIERS = 0.05, 100
BOX_POINTS, SPHERE_POINTS, BENCH_POINTS, SQUARE_POINTS = 5800, 2200, 135_100, 2_700_000
BOX_M3, SPHERE_M3 = 1.0, 4.0 / 3.0 * np.pi
#: Window of bench and fountain: the middle in x, from the fountain's ring to behind a bench in y;
#: on 36.7 m², 3,680 points per m².
BENCH_LOW, BENCH_HIGH = np.array([-2.35, -1.4]), np.array([2.35, 6.41])


def with_outliers(surface: F64, rng: np.random.Generator) -> F64:
    """The points (n, 3) and 100 more anywhere in their box, in random order."""
    every = np.concatenate(
        [surface, rng.uniform(surface.min(axis=0), surface.max(axis=0), (OUTLIERS, 3))]
    )
    return np.asarray(rng.permutation(every, axis=0))


def on_mesh(vertices: F64, triangles: I32, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
    """Points (count, 3) even over a mesh, without noise, and the unit normals of their
    triangles.
    """
    p = vertices[triangles]
    cross = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(cross, axis=1)
    which = np.searchsorted(np.cumsum(size), rng.uniform(0.0, size.sum(), count))
    u, v = rng.uniform(size=(2, count))
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    at = (
        p[which, 0]
        + u[:, None] * (p[which, 1] - p[which, 0])
        + v[:, None] * (p[which, 2] - p[which, 0])
    )
    return at, cross[which] / size[which, None]


def noisy(at: F64, normals: F64, rng: np.random.Generator) -> F64:
    """Uniform noise along the normals."""
    return np.asarray(at + rng.uniform(-NOISE_M, NOISE_M, (len(at), 1)) * normals)


def cube_mesh(bottom: bool) -> tuple[F64, I32]:
    """A cube of 1 m on the plane z = 0, with or without its bottom."""
    v = np.array([[x, y, z] for z in (0.0, 1.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    quads = [
        (4, 5, 7, 6),
        (0, 1, 5, 4),
        (2, 6, 7, 3),
        (0, 4, 6, 2),
        (1, 3, 7, 5),
        *([(0, 2, 3, 1)] if bottom else []),
    ]
    return v, np.array([q for a, b, c, d in quads for q in ((a, b, c), (a, c, d))], np.int32)


def box(seed: int) -> F64:
    """The cube with all six faces: Table 9.3."""
    rng = np.random.default_rng([seed, 91])
    return with_outliers(noisy(*on_mesh(*cube_mesh(True), BOX_POINTS, rng), rng), rng)


def box_on_ground(seed: int) -> F64:
    """The cube without its bottom in the middle of 3 by 3 m of ground: sections 9.1 to 9.3."""
    rng = np.random.default_rng([seed, 92])
    v, t = cube_mesh(False)
    outer = np.array([[x, y, 0.0] for y in (-1.5, 1.5) for x in (-1.5, 1.5)])
    frame = [(4, 5, 1, 0), (5, 7, 3, 1), (7, 6, 2, 3), (6, 4, 0, 2)]
    ground = np.array([q for a, b, c, d in frame for q in ((a, b, c), (a, c, d))], np.int32)
    number = np.array([0, 1, 2, 3, 8, 9, 10, 11])
    at, normals = on_mesh(
        np.concatenate([v, outer]),
        np.concatenate([t, number[ground].astype(np.int32)]),
        BOX_POINTS,
        rng,
    )
    return with_outliers(noisy(at, normals, rng), rng)


def sphere(seed: int) -> F64:
    """The sphere of 1 m: Table 9.4."""
    rng = np.random.default_rng([seed, 93])
    u = rng.standard_normal((SPHERE_POINTS, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    return with_outliers(noisy(u, u, rng), rng)


def square(count: int, seed: int = 0) -> F64:
    """So many points of the square. Raises :class:`SimulationError` for fewer than 1,000."""
    if count < 1000:
        raise SimulationError(
            f"a cloud of the square needs 1,000 points or more, not {count}", value=count
        )
    rng, scene = np.random.default_rng([seed, 95]), make_scene("square")
    return with_outliers(noisy(*on_mesh(scene.vertices, scene.triangles, count, rng), rng), rng)


def bench(seed: int, count: int = BENCH_POINTS) -> F64:
    """Bench and fountain: the window of the square's surface, so many points."""
    rng, scene = np.random.default_rng([seed, 94]), make_scene("square")
    corners = scene.vertices[scene.triangles][:, :, :2]
    near = ((corners.max(axis=1) >= BENCH_LOW) & (corners.min(axis=1) <= BENCH_HIGH)).all(axis=1)
    at, normals = on_mesh(scene.vertices, scene.triangles[near], int(1.3 * count) + 1000, rng)
    inside = np.flatnonzero(((at[:, :2] >= BENCH_LOW) & (at[:, :2] <= BENCH_HIGH)).all(axis=1))[
        :count
    ]
    return with_outliers(noisy(at[inside], normals[inside], rng), rng)
