"""Heights of many points above a polynomial surface, and sums of their design rows (see
:mod:`~ladar_volume.ground.polynomial`), without holding these rows.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.polynomial import COEFFICIENTS, design, inverse_root, root_of_products
from ladar_volume.math.kernels import kernel, leaf_kernel, run_in_ranges
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.records import F64, Bool, Plane

#: Points that are summed at once.
PART = 1024


@leaf_kernel
def write_row(x: float, y: float, row: F64) -> None:
    """Write the design row (p,) of a place about the origin."""
    row[0] = 1.0
    if len(row) > 1:
        row[1], row[2] = x, y
    if len(row) > 3:
        row[3], row[4], row[5] = x * x, x * y, y * y
    if len(row) > 6:
        row[6], row[7], row[8], row[9] = row[3] * x, row[4] * x, row[5] * x, row[5] * y


@kernel
def heights_kernel(first: int, end: int, points: F64, origin_xy: F64, beta: F64, out: F64) -> None:
    """See :func:`heights_above`; some points."""
    row = np.empty(len(beta))
    for i in range(first, end):
        write_row(points[i, 0] - origin_xy[0], points[i, 1] - origin_xy[1], row)
        height = beta[0]
        for c in range(1, len(beta)):
            height += beta[c] * row[c]
        out[i] = points[i, 2] - height


def heights_above(points: F64, origin_xy: F64, beta: F64) -> F64:
    """Heights (n,) m of points (n, 3) above the surface of coefficients beta (p,)."""
    out, points = large_zeros((len(points),)), np.ascontiguousarray(points)
    run_in_ranges(heights_kernel, len(out), points, origin_xy, beta, out)
    return out


def height_above(points: F64, base: Plane | None) -> F64:
    """Vertical heights (n,) m of points (n, 3) above a base surface; their z without one."""
    if base is None:
        return points[:, 2]
    return heights_above(points, base.origin_xy, base.beta)


def solve_points(points: F64, inside: Bool, origin_xy: F64, degree: int) -> tuple[F64, F64]:
    """:func:`solve` of those of points (n, 3) m that are ``inside`` (n,), whose rows are not all
    held at once.
    """
    square, right = design_sums(points, inside, origin_xy, degree)
    S = root_of_products(int(np.count_nonzero(inside)), square, degree)
    if S is None:
        S = inverse_root(design(points[inside, :2], origin_xy, degree), degree)
    return S @ (S.T @ right), S @ S.T


def design_sums(
    points: F64, inside: Bool, origin_xy: F64, degree: int, weight: F64 | None = None
) -> tuple[F64, F64]:
    """``XᵀWX`` (p, p) and ``XᵀWz`` (p,) of those of points (n, 3) m that are ``inside`` (n,), part
    by part; weight (n,), 1 where there is none.
    """
    p = COEFFICIENTS[degree]
    sums = np.zeros((len(points) // PART + 1, p, p + 1))
    known = np.zeros(0) if weight is None else weight
    sums_kernel(np.ascontiguousarray(points), inside, origin_xy, known, sums)
    total = sums.sum(axis=0)  # a sum of few sums has all its digits
    return np.ascontiguousarray(total[:, :p]), total[:, p].copy()


@kernel
def sums_kernel(points: F64, inside: Bool, origin_xy: F64, weight: F64, sums: F64) -> None:
    """See :func:`design_sums`: sums (k, p, p + 1) over every :data:`PART` points."""
    p = sums.shape[1]
    row = np.empty(p + 1)
    for i in range(len(points)):
        if not inside[i]:
            continue
        write_row(points[i, 0] - origin_xy[0], points[i, 1] - origin_xy[1], row[:p])
        row[p] = points[i, 2]
        w, own = weight[i] if len(weight) else 1.0, sums[i // PART]
        for a in range(p):
            for b in range(p + 1):
                own[a, b] += w * row[a] * row[b]


def design_products(points: F64, origin_xy: F64, degree: int, values: F64) -> F64:
    """``Xᵀ V`` (p, k) of the design rows X (n, p) of points (n, 3) m, and values V (n, k)."""
    sums = np.zeros((len(points) // PART + 1, COEFFICIENTS[degree], values.shape[1]))
    products_kernel(np.ascontiguousarray(points), origin_xy, np.ascontiguousarray(values), sums)
    out: F64 = sums.sum(axis=0)
    return out


@kernel
def products_kernel(points: F64, origin_xy: F64, values: F64, sums: F64) -> None:
    """See :func:`design_products`: sums (m, p, k) over every :data:`PART` points."""
    row = np.empty(sums.shape[1])
    for i in range(len(points)):
        write_row(points[i, 0] - origin_xy[0], points[i, 1] - origin_xy[1], row)
        own = sums[i // PART]
        for a in range(len(row)):
            for c in range(values.shape[1]):
                own[a, c] += row[a] * values[i, c]
