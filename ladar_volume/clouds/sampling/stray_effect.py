"""What points that were left out would change in a volume: the surface is triangulated with them
where they are, not as a whole.

A point changes the triangles whose circumcircle it lies in, or on, which hang together, and no
others. The new ones cover the same ground. So they are those over the corners of the triangles that
go and these points, where they lie on that ground.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.tin.full_tin import build_tin, corners_of, footprint_areas
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.predicates import incircle, workspace


def stray_effect(tin: Tin, inside_m2: F64, strays: F64, base: Plane | None = None) -> float:
    """Net volume below a surface less that with strays (s, 3) m in it, m³, above the same base and
    within the same outline: of each triangle inside_m2 (m,) counts. One beyond the surface changes
    nothing there.
    """
    where = locate(triangle_index(tin, tin.relevant), strays[:, :2])
    over = strays[where >= 0]
    if not len(over):
        return 0.0
    mesh = Mesh(tin.vertices, tin.triangles, tin.neighbours)
    gone: Bool = np.asarray(reached_kernel(mesh, over, where[where >= 0], workspace()))
    rows = corners_of(tin.triangles[gone], len(tin.vertices))
    over = over[np.lexsort(over.T[::-1])]  # of several at one place the lowest counts
    fresh = triangles_over(np.vstack([tin.vertices[rows], over]))
    at = locate(triangle_index(tin, gone), inner_places(fresh))
    area = footprint_areas(tin.vertices, tin.triangles)
    share = np.where(at >= 0, inside_m2[at] / np.where(area[at] > 0.0, area[at], 1.0), 0.0)
    old = held_below(tin.vertices[tin.triangles[gone]], inside_m2[gone], base)
    return old - held_below(fresh, share * plan_areas(fresh), base)


class Mesh(NamedTuple):
    """Vertices (n, 3) m, triangles (m, 3) and what lies across their sides (m, 3)."""

    vertices: F64
    triangles: I32
    neighbours: I32


@kernel
def reached_kernel(mesh: Mesh, points: F64, where: I64, w: F64) -> Bool:
    """The triangles (m,) whose circumcircle one of points (s, 3) lies in or on, which are in
    triangles ``where`` (s,).
    """
    vertices, triangles, neighbours = mesh.vertices, mesh.triangles, mesh.neighbours
    out, xy = np.zeros(len(triangles), np.bool_), np.empty((4, 2))
    seen = np.full(len(triangles), -1, np.int32)
    for p in range(len(points)):
        stack = [np.int64(where[p])]
        xy[3] = points[p, :2]
        while len(stack):
            t = stack.pop()
            if seen[t] == p:
                continue
            seen[t] = p
            for k in range(3):
                xy[k] = vertices[triangles[t, k], :2]
            if incircle(xy, 0, 1, 2, 3, w) >= 0.0:
                out[t] = True
                for k in range(3):
                    if neighbours[t, k] >= 0:
                        stack.append(np.int64(neighbours[t, k]))
    return out


def triangles_over(points: F64) -> F64:
    """Corners (k, 3, 3) of the triangles over points (n, 3)."""
    tin = build_tin(points)
    out: F64 = points[tin.source[tin.triangles]]
    return out


#: Where in a triangle it is asked which one it lies over, near its middle: on a lattice that itself
#: often lies on a side.
INNER = np.array([0.35, 0.33, 0.32])


def inner_places(corners: F64) -> F64:
    """A place (m, 2) m in each of triangles (m, 3, 3), whatever the order of their corners."""
    xy = corners[:, :, :2]
    order = np.lexsort((xy[..., 1], xy[..., 0]), axis=1)
    out: F64 = np.einsum("k,mkc->mc", INNER, np.take_along_axis(xy, order[..., None], axis=1))
    return out


def plan_areas(corners: F64) -> F64:
    """Areas (m,) m² of triangles (m, 3, 3) in plan."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    out: F64 = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return out


def held_below(corners: F64, area: F64, base: Plane | None) -> float:
    """Volume, m³, between triangles (m, 3, 3), of each of which an area (m,) m² counts, and a base;
    height 0 for none.
    """
    height = height_above(corners.reshape(-1, 3), base).reshape(-1, 3)
    return float(area @ height.mean(axis=1))
