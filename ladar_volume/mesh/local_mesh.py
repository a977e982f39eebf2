"""A triangle mesh through points of surfaces of any orientation (seed 002 chapter 5): local
triangulations in tangent planes that agree.

Every point triangulates its neighbours in its own tangent plane and keeps the triangles at itself,
its star. A triangle that is in the stars of all three corners is taken; where stars disagree the
surface grows by the triangles that fit, by votes and then the shortest first; what then still gapes
is closed up to a stated size. The result is a manifold with one orientation. The published
Algorithm 2, with its repairs, is the other method.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ladar_volume.mesh.local_frames import (
    PLANE,
    SLACK,
    consistent_normals,
    neighbours,
    plane_normals,
    spatial_order,
)
from ladar_volume.mesh.local_growth import FAN, drop_fans, grow, list_triangles
from ladar_volume.mesh.local_holes import fill_holes, open_handles, rims
from ladar_volume.mesh.local_published import published_triangles, repair_triangles
from ladar_volume.mesh.local_star import DEGREE, count_star_triangles, stars
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.body_parameters import LocalMeshParameters
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64
from ladar_volume.tin.scan_frame import check_cloud

#: What a vertex is: inside the surface, on a rim, in no triangle, or at the place of an earlier
#: point.
INSIDE, RIM, UNUSED, DUPLICATE = range(4)
#: Neighbours that the spacing of the points is taken from (the median distance of this one), those
#: a star is made of, and by how many times more where it stays open.
SPACING, NEIGHBOURS, WIDER = 6, 32, 4
#: Longest edge and largest hole in spacings, where no lengths are given.
REACH, HOLE = 4.0, 6.0
#: A cloud this much thinner than it is long is a line.
THIN = 1e-9
#: Rounds of closing holes and of dropping what hangs on a single vertex.
ROUNDS = 4


#: The thesis's three meshes (section 9.2): bench and fountain, cardboard box, sphere.
FOUNTAIN = LocalMeshParameters(0.10, method="published")
BOX = LocalMeshParameters(0.20, method="published")
SPHERE = LocalMeshParameters(0.35, method="published")


@dataclass(frozen=True)
class LocalMesh:
    """A mesh through points, in their frame.

    vertices : (n, 3) m, the input points in their order · normals : (n, 3), unit, on the side the
    triangles face · triangles : (m, 3) int32, counter-clockwise as seen from the normals' side:
    outside of a closed body · votes : (m,) by how many of its corners a triangle was proposed, 0
    where it closes a hole · status : (n,) int32, INSIDE, RIM, UNUSED or DUPLICATE · rims : vertices
    of each open rim, in their order with the gap on the left; the two ends of each open edge in the
    published method · over_full : (k, 2) edges that have more than two triangles, none but in the
    published method · report : counts of what was found, closed and dropped, lengths used
    """

    vertices: F64
    normals: F64
    triangles: I32
    votes: I32
    status: I32
    rims: tuple[I32, ...]
    over_full: I32
    report: dict[str, float | int] = field(default_factory=dict)

    @property
    def watertight(self) -> bool:
        """Whether every edge has two triangles."""
        return not self.rims and not len(self.over_full)


def mesh_cloud(
    points: F64, normals: F64 | None = None, settings: LocalMeshParameters | None = None
) -> LocalMesh:
    """A manifold mesh through points (n, 3), m, in any frame, with their normals (n, 3) of any
    length.

    Without normals, planes through the nearest points stand in, which round sharp edges off. Raises
    :class:`SurfaceError`: surface_shape, surface_not_finite, mesh_points (fewer than three places),
    mesh_normals, mesh_empty (no triangle: collinear, or all farther apart than the radius).
    """
    settings = settings or LocalMeshParameters()
    given = check_cloud(points, 3)
    first = np.sort(np.unique(given + 0.0, axis=0, return_index=True)[1])
    if len(first) < 3:
        raise SurfaceError(
            f"{len(first)} points at different places are no surface",
            reason="mesh_points",
            value=len(first),
        )
    if settings.method == "agreement":
        first = first[spatial_order(given[first])]
    # digits: offsets of the cloud's size, not map coordinates
    p = given[first] - 0.5 * (given.min(axis=0) + given.max(axis=0))
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[1] <= THIN * spread[0]:
        raise SurfaceError("no triangle: all points lie on one line", reason="mesh_empty")
    distance, index = neighbours(p, NEIGHBOURS)
    own = None if normals is None else np.asarray(normals, np.float64)
    n = unit_normals(p, index, own, first, len(given), settings.signed)
    if settings.method == "published":
        return published_mesh(given, first, p, n, settings)
    spacing = float(np.median(distance[:, min(SPACING, distance.shape[1]) - 1]))
    reach = settings.radius_m or REACH * spacing
    hole = settings.hole_m or HOLE / REACH * reach
    slack = SLACK * spacing
    triangles, votes, report = count_agreement(p, n, index, reach, slack)
    lengths = {"spacing_m": spacing, "radius_m": reach, "hole_m": hole, "slack_m": slack}
    return finish_mesh(given, first, p, n, triangles, votes, {**lengths, **report})


def unit_normals(
    p: F64, index: I64, normals: F64 | None, first: I64, given: int, signed: bool
) -> F64:
    """Normals of the points in use, of length 1 and with signs that agree; from planes where none
    are given.
    """
    if normals is None:
        return consistent_normals(p, plane_normals(p, index[:, :PLANE]), index)
    if normals.shape != (given, 3):
        raise SurfaceError(
            f"normals are ({given}, 3), not {normals.shape}",
            reason="mesh_normals",
            value=normals.shape,
        )
    length = np.linalg.norm(normals, axis=1)
    if not np.all(np.isfinite(length) & (length > 0.0)):
        raise SurfaceError("a normal that is zero or not finite", reason="mesh_normals")
    unit = (normals / length[:, None])[first]
    return unit if signed else consistent_normals(p, unit, index)


def count_agreement(
    p: F64, n: F64, index: I64, reach: float, slack: float
) -> tuple[I32, I32, dict[str, float | int]]:
    """Triangles of all stars in the order in which they are taken, their votes, and counts."""
    ring, closed = np.empty((len(p), DEGREE), np.int32), np.empty(len(p), np.int32)
    stars(p, n, index, np.arange(len(p)), reach, slack, ring, closed)
    # scans are dense along their lines: where the nearest do not go all round, ask more
    still = np.flatnonzero(closed == 0)
    if len(still) and index.shape[1] == NEIGHBOURS:
        stars(p, n, neighbours(p, WIDER * NEIGHBOURS, still)[1], still, reach, slack, ring, closed)
    triangles, votes = count_star_triangles(p, ring, closed, reach)
    most = np.diff(edge_table(triangles[votes >= 2])[1])
    corner = p[triangles]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    order = np.lexsort((longest, -votes))
    count = np.bincount(votes, minlength=4)
    report: dict[str, float | int] = {
        "agreed": int(count[3]),
        "of_two": int(count[2]),
        "of_one": int(count[1]),
        "edges_before": len(most),
        "over_full_before": int(np.sum(most > 2)),
    }
    return triangles[order], votes[order], report


def finish_mesh(
    given: F64,
    first: I64,
    p: F64,
    n: F64,
    triangles: I32,
    votes: I32,
    report: dict[str, float | int],
) -> LocalMesh:
    """Grow the surface, close its holes, and put the result in terms of the given points."""
    fan, size = np.zeros((len(p), FAN, 3), np.int32), np.zeros(len(p), np.int32)
    slack, hole = float(report["slack_m"]), float(report["hole_m"])
    grow(p, n, triangles, votes, slack, fan, size)
    holes, dropped = _fill_and_drop(p, n, fan, size, slack, hole)
    out = _collect_triangles(fan, size, float(report["radius_m"]))
    rim, start, _ = rims(p, n, fan, size, slack)
    status = np.full(len(given), DUPLICATE, np.int32)
    status[first] = np.where(size > 0, INSIDE, UNUSED)
    status[first[rim]] = RIM
    normals = np.zeros_like(given)
    normals[first] = n
    here = first.astype(np.int32)
    edges = tuple(here[rim[a:b]] for a, b in pairwise(start))
    report |= {
        "closed_holes": holes,
        "closing_triangles": int(np.sum(out[:, 3] == 0)),
        "dropped": dropped,
        "unused": int(np.sum(status == UNUSED)),
        "duplicates": len(given) - len(first),
    }
    none = np.empty((0, 2), np.int32)
    return LocalMesh(
        given, normals, here[out[:, :3]], out[:, 3].copy(), status, edges, none, report
    )


def _fill_and_drop(
    p: F64, n: F64, fan: I32, size: I32, slack: float, hole: float
) -> tuple[int, int]:
    """Close holes and take out what stands off the surface, in turns; returns how many of each."""
    holes = dropped = 0
    opened = np.zeros(len(p), np.bool_)
    for _ in range(ROUNDS):
        closed = fill_holes(p, n, fan, size, slack, hole, opened)[0]
        gone = drop_fans(fan, size) + open_handles(p, n, fan, size, slack, opened)
        holes, dropped = holes + closed, dropped + gone
        if not gone:
            break
    return holes, dropped


def _collect_triangles(fan: I32, size: I32, radius_m: float) -> I32:
    """The triangles (m, 3) of the fans, and how many agreed on each (m,). Refuses none."""
    out = np.empty((int(size.sum()) // 3, 4), np.int32)
    if list_triangles(fan, size, out) == 0:
        raise SurfaceError(
            f"no triangle: the points lie on lines, or all farther apart than {radius_m:.3g} m",
            reason="mesh_empty",
        )
    return out


def published_mesh(
    given: F64, first: I64, p: F64, n: F64, settings: LocalMeshParameters
) -> LocalMesh:
    """The mesh of the published method: each triangle faces the side of the normals at its corners;
    each open edge is a rim of its own.
    """
    found = published_triangles(p, settings.radius_m, settings.longest_m or settings.radius_m)
    if len(found) == 0:
        raise SurfaceError(
            f"no triangle with sides up to {settings.radius_m:.3g} m", reason="mesh_empty"
        )
    t = repair_triangles(found, settings.repair)
    a, b, c = (p[t[:, k]] for k in range(3))
    back = np.einsum("ni,ni->n", np.cross(b - a, c - a), n[t].sum(axis=1)) < 0.0
    t[back] = t[back][:, [0, 2, 1]]
    order, start, key = edge_table(t)
    uses, ends = np.diff(start), np.stack([key >> 32, key & 0xFFFFFFFF], axis=1)[order[start[:-1]]]
    here = first.astype(np.int32)
    single = here[ends[uses == 1]]
    status = np.full(len(given), DUPLICATE, np.int32)
    status[first] = UNUSED
    status[here[t]] = INSIDE
    status[single] = RIM
    normals = np.zeros_like(given)
    normals[first] = n
    report: dict[str, float | int] = {
        "method_published": 1,
        "radius_m": settings.radius_m,
        "found": len(found),
        "repaired": len(t) - len(found),
        "open_edges": len(single),
        "over_full": int(np.sum(uses > 2)),
        "unused": int(np.sum(status == UNUSED)),
        "duplicates": len(given) - len(first),
    }
    votes = np.ones(len(t), np.int32)
    return LocalMesh(
        given, normals, here[t], votes, status, tuple(single), here[ends[uses > 2]], report
    )
