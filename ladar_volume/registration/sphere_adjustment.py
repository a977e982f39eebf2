"""Transforms from common sphere centres: weighted least squares with full covariances of both
sides, tests and outlying spheres.

Source: seed 003 sections 2 and 4 (similarity transform from sphere centres; with a levelled scanner
only a rotation about Z is estimated). Both sets of centres carry errors: the residual ``y − s R (x
− pivot) − t`` has the covariance ``C_y + s² R C_x Rᵀ``, which follows R from step to step. Outliers
after Baarda's data snooping: the test of sphere i, ``T_i = (Pv)_iᵀ [(P Q_v P)_ii]⁻¹ (Pv)_i``,
equals that of its prediction by the others alone (leave-one-out), without refitting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.registration.transform import (
    Transform,
    check_geometry,
    free_parameters,
    nearest_transform,
)

#: A rotation less certain than this, rad, is refused: the linear covariance no longer holds.
MAX_ROTATION_SIGMA = 0.1
MAX_STEPS = 50


@dataclass(frozen=True)
class Registration:
    """A transform from common centres.

    transform · used : (n,) bool, spheres left after the outlier test · residuals : (n, 3) m, target
    frame, of all spheres · statistic, p_value : (n,), test of each sphere against the others; NaN
    where they do not control it · redundancy · sigma0 : root of the weighted sum of squares by the
    redundancy (NaN without redundancy) · p_global : of that sum; NaN without redundancy or without
    stated covariances · consistent : nothing left stands out at the chosen risk
    """

    transform: Transform
    used: Bool
    residuals: F64
    statistic: F64
    p_value: F64
    redundancy: int
    sigma0: float
    p_global: float
    consistent: bool


def joint_covariance(C: F64 | None, n: int) -> F64 | None:
    """Covariance (3n, 3n) m² of n centres from (n, 3, 3) or (3n, 3n). Raises
    :class:`RegistrationError` for anything else.
    """
    if C is None:
        return None
    c = np.asarray(C, dtype=np.float64)
    if c.shape == (n, 3, 3):
        out = np.zeros((3 * n, 3 * n))
        for i in range(n):
            out[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = c[i]
        c = out
    if (
        c.shape != (3 * n, 3 * n)
        or not np.isfinite(c).all()
        or not np.allclose(c, c.T, rtol=1e-9, atol=1e-300)
    ):
        raise RegistrationError(
            (
                f"the covariance of {n} centres is ({n}, 3, 3) or ({3 * n}, {3 * n}), "
                "symmetric and finite"
            ),
            reason="registration_covariance",
        )
    return c


def rows(keep: I64) -> I64:
    """Rows of a stacked (3n,) vector for the spheres in ``keep``."""
    out: I64 = (3 * keep[:, None] + np.arange(3)).ravel()
    return out


@dataclass(frozen=True)
class Solution:
    """One least-squares solution: transform with C for unit variance · v : (3k,) · P : (3k, 3k)
    weights · Qv : (3k, 3k) of the residuals
    """

    transform: Transform
    v: F64
    P: F64
    Qv: F64


def solve(
    x: F64, y: F64, Cx: F64 | None, Cy: F64 | None, free: list[int], start: Transform
) -> Solution:
    """Gauss-Newton from ``start`` between centres x, y (k, 3); covariances (3k, 3k) or None on both
    sides for unit weights.
    """
    k, T = len(x), start
    for _ in range(MAX_STEPS):
        turn = np.kron(np.eye(k), T.scale * T.R)
        S = np.eye(3 * k) if Cx is None and Cy is None else np.zeros((3 * k, 3 * k))
        S = S + (0.0 if Cy is None else Cy) + (0.0 if Cx is None else turn @ Cx @ turn.T)
        try:
            P = np.linalg.inv(np.linalg.cholesky(S))
        except np.linalg.LinAlgError as error:
            raise RegistrationError(
                "the covariances of the centres are not positive definite",
                reason="registration_covariance",
            ) from error
        P = P.T @ P
        v = (y - T.apply(x)).ravel()
        J = T.jacobian(x).reshape(3 * k, 7)[:, free]
        N = J.T @ P @ J
        scaling = 1.0 / np.sqrt(np.diag(N))
        if not np.isfinite(scaling).all() or np.linalg.cond(N * np.outer(scaling, scaling)) > 1e13:
            raise RegistrationError(
                "the centres do not determine the transform", reason="registration_collinear"
            )
        Q = np.linalg.inv(N * np.outer(scaling, scaling)) * np.outer(scaling, scaling)
        step = np.zeros(7)
        step[free] = Q @ (J.T @ P @ v)
        C = np.zeros((7, 7))
        C[np.ix_(free, free)] = Q
        T = replace(T.perturb(step), C=C)
        if np.all(
            np.abs(step[free]) <= 1e-9 * np.sqrt(np.diag(Q)) + 1e-15 * (1.0 + np.abs(T.t).max())
        ):
            break
    return Solution(T, (y - T.apply(x)).ravel(), P, S - J @ Q @ J.T)


def snoop(s: Solution, redundancy: int, known: bool, floor_m2: float) -> tuple[F64, F64]:
    """Test of every sphere: statistics and p-values (k,); NaN where a sphere is not controlled by
    the others.

    With stated covariances chi-square with 3 degrees of freedom, else the ratio to the variance of
    the others (F), which is at least ``floor_m2``: exact centres differ by rounding alone.
    """
    k = len(s.v) // 3
    value, p = np.full(k, np.nan), np.full(k, np.nan)
    w, M, total = s.P @ s.v, s.P @ s.Qv @ s.P, float(s.v @ s.P @ s.v)
    for i in range(k):
        block, own = (
            M[3 * i : 3 * i + 3, 3 * i : 3 * i + 3],
            s.P[3 * i : 3 * i + 3, 3 * i : 3 * i + 3],
        )
        if np.linalg.eigvalsh(block)[0] <= 1e-9 * np.linalg.eigvalsh(own)[-1]:
            continue
        wi = w[3 * i : 3 * i + 3]
        value[i] = float(wi @ np.linalg.solve(block, wi))
        if known:
            p[i] = stats.chi2.sf(value[i], 3)
        elif redundancy > 3:
            value[i] = (value[i] / 3.0) / max((total - value[i]) / (redundancy - 3), floor_m2)
            p[i] = stats.f.sf(value[i], 3, redundancy - 3)
    return value, p


def register(
    source: F64,
    target: F64,
    C_source: F64 | None = None,
    C_target: F64 | None = None,
    *,
    levelled: bool = False,
    scale: float | None = 1.0,
    risk: float = 0.001,
) -> Registration:
    """The transform that takes common sphere centres of the source frame to those of the target
    frame.

    source, target : (n, 3) m, in the same order · C_source, C_target : (n, 3, 3) or, where centres
    of one side are correlated, (3n, 3n), m²; without both, weights are equal and the covariance is
    scaled by the residuals · levelled : rotation about Z only, from 2 centres that are not on one
    vertical; else from 3 that are not on one line · scale : None where it is to be found, else its
    value · risk : of calling a good sphere of this set an outlier. The worst sphere is left out
    while its test says so, fewer than half are gone, and the rest determines and controls the
    transform.

    Raises :class:`RegistrationError`: registration_shape, registration_not_finite,
    registration_too_few, registration_vertical, registration_collinear, registration_covariance,
    registration_weak (a rotation uncertain by more than 0.1 rad), registration_scale.
    """
    x, y = (np.asarray(r, dtype=np.float64) for r in (source, target))
    check_centres(x, y, scale)
    n = len(x)
    centres = Centres(x, y, (joint_covariance(C_source, n), joint_covariance(C_target, n)))
    return assemble(centres, remove_outliers(centres, levelled, scale, risk), risk)


def solve_part(centres: Centres, keep: Bool, levelled: bool, scale: float | None) -> Part:
    """The transform of the spheres to keep (n,) and its redundancy. Raises as :func:`register`."""
    x, y = centres.x[keep], centres.y[keep]
    check_geometry(x, y, levelled)
    r, free = rows(np.flatnonzero(keep)), free_parameters(levelled, scale is None)
    start = nearest_transform(x, y, x.mean(axis=0), levelled, scale)
    part = [None if c is None else c[np.ix_(r, r)] for c in centres.C]
    return Part(solve(x, y, part[0], part[1], free, start), 3 * int(keep.sum()) - len(free))


def remove_outliers(
    centres: Centres, levelled: bool, scale: float | None, risk: float
) -> SphereTests:
    """The worst sphere goes while its test says so and fewer than half are gone."""
    n, used = len(centres.x), np.ones(len(centres.x), bool)
    size = float(max(np.abs(centres.x).max(), np.abs(centres.y).max()))
    one = solve_part(centres, used, levelled, scale)
    while True:
        value, p = snoop(one.solution, one.redundancy, centres.has_covariance, (1e-12 * size) ** 2)
        suspicious = bool(np.nanmin(p, initial=1.0) < risk / n)
        # half the spheres outlying: nobody can tell which half
        if not suspicious or 2 * (n - used.sum() + 1) >= n:
            break
        less = used.copy()
        less[np.flatnonzero(used)[int(np.nanargmax(value))]] = False
        try:
            trial = solve_part(centres, less, levelled, scale)
        except RegistrationError:
            break
        if trial.redundancy < 1:  # what is left would agree with anything
            break
        used, one = less, trial
    return SphereTests(one, used, value, p, suspicious)


def check_centres(x: F64, y: F64, scale: float | None) -> None:
    """Raises :class:`RegistrationError` for centres that are not both (n, 3) and finite, or a scale
    that is not above zero.
    """
    if x.shape != y.shape or x.ndim != 2 or x.shape[1:] != (3,):
        raise RegistrationError(
            f"common centres are (n, 3) in both frames, not {x.shape} and {y.shape}",
            reason="registration_shape",
            value=x.shape,
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise RegistrationError(
            "a sphere centre with a coordinate that is not finite", reason="registration_not_finite"
        )
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise RegistrationError(
            f"a scale of {scale}; it must be above zero", reason="registration_scale", value=scale
        )


class Centres(NamedTuple):
    """Common centres x, y (n, 3) m in both frames and their covariances (3n, 3n), where stated."""

    x: F64
    y: F64
    C: tuple[F64 | None, F64 | None]

    @property
    def has_covariance(self) -> bool:
        """Whether a covariance is stated."""
        return any(c is not None for c in self.C)


class Part(NamedTuple):
    """The solution of some of the spheres and its redundancy."""

    solution: Solution
    redundancy: int


class SphereTests(NamedTuple):
    """The spheres used (n,) and what they give; value, p (k,) : test of each used one, and its
    probability · suspicious : whether one that stands out could not be left out
    """

    part: Part
    used: Bool
    value: F64
    p: F64
    suspicious: bool


def assemble(centres: Centres, found: SphereTests, risk: float) -> Registration:
    """The transform with its covariance and the tests of all spheres. Raises
    :class:`RegistrationError` (registration_weak).
    """
    (s, redundancy), used, known = found.part, found.used, centres.has_covariance
    total = float(s.v @ s.P @ s.v)
    variance = total / redundancy if redundancy > 0 else np.nan
    p_global = float(stats.chi2.sf(total, redundancy)) if known and redundancy > 0 else np.nan
    T = s.transform if known else replace(s.transform, C=s.transform.C * variance)
    check_rotation(T)
    statistic, p = np.full(len(used), np.nan), np.full(len(used), np.nan)
    statistic[used], p[used] = found.value, found.p
    residuals = centres.y - T.apply(centres.x)
    for i in np.flatnonzero(~used):
        statistic[i] = test_against_rest(centres, T, int(i), residuals[i], variance)
        p[i] = (
            stats.chi2.sf(statistic[i], 3)
            if known
            else stats.f.sf(statistic[i] / 3.0, 3, redundancy)
        )
    consistent = not found.suspicious and not p_global < risk
    return Registration(
        T, used, residuals, statistic, p, redundancy, float(np.sqrt(variance)), p_global, consistent
    )


def check_rotation(T: Transform) -> None:
    """Raises :class:`RegistrationError` (registration_weak) for a rotation too uncertain."""
    worst = float(np.sqrt(np.max(np.diag(T.C)[:3])))
    if worst > MAX_ROTATION_SIGMA:
        raise RegistrationError(
            (
                f"the rotation is uncertain by {worst:.2g} rad: the spheres lie too near "
                "together or too near one line"
            ),
            reason="registration_weak",
            value=worst,
        )


def test_against_rest(
    centres: Centres, T: Transform, i: int, residual: F64, variance: float
) -> float:
    """Test of a sphere that was left out against the prediction of the rest; variance, m² : of a
    coordinate, where no covariance is stated.
    """
    J = T.jacobian(centres.x)[i]
    own = sum(
        f * c[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] @ f.T
        for c, f in zip(centres.C, (T.scale * T.R, np.eye(3)), strict=True)
        if c is not None
    )
    S = (own if centres.has_covariance else variance * np.eye(3)) + J @ T.C @ J.T
    return float(residual @ np.linalg.solve(S, residual))
