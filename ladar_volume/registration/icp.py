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
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.equal_rows import distinct_cells
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
#: Where no start is given.
IDENTITY = Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, np.zeros((7, 7)))


@dataclass(frozen=True)
class IcpResult:
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


def clustered_covariance(A: F64, r: F64, Q: F64, source: F64, cell_m: float) -> F64:
    """Covariance (f, f) of the step where residuals of one cell may be correlated: ``Q (Σ_c s_c
    s_cᵀ) Q``, ``s_c = Σ_(i in c) a_i r_i``.
    """
    _, cell = distinct_cells(np.floor(source / cell_m).astype(np.int64))
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
) -> IcpResult:
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
    if solver is not None:
        start = solve_with(solver, (x, y, n), reach_m, start)
    T, free = start_at_centroid(x, start), free_parameters(levelled, False)
    scale = lengths(x, T, free)
    last = iterate((x, y, n), T, free, scale, reach_m)
    plain = last.Q * float(last.r @ last.r) / (len(last.r) - len(free))
    # pairs at the threshold may come and go for ever, by less than what noise does
    settled = last.settled or bool((np.abs(last.step) <= SETTLED * np.sqrt(np.diag(plain))).all())
    at = x[last.pairs[:, 0]]
    C = plain if cell_m == 0.0 else clustered_covariance(last.A, last.r, last.Q, at, cell_m)
    check_determined(C, scale, reach_m)
    full = np.zeros((7, 7))
    full[np.ix_(free, free)] = C
    T, share = replace(last.transform, C=full), len(last.pairs) / len(x)
    return IcpResult(T, last.pairs, last.sigma_m, share, last.rounds, settled)


class IcpSolution(NamedTuple):
    """Where the steps ended. pairs : (k, 2) of source and target · sigma_m : their robust scale ·
    A : (k, f), derivatives of the distances r (k,) m by the free parameters · step : (f,), the
    last · Q : (f, f), inverse normal equations · settled : whether the last step changed nothing
    """

    transform: Transform
    pairs: I64
    sigma_m: float
    A: F64
    r: F64
    step: F64
    Q: F64
    rounds: int
    settled: bool


def extent(source: F64, T: Transform) -> float:
    """Root mean square distance, m, of points (n, 3) from the pivot."""
    return float(np.sqrt(float(np.mean(np.sum((source - T.pivot) ** 2, axis=1)))))


def lengths(source: F64, T: Transform, free: list[int]) -> F64:
    """Factors (f,) that make the free parameters lengths, m."""
    size = extent(source, T)
    return np.array([T.scale * size if k < 3 else 1.0 for k in free])


def iterate(
    clouds: tuple[F64, F64, F64], T: Transform, free: list[int], scale: F64, reach_m: float
) -> IcpSolution:
    """Steps from a start until pairs and transform stay as they are.

    clouds : source (n, 3), target and its normals (m, 3) · scale : (f,), which makes the free
    parameters lengths.
    """
    x, y, n = clouds
    tree, before, rounds, settled = cKDTree(y), np.zeros((0, 2), np.int64), 0, False
    size = extent(x, T)
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
        T, before = T.perturb(full), pairs
    return IcpSolution(T, pairs, sigma, A, r, step, Q, rounds, settled)


def check_determined(C: F64, scale: F64, reach_m: float) -> None:
    """Raises :class:`RegistrationError` (icp_weak) for a covariance (f, f) of the free parameters
    that leaves the shift too uncertain.
    """
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


def start_at_centroid(source: F64, start: Transform | None) -> Transform:
    """The start, default identity, with the centroid of the source (n, 3) as its pivot."""
    T, pivot = IDENTITY if start is None else start, source.mean(axis=0)
    return replace(T, t=T.apply(pivot[None])[0], pivot=pivot)


def solve_with(
    solver: Solver, clouds: tuple[F64, F64, F64], reach_m: float, start: Transform | None
) -> Transform:
    """What another program makes of source (n, 3), target and normals (m, 3) from a start."""
    T = IDENTITY if start is None else start
    M = solver(*clouds, reach_m, T.matrix())
    return Transform(M[:3, :3] / T.scale, M[:3, 3], np.zeros(3), T.scale, T.C)
