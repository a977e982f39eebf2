"""Polynomial surfaces ``z = x(dx, dy) @ beta`` about an origin, degree 0 (level), 1 (plane), 2 or 3
(seed 002 chapter 6).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.errors import GroundError
from ladar_volume.model.records import F64, Plane

#: Number of coefficients by degree.
COEFFICIENTS = (1, 3, 6, 10)
#: Where what a column of length 1 has of its own beside the others is more than this, products of
#: columns keep twelve digits of it.
FIXED = 1e-2
#: Heights that are told at a time: columns of all places would be more than what they are of.
AT_ONCE = 1 << 20


def degree_of(plane: Plane) -> int:
    """Degree 0, 1, 2 or 3 of a base surface."""
    return COEFFICIENTS.index(len(plane.beta))


def exponents(degree: int) -> list[tuple[int, int]]:
    """Powers of dx and dy of every coefficient: 1, dx, dy, dx², dx dy, dy², dx³, dx² dy, dx dy²,
    dy³ up to the degree.
    """
    return [(k - j, j) for k in range(degree + 1) for j in range(k + 1)]


def monomials(xy: F64, origin_xy: F64, degree: int) -> Iterator[F64]:
    """The design columns (n,) after the constant one, in their order, for points xy (n, 2), m."""
    x, y = xy[:, 0] - origin_xy[0], xy[:, 1] - origin_xy[1]
    last: list[F64] = []
    for k in range(1, degree + 1):
        last = (
            [*(column * x for column in last), last[-1] * y] if k > 1 else [x, y]
        )  # all of one power less, times x
        yield from last


def design(xy: F64, origin_xy: F64, degree: int) -> F64:
    """Rows ``(1, dx, dy, dx², dx dy, dy², dx³, dx² dy, dx dy², dy³)`` up to the degree: (n, p) for
    points xy (n, 2), m.
    """
    out = np.empty((len(xy), COEFFICIENTS[degree]))
    out[:, 0] = 1.0
    for c, column in enumerate(monomials(xy, origin_xy, degree), 1):
        out[:, c] = column
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
    out, degree = large_zeros((len(xy),)), degree_of(plane)
    for first in range(0, len(xy), AT_ONCE):
        part = out[first : first + AT_ONCE]
        part += plane.beta[0]
        columns = monomials(xy[first : first + AT_ONCE], plane.origin_xy, degree)
        for b, column in zip(plane.beta[1:], columns, strict=True):
            part += b * column
    return out


def base_gradient(plane: Plane, xy: F64) -> F64:
    """Slope (n, 2) of a base surface at xy (n, 2)."""
    D = design_gradient(xy, plane.origin_xy, degree_of(plane))
    out: F64 = (D.reshape(-1, D.shape[2]) @ plane.beta).reshape(
        -1, 2
    )  # as one product, not one for each point
    return out


def tilt_of(plane: Plane) -> float:
    """Tilt of a surface at its origin, rad."""
    return math.atan(float(np.linalg.norm(base_gradient(plane, plane.origin_xy[None])[0])))


def design_surface(beta: Sequence[float], origin_xy: tuple[float, float] = (0.0, 0.0)) -> Plane:
    """A base surface known without error, such as a level or a given plane; degree by the number of
    coefficients.
    """
    if len(beta) not in COEFFICIENTS or not np.isfinite(beta).all():
        raise GroundError(
            f"a base has 1, 3, 6 or 10 finite coefficients, not {tuple(beta)}",
            reason="ground_coefficients",
            value=tuple(beta),
        )
    p = len(beta)
    return Plane(
        np.asarray(origin_xy, dtype=np.float64),
        np.asarray(beta, dtype=np.float64),
        np.zeros((p, p)),
        np.zeros(0, np.int64),
    )


def solve(X: F64, z: F64, degree: int) -> tuple[F64, F64]:
    """Least-squares coefficients beta (p,) of design rows X (n, p) and heights z (n,), and ``N =
    (XᵀX)⁻¹`` (p, p): the coefficients follow heights by ``N Xᵀ``. Raises :class:`GroundError` where
    the points do not fix the surface.
    """
    S = inverse_root(X, degree)
    return S @ (S.T @ (X.T @ z)), S @ S.T


def inverse_root(X: F64, degree: int) -> F64:
    """S (p, p) with ``S Sᵀ = (XᵀX)⁻¹`` of design rows X (n, p): from that product, and from the
    rows where it has too few digits. Raises :class:`GroundError` where the points do not fix the
    surface.
    """
    square = X.T @ X
    found = root_of_products(len(X), square, degree)
    if found is not None:
        return found
    scale = column_scale(len(X), square, degree)
    R: F64 = np.asarray(np.linalg.qr(X / scale, mode="r"))
    check_rank(R, degree)
    out: F64 = np.linalg.solve(R, np.eye(len(R))) / scale[:, None]
    return out


def root_of_products(count: int, square: F64, degree: int) -> F64 | None:
    """:func:`inverse_root` from the products ``XᵀX`` (p, p) of ``count`` rows; None where these
    have too few digits.
    """
    scale = column_scale(count, square, degree)
    try:
        R: F64 = np.asarray(np.linalg.cholesky(square / np.outer(scale, scale)).T, np.float64)
    except np.linalg.LinAlgError:
        return None
    if not float(R.diagonal().min()) > FIXED:
        return None
    out: F64 = np.linalg.solve(R, np.eye(len(R))) / scale[:, None]
    return out


def column_scale(count: int, square: F64, degree: int) -> F64:
    """Lengths (p,) of the columns of ``count`` design rows from their products (p, p). Raises
    :class:`GroundError` for too few rows or an empty column.
    """
    scale: F64 = np.sqrt(square.diagonal())
    if count < len(scale) or (scale == 0).any():
        raise GroundError(
            (
                f"{count} points do not define a ground of degree {degree}: give more of the "
                "ground, or a lower ground.degree"
            ),
            reason="ground_too_few_points",
            value=count,
        )
    return scale


def check_rank(R: F64, degree: int) -> None:
    """Raises :class:`GroundError` where a triangular factor R (p, p) of scaled columns shows that
    they do not fix the surface.
    """
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-9 * diagonal.max():
        raise GroundError(
            f"the points lie on a curve that does not define a ground of degree {degree}: "
            "give ground on all sides, or a lower "
            "ground.degree",
            reason="ground_degenerate",
        )
