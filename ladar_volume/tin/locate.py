"""Where points lie in a triangulated surface: a box tree over the triangles' footprints.

Unlike a walk from neighbour to neighbour the tree needs neither a convex hull nor a Delaunay
triangulation, so it also serves surfaces whose diagonals were exchanged, surfaces with holes, and
the overlay of two surfaces. Triangles are ordered along a Z-curve and grouped by fours; a complete
binary tree of boxes stands above the groups.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from scipy import sparse

from ladar_volume.math.box_tree import join_boxes
from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.math.space_curve import radix_order
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.predicates import WORKSPACE, orientation, workspace

LEAF = 4
#: Steps of the curve's grid per axis, as a power of two.
CURVE_BITS = 20
#: Parts that are worked on independently; fixed, so that results do not depend on the number of
#: threads.
CHUNKS = 32


@dataclass(frozen=True)
class TriangleIndex:
    """order : (m,) int64 triangle numbers along the curve · corners : (m, 3, 2) m, their footprints
    in that order, counter-clockwise · boxes : (2 k, 4) low x, low y, high x, high y; node i has
    children 2 i and 2 i + 1, leaves are k to 2 k − 1
    """

    order: I64
    corners: F64
    boxes: F64


class Walked(NamedTuple):
    """vertices (n, 3) m, triangles (m, 3) and neighbours (m, 3) of a Delaunay triangulation."""

    vertices: F64
    triangles: I32
    neighbours: I32


@kernel
def curve_keys(centres: F64) -> I64:
    """Position of points (m, 2) along a Z-curve over their bounding box: (m,), :data:`CURVE_BITS`
    bits per axis, int64.
    """
    m = len(centres)
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(m):
        for c in range(2):
            low[c], high[c] = min(low[c], centres[i, c]), max(high[c], centres[i, c])
    size = max(high[0] - low[0], high[1] - low[1])
    scale = (2.0**CURVE_BITS - 1.0) / size if size > 0.0 else 0.0
    out = np.empty(m, np.int64)
    for i in range(m):
        key = 0
        for c in range(2):
            v = int((centres[i, c] - low[c]) * scale)
            v = (v | (v << 16)) & 0x0000FFFF0000FFFF
            v = (v | (v << 8)) & 0x00FF00FF00FF00FF
            v = (v | (v << 4)) & 0x0F0F0F0F0F0F0F0F
            v = (v | (v << 2)) & 0x3333333333333333
            v = (v | (v << 1)) & 0x5555555555555555
            key |= v << c
        out[i] = key
    return out


@kernel
def centres_of(vertices: F64, triangles: I32, chosen: I64) -> F64:
    """Centres (m, 2) of the footprints of triangles ``chosen`` (m,)."""
    out = np.empty((len(chosen), 2))
    for i in range(len(chosen)):
        a, b, c = triangles[chosen[i], 0], triangles[chosen[i], 1], triangles[chosen[i], 2]
        for k in range(2):
            out[i, k] = (vertices[a, k] + vertices[b, k] + vertices[c, k]) / 3.0
    return out


@kernel
def corners_of(vertices: F64, triangles: I32, chosen: I64) -> F64:
    """Corners (m, 3, 2) of the footprints of triangles ``chosen`` (m,)."""
    out = np.empty((len(chosen), 3, 2))
    for i in range(len(chosen)):
        for k in range(3):
            v = triangles[chosen[i], k]
            out[i, k, 0], out[i, k, 1] = vertices[v, 0], vertices[v, 1]
    return out


@kernel
def build_boxes(corners: F64, leaves: int) -> F64:
    """Boxes (2 leaves, 4) of the complete tree over triangles (m, 3, 2) in order."""
    boxes = np.empty((2 * leaves, 4))
    boxes[:, :2], boxes[:, 2:] = np.inf, -np.inf
    for t in range(len(corners)):
        node = leaves + t // LEAF
        for k in range(3):
            for c in range(2):
                boxes[node, c] = min(boxes[node, c], corners[t, k, c])
                boxes[node, 2 + c] = max(boxes[node, 2 + c], corners[t, k, c])
    join_boxes(boxes)
    return boxes


def triangle_index(tin: Tin, mask: Bool | None = None) -> TriangleIndex:
    """Index of the triangles in ``mask`` (m,) (default: all) of a surface. Raises
    :class:`SurfaceError` where there is none.
    """
    chosen = (
        np.arange(len(tin.triangles), dtype=np.int64)
        if mask is None
        else np.flatnonzero(mask).astype(np.int64)
    )
    if len(chosen) == 0:
        raise SurfaceError("there is no triangle to look in", reason="surface_no_relevant")
    keys = curve_keys(centres_of(tin.vertices, tin.triangles, chosen))
    order = chosen[radix_order(keys.view(np.uint64), 2 * CURVE_BITS)]
    corners = corners_of(tin.vertices, tin.triangles, order)
    leaves = 1
    while leaves * LEAF < len(corners):
        leaves *= 2
    return TriangleIndex(order, corners, build_boxes(corners, leaves))


@kernel
def search_boxes(boxes: F64, count: int, box: F64, stack: I64, found: I64) -> int:
    """Positions of the triangles in leaves whose box meets ``box`` (4,) into ``found``; returns how
    many there are, which may exceed the length of ``found``: the rest is then not written.
    """
    leaves = len(boxes) // 2
    stack[0], top, n = 1, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        b = boxes[node]
        if b[0] > box[2] or b[1] > box[3] or b[2] < box[0] or b[3] < box[1]:
            continue
        if node < leaves:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node
            top += 2
            continue
        for t in range((node - leaves) * LEAF, min((node - leaves + 1) * LEAF, count)):
            if n < len(found):
                found[n] = t
            n += 1
    return n


@parallel_kernel
def locate_kernel(order: I64, corners: F64, boxes: F64, xy: F64) -> I64:
    """Triangle (n,) that holds each point (n, 2), edges included and the lowest number where
    several do; −1 outside.
    """
    n, m = len(xy), len(corners)
    out = np.full(n, -1, np.int64)
    for chunk in numba.prange(CHUNKS):
        w = np.zeros(WORKSPACE)  # the scratch rows of the exact predicates
        stack, found, box = np.empty(128, np.int64), np.empty(64, np.int64), np.empty(4)
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            x, y = xy[i, 0], xy[i, 1]
            box[0], box[1], box[2], box[3] = x, y, x, y
            count = search_boxes(boxes, m, box, stack, found)
            if count > len(found):
                found = np.empty(2 * count, np.int64)
                count = search_boxes(boxes, m, box, stack, found)
            best = -1
            for j in range(count):
                p, number = corners[found[j]], order[found[j]]
                inside = best < 0 or number < best
                for k in range(3):
                    a, b = (k + 1) % 3, (k + 2) % 3
                    at_corner = (x == p[a, 0] and y == p[a, 1]) or (
                        x == p[b, 0] and y == p[b, 1]
                    )  # zero, without the exact stage
                    inside = inside and (
                        at_corner or orientation(p[a, 0], p[a, 1], p[b, 0], p[b, 1], x, y, w) >= 0.0
                    )
                if inside:
                    best = number
            out[i] = best
    return out


def locate_plain(index: TriangleIndex, xy: F64) -> I64:
    """The plain twin of :func:`locate`: every triangle is asked about every point."""
    w = workspace()
    out = np.full(len(xy), -1, np.int64)
    for i, (x, y) in enumerate(xy):
        holds = [
            int(number)
            for number, p in zip(index.order, index.corners, strict=True)
            if all(
                orientation(p[k - 2, 0], p[k - 2, 1], p[k - 1, 0], p[k - 1, 1], x, y, w) >= 0.0
                for k in range(3)
            )
        ]
        out[i] = min(holds, default=-1)
    return out


def locate(index: TriangleIndex, xy: F64) -> I64:
    """Triangle (n,) of each point xy (n, 2), m, map frame; −1 where no triangle holds it. Decided
    exactly: in a surface without gaps no point falls between two triangles. Points near one another
    in the array are found faster.
    """
    return np.asarray(
        locate_kernel(
            index.order, index.corners, index.boxes, np.ascontiguousarray(xy, dtype=np.float64)
        )
    )


@kernel
def walk_part(tin: Walked, xy: F64, order: I32, out: I64) -> None:
    """The triangle of each place (n, 2) in a Delaunay triangulation, by a walk from that of the one
    before in ``order`` (k,); -1 outside, -2 where the place lies on a side.
    """
    w, t = np.zeros(WORKSPACE), 0  # the scratch rows of the exact predicates
    for i in order:
        x, y = xy[i, 0], xy[i, 1]
        found, steps = -3, 0
        while found == -3:
            found, steps = t, steps + 1
            for k in range(3):
                a, b = tin.triangles[t, (k + 1) % 3], tin.triangles[t, (k + 2) % 3]
                p, q = tin.vertices[a], tin.vertices[b]
                side = orientation(p[0], p[1], q[0], q[1], x, y, w)
                if side < 0.0:
                    found = -1 if tin.neighbours[t, k] < 0 else -3
                    t = max(tin.neighbours[t, k], 0) if found == -3 else t
                    break
                if side == 0.0:
                    found = -2
            if steps > len(tin.triangles):  # of no Delaunay triangulation: ask every triangle
                found = -2
        out[i] = found


@parallel_kernel
def walk_kernel(tin: Walked, xy: F64, order: I32, out: I64) -> None:
    """See :func:`walk_part`; parts of the order are walked independently."""
    n = len(order)
    for chunk in numba.prange(CHUNKS):
        walk_part(tin, xy, order[chunk * n // CHUNKS : (chunk + 1) * n // CHUNKS], out)


def locate_in_delaunay(tin: Tin, xy: F64) -> I64:
    """:func:`locate` among all triangles of a Delaunay triangulation of some points, by walks from
    place to place: faster, and without an index where no place lies on a side.
    """
    places, out = np.ascontiguousarray(xy, dtype=np.float64), np.empty(len(xy), np.int64)
    walked = Walked(tin.vertices, tin.triangles, tin.neighbours)
    walk_kernel(walked, places, hilbert_order(places), out)
    on_side = np.flatnonzero(out == -2)
    if len(on_side):
        out[on_side] = locate(triangle_index(tin), places[on_side])
    return out


@kernel
def barycentric_kernel(vertices: F64, triangles: I32, where: I64, xy: F64) -> F64:
    """See :func:`barycentric`."""
    out = np.empty((len(xy), 3))
    to = np.empty((3, 2))
    for i in range(len(xy)):
        if where[i] < 0:
            out[i] = np.nan
            continue
        for k in range(3):
            for c in range(2):
                to[k, c] = vertices[triangles[where[i], k], c] - xy[i, c]
        total = 0.0
        for k in range(3):
            u, v = to[(k + 1) % 3], to[(k + 2) % 3]
            out[i, k] = u[0] * v[1] - u[1] * v[0]
            total += out[i, k]
        if total > 0.0:
            out[i] /= total
            continue
        nearest = 0
        for k in range(1, 3):
            if (to[k] ** 2).sum() < (to[nearest] ** 2).sum():
                nearest = k
        out[i] = 0.0
        out[i, nearest] = 1.0
    return out


def barycentric(tin: Tin, triangle: I64, xy: F64) -> F64:
    """Barycentric coordinates (n, 3) of points xy (n, 2) in their triangles (n,); rows of NaN for
    triangle −1. In a sliver whose area rounds to nothing the nearest corner has all the weight.
    """
    places = np.ascontiguousarray(xy, dtype=np.float64)
    return np.asarray(barycentric_kernel(tin.vertices, tin.triangles, triangle, places))


class InterpolatedHeights(NamedTuple):
    """Heights between vertices. height_m, sigma_m : (n,), NaN outside the relevant triangles, the
    latter also where the noise is not known · triangle : (n,), −1 outside
    """

    height_m: F64
    sigma_m: F64
    triangle: I64


def interpolate_heights(
    tin: Tin,
    xy: F64,
    covariance: sparse.csr_array | None = None,
    index: TriangleIndex | None = None,
) -> InterpolatedHeights:
    """Heights ``λ·z`` of a surface at places xy (n, 2), m, in its relevant triangles (or in those
    of ``index``), with variance ``λᵀ C λ``: λ the barycentric coordinates, C the covariance of the
    three vertices.

    covariance : (v, v) m² of the vertex heights, at least the diagonal and the pairs joined by an
    edge; None where it is not known. For independent vertices of one variance the variance is from
    a third of it, at the centroid, to all of it, at a vertex; the published factor is the mean over
    a triangle, a half (seed 004 equation 4, Zhu et al. 2005). What lies between the vertices, as
    roughness, is not in it.
    """
    where = locate(triangle_index(tin, tin.relevant) if index is None else index, xy)
    weight, corner = barycentric(tin, where, xy), tin.triangles[where]
    height = (weight * tin.vertices[:, 2][corner]).sum(axis=1)
    variance = np.full(len(where), np.nan)
    if covariance is not None:
        variance = np.zeros(len(where))
        for a in range(3):
            for b in range(3):
                common = np.asarray(covariance[corner[:, a], corner[:, b]]).ravel()
                variance += weight[:, a] * weight[:, b] * common
    return InterpolatedHeights(height, np.sqrt(np.maximum(variance, 0.0)), where)


def height_at(tin: Tin, xy: F64, index: TriangleIndex | None = None) -> F64:
    """Height (n,) m of a surface at points xy (n, 2); NaN outside its relevant triangles (or
    outside ``index``).
    """
    return interpolate_heights(tin, xy, index=index).height_m
