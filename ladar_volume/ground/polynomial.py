"""Polynomial surfaces ``z = x(dx, dy) @ beta`` about an origin, degree 0 (level), 1 (plane) or 2 (seed 002 chapter 6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ladar_volume.model.errors import GroundError
from ladar_volume.model.records import F64, Plane

#: Number of coefficients by degree.
COEFFICIENTS = (1, 3, 6)


def degree_of(plane: Plane) -> int:
    """Degree 0, 1 or 2 of a base surface."""
    return COEFFICIENTS.index(len(plane.beta))


def design(xy: F64, origin_xy: F64, degree: int) -> F64:
    """Rows ``(1, dx, dy, dx², dx dy, dy²)`` up to the degree: (n, p) for points xy (n, 2), m."""
    d = xy - origin_xy
    out = np.ones((len(d), COEFFICIENTS[degree]))
    if degree >= 1:
        out[:, 1:3] = d
    if degree == 2:
        out[:, 3], out[:, 4], out[:, 5] = d[:, 0] ** 2, d[:, 0] * d[:, 1], d[:, 1] ** 2
    return out


def design_gradient(xy: F64, origin_xy: F64, degree: int) -> F64:
    """Derivatives of the design rows by x and y: (n, 2, p)."""
    d = xy - origin_xy
    out = np.zeros((len(d), 2, COEFFICIENTS[degree]))
    if degree >= 1:
        out[:, 0, 1] = out[:, 1, 2] = 1.0
    if degree == 2:
        out[:, 0, 3], out[:, 0, 4], out[:, 1, 4], out[:, 1, 5] = 2.0 * d[:, 0], d[:, 1], d[:, 0], 2.0 * d[:, 1]
    return out


def base_height(plane: Plane, xy: F64) -> F64:
    """Height (n,) m of a base surface at xy (n, 2)."""
    out: F64 = design(xy, plane.origin_xy, degree_of(plane)) @ plane.beta
    return out


def base_gradient(plane: Plane, xy: F64) -> F64:
    """Slope (n, 2) of a base surface at xy (n, 2)."""
    out: F64 = design_gradient(xy, plane.origin_xy, degree_of(plane)) @ plane.beta
    return out


def design_surface(beta: Sequence[float], origin_xy: tuple[float, float] = (0.0, 0.0)) -> Plane:
    """A base surface known without error, such as a level or a given plane; degree by the number of coefficients."""
    if len(beta) not in COEFFICIENTS or not np.isfinite(beta).all():
        raise GroundError(f"a base has 1, 3 or 6 finite coefficients, not {tuple(beta)}", reason="ground_coefficients", value=tuple(beta))
    p = len(beta)
    return Plane(np.asarray(origin_xy, dtype=np.float64), np.asarray(beta, dtype=np.float64), np.zeros((p, p)), np.zeros(0, np.int64))


def solve(points: F64, origin_xy: F64, degree: int) -> tuple[F64, F64, F64]:
    """Least-squares coefficients of points (n, 3) with vertical residuals.

    Returns beta (p,), ``H = (XᵀX)⁻¹Xᵀ`` (p, n), and ``(XᵀX)⁻¹`` (p, p). Raises :class:`GroundError` where the points do not fix
    the surface.
    """
    X = design(points[:, :2], origin_xy, degree)
    scale = np.sqrt((X * X).sum(axis=0))
    if len(points) < X.shape[1] or (scale == 0).any():
        raise GroundError(
            f"{len(points)} points do not define a ground of degree {degree}", reason="ground_too_few_points", value=len(points)
        )
    Q, R = np.linalg.qr(X / scale)
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-9 * diagonal.max():
        raise GroundError(f"the points lie on a curve that does not define a ground of degree {degree}", reason="ground_degenerate")
    H: F64 = np.linalg.solve(R, Q.T) / scale[:, None]
    return H @ points[:, 2], H, H @ H.T
