"""Where a surface runs within three sigma of its base, cut and fill are biased: the folded-normal
correction (UNCERTAINTY step 7).

Noise of standard deviation s about a true height μ turns ``max(μ, 0)`` into ``g = μ Φ(μ/s) + s
φ(μ/s)`` on average: flat ground at the level has cut and fill of 0.28 sigma per area each, though
both are zero. With the node covariance C of a triangle, ``s² = λᵀCλ`` at barycentric coordinates λ;
the integrals over the triangle are by quadrature, on parts no taller than s.

The true height is not known; the noisy one would find two fifths of the bias only. It is estimated
by a plane through each vertex' neighbourhood of several rings, whose own noise s' is allowed for to
second order: the correction is ``2 b(s) − b(√(s² + s'²)) + b(s')`` with ``b = g − max(μ, 0)``. It
is the same for cut and fill: the net volume is left alone.

Variance: the noise acts through the mean slopes ``G = ∫ λ Φ`` and, since the fold is no line,
through ``H = ∫ λ λᵀ φ / s``: ``GᵀCG + ½ tr(HCHC)``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy import sparse

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.tin.full_tin import any_corner, footprint_areas
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.folded_normal import PACKED, folded_means, positive_parts
from ladar_volume.volume.neighbourhood import CHUNKS, Smooth, SparseF64, part_around
from ladar_volume.volume.prismoids import gather, mean_above
from ladar_volume.volume.remaining_fold import RemainingFold, remaining_fold, scatter_factor

#: A triangle counts as near where its heights come within this many standard deviations of the
#: base.
REACH = 3.0
#: Share of the scatter of chosen vertices beyond their noise that is not known.
SCATTER_UNKNOWN = 0.25
#: Triangles looked at at once: the means of a few numbers each take room.
BLOCK = 1 << 18


@dataclass(frozen=True)
class Fold:
    """correction_m3 : what is to be taken from cut and from fill alike (the correction named
    "folded normal") · near_area_m2 : footprint of the triangles it comes from
    """

    correction_m3: float
    near_area_m2: float

    def removed_m3(self, cut_m3: float, fill_m3: float) -> float:
        """What is taken, m³: neither volume becomes negative."""
        return min(self.correction_m3, cut_m3, fill_m3)


@dataclass(frozen=True)
class WholeFold(Fold):
    """curved_m6 : second-order part of the variances of cut and of fill · remaining : what the
    correction leaves in both, see :mod:`remaining_fold`
    """

    curved_m6: float
    remaining: RemainingFold

    def removed_m3(self, cut_m3: float, fill_m3: float) -> float:
        """What is taken, m³, with what the correction leaves: neither volume becomes negative."""
        return min(self.correction_m3 + self.remaining.fold_m3, cut_m3, fill_m3)

    @property
    def variance_m6(self) -> float:
        """What the fold adds to the variances of cut and of fill: its curvature, and that what the
        correction leaves is not known.
        """
        return self.curved_m6 + self.remaining.sigma_m3**2


@dataclass(frozen=True)
class NearBase(WholeFold):
    """near : (m,) bool, triangles the correction comes from, among the chosen ones ·
    variance_cut_m6, variance_fill_m6, variance_net_m6 : of the volumes of all chosen triangles, for
    the given covariance of the heights, the first two with ``curved_m6`` · gradient_cut,
    gradient_net : (n,) m² mean derivatives by the vertex heights, to be used where first-order
    propagation would take a triangle to be wholly cut or wholly fill
    """

    near: Bool
    variance_cut_m6: float
    variance_fill_m6: float
    variance_net_m6: float
    gradient_cut: F64
    gradient_net: F64


@parallel_kernel
def packed_kernel(start: I64, column: I64, value: F64, triangles: I32) -> F64:
    """Packed node covariances (m, 6) of triangles (m, 3) from a sparse matrix in CSR form."""
    out = np.zeros((len(triangles), 6))
    for t in numba.prange(len(triangles)):
        k = 0
        for a in range(3):
            i = triangles[t, a]
            for b in range(a, 3):
                for e in range(start[i], start[i + 1]):
                    if column[e] == triangles[t, b]:
                        out[t, k] += value[e]
                k += 1
    return out


def node_covariances(C: SparseF64, triangles: I32) -> F64:
    """Packed node covariances (m, 6) of triangles (m, 3) from a sparse covariance (n, n) of the
    heights.
    """
    return np.asarray(packed_kernel(*csr(C), triangles))


class Csr(NamedTuple):
    """A sparse matrix: start of each row, columns and values."""

    start: I64
    column: I64
    value: F64


def csr(C: SparseF64) -> Csr:
    """A sparse matrix as kernels read it."""
    rows = sparse.csr_array(C)
    return Csr(rows.indptr.astype(np.int64), rows.indices.astype(np.int64), rows.data)


def near_triangles(t: I32, height: F64, variance: F64) -> Bool:
    """Which of the triangles t (k, 3) come within reach of a base, (k,), for vertex heights (n,)
    above it with variances (n,).
    """
    reach = REACH * np.sqrt(variance)
    return (
        any_corner(t, height - reach <= 0)
        & any_corner(t, height + reach >= 0)
        & any_corner(t, reach > 0)
    )


def fold(
    tin: Tin, height: F64, variance: F64, near: I32, packed: F64, rings: int, summed: F64
) -> Fold:
    """The correction of cut and fill alone, where the surface runs near its base.

    height, variance : (n,) of the vertices above the base, m, and of their independent noise, m² ·
    near : (k, 3) triangles in reach of the base, packed : (k, 6) m² their node covariances · rings,
    summed : as in :func:`near_base`. Raises :class:`VolumeError` for bad variances.
    """
    smooth, area = (
        smooth_heights(tin, height, check_variances(variance, len(height)), near, rings, summed),
        footprint_areas(tin.vertices, near),
    )
    total = sum(
        float(area[part] @ correction(*folds(*at, slopes=False)))
        for part, at in blocks(smooth, near, packed)
    )
    return Fold(total, float(area.sum()))


def loads(height: F64, t: I32, area: F64, near: Bool, slope_near: F64) -> tuple[F64, F64]:
    """Gradients (n,) m² of cut and net volume by the vertex heights (n,) m above the base: for
    triangles near it with the mean derivatives (k, 3), for the others among t (m, 3) of areas (m,)
    m² with their sign.
    """
    cut, net = np.zeros(len(height)), np.zeros(len(height))
    loads_kernel(height, t, area, near, slope_near, cut, net)
    return cut, net


@kernel
def loads_kernel(
    height: F64, t: I32, area: F64, near: Bool, slope_near: F64, cut: F64, net: F64
) -> None:
    """See :func:`loads`; adds to cut and net (n,)."""
    h, slope, count = np.empty(3), np.empty(3), 0
    for i in range(len(t)):
        if near[i]:
            for c in range(3):
                slope[c] = slope_near[count, c]
            count += 1
        else:
            for c in range(3):
                h[c] = height[t[i, c]]
            mean_above(h, slope)
        for c in range(3):
            cut[t[i, c]] += slope[c] * area[i]
            net[t[i, c]] += area[i] / 3.0


def near_base(
    tin: Tin,
    base: Plane,
    C: F64 | SparseF64,
    mask: Bool | None = None,
    rings: int = 4,
    summed: F64 | None = None,
    selected: bool = False,
) -> NearBase:
    """Correction of cut and fill above ``base`` where the surface runs near it, and the variances
    of both.

    C : variances (n,) m², or sparse covariance (n, n), of the vertex heights above the base
    (independent noise; what base and surface share cancels and does not belong here); of pairs that
    no edge joins nothing is needed · mask : triangles that count, by default the relevant ones ·
    rings : size of the neighbourhood from which true heights are estimated · summed : (n,) m² sums
    of each height's covariances with all others, where they reach beyond the edges · selected :
    whether the vertices were chosen from more points, by their heights: then their variances near
    the base are raised to what they scatter. Raises :class:`VolumeError` without triangles or for
    bad variances.
    """
    t = tin.triangles[tin.relevant if mask is None else mask]
    h, area = height_above(tin.vertices, base), footprint_areas(tin.vertices, t)
    near, joint, wider = _near_and_covariance(tin, h, t, C, selected)
    part, close_area = part_around(tin, t[near], rings), area[near]
    own, close = part.vertex, part.close
    C_own, sums = _covariance_of(joint, own, summed)
    smooth = smooth_heights(part.tin, h[own], C_own.diagonal(), close, rings, sums)
    found = all_moments(smooth, close, node_covariances(C_own, close))
    cut, net = loads(h, t, area, near, found[:, 1:4])
    cut[own] -= smooth.adjoint(load(found[:, 4:7], close_area, close, len(own)))
    curvature = close_area[:, None] * found[:, 7:]
    curved = second_order(curvature, close, smooth.start, smooth.link, C_own)
    first = [float(g @ (joint @ g)) for g in (cut, cut - net, net)]
    variances = first[0] + curved, first[1] + curved, first[2]
    left = remaining_fold(smooth, close, close_area, rings)
    total = float(close_area @ found[:, 0])
    if wider > 1.0:
        packed = node_covariances(C_own, close)
        left = left.with_scatter(total - _with_more_noise(smooth, close, close_area, packed, wider))
    return NearBase(total, float(close_area.sum()), curved, left, near, *variances, cut, net)


def _covariance_of(joint: SparseF64, own: I64, summed: F64 | None) -> tuple[SparseF64, F64]:
    """The covariance (k, k) of some heights (k,), and the sums (k,) of their covariances with all
    others, where these are not given (n,).
    """
    rows = sparse.csr_array(joint)[own]
    sums = np.asarray(rows.sum(axis=1), dtype=np.float64).ravel()
    return rows[:, own], sums if summed is None else summed[own]


def _with_more_noise(smooth: Smooth, close: I32, area: F64, packed: F64, wider: float) -> float:
    """The correction, m³, of triangles close (k, 3) of areas (k,) m² if the factor ``wider``, by
    which their node covariances (k, 6) were raised, were more: noise of chosen vertices is not
    Gaussian, and how far it folds is known no better.
    """
    more = 1.0 + SCATTER_UNKNOWN * (wider - 1.0) / wider
    return sum(
        float(area[part] @ correction(*folds(mu, math.sqrt(more) * s, more * noise, slopes=False)))
        for part, (mu, s, noise) in blocks(smooth, close, packed)
    )


def _near_and_covariance(
    tin: Tin, height: F64, t: I32, C: F64 | SparseF64, selected: bool
) -> tuple[Bool, Any, float]:
    """Which of the triangles t (m, 3) are near the base (m,), and the heights' covariance (n, n),
    sparse, raised where the vertices were ``selected``, as :func:`near_base` says, and by how much.
    """
    if len(t) == 0:
        raise VolumeError("there is no triangle to take a volume of", reason="volume_no_triangle")
    joint: Any = C if sparse.issparse(C) else diagonal_matrix(np.asarray(C, dtype=np.float64))
    near = near_triangles(t, height, check_variances(joint.diagonal(), len(tin.vertices)))
    wider = 1.0
    if selected and near.any():
        wider = scatter(tin, height, joint.diagonal(), t[near])
        joint = joint * wider
    return near, joint, wider


def load(slope: F64, area: F64, triangles: I32, n: int) -> F64:
    """Mean derivatives (m, 3) of triangles of areas (m,) m², added up by vertex (n,) m²."""
    return gather((slope * area[:, None])[..., None], triangles, n)[:, 0]


def scatter(tin: Tin, height: F64, variance: F64, near: I32) -> float:
    """By how much the variances (n,) of heights (n,) are too small about triangles near (k, 3)."""
    start, link = edges(tin.triangles, tin.neighbours, len(height))
    rows = np.unique(near).astype(np.int64)
    return scatter_factor(start, link, tin.vertices[:, :2], height, variance, rows)


def check_variances(variance: F64, n: int) -> F64:
    """Variances of n vertices. Raises :class:`VolumeError` where one is missing, negative or no
    number.
    """
    if variance.shape != (n,) or not (np.isfinite(variance) & (variance >= 0)).all():
        raise VolumeError("every vertex needs a variance of 0 or more", reason="volume_variance")
    return variance


def smooth_heights(
    tin: Tin, height: F64, variance: F64, near: I32, rings: int, summed: F64
) -> Smooth:
    """True heights of the vertices of triangles ``near`` (k, 3), as estimated."""
    wanted = np.zeros(len(tin.vertices), bool)
    wanted[near] = True
    return Smooth(tin, height, variance, wanted, rings, summed)


def blocks(
    smooth: Smooth, triangles: I32, packed: F64
) -> Iterator[tuple[slice, tuple[F64, F64, F64]]]:
    """Some triangles at a time, and what :func:`folds` takes of them."""
    deviation = np.sqrt(smooth.variance)
    for i in range(0, len(triangles), BLOCK):
        part = slice(i, i + BLOCK)
        yield part, (smooth.heights[triangles[part]], deviation[triangles[part]], packed[part])


def folds(mu: F64, s: F64, noise: F64, slopes: bool) -> tuple[F64, F64, F64, F64]:
    """Means of the positive part of smoothed heights mu (m, 3) above the base: as they are, with
    the noise, packed (m, 6), with that and the heights' own standard deviations s (m, 3), and with
    these alone; ``slopes`` as for :func:`~ladar_volume.volume.folded_normal.folded_means`.
    """
    plain = positive_parts(mu)
    own = np.stack(
        [s[:, i] * s[:, j] for i, j in PACKED], axis=1
    )  # neighbouring planes share their points: as if fully correlated
    once, twice, plane = (folded_means(mu, C, plain, slopes) for C in (noise, noise + own, own))
    return plain, once, twice, plane


def correction(plain: F64, once: F64, twice: F64, plane: F64) -> F64:
    """What is to be taken (m,), from :func:`folds`, m."""
    out: F64 = np.maximum(2.0 * once[:, 0] - twice[:, 0] + plane[:, 0] - 2.0 * plain[:, 0], 0.0)
    return out


def moments(mu: F64, s: F64, noise: F64) -> F64:
    """Means (m, 13) over triangles, of what :func:`folds` takes: the correction, slopes of the cut
    (3), derivatives of the correction by the smoothed heights (3), curvature (6).
    """
    out, (plain, once, twice, plane) = np.empty((len(mu), 13)), folds(mu, s, noise, slopes=True)
    out[:, 0] = correction(plain, once, twice, plane)
    # how the correction follows the heights through the planes; its kink at zero is smoothed as the
    # planes are
    out[:, 4:7] = 2.0 * once[:, 1:4] - twice[:, 1:4] - plane[:, 1:4]
    out[:, 1:4], out[:, 7:] = once[:, 1:4], once[:, 4:]
    return out


def all_moments(smooth: Smooth, triangles: I32, packed: F64) -> F64:
    """:func:`moments` (m, 13) of triangles (m, 3) with node covariances, packed (m, 6)."""
    found = np.empty((len(triangles), 13))
    for some, at in blocks(smooth, triangles, packed):
        found[some] = moments(*at)
    return found


def near_levels(
    tin: Tin,
    levels_m: F64,
    C: SparseF64,
    base: Plane | None = None,
    mask: Bool | None = None,
    rings: int = 4,
) -> F64:
    """Corrections (k,) m³ of cut and fill at levels (k,), m, in any order; with ``base`` they count
    from it. At each it is that of :func:`near_base`, which see; the true heights are estimated
    once.
    """
    chosen = tin.relevant if mask is None else mask
    t, variance = tin.triangles[chosen], sparse.csr_array(C).diagonal()
    h = height_above(tin.vertices, base)
    order, reach = np.argsort(levels_m, kind="stable"), REACH * np.sqrt(variance)
    level = np.asarray(levels_m, dtype=np.float64)[order]
    low, high = (h - reach)[t].min(axis=1), (h + reach)[t].max(axis=1)
    first = np.searchsorted(level, low)
    count = np.where(
        any_corner(t, reach > 0), np.searchsorted(level, high, side="right") - first, 0
    )
    close, out = np.flatnonzero(count > 0), np.zeros(len(level))
    summed: F64 = np.asarray(sparse.csr_array(C).sum(axis=1), dtype=np.float64).ravel()
    smooth = smooth_heights(tin, h, variance, t[close], rings, summed)
    t, first, count = t[close], first[close], count[close]
    area, packed, s = (
        footprint_areas(tin.vertices, t),
        node_covariances(C, t),
        np.sqrt(smooth.variance)[t],
    )
    for one, at in pairs(first, count):
        taken = correction(
            *folds(smooth.heights[t[one]] - level[at, None], s[one], packed[one], slopes=False)
        )
        out += np.bincount(at, area[one] * taken, len(level))
    back = np.empty_like(out)
    back[order] = out
    return back


def pairs(first: I64, count: I64) -> Iterator[tuple[I64, I64]]:
    """Every triangle (m,) with every level it comes near, ``count`` of them from ``first`` on, some
    at a time: numbers of triangles and of levels.
    """
    ends = np.cumsum(count)
    for i in range(0, int(ends[-1]) if len(ends) else 0, BLOCK):
        pair = np.arange(i, min(i + BLOCK, int(ends[-1])))
        one = np.searchsorted(ends, pair, side="right")
        yield one, first[one] + pair - (ends[one] - count[one])


@kernel
def edge_sums(curvature: F64, triangles: I32, start: I64, link: I64) -> tuple[F64, F64]:
    """Packed curvatures (m, 6) of triangles added up by edge, as ``link`` lists them, and by vertex
    (n,).
    """
    edge, own = np.zeros(len(link)), np.zeros(len(start) - 1)
    for t in range(len(triangles)):
        k = 0
        for a in range(3):
            own[triangles[t, a]] += curvature[t, k]
            k += 1
            for b in range(a + 1, 3):
                for i, j in (
                    (triangles[t, a], triangles[t, b]),
                    (triangles[t, b], triangles[t, a]),
                ):
                    for e in range(start[i], start[i + 1]):
                        if link[e] == j:
                            edge[e] += curvature[t, k]
                            break
                k += 1
    return edge, own


@parallel_kernel
def trace_kernel(
    start: I64, link: I64, edge: F64, own: F64, begin: I64, column: I64, value: F64
) -> F64:
    """Parts (chunks,) of ``tr(HCHC)``: H by edge and by vertex, C in CSR form; both symmetric. Row
    by row: ``Σ_j H_ij (CHC)_ij``.
    """
    n = len(own)
    out = np.zeros(CHUNKS)
    for chunk in numba.prange(CHUNKS):
        row = np.zeros(n)
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            if own[i] == 0.0:
                continue
            for a in range(begin[i], begin[i + 1]):  # row i of CH
                k = column[a]
                row[k] += value[a] * own[k]
                for e in range(start[k], start[k + 1]):
                    row[link[e]] += value[a] * edge[e]
            for a in range(begin[i], begin[i + 1]):
                out[chunk] += own[i] * row[column[a]] * value[a]
            for e in range(start[i], start[i + 1]):
                if edge[e] != 0.0:
                    for a in range(begin[link[e]], begin[link[e] + 1]):
                        out[chunk] += edge[e] * row[column[a]] * value[a]
            for a in range(begin[i], begin[i + 1]):
                k = column[a]
                row[k] = 0.0
                for e in range(start[k], start[k + 1]):
                    row[link[e]] = 0.0
    return out


def second_order(curvature: F64, triangles: I32, start: I64, link: I64, C: SparseF64) -> float:
    """``½ tr(HCHC)`` of packed curvatures (m, 6) summed over triangles, m⁶; start, link : edges of
    the triangulation in CSR form.
    """
    edge, own = edge_sums(curvature, triangles, start, link)
    return 0.5 * float(trace_kernel(start, link, edge, own, *csr(C)).sum())
