"""Where a surface runs within three sigma of its base, cut and fill are biased: the folded-normal correction (UNCERTAINTY step 7).

Noise of standard deviation s about a true height μ turns ``max(μ, 0)`` into ``g = μ Φ(μ/s) + s φ(μ/s)`` on average: flat ground at the
level has cut and fill of 0.28 sigma per area each, though both are zero. With the node covariance C of a triangle,
``s² = λᵀCλ`` at barycentric coordinates λ; the integrals over the triangle are by quadrature, on parts no taller than s.

The true height is not known; the noisy one would find two fifths of the bias only. It is estimated by a plane through each vertex'
neighbourhood of several rings, whose own noise s' is allowed for to second order: the correction is ``2 b(s) − b(√(s² + s'²)) + b(s')``
with ``b = g − max(μ, 0)``. It is the same for cut and fill: the net volume is left alone.

Variance: the noise acts through the mean slopes ``G = ∫ λ Φ`` and, since the fold is no line, through ``H = ∫ λ λᵀ φ / s``:
``GᵀCG + ½ tr(HCHC)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from scipy import sparse

from ladar_volume.ground.polynomial import base_height
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.kernels import kernel, parallel_kernel
from ladar_volume.model.records import F64, I32, Bool, Plane, Tin
from ladar_volume.surface.tin import footprint_areas
from ladar_volume.volume.neighbourhood import Smooth
from ladar_volume.volume.prismoids import gather, positive_part

#: A triangle counts as near where its heights come within this many standard deviations of the base.
REACH = 3.0
#: Most parts an edge is divided into; a taller triangle crosses the base on a strip that is treated as a line.
PARTS = 64
#: Quadrature of degree 5 on a triangle: weights, and the coordinates of each orbit (Radon 1948).
ROOT = math.sqrt(15.0)
ORBITS = (((6 - ROOT) / 21, (155 - ROOT) / 1200), ((6 + ROOT) / 21, (155 + ROOT) / 1200))
NODES = np.array([[1 / 3, 1 / 3, 9 / 40]] + [[x, y, w] for r, w in ORBITS for x, y in ((r, r), (1 - 2 * r, r), (r, 1 - 2 * r))])
#: Columns of a packed symmetric 3 by 3 matrix.
PACKED = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]])


@dataclass(frozen=True)
class NearBase:
    """correction_m3 : what is to be taken from cut and from fill alike (the correction named "folded normal") · near : (m,) bool, triangles
    it applies to, among the chosen ones · near_area_m2 : their footprint · variance_cut_m6, variance_fill_m6, variance_net_m6 : of the
    volumes of all chosen triangles, for the given covariance of the heights · gradient_cut : (n,) m² mean derivatives by the vertex
    heights, to be used where first-order propagation would take a triangle to be wholly cut or wholly fill"""

    correction_m3: float
    near: Bool
    near_area_m2: float
    variance_cut_m6: float
    variance_fill_m6: float
    variance_net_m6: float
    gradient_cut: F64


@kernel
def add_point(mu: F64, C: F64, p: float, q: float, weight: float, out: F64) -> None:
    """Adds one quadrature point with barycentric coordinates (1 − p − q, p, q) to ``out`` (10,): g, ∂g/∂μ (3), its curvature (6)."""
    o = 1.0 - p - q
    m = o * mu[0] + p * mu[1] + q * mu[2]
    s2 = o * o * C[0] + p * p * C[3] + q * q * C[5] + 2.0 * (o * p * C[1] + o * q * C[2] + p * q * C[4])
    s = math.sqrt(max(s2, 1e-300))
    t = m / s
    density = math.exp(-0.5 * t * t) * 0.3989422804014327
    share = 0.5 * math.erfc(-t * 0.7071067811865476)
    out[0] += weight * (m * share + s * density)
    out[1] += weight * o * share
    out[2] += weight * p * share
    out[3] += weight * q * share
    curve = weight * density / s
    out[4] += curve * o * o
    out[5] += curve * o * p
    out[6] += curve * o * q
    out[7] += curve * p * p
    out[8] += curve * p * q
    out[9] += curve * q * q


@kernel
def by_quadrature(mu: F64, C: F64, parts: int, nodes: F64, out: F64) -> None:
    """Means over a triangle of :func:`add_point`, divided into parts² equal triangles."""
    size = 1.0 / parts
    for i in range(parts):
        for j in range(parts - i):
            for flip in range(2 if j < parts - i - 1 else 1):
                for k in range(len(nodes)):
                    u, v = (nodes[k, 0], nodes[k, 1]) if flip == 0 else (1.0 - nodes[k, 0], 1.0 - nodes[k, 1])
                    add_point(mu, C, (i + u) * size, (j + v) * size, nodes[k, 2] * size * size, out)


@kernel
def by_line(mu: F64, C: F64, out: F64) -> None:
    """The same for a triangle so tall that the noise acts on the zero line only; adds to the values without noise in ``out`` (10,)."""
    lone = 0
    for k in range(3):
        if (mu[k] > 0.0) != (mu[(k + 1) % 3] > 0.0) and (mu[k] > 0.0) != (mu[(k + 2) % 3] > 0.0):
            lone = k
    j, k = (lone + 1) % 3, (lone + 2) % 3
    s, t = mu[lone] / (mu[lone] - mu[j]), mu[lone] / (mu[lone] - mu[k])
    # the density of heights at zero: derivative of the tip's share s t by the level, whose two halves are equal
    density = 2.0 * abs(mu[lone] / ((mu[lone] - mu[j]) * (mu[lone] - mu[k])))
    w = np.zeros(3)
    for i in range(3):  # Simpson along the zero line, exact for the quadratic s²
        f = 0.5 * i
        w[j], w[k] = s * (1.0 - f), t * f
        w[lone] = 1.0 - w[j] - w[k]
        weight = density * (4.0 if i == 1 else 1.0) / 6.0
        s2 = w[0] * w[0] * C[0] + w[1] * w[1] * C[3] + w[2] * w[2] * C[5]
        s2 += 2.0 * (w[0] * w[1] * C[1] + w[0] * w[2] * C[2] + w[1] * w[2] * C[4])
        out[0] += 0.5 * weight * s2
        out[4] += weight * w[0] * w[0]
        out[5] += weight * w[0] * w[1]
        out[6] += weight * w[0] * w[2]
        out[7] += weight * w[1] * w[1]
        out[8] += weight * w[1] * w[2]
        out[9] += weight * w[2] * w[2]


@kernel
def least_deviation(C: F64) -> float:
    """Least standard deviation of the interpolated height at corners, midpoints of edges and centre, for packed covariances (6,)."""
    least = min(C[0], C[3], C[5])
    least = min(least, 0.25 * (C[0] + C[3] + 2.0 * C[1]), 0.25 * (C[0] + C[5] + 2.0 * C[2]), 0.25 * (C[3] + C[5] + 2.0 * C[4]))
    return math.sqrt(max(min(least, (C[0] + C[3] + C[5] + 2.0 * (C[1] + C[2] + C[4])) / 9.0), 0.0))


@parallel_kernel
def folded_kernel(mu: F64, C: F64, plain: F64, nodes: F64) -> F64:
    """Means (m, 10) over triangles with heights mu (m, 3) and packed node covariances C (m, 6): g, its slopes (3), its curvature (6).
    ``plain`` (m, 4): mean and slopes without noise, taken where the base is more than eight standard deviations away."""
    out = np.zeros((len(mu), 10))
    for t in numba.prange(len(mu)):
        low, high = min(mu[t, 0], mu[t, 1], mu[t, 2]), max(mu[t, 0], mu[t, 1], mu[t, 2])
        s = math.sqrt(max(C[t, 0], C[t, 3], C[t, 5]))
        small = least_deviation(C[t])
        if low >= 8.0 * s or high <= -8.0 * s:
            out[t, :4] = plain[t]
        elif high - low > PARTS * s and low < 0.0 and high > 0.0:
            out[t, :4] = plain[t]
            by_line(mu[t], C[t], out[t])
        else:
            parts = PARTS if high - low > PARTS * small else max(2, math.ceil((high - low) / max(small, 1e-300)))
            by_quadrature(mu[t], C[t], parts, nodes, out[t])
    return out


def folded(mu: F64, C: F64) -> F64:
    """:func:`folded_kernel` of heights (m, 3), m, and packed covariances (m, 6), m²."""
    mean, slope = positive_part(mu)
    return np.asarray(folded_kernel(np.ascontiguousarray(mu), np.ascontiguousarray(C), np.c_[mean, slope], NODES))


def node_covariances(C: Any, triangles: I32) -> F64:
    """Packed node covariances (m, 6) of triangles (m, 3) from variances (n,) or a sparse covariance (n, n) of the heights."""
    out, known = np.zeros((len(triangles), 6)), sparse.issparse(C)
    if known:
        for k, (i, j) in enumerate(PACKED):
            out[:, k] = np.asarray(C.tocsr()[triangles[:, i], triangles[:, j]]).ravel()
    else:
        out[:, [0, 3, 5]] = np.asarray(C)[triangles]
    return out


def near_base(tin: Tin, base: Plane, C: Any, mask: Bool | None = None, rings: int = 4) -> NearBase:
    """Correction of cut and fill above ``base`` where the surface runs near it, and the variances of both.

    C : variances (n,) m², or sparse covariance (n, n), of the vertex heights above the base (independent noise; what base and surface
    share cancels and does not belong here) · mask : triangles that count, by default the relevant ones · rings : size of the
    neighbourhood from which true heights are estimated. Raises :class:`VolumeError` without triangles or for bad variances.
    """
    chosen = tin.relevant if mask is None else mask
    t = tin.triangles[chosen]
    if len(t) == 0:
        raise VolumeError("there is no triangle to take a volume of", reason="volume_no_triangle")
    joint = sparse.issparse(C)
    variance = C.diagonal() if joint else np.asarray(C, dtype=np.float64)
    if variance.shape != (len(tin.vertices),) or not (np.isfinite(variance) & (variance >= 0)).all():
        raise VolumeError("every vertex needs a variance of 0 or more", reason="volume_variance")
    h = tin.vertices[:, 2] - base_height(base, tin.vertices[:, :2])
    area, packed, sigma = footprint_areas(tin.vertices, t), node_covariances(C, t), np.sqrt(variance)
    reach = REACH * sigma[t]
    near = ((h[t] - reach) <= 0).any(axis=1) & ((h[t] + reach) >= 0).any(axis=1) & (reach > 0).any(axis=1)
    wanted = np.zeros(len(h), bool)
    wanted[t[near]] = True
    smooth = Smooth(tin, h, variance, wanted, rings)
    value = smooth.heights
    mu, s = value[t[near]], np.sqrt(smooth.variance)[t[near]]
    own = np.stack([s[:, i] * s[:, j] for i, j in PACKED], axis=1)  # neighbouring planes share their points: as if fully correlated
    noise = packed[near]
    once, twice, plane = folded(mu, noise), folded(mu, noise + own), folded(mu, own)
    correction = 2.0 * once[:, 0] - twice[:, 0] + plane[:, 0] - 2.0 * positive_part(mu)[0]
    # how the correction follows the heights through the planes; its kink at zero is smoothed as the planes are
    follow = (2.0 * once[:, 1:4] - twice[:, 1:4] - plane[:, 1:4]) * area[near, None]
    means = folded(value[t], packed)
    cut = gather((means[:, 1:4] * area[:, None])[..., None], t, len(h))[:, 0]
    cut = cut - smooth.adjoint(gather(follow[..., None], t[near], len(h))[:, 0])
    net = gather(np.repeat(area / 3.0, 3).reshape(-1, 3, 1), t, len(h))[:, 0]
    full: Any = C if joint else sparse.diags_array(variance)
    curved = second_order(means[:, 4:] * area[:, None], t, full)
    first = [float(g @ (full @ g)) for g in (cut, cut - net, net)]
    total = float(area[near] @ np.maximum(correction, 0.0))
    return NearBase(total, near, float(area[near].sum()), first[0] + curved, first[1] + curved, first[2], cut)


def second_order(curvature: F64, triangles: I32, C: Any) -> float:
    """``½ tr(HCHC)`` of packed curvatures (m, 6) summed over triangles, m⁶."""
    n = C.shape[0]
    index = [(i, j, k) for k, (i, j) in enumerate(PACKED)] + [(j, i, k) for k, (i, j) in enumerate(PACKED) if i != j]
    rows, columns = (np.concatenate([triangles[:, e[c]] for e in index]) for c in (0, 1))
    H = sparse.csr_array((np.concatenate([curvature[:, e[2]] for e in index]), (rows, columns)), shape=(n, n))
    HC = sparse.csr_array(H @ C)
    return 0.5 * float((HC * HC.T).sum())
