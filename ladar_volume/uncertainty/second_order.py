"""Where the first order fails: the volume's second derivatives by the boresight angles (UNCERTAINTY
step 9).

A boresight error is one rotation vector theta for the whole survey. A point seen at ``v`` (body
frame, laser to target), normal ``m = Rᵀn``, moves by ``theta x v + ½ theta x (theta x v)``. The
height along n at a fixed place changes by ``theta·(v x m)`` and, to second order, by ``½ m·(theta x
(theta x v)) − a·∇(theta·(v x m)) + ½ aᵀKa``: what is found there was displaced by ``a``, the part
of ``theta x v`` along the surface, and brought its own first-order error with it. How that error
changes along the surface is in the patch's slopes: over ground straight below one standpoint the
first two terms add up to ``−½ h theta²``, under a moving sensor to ``+½ h theta²`` for a turn about
the axis across the path. The third is the surface's own curvature K: the slope of the place that is
found is not that of the place that was seen (``−½ aᵀKa``), and the normal turns along the way
(``+aᵀKa``). With the patches' loads all three give ``½ thetaᵀ H theta`` for the volume.

Over a body K cancels but for what of ``a`` changes across it, and sums of fitted curvatures do not:
at a toe filters round the crease off, and the rest times the square of a is more than the whole
term. So the third is integrated by parts, ``½ ∫ aᵀKa = −½ ∫ ∂_j(a_i a_j) s_i`` with the slopes s of
the surface against their mean: where a body ends on the ground there are none. A place that stands
higher is shifted less, by ``c = theta x e_z`` per metre: the term is ``−(c·s)(a·s)``. That is what
it comes to under a moving sensor; what a turn about the vertical adds under a standing one is left
out. On a round hill of 100 m³ straight below the path it makes sigma a seventh smaller.

For Gaussian theta the two orders are uncorrelated; the second has the mean ``½ tr(HC)`` and the
variance ``½ tr(HCHC)``. The volume is not corrected for that mean: the line of the budget is the
mean square, both together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I32, I64, PatchTable
from ladar_volume.uncertainty.load_kernels import BinRows
from ladar_volume.uncertainty.navigation_sum import NavigationBins, markov_sum
from ladar_volume.uncertainty.packing import bin_rows
from ladar_volume.uncertainty.propagation import time_bins

#: Columns of M_cal and C_cal that hold the boresight.
BORESIGHT = slice(1, 4)
#: The second order is said to matter from this share of the first order's variance on, or for a
#: boresight sigma (rad) beyond this.
SHARE, SIGMA_RAD = 0.01, math.radians(0.1)
Vector: TypeAlias = tuple[float, float, float]
#: Walls count as no steeper than this vertical component of their normal: a second derivative grows
#: with its inverse cube, and would be noise beyond. (First-order terms use LEAST_UPWARD.)
STEEPEST = 0.2


@dataclass(frozen=True)
class SecondOrder:
    """Of an angular error in the volume. shift_m3 : mean of the second-order term · variance_m6 :
    its variance · matters : whether it changes what the first order says, or the angle is so
    uncertain that it may
    """

    shift_m3: float
    variance_m6: float
    matters: bool

    @property
    def line_m6(self) -> float:
        """Mean square of the term: its line in the budget, m⁶."""
        return self.variance_m6 + self.shift_m3**2


@leaf_kernel
def triple(a: F64) -> Vector:
    """The three numbers of an array (3,)."""
    return a[0], a[1], a[2]


@leaf_kernel
def cross(a: Vector, b: Vector) -> Vector:
    """``a x b``. Vectors are three numbers, not arrays: they stay in registers."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@leaf_kernel
def rotate_back(R: F64, a: Vector) -> Vector:
    """``Rᵀ a``."""
    return (
        R[0, 0] * a[0] + R[1, 0] * a[1] + R[2, 0] * a[2],
        R[0, 1] * a[0] + R[1, 1] * a[1] + R[2, 1] * a[2],
        R[0, 2] * a[0] + R[1, 2] * a[1] + R[2, 2] * a[2],
    )


@leaf_kernel
def add_outer(out: F64, factor: float, a: Vector, b: Vector) -> None:
    """Adds ``factor a bᵀ`` to out (3, 3)."""
    for i in range(3):
        row = factor * a[i]
        out[i, 0] += row * b[0]
        out[i, 1] += row * b[1]
        out[i, 2] += row * b[2]


class SeenPatch(NamedTuple):
    """A patch seen from the mean pose of a time bin. m : its normal, v : from the sensor to it, m,
    both in the body frame · load : on its height · part : of the patch that this bin saw
    """

    m: Vector
    v: Vector
    load: float
    part: float


@kernel
def add_normal(half: F64, seen: SeenPatch) -> None:
    """Adds to half (3, 3) of H what a turn of the ray does along the patch's normal."""
    m, v, share = seen.m, seen.v, seen.load * seen.part
    vv = 0.5 * share * (m[0] * v[0] + m[1] * v[1] + m[2] * v[2])
    add_outer(half, 0.5 * share, m, v)
    for i in range(3):
        half[i, i] -= vv


@kernel
def add_tangent(
    half: F64,
    mean: F64,
    moving: F64,
    seen: SeenPatch,
    body: Vector,
    lean: float,
    slope: Vector,
) -> None:
    """Adds what a turn of the ray does along a tangent, ``body`` in the body frame, that rises by
    ``lean`` of the normal: to half (3, 3) of H under a standing sensor, and to the pass's sums mean
    and moving (3,), with the patch's own sensitivity ``slope`` along that tangent.
    """
    v, m, part = seen.v, seen.m, seen.part
    upon, standing, vm = cross(v, body), cross(body, m), cross(v, m)
    # a place is one of the map's plane: what moved along the normal came from beside it
    shift = (upon[0] - lean * vm[0], upon[1] - lean * vm[1], upon[2] - lean * vm[2])
    for i in range(3):
        mean[i] += (abs(part) + 1e-12) * shift[i]
        moving[i] += seen.load * (slope[i] - part * standing[i])
    add_outer(half, -(seen.load * part), shift, standing)


@kernel
def curvature_kernel(
    q: F64, rows: BinRows, bins: I64, position: F64, R: F64, centre: F64, slope: F64
) -> F64:
    """H (b, 3, 3) of :func:`curvatures`: loads q (m, p) of patches with centres (m, 3) and slopes
    (m, 2) against their mean; their sensitivities by row of ascending bins (b,), whose mean poses
    are (b, 3) and (b, 3, 3).
    """
    start, index, M_nav, unit = rows.start, rows.bins, rows.M, rows.unit
    H, mean, moving, weight = np.zeros((len(bins), 3, 3)), np.zeros((2, 3)), np.zeros((2, 3)), 0.0
    for a in np.flatnonzero(q[:, 0]):
        n, t, c = triple(rows.normal[a]), triple(rows.tangent[a]), centre[a]
        along = (t, cross(n, t))
        downhill, beside = (slope[a, 0], slope[a, 1], 0.0), (-slope[a, 1], slope[a, 0], 0.0)
        upright = math.copysign(max(abs(n[2]), STEEPEST), n[2])
        for e in range(start[a], start[a + 1]):
            M, b, u = M_nav[e], index[e], unit[a]
            half, turn, at = H[b], R[b], position[b]
            away = (c[0] - at[0], c[1] - at[1], c[2] - at[2])
            part = u[0, 0] * M[0, 0]
            seen = SeenPatch(rotate_back(turn, n), rotate_back(turn, away), q[a, 0], part)
            add_normal(half, seen)
            for k in range(2):
                w, row, lean = u[k + 1, 1], M[k + 1], along[k][2] / upright
                own = (w * row[1], w * row[2], w * row[3])
                body = rotate_back(turn, along[k])
                add_tangent(half, mean[k], moving[k], seen, body, lean, own)
            # along the slope: by how much a place is shifted, and how that changes with its height
            factor, fall = -(q[a, 0] * part) * upright, cross(seen.v, rotate_back(turn, downhill))
            add_outer(half, factor, rotate_back(turn, beside), fall)
            weight += abs(part) + 1e-12
            if e + 1 == start[a + 1] or bins[index[e + 1]] > bins[b] + 1:  # the pass ends
                for k in range(2):
                    add_outer(half, -1.0 / weight, triple(mean[k]), triple(moving[k]))
                mean[:], moving[:], weight = 0.0, 0.0, 0.0
    for b in range(len(bins)):
        H[b] += H[b].T.copy()
    return H


def curvatures(
    q: F64, patches: PatchTable, navigation: NavigationBins, listed: tuple[I64, I32] | None = None
) -> F64:
    """H by time bin (b, 3, 3), unit of the result per rad², of one result with loads q (m, p) on
    the patches' parameters: by an error that is the same for all that was seen in the bin. The
    boresight's is the sum.

    Each patch was seen from one or more time bins: v and m are taken from the mean pose in the bin,
    the bin's share of the patch from the patch's own sensitivities to the attitude, which turns the
    ray as the boresight does. The slope of the first-order error is that under a standing sensor,
    and over each pass (bins without a gap) what the patch's slopes say beyond it: there the sensor
    moves with the places it sees. listed : time bins (b,) of the sensitivities, where known.
    """
    bins, index = time_bins(patches) if listed is None else listed
    position, R = navigation.mean_pose(bins)
    p, n = patches, patches.normal
    upright = np.copysign(np.maximum(np.abs(n[:, 2]), STEEPEST), n[:, 2])
    slope: F64 = large_zeros((len(p), 2))
    np.divide(-n[:, :2], upright[:, None], out=slope)
    weight = np.abs(q[:, 0] * upright)
    slope -= weight @ slope / max(float(weight.sum()), 1e-300)
    del weight, upright
    found = curvature_kernel(
        q,
        bin_rows(p, index),
        bins,
        position,
        np.ascontiguousarray(R),
        p.centre,
        slope,
    )
    return np.asarray(found)


@dataclass(frozen=True)
class AttitudeCurvature:
    """Second order of the attitude by time bin. t_s : (b,) ascending, s · S : (b, 3, 3) ``C^{1/2} H
    C^{1/2}``, in the result's unit
    """

    t_s: F64
    S: F64


def attitude_curvature(H: F64, bins: I64, navigation: NavigationBins) -> AttitudeCurvature:
    """From curvatures H (b, 3, 3) by ascending time bins (b,)."""
    root = navigation.roots(bins)[1]
    return AttitudeCurvature(
        (bins - (bins[0] if len(bins) else 0)) * (navigation.bin_ns * 1e-9), root @ H @ root
    )


def attitude_second_order(
    swing: AttitudeCurvature, budget: BudgetParameters, first_m6: float
) -> SecondOrder:
    """The attitude's second-order term ``Σ_e ½ theta_eᵀ H_e theta_e``, beside the first order's
    variance.

    An attitude error turns what is seen as a boresight error does, but for the lever arms; from
    time to time it changes. With the correlation rho of two bins the variance is ``½ Σ_ef rho²
    tr(S_e S_f)``, and the square of a constant and an exponential part is made of exponentials. The
    white part, of the variance of which each state has its own, is left out: it averages, and turns
    no surface.
    """
    bias, markov = (
        budget.attitude_bias_fraction,
        1.0 - budget.attitude_bias_fraction - budget.attitude_white_fraction,
    )
    S, tau = np.ascontiguousarray(swing.S.reshape(len(swing.S), 9)), budget.tau_attitude_s
    total = S.sum(axis=0)
    constant, once, twice = (
        float(total @ total),
        float(markov_sum(swing.t_s, S, tau)),
        float(markov_sum(swing.t_s, S, 0.5 * tau)),
    )
    variance = 0.5 * (bias**2 * constant + 2.0 * bias * markov * once + markov**2 * twice)
    shift = 0.5 * (bias + markov) * float(total[[0, 4, 8]].sum())
    return SecondOrder(shift, variance, variance + shift**2 > SHARE * first_m6)


def combine_second_orders(parts: dict[str, SecondOrder]) -> tuple[dict[str, float], SecondOrder]:
    """Lines m⁶ of several second orders, by name, and all of them as one. The errors are
    independent but their means are not: the square of the sum of all means is shared out in order,
    no line below zero.
    """
    lines, mean = {}, 0.0
    for name, part in parts.items():
        lines[name] = max(0.0, part.line_m6 + 2.0 * part.shift_m3 * mean)
        mean += part.shift_m3
    return lines, SecondOrder(
        mean, sum(p.variance_m6 for p in parts.values()), any(p.matters for p in parts.values())
    )


def second_order(H: F64, C: F64, first_m6: float) -> SecondOrder:
    """The second-order term of curvature H (3, 3) under a boresight covariance C (3, 3) rad²,
    beside the first order's variance.
    """
    HC = H @ C
    shift, variance = 0.5 * float(np.trace(HC)), 0.5 * float(np.trace(HC @ HC))
    strong = variance + shift**2 > SHARE * first_m6
    return SecondOrder(shift, variance, bool(strong or np.sqrt(np.diag(C)).max() > SIGMA_RAD))
