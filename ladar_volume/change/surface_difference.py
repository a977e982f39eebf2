"""The difference of two surfaces as one surface, for what needs its noise at every point: the
correction near the base.

The finer surface carries it: its vertices, where both surfaces are, get the difference of heights,
the other one interpolated there. The volumes themselves come from the exact overlay; only the noise
that folds into cut and fill is taken from here.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numba
import numpy as np
from scipy.sparse import csr_array

from ladar_volume.math.kernels import kernel, parallel_kernel, signed
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.full_tin import any_corner, footprint_areas
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.locate import TriangleIndex, barycentric, locate, triangle_index
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.near_base import Csr, csr
from ladar_volume.volume.neighbourhood import CHUNKS


@dataclass(frozen=True)
class Difference:
    """tin : upper minus lower, m, over the finer surface; relevant are its triangles whose corners
    lie on both · upper_carries : whether that is the upper one · corner, weight : (n, 3) vertices
    of the other surface and their shares in its height at each vertex; shares of zero where it is
    not
    """

    tin: Tin
    upper_carries: bool
    corner: I32
    weight: F64

    def common(self) -> Tin:
        """The difference over the common footprint alone: vertices that are not on both surfaces,
        whose heights are no differences, are joined to nothing.
        """
        number = np.full(len(self.tin.triangles) + 1, -1, np.int32)  # the last stands for the hull
        number[:-1][self.tin.relevant] = np.arange(np.count_nonzero(self.tin.relevant))
        return dataclasses.replace(
            self.tin,
            triangles=self.tin.triangles[self.tin.relevant],
            neighbours=number[self.tin.neighbours[self.tin.relevant]],
            relevant=np.ones(np.count_nonzero(self.tin.relevant), bool),
        )

    def covariance(self, C_own: csr_array, other: Tin, C_other: csr_array) -> csr_array:
        """Covariance (n, n), sparse, m², of the differences from those of the carrying surface's
        heights and of the other's: the variances and the pairs joined by an edge.

        To interpolate what is interpolated already takes noise away: the other surface's part is
        scaled to its own mean variance.
        """
        n = len(self.tin.vertices)
        start, link = edges(self.tin.triangles, self.tin.neighbours, n)
        begin, column = with_diagonal(start, link)
        own, taken = difference_kernel(
            begin, column, csr(C_own), csr(C_other), self.corner, self.weight
        )
        size = mean_variance(self.tin, csr_array((taken, column, begin), shape=(n, n)))
        scale = mean_variance(other, C_other) / size if size > 0.0 else 1.0
        return csr_array((own + scale * taken, column, begin), shape=(n, n))

    def shares(self, cut: F64, net: F64, other: int) -> tuple[F64, F64]:
        """What part of each vertex' derivative of the net volume that of the cut is, for the
        carrying surface (n,) and the other (other,), from derivatives (n,) of cut and net by the
        differences; NaN where these say nothing.
        """
        at, by_other = self.corner.ravel(), []
        for g in (cut, net):
            by_other.append(np.bincount(at, (self.weight * g[:, None]).ravel(), other))
        out = []
        for top, bottom in ((cut, net), by_other):
            share = np.full(len(top), np.nan)
            np.divide(top, bottom, out=share, where=bottom > 0.0)
            out.append(share)
        return out[0], out[1]


@kernel
def with_diagonal(start: I64, link: I64) -> tuple[I64, I64]:
    """CSR form of edges together with the vertices themselves, which come first in their rows."""
    n = len(start) - 1
    begin, column = np.empty(n + 1, np.int64), np.empty(n + len(link), np.int64)
    for i in range(n + 1):
        begin[i] = start[i] + i
    for i in range(n):
        column[begin[i]] = i
        column[begin[i] + 1 : begin[i + 1]] = link[start[i] : start[i + 1]]
    return begin, column


@kernel
def entry(start: I64, column: I64, value: F64, i: int, j: int) -> float:
    """Entry of a sparse matrix in CSR form."""
    total = 0.0
    for e in range(start[i], start[i + 1]):
        if column[e] == j:
            total += value[e]
    return total


@parallel_kernel
def difference_kernel(
    begin: I64,
    column: I64,
    carrier: Csr,
    other: Csr,
    corner: I32,
    weight: F64,
) -> tuple[F64, F64]:
    """Covariances at the entries of a pattern (begin, column): of the carrying surface's heights,
    and of the other's interpolated ones.
    """
    own_start, own_column, own_value = carrier.start, carrier.column, carrier.value
    start, other_column, value = other.start, other.column, other.value
    own, taken = np.zeros(len(column)), np.zeros(len(column))
    for i in numba.prange(len(begin) - 1):
        for e in range(begin[i], begin[i + 1]):
            j = column[e]
            own[e] = entry(own_start, own_column, own_value, signed(i), j)
            for a in range(3):
                for b in range(3):
                    w = weight[i, a] * weight[j, b]
                    if w != 0.0:
                        taken[e] += w * entry(
                            start, other_column, value, corner[i, a], corner[j, b]
                        )
    return own, taken


@parallel_kernel
def variance_kernel(
    vertices: F64, triangles: I32, relevant: Bool, start: I64, column: I64, value: F64
) -> F64:
    """Parts (chunks, 2): ``A (tr C + 1ᵀC1) / 12`` and the area A, of relevant triangles."""
    m, out = len(triangles), np.zeros((CHUNKS, 2))
    for chunk in numba.prange(CHUNKS):
        for t in range(chunk * m // CHUNKS, (chunk + 1) * m // CHUNKS):
            if not relevant[t]:
                continue
            a, b, c = triangles[t]
            ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
            vx, vy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
            total = 0.0
            for i in (a, b, c):
                total += entry(start, column, value, i, i)
            for i, j in ((a, b), (b, c), (c, a)):
                total += entry(start, column, value, i, j)
            area = 0.5 * (ux * vy - uy * vx)
            out[chunk, 0] += area * total / 6.0
            out[chunk, 1] += area
    return out


def mean_variance(tin: Tin, C: csr_array) -> float:
    """Mean over the relevant area of the variance, m², of the interpolated height, for a sparse
    covariance (n, n) of the vertex heights: ``(tr C + 1ᵀC1) / 12`` in each triangle.
    """
    total, area = variance_kernel(tin.vertices, tin.triangles, tin.relevant, *csr(C)).sum(axis=0)
    return float(total / area)


def interpolation(tin: Tin, xy: F64, index: TriangleIndex | None = None) -> tuple[I32, F64, Bool]:
    """Corners and shares (n, 3) that make a surface's heights at points xy (n, 2), zero where it is
    not, and where it is (n,). index : of its relevant triangles, where known
    """
    order, where = hilbert_order(xy), np.empty(len(xy), np.int64)
    known = triangle_index(tin, tin.relevant) if index is None else index
    where[order] = locate(known, xy[order])  # neighbours in turn are found faster
    there = where >= 0
    corner, weight = np.zeros((len(xy), 3), np.int32), np.zeros((len(xy), 3))
    corner[there], weight[there] = (
        tin.triangles[where[there]],
        barycentric(tin, where[there], xy[there]),
    )
    return corner, weight, there


def along_curve(tin: Tin) -> tuple[Tin, I64]:
    """The same surface with its vertices numbered along a Hilbert curve, and its triangles by them;
    and the old numbers (n,) of its vertices. What lies together then stands together in memory,
    whatever the order of the cloud.
    """
    order, m = hilbert_order(tin.vertices[:, :2]).astype(np.int64), len(tin.triangles)
    place, number = np.empty(len(order), np.int32), np.full(m + 1, -1, np.int32)
    place[order] = np.arange(len(order))
    t = place[tin.triangles]
    first = np.argsort(np.minimum(np.minimum(t[:, 0], t[:, 1]), t[:, 2]), kind="stable")
    number[first] = np.arange(m)  # the last entry stays -1, for the hull
    return Tin(
        tin.vertices[order],
        t[first],
        number[tin.neighbours[first]],
        tin.relevant[first],
        tin.source[order],
        tin.duplicates,
    ), order


def fineness(tin: Tin) -> float:
    """Relevant triangles per area, 1/m²."""
    return float(
        np.count_nonzero(tin.relevant)
        / max(footprint_areas(tin.vertices, tin.triangles[tin.relevant]).sum(), 1e-300)
    )


def difference(upper: Tin, lower: Tin) -> Difference:
    """The difference of two surfaces. Raises :class:`VolumeError` where the two have no area in
    common.
    """
    carries = fineness(upper) >= fineness(lower)
    own, other, sign = (upper, lower, 1.0) if carries else (lower, upper, -1.0)
    corner, weight, there = interpolation(other, own.vertices[:, :2])
    z = sign * (own.vertices[:, 2] - (weight * other.vertices[corner, 2]).sum(axis=1))
    relevant: Bool = own.relevant & ~any_corner(own.triangles, ~there)
    if not relevant.any():
        raise VolumeError(
            "the two surfaces have no area in common", reason="volume_no_common_footprint"
        )
    return Difference(
        dataclasses.replace(own, vertices=np.c_[own.vertices[:, :2], z], relevant=relevant),
        carries,
        corner,
        weight,
    )
