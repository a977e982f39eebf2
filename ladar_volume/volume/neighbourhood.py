"""True heights near a base, estimated by planes through the vertices' neighbourhoods (UNCERTAINTY
step 7).

A neighbourhood grows ring by ring, up to a number of rings, as long as the squares of its heights
about its plane are what noise explains (three standard deviations of their sum): it ends where the
ground ends or leaves the level.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numba
import numpy as np
from scipy import sparse

from ladar_volume.math.kernels import kernel, parallel_kernel, run_in_threads
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.full_tin import part_of, places_in
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.median_screen import edges

#: A sparse matrix (n, n) by rows.
SparseF64: TypeAlias = "sparse.csr_array[np.float64, tuple[int, int]]"
#: Pieces of work shared over the cores; the result does not depend on it.
CHUNKS = 16


class Given(NamedTuple):
    """Heights and variances (n,) of vertices, and sums of their covariances."""

    h: F64
    variance: F64
    summed: F64


class Smoothed(NamedTuple):
    """Of some vertices (r,): rings of the neighbourhood, 0 where the height stays; weights (r, 3)
    of its plane; height of the plane there, m, and its variance, m².
    """

    ring: I64
    plane: F64
    level: F64
    spread: F64


class Smooth:
    """Heights of the ``wanted`` (n,) vertices as those of planes through their neighbourhoods, the
    others' as they are.

    start, link : edges of the triangulation in CSR form · heights : (n,) m · variance : (n,) m². h,
    variance : (n,) heights given and their variances · summed : (n,) m², by default the variances:
    sums of each height's covariances, what it brings to the variance of a mean
    """

    def __init__(
        self, tin: Tin, h: F64, variance: F64, wanted: Bool, rings: int, summed: F64 | None = None
    ) -> None:
        self.start, self.link = edges(tin.triangles, tin.neighbours, len(h))
        self._xy, rows = (
            np.ascontiguousarray(tin.vertices[:, :2]),
            np.flatnonzero(wanted).astype(np.int64),
        )
        self._rows = rows[
            hilbert_order(self._xy[rows])
        ]  # neighbours in turn share what the cache holds
        self._ring, self._plane = np.zeros(len(rows), np.int64), np.zeros((len(rows), 3))
        level, spread = np.zeros(len(rows)), np.zeros(len(rows))
        self.heights, self.variance = h.copy(), variance.copy()
        if rings > 0 and len(rows):
            share = variance if summed is None else np.maximum(summed, 0.0)
            run_in_threads(
                smooth_kernel,
                np.arange(CHUNKS),
                self.start,
                self.link,
                self._xy,
                Given(np.ascontiguousarray(h), variance, share),
                self._rows,
                rings,
                Smoothed(self._ring, self._plane, level, spread),
            )
            grown = self._ring > 0
            self.heights[self._rows[grown]], self.variance[self._rows[grown]] = (
                level[grown],
                spread[grown],
            )

    def rings(self) -> I64:
        """Rings (n,) of the neighbourhood of each vertex, 0 where its height stays."""
        out = np.zeros(len(self.heights), np.int64)
        out[self._rows] = self._ring
        return out

    def adjoint(self, gradient: F64) -> F64:
        """From derivatives (n,) by the smoothed heights to those (n,) by the heights given; the
        neighbourhoods are held fixed.
        """
        used = np.flatnonzero((self._ring > 0) & (gradient[self._rows] != 0.0))
        rows = self._rows[used]
        out = gradient.copy()
        out[rows] = 0.0
        parts = adjoint_kernel(
            self.start,
            self.link,
            self._xy,
            rows,
            self._ring[used],
            self._plane[used],
            gradient[rows],
        )
        return np.asarray(out + parts.sum(axis=0))


class Part(NamedTuple):
    """The surface about triangles near the base. tin : a part of it · vertex : (k,) its vertices in
    the whole · close : (c, 3) the triangles, by its own numbers
    """

    tin: Tin
    vertex: I64
    close: I32


@kernel
def grow_kernel(triangles: I32, marked: Bool, rings: int) -> None:
    """Mark the vertices (n,) that are joined to marked ones by so many edges."""
    for _ in range(rings):
        before = marked.copy()
        for t in range(len(triangles)):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            if before[a] or before[b] or before[c]:
                marked[a] = marked[b] = marked[c] = True


def part_around(tin: Tin, close: I32, rings: int) -> Part:
    """The part of a surface in which the neighbourhoods of the triangles (c, 3) lie, so that the
    work near the base does not grow with the rest of the surface.
    """
    marked = np.zeros(len(tin.vertices), np.bool_)
    marked[close] = True
    grow_kernel(tin.triangles, marked, rings + 1)
    vertex = np.flatnonzero(marked)
    if len(vertex) in (0, len(marked)):
        return Part(tin, np.arange(len(marked)), close)
    return Part(part_of(tin, marked), vertex, places_in(vertex, len(marked))[close])


@kernel
def grow(
    start: I64, link: I64, member: I64, begin: int, count: int, mark: I32, stamp: int
) -> tuple[I64, int]:
    """Add the vertices an edge away from members begin..count; returns the members, which may have
    moved to a longer array, and how many they are.
    """
    end = count
    for i in range(begin, count):
        v = member[i]
        if end + start[v + 1] - start[v] > len(member):
            longer = np.empty(2 * (end + start[v + 1] - start[v]), np.int64)
            longer[:end] = member[:end]
            member = longer
        for j in range(start[v], start[v + 1]):
            if mark[link[j]] != stamp:
                mark[link[j]] = stamp
                member[end] = link[j]
                end += 1
    return member, end


@kernel
def add_moments(xy: F64, h: F64, share: F64, member: I64, begin: int, count: int, m: F64) -> None:
    """Adds members begin..count to the moments m (15,) about the first of them: of 1, x, y, x², xy,
    y², then h, hx, hy, and those six weighted with ``share``.
    """
    o = member[0]
    for i in range(begin, count):
        v = member[i]
        x, y, s = xy[v, 0] - xy[o, 0], xy[v, 1] - xy[o, 1], share[v]
        m[0] += 1.0
        m[1] += x
        m[2] += y
        m[3] += x * x
        m[4] += x * y
        m[5] += y * y
        m[6] += h[v]
        m[7] += h[v] * x
        m[8] += h[v] * y
        m[9] += s
        m[10] += s * x
        m[11] += s * y
        m[12] += s * x * x
        m[13] += s * x * y
        m[14] += s * y * y


@kernel
def plane_weights(m: F64, plane: F64) -> None:
    """The weights ``a + b x + c y`` (plane: a, b, c) with which heights at (x, y) give the height
    of their plane at the origin, from their moments; the same for all, which gives the mean, where
    they lie on a line.
    """
    cx, cy = m[1] / m[0], m[2] / m[0]
    sxx, sxy, syy = m[3] - cx * m[1], m[4] - cx * m[2], m[5] - cy * m[2]
    det = sxx * syy - sxy * sxy
    plane[0], plane[1], plane[2] = 1.0 / m[0], 0.0, 0.0
    if det > 1e-9 * (sxx + syy) ** 2:
        plane[1], plane[2] = (sxy * cy - syy * cx) / det, (sxy * cx - sxx * cy) / det
        plane[0] -= plane[1] * cx + plane[2] * cy


@kernel
def smooth_kernel(
    chunks: I64, start: I64, link: I64, xy: F64, given: Given, rows: I64, rings: int, out: Smoothed
) -> None:
    """Of vertices ``rows`` (r,), those of ``chunks`` of :data:`CHUNKS`, to ``out``."""
    h, variance, share = given
    ring, planes, level, spread = out
    r, n = len(rows), len(h)
    for chunk in chunks:
        mark, member, m, p = (
            np.full(n, -1, np.int32),
            np.empty(256, np.int64),
            np.empty(15),
            np.empty(3),
        )
        for i in range(chunk * r // CHUNKS, (chunk + 1) * r // CHUNKS):
            member[0], mark[rows[i]] = rows[i], i
            begin, count = 0, 1
            m[:] = 0.0
            add_moments(xy, h, share, member, 0, 1, m)
            for k in range(rings):
                member, more = grow(start, link, member, begin, count, mark, i)
                begin, count = count, more
                add_moments(xy, h, share, member, begin, count, m)
                plane_weights(m, p)
                z = p[0] * m[6] + p[1] * m[7] + p[2] * m[8]
                square, most = 0.0, count + 3.0 * np.sqrt(2.0 * count)
                for j in range(count):
                    d = h[member[j]] - z
                    square += d * d / max(variance[member[j]], 1e-300)
                if square > most:
                    break
                ring[i], level[i], planes[i] = k + 1, z, p
                spread[i] = p[0] * (p[0] * m[9] + 2.0 * (p[1] * m[10] + p[2] * m[11]))
                spread[i] += p[1] * (p[1] * m[12] + 2.0 * p[2] * m[13]) + p[2] * p[2] * m[14]
            spread[i] = max(spread[i], 0.0)


@parallel_kernel
def adjoint_kernel(
    start: I64, link: I64, xy: F64, rows: I64, ring: I64, planes: F64, gradient: F64
) -> F64:
    """Derivatives (chunks, n), to be summed, by the heights from those (r,) by the heights of
    planes with weights ``planes`` (r, 3) over neighbourhoods of ``ring`` (r,) rings about rows
    (r,).
    """
    r, n, chunks = len(rows), len(xy), CHUNKS // 2
    out = np.zeros((chunks, n))
    for chunk in numba.prange(chunks):
        mark, member = np.full(n, -1, np.int32), np.empty(256, np.int64)
        for i in range(chunk * r // chunks, (chunk + 1) * r // chunks):
            o, g = rows[i], gradient[i]
            member[0], mark[o] = o, i
            begin, count = 0, 1
            for _ in range(ring[i]):
                member, more = grow(start, link, member, begin, count, mark, i)
                begin, count = count, more
            for j in range(count):
                v = member[j]
                weight = (
                    planes[i, 0]
                    + planes[i, 1] * (xy[v, 0] - xy[o, 0])
                    + planes[i, 2] * (xy[v, 1] - xy[o, 1])
                )
                out[chunk, v] += g * weight
    return out
