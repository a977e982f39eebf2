"""True heights near a base, estimated by planes through the vertices' neighbourhoods (UNCERTAINTY step 7).

A neighbourhood grows ring by ring, up to a number of rings, as long as the squares of its heights about its plane are what noise explains
(three standard deviations of their sum): it ends where the ground ends or leaves the level.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from scipy import sparse

from ladar_volume.model.kernels import kernel, parallel_kernel
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.surface.screen import edges

#: Pieces of work shared over the cores; the result does not depend on it.
CHUNKS = 16


class Smooth:
    """Heights of the ``wanted`` (n,) vertices as those of planes through their neighbourhoods, the others' as they are.

    heights : (n,) m · variance : (n,) m², for independent variances (n,) of the heights h (n,) given
    """

    def __init__(self, tin: Tin, h: F64, variance: F64, wanted: Bool, rings: int) -> None:
        self._start, self._link = edges(tin.triangles, tin.neighbours, len(h))
        self._xy, self._rows = np.ascontiguousarray(tin.vertices[:, :2]), np.flatnonzero(wanted).astype(np.int64)
        self._ring = np.zeros(len(self._rows), np.int64)
        self.heights, self.variance = h.copy(), variance.copy()
        if rings > 0 and len(self._rows):
            self._ring, level, spread = smooth_kernel(self._start, self._link, self._xy, h, variance, self._rows, rings)
            grown = self._ring > 0
            self.heights[self._rows[grown]], self.variance[self._rows[grown]] = level[grown], spread[grown]

    def adjoint(self, gradient: F64) -> F64:
        """From derivatives (n,) by the smoothed heights to those (n,) by the heights given; the neighbourhoods are held fixed."""
        return np.asarray(adjoint_kernel(self._start, self._link, self._xy, self._rows, self._ring, gradient))


@kernel
def grow(start: I64, link: I64, member: I32, begin: int, count: int, mark: I32, stamp: int) -> int:
    """Add the vertices an edge away from members begin..count; returns the new count."""
    end = count
    for i in range(begin, count):
        for j in range(start[member[i]], start[member[i] + 1]):
            v = link[j]
            if mark[v] != stamp:
                mark[v] = stamp
                member[end] = v
                end += 1
    return end


@kernel
def plane_weights(xy: F64, member: I32, count: int, weight: F64) -> None:
    """Weights (count,) with which the heights of the members give the height of their plane at the first of them; their mean where they lie
    on a line."""
    o = member[0]
    cx = cy = sxx = sxy = syy = 0.0
    for i in range(count):
        cx += xy[member[i], 0] - xy[o, 0]
        cy += xy[member[i], 1] - xy[o, 1]
    cx /= count
    cy /= count
    for i in range(count):
        x, y = xy[member[i], 0] - xy[o, 0] - cx, xy[member[i], 1] - xy[o, 1] - cy
        sxx += x * x
        sxy += x * y
        syy += y * y
    det = sxx * syy - sxy * sxy
    px = py = 0.0
    if det > 1e-9 * (sxx + syy) ** 2:
        px, py = (sxy * cy - syy * cx) / det, (sxy * cx - sxx * cy) / det
    for i in range(count):
        x, y = xy[member[i], 0] - xy[o, 0] - cx, xy[member[i], 1] - xy[o, 1] - cy
        weight[i] = 1.0 / count + px * x + py * y


@parallel_kernel
def smooth_kernel(start: I64, link: I64, xy: F64, h: F64, variance: F64, rows: I64, rings: int) -> tuple[I64, F64, F64]:
    """For vertices rows (r,): how many rings their neighbourhood has, and the height of its plane there and its variance."""
    r, n = len(rows), len(h)
    ring, level, spread = np.zeros(r, np.int64), np.zeros(r), np.zeros(r)
    for chunk in numba.prange(CHUNKS):
        mark, member, weight = np.full(n, -1, np.int32), np.empty(n, np.int32), np.empty(n)
        for i in range(chunk * r // CHUNKS, (chunk + 1) * r // CHUNKS):
            member[0], mark[rows[i]] = rows[i], i
            begin, count = 0, 1
            for k in range(rings):
                more = grow(start, link, member, begin, count, mark, i)
                begin, count = count, more
                plane_weights(xy, member, count, weight)
                z = square = s2 = 0.0
                for j in range(count):
                    z += weight[j] * h[member[j]]
                    s2 += weight[j] * weight[j] * variance[member[j]]
                for j in range(count):
                    d = h[member[j]] - z
                    square += d * d / max(variance[member[j]], 1e-300)
                if square > count + 3.0 * np.sqrt(2.0 * count):
                    break
                ring[i], level[i], spread[i] = k + 1, z, s2
    return ring, level, spread


@kernel
def adjoint_kernel(start: I64, link: I64, xy: F64, rows: I64, ring: I64, gradient: F64) -> F64:
    """Derivatives (n,) by the heights from those by the smoothed heights, for neighbourhoods of ``ring`` (r,) rings about rows (r,)."""
    n = len(gradient)
    out = gradient.copy()
    mark, member, weight = np.full(n, -1, np.int32), np.empty(n, np.int32), np.empty(n)
    for i in range(len(rows)):
        g = gradient[rows[i]]
        if ring[i] == 0 or g == 0.0:
            continue
        member[0], mark[rows[i]] = rows[i], i
        begin, count = 0, 1
        for _ in range(ring[i]):
            more = grow(start, link, member, begin, count, mark, i)
            begin, count = count, more
        plane_weights(xy, member, count, weight)
        out[rows[i]] -= g
        for j in range(count):
            out[member[j]] += g * weight[j]
    return out


def neighbourhoods(tin: Tin) -> Any:
    """Sparse (n, n): 1 for each vertex and those an edge away."""
    n, t = len(tin.vertices), tin.triangles
    pairs = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    links = sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    near = sparse.csr_array(links + links.T + sparse.eye_array(n))
    near.data[:] = 1.0
    return near


def plane_rows(member: Any, rows: I64, xy: F64) -> Any:
    """Weights (r, n), sparse, with which the heights of a vertex' neighbourhood, ``member`` (r, n), give the plane's height at it."""
    x, y = xy.T
    sums = member @ np.c_[np.ones(len(x)), x, y, x * x, x * y, y * y]
    n, cx, cy = sums[:, 0], sums[:, 1] / sums[:, 0], sums[:, 2] / sums[:, 0]
    sxx, sxy, syy = sums[:, 3] - cx * sums[:, 1], sums[:, 4] - cx * sums[:, 2], sums[:, 5] - cy * sums[:, 2]
    det, dx, dy = sxx * syy - sxy * sxy, x[rows] - cx, y[rows] - cy
    good = det > 1e-9 * (sxx + syy) ** 2
    det = np.where(good, det, 1.0)
    px, py = np.where(good, (syy * dx - sxy * dy) / det, 0.0), np.where(good, (sxx * dy - sxy * dx) / det, 0.0)
    S, own = member.copy(), np.repeat(np.arange(len(rows)), np.diff(member.indptr))
    S.data = (1.0 / n - px * cx - py * cy)[own] + px[own] * x[S.indices] + py[own] * y[S.indices]
    return S


def smoother(tin: Tin, h: F64, variance: F64, wanted: Bool, rings: int) -> Any:
    """The plain twin of :class:`Smooth`, sparse (n, n): smoothed heights are ``S h``, the adjoint is ``Sᵀ``."""
    rows, near = np.flatnonzero(wanted).astype(np.int64), neighbourhoods(tin)
    xy = tin.vertices[:, :2] - tin.vertices[:, :2].mean(axis=0)
    S, member, alive = sparse.eye_array(len(h), format="csr"), sparse.eye_array(len(h), format="csr")[rows], np.ones(len(rows), bool)
    for _ in range(rings if len(rows) else 0):
        member = sparse.csr_array(member @ near)
        member.data[:] = 1.0
        new = plane_rows(member, rows, xy)
        level = new @ h
        own, count = np.repeat(np.arange(len(rows)), np.diff(member.indptr)), np.diff(member.indptr)
        square = np.bincount(own, (h[member.indices] - level[own]) ** 2 / np.maximum(variance[member.indices], 1e-300), len(rows))
        alive &= square <= count + 3.0 * np.sqrt(2.0 * count)
        keep = np.ones(len(h))
        keep[rows[alive]] = 0.0
        lift = sparse.csr_array((np.ones(alive.sum()), (rows[alive], np.flatnonzero(alive))), shape=(len(h), len(rows)))
        S = sparse.csr_array(sparse.diags_array(keep) @ S + lift @ new)
    return S
