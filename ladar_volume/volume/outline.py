"""Where the volume counts: bodies above a base, widened so that their toes are inside, as sets of
whole triangles.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import in_its_room, large_zeros
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.tin.boundary import boundary_sides, part_numbers, side_ends
from ladar_volume.tin.full_tin import any_corner, area_of, footprint_areas, vertex_mask
from ladar_volume.volume.centroid import plan_centre

#: Nearest vertices of bodies among which those that are as near are looked for.
TIES = 8


def components(tin: Tin, mask: Bool) -> I32:
    """Number (m,) of the edge-connected component of each triangle in ``mask``; -1 elsewhere."""
    return part_numbers(tin.neighbours, mask)


def labelled_bodies(
    tin: Tin, base: Plane, object_height_m: float, count: int = 1, least_m3: float = 0.0
) -> tuple[I32, list[int]]:
    """The largest bodies by volume, ``count`` at most (0: all): connected relevant triangles whose
    three vertices rise more than ``object_height_m`` above the base. The first always counts, the
    others with at least ``least_m3``. The part (m,) that each triangle belongs to, -1 for none, and
    the bodies among the parts, the largest first.

    Raises :class:`VolumeError` where nothing rises that high.
    """
    height = height_above(tin.vertices, base)
    rising = tin.relevant & ~any_corner(tin.triangles, ~(height > object_height_m))
    if not rising.any():
        words = f"nothing rises more than {object_height_m:g} m above the base"
        words += pit_words(tin, height, object_height_m)
        raise VolumeError(words, reason="volume_no_body", value=object_height_m)
    label = components(tin, rising)
    total = np.asarray(volume_by_part(tin.vertices, tin.triangles, height, label))
    order = np.argsort(-total, kind="stable")
    kept = [
        int(k) for n, k in enumerate(order) if n == 0 or (total[k] > 0 and total[k] >= least_m3)
    ]
    return label, kept[:count] if count else kept


@kernel
def volume_by_part(vertices: F64, triangles: I32, height: F64, label: I32) -> F64:
    """Volumes (k,) m³ of the parts that triangles belong to by their ``label`` (m,), -1 for none;
    height : (n,) m above the base.
    """
    out = np.zeros(label.max() + 1)
    for t in range(len(triangles)):
        if label[t] >= 0:
            a, b, c = height[triangles[t, 0]], height[triangles[t, 1]], height[triangles[t, 2]]
            out[label[t]] += area_of(vertices, triangles, t) * ((a + b + c) / 3.0)
    return out


def pit_words(tin: Tin, height: F64, depth_m: float) -> str:
    """What lies deeper than so much below the base and what to do, to end a sentence with; empty
    for nothing. height : (n,) m above the base
    """
    falling = tin.relevant & ~any_corner(tin.triangles, ~(height < -depth_m))
    if not falling.any():
        return ""
    t = tin.triangles[falling]
    area = footprint_areas(tin.vertices, t)
    x, y = plan_centre(tin, t, area)
    return words_of_pit(float(area.sum()), -float(height[t].min()), x, y)


def words_of_pit(area_m2: float, depth_m: float, x_m: float, y_m: float) -> str:
    """The same from its area, depth and middle."""
    return (
        f"; a pit of {area_m2:.3g} m² is up to {depth_m:.3g} m deep about "
        f"({x_m:.1f}, {y_m:.1f}) m: the outline 'all' takes it for fill, volume.polygon_m draws "
        "around it"
    )


def nearest_bodies(tin: Tin, outline: Bool, label: I32, kept: list[int]) -> I32:
    """Which of the bodies of :func:`labelled_bodies`, by their place in ``kept``, each triangle
    (m,) of an outline around them goes to: its own, or that with the vertex nearest to its
    centroid; -1 off the outline.
    """
    place = np.full(int(label.max()) + 2, -1, np.int32)  # the last is that of no body
    place[kept] = np.arange(len(kept), dtype=np.int32)
    out = np.where(outline, place[label], np.int32(-1))
    rest = np.flatnonzero(outline & (out < 0))
    if not len(rest):
        return out
    if len(kept) == 1:
        out[rest] = 0
        return out
    body = np.full(len(tin.vertices), -1, np.int32)
    rows = np.flatnonzero(out >= 0)
    rows = rows[np.argsort(-out[rows], kind="stable")]  # at a vertex of two the larger body counts
    body[tin.triangles[rows]] = out[rows, None]
    own = np.flatnonzero(body >= 0)
    middle = tin.vertices[tin.triangles[rest], :2].mean(axis=1)
    # on a lattice vertices of two bodies are as near: the larger body counts, in any order of them
    k = min(TIES, len(own))
    tree = cKDTree(tin.vertices[own, :2])
    far, near = (np.asarray(told) for told in tree.query(middle, np.arange(1, k + 1)))
    out[rest] = np.where(far <= far[:, :1], body[own[near]], len(kept)).min(axis=1)
    return out


def vertices_within(tin: Tin, mask: Bool, distance_m: float) -> Bool:
    """Vertices (n,) within ``distance_m``, horizontally, of a vertex of the triangles in ``mask``;
    these themselves are.
    """
    some = vertex_mask(tin, mask)
    if not some.any():
        return some
    out = reached_vertices(
        tin.triangles, tin.neighbours, tin.vertices, some, distance_m * (1.0 - 1e-9)
    )
    bound, rest = 1.001 * distance_m + 1e-6, ~out  # the search excludes its bound
    for c in tin.vertices.T[:2]:
        own = c[some]
        rest &= (c > own.min() - bound) & (c < own.max() + bound)
    if rest.any():
        tree = cKDTree(
            tin.vertices[some, :2], balanced_tree=False, compact_nodes=False
        )  # built in half the time
        distance, _ = tree.query(tin.vertices[rest, :2], distance_upper_bound=bound)
        out[rest] = np.asarray(distance) <= distance_m
    return out


def reached_vertices(
    triangles: I32, neighbours: I32, vertices: F64, some: Bool, distance_m: float
) -> Bool:
    """Vertices (n,) that lie within a distance, horizontally, of one of ``some`` (n,), as far as
    these show themselves on the way from triangle to triangle: each vertex tries those that its
    neighbours found. That is most of them, for less than a search each.
    """
    m, n = len(triangles), len(vertices)
    queue, nearest = large_zeros((m,), np.int32), large_zeros((n,), np.int32)
    reach_kernel(triangles, neighbours, vertices, some, distance_m, queue, nearest)
    return nearest >= 0


@kernel
def reach_kernel(
    triangles: I32,
    neighbours: I32,
    vertices: F64,
    some: Bool,
    distance_m: float,
    queue: I32,
    nearest: I32,
) -> None:
    """See :func:`reached_vertices`: the nearest vertex found for each (n,), -1 for none; queue :
    (m,) room
    """
    m = len(triangles)
    queued, first, last = np.zeros(m, np.bool_), 0, 0
    for v in range(len(vertices)):
        nearest[v] = v if some[v] else -1
    for t in range(m):
        found = int(some[triangles[t, 0]]) + int(some[triangles[t, 1]]) + int(some[triangles[t, 2]])
        if 0 < found < 3:
            queue[last], queued[t], last = t, True, last + 1
    while first < last:
        t, first, found = queue[first], first + 1, 0
        for k in range(3):
            v = triangles[t, k]
            if nearest[v] < 0:
                least = distance_m * distance_m
                for j in range(1, 3):
                    s = nearest[triangles[t, (k + j) % 3]]
                    if s >= 0:
                        square = (vertices[s, 0] - vertices[v, 0]) ** 2 + (
                            vertices[s, 1] - vertices[v, 1]
                        ) ** 2
                        if square <= least:
                            least, nearest[v] = square, s
            found += nearest[v] >= 0
        for k in range(3):
            o = neighbours[t, k]
            if found == 3 and o >= 0 and not queued[o]:
                queue[last], queued[o], last = o, True, last + 1


def widen_body(tin: Tin, body: Bool, margin_m: float) -> Bool:
    """The body, the relevant triangles with a vertex within ``margin_m`` of it, and the holes these
    enclose.
    """
    near = vertices_within(tin, body, margin_m)
    grown = tin.relevant & (body | any_corner(tin.triangles, near))
    return fill_holes(tin, grown)


def fill_holes(tin: Tin, mask: Bool) -> Bool:
    """``mask`` with the relevant triangles added that it encloses: those cut off from the hull and
    from irrelevant triangles.
    """
    return np.asarray(fill_parts(tin.neighbours, tin.relevant, mask, components(tin, ~mask)))


@kernel
def fill_parts(neighbours: I32, relevant: Bool, mask: Bool, part: I32) -> Bool:
    """See :func:`fill_holes`; part : (m,) number of the component off the mask each triangle
    belongs to, -1 on it.
    """
    outside = np.zeros(part.max() + 1, np.bool_)
    for t in range(len(part)):
        if part[t] >= 0 and (
            not relevant[t] or neighbours[t, 0] < 0 or neighbours[t, 1] < 0 or neighbours[t, 2] < 0
        ):
            outside[part[t]] = True
    out = mask.copy()
    for t in range(len(part)):
        if part[t] >= 0 and not outside[part[t]]:
            out[t] = True
    return out


def surroundings(tin: Tin, outline: Bool, ring_m: float) -> I64:
    """Vertices (k,) of relevant triangles outside the outline, within ``ring_m`` of it (0: all)."""
    outside = vertex_mask(tin, tin.relevant) & ~vertex_mask(tin, outline)
    if ring_m > 0:
        outside &= vertices_within(tin, outline, ring_m)
    return in_its_room(np.flatnonzero(outside).astype(np.int64, copy=False))


def boundary_loop(tin: Tin, mask: Bool) -> F64:
    """The boundary ring (k, 2) m of the triangles in ``mask`` with the largest area,
    counter-clockwise, not repeated at its end.
    """
    follow: dict[int, list[int]] = {}
    for i, j in side_ends(tin, *boundary_sides(tin, mask)).tolist():
        follow.setdefault(i, []).append(j)
    best, best_area = np.zeros((0, 2)), 0.0
    while follow:
        first = next(iter(follow))
        ring, v = [first], follow[first].pop()
        while v != first:
            ring.append(v)
            if not follow[ring[-2]]:
                del follow[ring[-2]]
            v = follow[v].pop()
        if not follow[ring[-1]]:
            del follow[ring[-1]]
        xy = tin.vertices[ring, :2]
        d = xy - xy[0]
        area = 0.5 * float((d[:-1, 0] * d[1:, 1] - d[1:, 0] * d[:-1, 1]).sum())
        if area > best_area:
            best, best_area = xy, area
    return best
