"""How scan B lies on scan A: measured on the ring, the unchanged common boundary of both.

A rigid motion of B shifts the volume by its flux through B's surface. The motion is free of
divergence, so that flux is the one through the ring, whatever was dug within: what the ring says of
the motion is all that the volume needs. The gaps along the ring are fitted by shift and tilt, and
weakly by shift and turn across the lines, which act where the ground slopes.

Least median of squares (Rousseeuw 1984) begins, Tukey's weights (Beaton & Tukey 1974) end: what
changed on less than half of the ring does not count. Neighbouring gaps share points and roughness;
the covariance sums the scores of a stretch of the ring first, and the larger of that and the one of
independent gaps counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.change.two_surfaces import TwoSurfaces
from ladar_volume.math.se3 import exp_so3, skew
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool
from ladar_volume.registration.transform import Transform

#: Fewest lines that a fit is made from, random starts of it, steps, and its seed.
MIN_LINES, TRIALS, STEPS, SEED = 12, 400, 30, 20
#: Tukey's constant, and residuals beyond so many robust sigma are called changed.
TUKEY, CHANGED = 4.685, 4.685
MAD_TO_SIGMA = 1.4826
#: What is assumed of the shift across the lines, and of the turn about them times the size: a
#: standard deviation, in sizes of the ring.
ACROSS_SHARE = 0.03
#: Stretches of the ring within which gaps may be correlated.
STRETCHES = 12
#: A line along a wall says nothing of the motion: least cosine to the normal.
LEAST_COSINE = 0.1
#: Parameters: shift along the lines, two tilts; these alone start the fit.
ALONG = 3


@dataclass(frozen=True)
class RingFit:
    """Misregistration of B against A.

    offset_m, offset_sigma_m : along the lines, in the middle of the ring · tilt_rad · effect_m3,
    effect_sigma_m3 : what it does to the volume removed · scatter_m : robust sigma of a gap about
    the fit · changed : (k,) lines that the fit does not hold for · home : brings B back, with
    covariance, pivot in B's present frame
    """

    offset_m: float
    offset_sigma_m: float
    tilt_rad: float
    effect_m3: float
    effect_sigma_m3: float
    scatter_m: float
    changed: Bool
    home: Transform

    @property
    def changed_share(self) -> float:
        """Share of the lines that lie on changed ground."""
        return float(self.changed.mean())


@dataclass(frozen=True)
class RingModel:
    """The linear model of the gaps: A (k, 6) by shift along the lines, two tilts (m at the size),
    two shifts across, turn (m at the size); m · basis : (6, 6), to rotation vector (rad) and shift
    (m) of the map · prior : (6,) standard deviations, m, inf for none · effect : (6,) m²
    """

    A: F64
    basis: F64
    prior: F64
    effect: F64
    pivot: F64
    size_m: float


def ring_model(d: TwoSurfaces, points_b: F64) -> RingModel:
    """The model of the gaps of a ring, for points (n, 3) of scan B."""
    pivot = d.ring_b.mean(axis=0)
    r = d.ring_b - pivot
    size = float(np.sqrt((r**2).sum(axis=1).mean()))
    w = d.ring_direction.mean(axis=0)
    w = w / max(float(np.linalg.norm(w)), 1e-12)
    u = np.cross(w, np.eye(3)[np.abs(w).argmin()])
    u /= np.linalg.norm(u)
    v = np.cross(w, u)
    basis = np.zeros((6, 6))  # columns: the six motions as (rotation vector, shift)
    basis[3:, 0] = w
    basis[:3, 1], basis[:3, 2], basis[:3, 5] = u / size, v / size, w / size
    basis[3:, 3], basis[3:, 4] = u, v
    A = np.einsum("ki,kij->kj", d.ring_slide, motion(r)) @ basis
    effect = np.einsum("ni,nij->j", d.gradient_b, motion(points_b - pivot)) @ basis
    prior = np.array([np.inf] * ALONG + [ACROSS_SHARE * size] * 3)
    return RingModel(A, basis, prior, effect, pivot, size)


def motion(r: F64) -> F64:
    """Displacements (n, 3, 6) of points (n, 3) by a rotation vector and a shift."""
    return np.concatenate([-skew(r), np.broadcast_to(np.eye(3), (len(r), 3, 3))], axis=2)


def fit_ring(d: TwoSurfaces, points_b: F64, parameters: int = 6) -> RingFit:
    """The misregistration of B (points (n, 3) m, map frame) on A from the gaps of their ring.

    parameters : 6, or 1 for the shift along the lines alone. Raises :class:`VolumeError`
    (ring_short) for a ring of too few lines.
    """
    upright = np.linalg.norm(d.ring_slide, axis=1) < 1.0 / LEAST_COSINE
    if int(upright.sum()) < MIN_LINES:
        raise VolumeError(
            f"{int(upright.sum())} lines of the ring meet the surface well: too few to tell how "
            f"the scans lie on each other ({MIN_LINES}); give a smaller --spacing",
            reason="ring_short",
            value=int(upright.sum()),
        )
    model = ring_model(d, points_b)
    free = slice(0, parameters)
    A, g = model.A[upright][:, free], d.gap_m[upright]
    penalty = np.diag(1.0 / model.prior[free] ** 2)
    floor = 1e-9 * model.size_m
    x, sigma = start(A[:, : min(ALONG, parameters)], g, floor)
    x = np.concatenate([x, np.zeros(A.shape[1] - len(x))])
    for _ in range(STEPS):
        x, sigma, weight, N = step(A, g, x, penalty, floor)
    Q: F64 = np.asarray(np.linalg.inv(N), dtype=np.float64)
    v = g - A @ x
    C = larger_covariance(Q, sandwich(A * (weight * v)[:, None] / sigma**2, Q), model.effect[free])
    full, Cx = np.zeros(6), np.zeros((6, 6))
    full[free], Cx[free, free] = x, C
    changed = np.ones(len(d.gap_m), bool)
    changed[upright] = np.abs(v) > CHANGED * sigma
    return RingFit(
        float(x[0]),
        float(np.sqrt(C[0, 0])),
        float(np.hypot(full[1], full[2]) / model.size_m),
        float(model.effect[free] @ x),
        float(np.sqrt(model.effect[free] @ C @ model.effect[free])),
        sigma,
        changed,
        inverse_motion(model, full, Cx),
    )


def start(A: F64, g: F64, floor: float) -> tuple[F64, float]:
    """Least median of squares (p,) of gaps g (k,) and the robust sigma, m, from random samples."""
    rng, p = np.random.default_rng(SEED), A.shape[1]
    best: F64 = np.zeros(p)
    least = np.inf
    for rows in [np.arange(len(g)), *rng.integers(0, len(g), (TRIALS, p + 1))]:
        x: F64 = np.asarray(np.linalg.lstsq(A[rows], g[rows], rcond=1e-3)[0], dtype=np.float64)
        middle = float(np.median(np.abs(g - A @ x)))
        if middle < least:
            best, least = x, middle
    return best, max(MAD_TO_SIGMA * least, floor)


def step(A: F64, g: F64, x: F64, penalty: F64, floor: float) -> tuple[F64, float, F64, F64]:
    """One step of the weighted fit: parameters, robust sigma, weights (k,), normal equations."""
    v = g - A @ x
    sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(v))), floor)
    weight = np.maximum(1.0 - (v / (TUKEY * sigma)) ** 2, 0.0) ** 2
    N = (A * weight[:, None]).T @ A / sigma**2 + penalty
    N += 1e-12 * np.trace(N) * np.eye(len(N))
    return np.linalg.solve(N, A.T @ (weight * g) / sigma**2), sigma, weight, N


def sandwich(scores: F64, Q: F64) -> F64:
    """Covariance (p, p) from scores (k, p) summed over stretches of the ring, which has neither
    beginning nor end: the mean over how the stretches may lie.
    """
    k = len(scores)
    length = max(k // STRETCHES, 1)
    twice = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(np.r_[scores, scores], 0)])
    sums = twice[length : length + k] - twice[:k]  # of every stretch of that length
    count = k / length
    out: F64 = Q @ (sums.T @ sums / length) @ Q * count / max(count - ALONG, 1.0)
    return out


def larger_covariance(C: F64, D: F64, effect: F64) -> F64:
    """The covariance that leaves more of an effect uncertain."""
    return D if effect @ D @ effect > effect @ C @ effect else C


def inverse_motion(model: RingModel, x: F64, C: F64) -> Transform:
    """The transform that takes the motion x (6,) out of scan B."""
    by_map, C_map = model.basis @ x, model.basis @ C @ model.basis.T
    R = exp_so3(by_map[:3])
    cov = np.zeros((7, 7))
    cov[:6, :6] = C_map
    return Transform(R.T, model.pivot - R.T @ by_map[3:], model.pivot, 1.0, cov)
