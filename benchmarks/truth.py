"""Exact distances to surfaces that have a formula, and uniform samples of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
#: Points (k, 3) m → their foot points on the surface and the outward unit normals there, (k, 3)
#: each.
Truth = Callable[[F64], tuple[F64, F64]]
TIE_M = 1e-12


def to_segments(points: F64, segments: F64) -> tuple[F64, F64]:
    """Distance (n,) and foot (n, 3) of points (n, 3) to the nearest of segments (k, 2, 3)."""
    best, foot = np.full(len(points), np.inf), np.zeros_like(points)
    for a, b in segments:
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        at = a + t[:, None] * (b - a)
        d = np.linalg.norm(points - at, axis=1)
        nearer = d < best
        best[nearer], foot[nearer] = d[nearer], at[nearer]
    return best, foot


def polygon_normal(polygon: F64) -> F64:
    """Unit normal (3,) of a convex polygon (k, 3), corners anticlockwise seen from outside."""
    normal = np.cross(polygon[1] - polygon[0], polygon[2] - polygon[0])
    out: F64 = normal / np.linalg.norm(normal)
    return out


def to_polygons(faces: list[F64]) -> Truth:
    """Exact foot points on a union of convex polygons: the projection where it falls inside, else
    the nearest side.
    """

    def foot(points: F64) -> tuple[F64, F64]:
        best, tallest = np.full(len(points), np.inf), np.zeros(len(points))
        at, normals = np.zeros_like(points), np.zeros_like(points)
        for face in faces:
            normal = polygon_normal(face)
            sides = np.stack([face, np.roll(face, -1, axis=0)], axis=1)
            height = (points - face[0]) @ normal
            inward = np.cross(normal, sides[:, 1] - sides[:, 0])
            inside = np.all(points @ inward.T >= np.einsum("ki,ki->k", sides[:, 0], inward), axis=1)
            d, here = np.abs(height), points - height[:, None] * normal
            d[~inside], here[~inside] = to_segments(points[~inside], sides)
            # faces tie where the foot is on an edge: the one seen more steeply knows the side, also
            # where the edge is acute
            nearer = (d < best - TIE_M) | ((d < best + TIE_M) & (np.abs(height) > tallest))
            best[nearer], at[nearer], normals[nearer], tallest[nearer] = (
                d[nearer],
                here[nearer],
                normal,
                np.abs(height[nearer]),
            )
        return at, normals

    return foot


def to_sphere(centre: F64, radius: float) -> Truth:
    """Exact foot points on a sphere; its centre goes to the pole."""

    def foot(points: F64) -> tuple[F64, F64]:
        offset = points - centre
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        normal = np.where(length > 0, offset / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
        return centre + radius * normal, normal

    return foot


def sample_polygons(faces: list[F64], count: int, rng: np.random.Generator) -> tuple[F64, F64]:
    """Points and outward normals (count, 3), uniform by area: fans of triangles, then barycentric
    coordinates.
    """
    triangles = np.array(
        [[face[0], face[i], face[i + 1]] for face in faces for i in range(1, len(face) - 1)]
    )
    normals = np.array([polygon_normal(face) for face in faces for _ in range(1, len(face) - 1)])
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    chosen = rng.choice(len(triangles), size=count, p=area / area.sum())
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = triangles[chosen].transpose(1, 0, 2)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), normals[chosen]


def rotation(rng: np.random.Generator) -> F64:
    """A rotation matrix (3, 3), uniform over all of them."""
    x, y, z, w = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def box_faces(low: F64, high: F64) -> list[F64]:
    """The six faces of an axis-parallel box, bottom first."""
    (x, y, z), (X, Y, Z) = low, high
    return [
        np.array(corners, dtype=float)
        for corners in (
            [(x, y, z), (x, Y, z), (X, Y, z), (X, y, z)],
            [(x, y, Z), (X, y, Z), (X, Y, Z), (x, Y, Z)],
            [(x, y, z), (X, y, z), (X, y, Z), (x, y, Z)],
            [(X, Y, z), (x, Y, z), (x, Y, Z), (X, Y, Z)],
            [(x, Y, z), (x, y, z), (x, y, Z), (x, Y, Z)],
            [(X, y, z), (X, Y, z), (X, Y, Z), (X, y, Z)],
        )
    ]


def sides_of(faces: list[F64]) -> F64:
    """All sides (k, 2, 3) of polygons."""
    return np.concatenate([np.stack([face, np.roll(face, -1, axis=0)], axis=1) for face in faces])
