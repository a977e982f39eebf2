"""Triangulation adjustment (seed 000 section 3.3): diagonals are exchanged where the surface then
follows the points better.

Wherever two relevant triangles form a strictly convex quadrangle, the other diagonal is tried; the
measure of fit is the sum of sizes (ASD) or of squares (RMS) of the vertical residuals of the points
within the quadrangle. The exchange with the biggest improvement comes first, then its surroundings
are looked at anew. Every exchange lowers the sum over all points, so it ends; the result is in
general no Delaunay triangulation.
"""

from __future__ import annotations

import dataclasses
import heapq
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.choices import MEASURES
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.tin.delaunay import finite_points
from ladar_volume.tin.elevation_adjustment import measures
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.predicates import workspace
from ladar_volume.tin.triangle_table import orientation_of

#: An exchange has to lower the sum over all points by this share at least: below it rounding could
#: turn it back and forth.
LEAST_GAIN = 1e-13


@dataclass(frozen=True)
class Exchange:
    """tin : the surface with exchanged diagonals, same vertices · exchanges : how many · rms_m,
    asd_m : measures of fit on all points in relevant triangles afterwards · rms_before_m,
    asd_before_m : before
    """

    tin: Tin
    exchanges: int
    rms_m: float
    asd_m: float
    rms_before_m: float
    asd_before_m: float


class ListedSurface(NamedTuple):
    """A surface with its points in lists by triangle. vertices : (n, 3) m · points : (k, 3) m ·
    tri, nb : (m, 3) vertices and neighbours of the triangles · relevant : (m,) · first : (m,) first
    point of each triangle · after : (k,) the one after each point; −1 ends a list
    """

    vertices: F64
    points: F64
    tri: I64
    nb: I64
    relevant: Bool
    first: I64
    after: I64


@kernel
def relink(nb: I64, t: int, old: int, new: int) -> None:
    """Triangle ``t`` now borders ``new`` where it bordered ``old``."""
    for k in range(3):
        if nb[t, k] == old:
            nb[t, k] = new


@kernel
def write_triangle(
    tri: I64, nb: I64, t: int, v: tuple[int, int, int], n: tuple[int, int, int]
) -> None:
    """Write one triangle's vertices and neighbours."""
    tri[t, 0], tri[t, 1], tri[t, 2] = v
    nb[t, 0], nb[t, 1], nb[t, 2] = n


@kernel
def residual(vertices: F64, a: int, b: int, c: int, p: F64) -> float:
    """Height of a point p (3,) of a triangle over the plane through its vertices.

    The same whichever vertex is named first, and with coordinates kept within the triangle: what
    rounding makes of slivers must not let two states of the surface each look better than the
    other, or the exchanges would not end.
    """
    if b < a and b < c:
        a, b, c = b, c, a
    elif c < a and c < b:
        a, b, c = c, a, b
    ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
    vx, vy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
    dx, dy = p[0] - vertices[a, 0], p[1] - vertices[a, 1]
    area = ux * vy - uy * vx
    if area == 0.0:  # a sliver that rounds to nothing: its first corner stands for it
        return float(p[2] - vertices[a, 2])
    s = min(max((dx * vy - dy * vx) / area, 0.0), 1.0)
    t = min(max((ux * dy - uy * dx) / area, 0.0), 1.0 - s)
    za = vertices[a, 2]
    return float(p[2] - za - s * (vertices[b, 2] - za) - t * (vertices[c, 2] - za))


@kernel
def side(vertices: F64, a: int, b: int, p: F64) -> float:
    """Positive where p lies to the left of the line from vertex a to vertex b."""
    ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
    return float(ux * (p[1] - vertices[a, 1]) - uy * (p[0] - vertices[a, 0]))


@kernel
def exchange_gain(s: ListedSurface, t: int, k: int, square: bool, w: F64) -> float:
    """By how much the sum over the points of triangle t and its neighbour across edge k falls when
    their diagonal is exchanged; 0 where it may not be.
    """
    vertices, points, tri, nb = s.vertices, s.points, s.tri, s.nb
    relevant, first, after = s.relevant, s.first, s.after
    o = nb[t, k]
    if o < 0 or not relevant[t] or not relevant[o]:
        return 0.0
    if first[t] < 0 and first[o] < 0:
        return 0.0
    j = 0
    while nb[o, j] != t:
        j += 1
    a, b, c, d = tri[t, k], tri[t, (k + 1) % 3], tri[t, (k + 2) % 3], tri[o, j]
    if orientation_of(vertices, a, b, d, w) <= 0.0 or orientation_of(vertices, a, d, c, w) <= 0.0:
        return 0.0
    before = now = 0.0
    for home in (t, o):
        p = first[home]
        while p >= 0:
            old = (
                residual(vertices, a, b, c, points[p])
                if home == t
                else residual(vertices, d, c, b, points[p])
            )
            if side(vertices, a, d, points[p]) >= 0.0:
                new = residual(vertices, a, d, c, points[p])
            else:
                new = residual(vertices, a, b, d, points[p])
            before += old * old if square else abs(old)
            now += new * new if square else abs(new)
            p = after[p]
    return float(before - now)


@kernel
def exchange_one(s: ListedSurface, t: int, k: int) -> int:
    """Exchange the diagonal at edge k of t: t becomes (a, b, d), its neighbour (a, d, c), and their
    points are shared out anew. Returns the neighbour.
    """
    vertices, points, tri, nb = s.vertices, s.points, s.tri, s.nb
    first, after = s.first, s.after
    o = int(nb[t, k])
    j = 0
    while nb[o, j] != t:
        j += 1
    a, b, c, d = tri[t, k], tri[t, (k + 1) % 3], tri[t, (k + 2) % 3], tri[o, j]
    nca, nab, nbd, ndc = (
        nb[t, (k + 1) % 3],
        nb[t, (k + 2) % 3],
        nb[o, (j + 1) % 3],
        nb[o, (j + 2) % 3],
    )
    write_triangle(tri, nb, t, (a, b, d), (nbd, o, nab))
    write_triangle(tri, nb, o, (a, d, c), (ndc, nca, t))
    if nbd >= 0:
        relink(nb, nbd, o, t)
    if nca >= 0:
        relink(nb, nca, t, o)
    heads = (first[t], first[o])
    first[t] = first[o] = -1
    for h in heads:
        p = h
        while p >= 0:
            following = after[p]
            home = o if side(vertices, a, d, points[p]) >= 0.0 else t
            after[p] = first[home]
            first[home] = p
            p = following
    return o


@kernel
def exchange_kernel(s: ListedSurface, square: bool, least: float, w: F64) -> int:
    """Exchange diagonals, biggest improvement first; changes tri, nb, first, after and returns how
    many. Entries of the queue whose triangles have changed since are skipped.
    """
    nb, m = s.nb, len(s.tri)
    version = np.zeros(m, np.int64)
    queue = [(0.0, 0, 0, 0, 0, 0)]
    queue.pop()
    for t in range(m):
        for k in range(3):
            if nb[t, k] > t:
                g = exchange_gain(s, t, k, square, w)
                if g > least:
                    queue.append((-g, t, k, nb[t, k], 0, 0))
    heapq.heapify(queue)
    done = 0
    while len(queue) > 0:
        _, t, k, other, vt, vo = heapq.heappop(queue)
        if nb[t, k] != other or version[t] != vt or version[other] != vo:
            continue
        o = exchange_one(s, t, k)
        version[t] += 1
        version[o] += 1
        done += 1
        for one in (t, o):
            for edge in range(3):
                other = nb[one, edge]
                if other == o and one == t:
                    continue  # the new diagonal: exchanging it again cannot gain
                g = exchange_gain(s, one, edge, square, w)
                if g > least:
                    heapq.heappush(queue, (-g, one, edge, other, version[one], version[other]))
    return done


def point_lists(triangle: I64, m: int) -> tuple[I64, I64]:
    """Points by triangle as linked lists: the first point of each of m triangles (−1: none) and the
    one after each point.
    """
    first, after = np.full(m, -1, np.int64), np.full(len(triangle), -1, np.int64)
    order = np.argsort(triangle, kind="stable")
    same = triangle[order[1:]] == triangle[order[:-1]]
    after[order[:-1][same]] = order[1:][same]
    head = order[np.concatenate([[True], ~same])] if len(order) else order
    first[triangle[head]] = head
    return first, after


def checked_points(points_map: F64, measure: str) -> F64:
    """The points (n, 3); raises :class:`SurfaceError` for what :func:`exchange_diagonals`
    refuses.
    """
    if measure not in MEASURES:
        raise SurfaceError(
            f"the measure of fit is one of {MEASURES}, not {measure!r}",
            reason="surface_measure",
            value=measure,
        )
    return finite_points(points_map)


def exchange_diagonals(tin: Tin, points_map: F64, measure: str = "asd") -> Exchange:
    """ASD or RMS triangulation adjustment of a surface to all points (n, 3), m, map frame;
    ``measure`` is "asd" or "rms".

    Heights, footprint and relevant area stay. Raises :class:`SurfaceError` for an unknown measure,
    points of a wrong shape or not finite, or no point in a relevant triangle.
    """
    points = checked_points(points_map, measure)
    where = locate(triangle_index(tin, tin.relevant), points[:, :2])
    points, where = np.ascontiguousarray(points[where >= 0]), where[where >= 0]
    if len(points) == 0:
        raise SurfaceError("no point lies in a relevant triangle", reason="surface_no_point")
    vertices, tri, nb = (
        np.ascontiguousarray(tin.vertices),
        tin.triangles.astype(np.int64),
        tin.neighbours.astype(np.int64),
    )
    first, after = point_lists(where, len(tri))
    before = list_residuals(vertices, points, tri, first, after)
    square = measure == "rms"
    total = float(np.sum(before**2 if square else np.abs(before)))
    done = int(
        exchange_kernel(
            ListedSurface(vertices, points, tri, nb, tin.relevant, first, after),
            square,
            LEAST_GAIN * total,
            workspace(),
        )
    )
    new = dataclasses.replace(tin, triangles=tri.astype(np.int32), neighbours=nb.astype(np.int32))
    return Exchange(
        new, done, *measures(list_residuals(vertices, points, tri, first, after)), *measures(before)
    )


@kernel
def list_residuals(vertices: F64, points: F64, tri: I64, first: I64, after: I64) -> F64:
    """Residuals (n,) m of the points in their triangles."""
    out = np.zeros(len(points))
    for t in range(len(tri)):
        p = first[t]
        while p >= 0:
            out[p] = residual(vertices, tri[t, 0], tri[t, 1], tri[t, 2], points[p])
            p = after[p]
    return out
