"""ASD elevation adjustment: the vertex heights with the least sum of sizes of the residuals (left
open in seed 000 section 3.2).

Minimises ``Σ w |z − B h|`` over the heights h, with the fit of
:mod:`ladar_volume.tin.elevation_adjustment`: by reweighted least squares, or as a linear program,
which serves as its check.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from ladar_volume.math.sparse_diagonal import identity_matrix
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, Tin
from ladar_volume.tin.elevation_adjustment import (
    Adjustment,
    Normal,
    SurfaceFit,
    adjustment_record,
    fit_of,
)

MAX_STEPS = 80


def adjust_asd(
    tin: Tin,
    points_map: F64,
    sigma_m: F64 | None = None,
    fit: SurfaceFit | None = None,
    tolerance: float = 1e-9,
) -> Adjustment:
    """The heights with the least weighted sum of sizes of the vertical residuals (weights ``1 /
    sigma``), by reweighted least squares.

    The weights are those of a primal-dual interior point with predictor and corrector (Portnoy &
    Koenker 1997, "The Gaussian hare and the Laplacian tortoise"): the plain weights ``1 / |r|``
    converge too slowly to trust. Ends when the duality gap, which bounds the distance from the
    optimum, is below ``tolerance`` of the sum. See :func:`adjust_asd_exact`.
    """
    fit = fit_of(tin, points_map, sigma_m) if fit is None else fit
    old, w = tin.vertices[:, 2], np.sqrt(fit.weight)
    target = fit.residuals(old)
    size = float(np.max(np.abs(target)))
    if size == 0.0:
        return adjustment_record(tin, fit, old.copy(), 0, True)
    change, steps, gap = least_sizes(fit.B, target / size, w / w.max(), tolerance)
    return adjustment_record(tin, fit, old + size * change, steps, gap <= tolerance)


def least_sizes(B: sparse.csr_array, z: F64, w: F64, tolerance: float) -> tuple[F64, int, float]:
    """``argmin Σ w |z − B h|``: h (n,), the steps taken, and the duality gap relative to the sum.

    Dual: multipliers a with ``0 ≤ a ≤ 2 w``, ``Bᵀa = Bᵀw``; lower, upper are the multipliers of its
    bounds, the two parts of the residual. Every step is one matrix and two solves.
    """
    a, s = w.copy(), w.copy()
    h = Normal(B, w, direct=True).solve(B.T @ (w * z))
    r = z - B @ h
    margin = 1e-3 * float(np.mean(np.abs(r))) + 1e-300
    upper, lower = np.maximum(r, 0.0) + margin, np.maximum(-r, 0.0) + margin
    gap = np.inf
    for step in range(MAX_STEPS):
        total = float(w @ np.abs(z - B @ h))
        gap = float(lower @ a + upper @ s) / max(total, 1e-300)
        if gap <= tolerance or total <= tolerance * float(w @ np.abs(z)):
            return h, step, min(gap, tolerance)
        q = 1.0 / (lower / a + upper / s)
        normal, r = Normal(B, q, direct=True), upper - lower
        dh = normal.solve(B.T @ (q * r))
        da = q * (r - B @ dh)
        dl, du = -lower * (1.0 + da / a), -upper * (1.0 - da / s)
        fp, fd = step_length((a, da), (s, -da)), step_length((lower, dl), (upper, du))
        if min(fp, fd) < 1.0:
            mu = float(lower @ a + upper @ s)
            reached = float((lower + fd * dl) @ (a + fp * da) + (upper + fd * du) @ (s - fp * da))
            mu *= (reached / mu) ** 3 / (2.0 * len(z))
            second_l, second_u = da * dl, -da * du
            r = r + mu * (1.0 / a - 1.0 / s) - second_l / a + second_u / s
            dh = normal.solve(B.T @ (q * r))
            da = q * (r - B @ dh)
            dl = (mu - second_l - lower * da) / a - lower
            du = (mu - second_u + upper * da) / s - upper
            fp, fd = step_length((a, da), (s, -da)), step_length((lower, dl), (upper, du))
        a, s, h = a + fp * da, s - fp * da, h + fd * dh
        lower, upper = lower + fd * dl, upper + fd * du
    return h, MAX_STEPS, gap


def step_length(*pairs: tuple[F64, F64]) -> float:
    """The longest step, at most 1, that keeps every ``x + step dx`` of the pairs well above
    zero.
    """
    return min(
        1.0,
        *(
            0.9995 * float(np.min(np.where(dx < 0, -x / np.minimum(dx, -1e-300), np.inf)))
            for x, dx in pairs
        ),
    )


def adjust_asd_exact(
    tin: Tin, points_map: F64, sigma_m: F64 | None = None, fit: SurfaceFit | None = None
) -> Adjustment:
    """ASD adjustment as a linear program ``min wᵀ(u + v)``, ``B h + u − v = z``, u, v ≥ 0 (HiGHS):
    exact, and slow beyond some 10,000 points. Raises :class:`SurfaceError` where the solver gives
    up.
    """
    fit = fit_of(tin, points_map, sigma_m) if fit is None else fit
    w, k, z = np.sqrt(fit.weight), len(fit.z), tin.vertices[:, 2]
    used = np.flatnonzero(fit.adjusted)
    one = identity_matrix(k)
    A = sparse.hstack([fit.B.tocsc()[:, used], one, -one], format="csc")
    cost = np.r_[np.zeros(len(used)), w, w] / w.max()
    bounds = np.r_[np.tile([-np.inf, np.inf], (len(used), 1)), np.tile([0.0, np.inf], (2 * k, 1))]
    # as changes of the present heights: numbers near zero whatever the datum
    from scipy.optimize import (
        linprog,
    )  # a quarter of a second to load, and the online surface never needs it

    found = linprog(cost, A_eq=A, b_eq=fit.residuals(z), bounds=bounds, method="highs")
    if found.status != 0 or found.x is None:
        raise SurfaceError(
            f"the linear program was not solved: {found.message}",
            reason="surface_adjustment",
            value=found.status,
        )
    heights = z.copy()
    heights[used] += found.x[: len(used)]
    return adjustment_record(tin, fit, heights, int(found.nit), True)
