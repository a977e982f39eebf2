"""Refinement of a transform between two epochs by their common ground: point to plane, with
covariance from its normal equations.

Source: seed 003 (registered scans A and B); normal equations after Chen & Medioni 1992, their
covariance as in Censi 2007 without the derivative of the correspondences. Another program's
iteration (Open3D's: ``io.epoch_registration``) may find the way; the last steps and the covariance
are done here, at fixed correspondences, so that both agree.

Residuals of neighbouring points are not independent: roughness, shared target points and the filter
correlate them. With ``cell_m`` the covariance sums each cell's score first (a sandwich by
clusters), which holds for any correlation shorter than a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64, I64
from ladar_volume.registration.transform import Transform, free_parameters

#: (source (n, 3), target (m, 3), target normals (m, 3), reach m, start (4, 4)) -> source to target
#: (4, 4)
Solver = Callable[[F64, F64, F64, float, F64], F64]
#: Pairs beyond so many robust sigma do not count: they are where the epochs differ, which is what
#: is measured later.
THRESHOLD_SIGMAS = 3.5
MAD_TO_SIGMA = 1.4826
MIN_PAIRS = 30
MAX_ROUNDS = 60
#: A direction less certain than this share of the search reach is not determined: the surfaces
#: slide on each other.
MAX_RELATIVE_SIGMA = 0.25
#: A last step below this share of its standard deviation has converged.
SETTLED = 0.3


@dataclass(frozen=True)
class Refined:
    """A refined transform.

    transform · pairs : (k, 2) int64, indices of source and target points used · sigma_m : robust
    scale of their distances along the normal · overlap : share of the source points used · rounds :
    how many steps were made · converged : whether the last one changed nothing to
    speak of
    """

    transform: Transform
    pairs: I64
    sigma_m: float
    overlap: float
    rounds: int
    converged: bool


def check_clouds(source: F64, target: F64, normals: F64, reach_m: float) -> tuple[F64, F64, F64]:
    """The arrays as float64. Raises :class:`RegistrationError` for shapes, values not finite,
    normals not of length 1, no reach.
    """
    x, y, n = (np.asarray(a, dtype=np.float64) for a in (source, target, normals))
    if x.ndim != 2 or x.shape[1:] != (3,) or y.shape[1:] != (3,) or n.shape != y.shape:
        raise RegistrationError(
            f"source (n, 3), target and its normals (m, 3); got {x.shape}, {y.shape}, {n.shape}",
            reason="icp_shape",
            value=x.shape,
        )
    if not (
        np.isfinite(x).all()
        and np.isfinite(y).all()
        and np.allclose((n * n).sum(axis=1), 1.0, atol=1e-3)
    ):
        raise RegistrationError(
            "a point that is not finite, or a normal that is not of length 1",
            reason="icp_not_finite",
        )
    if min(len(x), len(y)) < MIN_PAIRS:
        raise RegistrationError(
            f"two epochs need {MIN_PAIRS} points each",
            reason="icp_too_few",
            value=min(len(x), len(y)),
        )
    if not 0.0 < reach_m < np.inf:
        raise RegistrationError(
            f"a search reach of {reach_m} m; it must be above zero",
            reason="icp_reach",
            value=reach_m,
        )
    return x, y, n


def find_pairs(
    moved: F64, target: F64, tree: cKDTree, normals: F64, reach_m: float
) -> tuple[I64, float]:
    """Pairs (k, 2) within the reach and within 3.5 robust sigma along the normal, and that sigma,
    m.
    """
    distance, nearest = tree.query(moved, distance_upper_bound=reach_m)
    i = np.flatnonzero(np.isfinite(distance))
    if len(i) < MIN_PAIRS:
        raise RegistrationError(
            (
                f"only {len(i)} points have a partner within {reach_m:g} m: widen the reach "
                "or start nearer"
            ),
            reason="icp_no_overlap",
            value=len(i),
        )
    j = np.asarray(nearest, dtype=np.int64)[i]
    r = ((target[j] - moved[i]) * normals[j]).sum(axis=1)
    middle = float(np.median(r))
    sigma = MAD_TO_SIGMA * float(np.median(np.abs(r - middle)))
    keep = np.abs(r - middle) <= max(
        THRESHOLD_SIGMAS * sigma, 1e-12 * (1.0 + float(np.abs(moved).max()))
    )
    pairs: I64 = np.stack([i[keep], j[keep]], axis=1).astype(np.int64)
    return pairs, sigma


def normal_rows(T: Transform, source: F64, normals: F64, free: list[int]) -> F64:
    """Derivatives (k, f) of the distances along the normals (k, 3) of transformed points by the
    free parameters.
    """
    out: F64 = np.einsum("ni,nik->nk", normals, T.jacobian(source))[:, free]
    return out


def solve_step(A: F64, r: F64, scale: F64) -> tuple[F64, F64]:
    """Least-squares step (f,) and inverse normal equations (f, f); columns are scaled by ``scale``
    (f,), which makes rotations lengths.

    Raises :class:`RegistrationError` (icp_slides) where the normals leave a motion undetermined.
    """
    B = A / scale
    N = B.T @ B
    value = np.linalg.eigvalsh(N)
    if value[0] <= 1e-9 * value[-1]:
        raise RegistrationError(
            (
                "the surfaces slide on each other: their normals leave a motion "
                "undetermined; add ground of another slope, or spheres"
            ),
            reason="icp_slides",
            value=float(value[0] / value[-1]),
        )
    Q = np.linalg.inv(N) / np.outer(scale, scale)
    step: F64 = Q @ (A.T @ r)
    return step, Q


def clustered(A: F64, r: F64, Q: F64, source: F64, cell_m: float) -> F64:
    """Covariance (f, f) of the step where residuals of one cell may be correlated: ``Q (Σ_c s_c
    s_cᵀ) Q``, ``s_c = Σ_(i in c) a_i r_i``.
    """
    _, cell = np.unique(np.floor(source / cell_m).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    count = int(cell.max()) + 1
    scores = np.stack([np.bincount(cell, A[:, k] * r, count) for k in range(A.shape[1])], axis=1)
    if count <= 2 * A.shape[1]:
        raise RegistrationError(
            f"{count} cells of {cell_m:g} m are too few: choose smaller ones",
            reason="icp_cells",
            value=count,
        )
    out: F64 = Q @ (scores.T @ scores) @ Q * count / (count - A.shape[1])
    return out


def refine(
    source: F64,
    target: F64,
    normals: F64,
    start: Transform | None = None,
    *,
    reach_m: float,
    levelled: bool = False,
    cell_m: float = 0.0,
    solver: Solver | None = None,
) -> Refined:
    """The rigid transform that lays the source cloud on the target's surface, from a start within
    the reach.

    source : (n, 3) m · target, normals : (m, 3) m and unit · start : source to target, default
    identity; its scale is kept · reach_m : partners are searched so far · levelled : rotation about
    Z and shift only · cell_m : see the module; 0 takes residuals as independent · solver : another
    program's iteration to go first. Where the epochs differ, leave those points out or let the
    threshold do so (fewer than half).

    Raises :class:`RegistrationError`: icp_shape, icp_not_finite, icp_too_few, icp_reach,
    icp_no_overlap, icp_slides (say, two planes), icp_weak (a shift as uncertain as a quarter of the
    reach), icp_cells.
    """
    x, y, n = check_clouds(source, target, normals, reach_m)
    T = (
        Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, np.zeros((7, 7)))
        if start is None
        else start
    )
    if solver is not None:
        M = solver(x, y, n, reach_m, T.matrix())
        T = Transform(M[:3, :3] / T.scale, M[:3, 3], np.zeros(3), T.scale, T.C)
    pivot = x.mean(axis=0)
    T = replace(T, t=T.apply(pivot[None])[0], pivot=pivot)
    free, tree = free_parameters(levelled, False), cKDTree(y)
    size = np.sqrt(float(np.mean(np.sum((x - pivot) ** 2, axis=1))))
    scale = np.array([T.scale * size if k < 3 else 1.0 for k in free])
    before, rounds, settled = np.zeros((0, 2), np.int64), 0, False
    while rounds < MAX_ROUNDS and not settled:
        rounds += 1
        pairs, sigma = find_pairs(T.apply(x), y, tree, n, reach_m)
        i, j = pairs.T
        A, r = normal_rows(T, x[i], n[j], free), ((y[j] - T.apply(x[i])) * n[j]).sum(axis=1)
        step, Q = solve_step(A, r, scale)
        small = float(np.abs(step * scale).max()) <= 1e-6 * max(sigma, 1e-9 * size)
        settled = small and np.array_equal(pairs, before)
        if settled:
            break
        full = np.zeros(7)
        full[free] = step
        T, before = T.perturbed(full), pairs
    plain = Q * float(r @ r) / (len(r) - len(free))
    # pairs at the threshold may come and go for ever, by less than what noise does
    settled = settled or bool((np.abs(step) <= SETTLED * np.sqrt(np.diag(plain))).all())
    C = plain if cell_m == 0.0 else clustered(A, r, Q, x[i], cell_m)
    worst = float((np.sqrt(np.diag(C)) * scale).max())
    if worst > MAX_RELATIVE_SIGMA * reach_m:
        raise RegistrationError(
            (
                f"the shift is uncertain by {worst:.3g} m at a reach of {reach_m:g} m: the "
                "ground has too little shape"
            ),
            reason="icp_weak",
            value=worst,
        )
    whole = np.zeros((7, 7))
    whole[np.ix_(free, free)] = C
    return Refined(replace(T, C=whole), pairs, sigma, len(pairs) / len(x), rounds, settled)
