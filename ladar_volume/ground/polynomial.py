"""Polynomial surfaces ``z = x(dx, dy) @ beta`` about an origin, degree 0 (level), 1 (plane), 2 or 3 (seed 002 chapter 6)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ladar_volume.model.errors import GroundError
from ladar_volume.model.records import F64, Plane

#: Number of coefficients by degree.
COEFFICIENTS = (1, 3, 6, 10)


def degree_of(plane: Plane) -> int:
    """Degree 0, 1, 2 or 3 of a base surface."""
    return COEFFICIENTS.index(len(plane.beta))


def exponents(degree: int) -> list[tuple[int, int]]:
    """Powers of dx and dy of every coefficient: 1, dx, dy, dx², dx dy, dy², dx³, dx² dy, dx dy², dy³ up to the degree."""
    return [(k - j, j) for k in range(degree + 1) for j in range(k + 1)]


def design(xy: F64, origin_xy: F64, degree: int) -> F64:
    """Rows ``(1, dx, dy, dx², dx dy, dy², dx³, dx² dy, dx dy², dy³)`` up to the degree: (n, p) for points xy (n, 2), m."""
    (x, y), c = (xy - origin_xy).T, 1
    out = np.ones((len(xy), COEFFICIENTS[degree]))
    for k in range(1, degree + 1):
        for j in range(k):  # all of one power less, times x
            np.multiply(out[:, c - k + j], x, out=out[:, c + j])
        np.multiply(out[:, c - 1], y, out=out[:, c + k])
        c += k + 1
    return out


def design_gradient(xy: F64, origin_xy: F64, degree: int) -> F64:
    """Derivatives of the design rows by x and y: (n, 2, p)."""
    d = xy - origin_xy
    out = np.zeros((len(d), 2, COEFFICIENTS[degree]))
    for column, (a, b) in enumerate(exponents(degree)):
        if a:
            out[:, 0, column] = a * d[:, 0] ** (a - 1) * d[:, 1] ** b
        if b:
            out[:, 1, column] = b * d[:, 0] ** a * d[:, 1] ** (b - 1)
    return out


def base_height(plane: Plane, xy: F64) -> F64:
    """Height (n,) m of a base surface at xy (n, 2)."""
    out: F64 = design(xy, plane.origin_xy, degree_of(plane)) @ plane.beta
    return out


def base_gradient(plane: Plane, xy: F64) -> F64:
    """Slope (n, 2) of a base surface at xy (n, 2)."""
    D = design_gradient(xy, plane.origin_xy, degree_of(plane))
    out: F64 = (D.reshape(-1, D.shape[2]) @ plane.beta).reshape(-1, 2)  # as one product, not one for each point
    return out


def tilt_of(plane: Plane) -> float:
    """Tilt of a surface at its origin, rad."""
    return math.atan(float(np.linalg.norm(base_gradient(plane, plane.origin_xy[None])[0])))


def design_surface(beta: Sequence[float], origin_xy: tuple[float, float] = (0.0, 0.0)) -> Plane:
    """A base surface known without error, such as a level or a given plane; degree by the number of coefficients."""
    if len(beta) not in COEFFICIENTS or not np.isfinite(beta).all():
        raise GroundError(
            f"a base has 1, 3, 6 or 10 finite coefficients, not {tuple(beta)}", reason="ground_coefficients", value=tuple(beta)
        )
    p = len(beta)
    return Plane(np.asarray(origin_xy, dtype=np.float64), np.asarray(beta, dtype=np.float64), np.zeros((p, p)), np.zeros(0, np.int64))


def solve(points: F64, origin_xy: F64, degree: int) -> tuple[F64, F64, F64]:
    """Least-squares coefficients of points (n, 3) with vertical residuals.

    Returns beta (p,), the design rows X (n, p), and ``N = (XᵀX)⁻¹`` (p, p): the coefficients follow heights by ``N Xᵀ``. Raises
    :class:`GroundError` where the points do not fix the surface.
    """
    X = design(points[:, :2], origin_xy, degree)
    S = inverse_root(X, degree)
    return S @ (S.T @ (X.T @ points[:, 2])), X, S @ S.T


def coefficients(X: F64, z: F64, degree: int) -> F64:
    """The coefficients (p,) alone, from design rows X (n, p) and heights z (n,)."""
    S = inverse_root(X, degree)
    out: F64 = S @ (S.T @ (X.T @ z))
    return out


def inverse_root(X: F64, degree: int) -> F64:
    """S (p, p) with ``S Sᵀ = (XᵀX)⁻¹`` of design rows X (n, p). Raises :class:`GroundError` where the points do not fix the surface."""
    scale = column_scale(X, degree)
    R: F64 = np.asarray(np.linalg.qr(X / scale, mode="r"))
    check_rank(R, degree)
    out: F64 = np.linalg.solve(R, np.eye(len(R))) / scale[:, None]
    return out


def column_scale(X: F64, degree: int) -> F64:
    """Lengths (p,) of the columns of design rows X (n, p). Raises :class:`GroundError` for too few rows or an empty column."""
    scale: F64 = np.sqrt(np.einsum("np,np->p", X, X))
    if len(X) < X.shape[1] or (scale == 0).any():
        raise GroundError(
            f"{len(X)} points do not define a ground of degree {degree}: give more of the ground, or a lower ground.degree",
            reason="ground_too_few_points",
            value=len(X),
        )
    return scale


def check_rank(R: F64, degree: int) -> None:
    """Raises :class:`GroundError` where a triangular factor R (p, p) of scaled columns shows that they do not fix the surface."""
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-9 * diagonal.max():
        raise GroundError(
            f"the points lie on a curve that does not define a ground of degree {degree}: give ground on all sides, or a lower "
            "ground.degree",
            reason="ground_degenerate",
        )
