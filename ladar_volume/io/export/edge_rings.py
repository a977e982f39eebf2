"""Outlines of a set of triangles as polygons with holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, I32, Bool, Tin
from ladar_volume.tin.boundary import boundary_sides, part_numbers, side_ends
from ladar_volume.volume.polygon import signed_area


@dataclass(frozen=True)
class Polygon:
    """outer : (k, 3) m, counter-clockwise from above, its first point not repeated · holes : (k, 3)
    each, clockwise · area_m2 : inside the outer ring and outside the holes, in plan
    """

    outer: F64
    holes: tuple[F64, ...]
    area_m2: float


def polygons_of(tin: Tin, mask: Bool) -> list[Polygon]:
    """The polygons of the triangles (m,), one for each part joined by edges, the largest first.
    Rings meet themselves and one another in single vertices at most.
    """
    part = np.asarray(part_numbers(tin.neighbours, mask))
    rings = edge_rings(tin, mask, part)
    out = []
    for number in sorted(rings):
        mine = [(signed_area(tin.vertices[ring]), tin.vertices[ring]) for ring in rings[number]]
        mine.sort(key=lambda pair: -pair[0])
        holes = tuple(ring for area, ring in mine[1:] if area < 0.0)
        out.append(Polygon(mine[0][1], holes, sum(area for area, _ in mine)))
    return sorted(out, key=lambda polygon: -polygon.area_m2)


def edge_rings(tin: Tin, mask: Bool, part: I32) -> dict[int, list[list[int]]]:
    """Rings of vertices along the boundary of the triangles (m,), by the part (m,) they bound; the
    triangles are on their left. A ring that comes through a vertex twice is parted there.
    """
    t, k = boundary_sides(tin, mask)
    follow: dict[int, dict[int, list[int]]] = {}
    for number, (one, two) in zip(part[t].tolist(), side_ends(tin, t, k).tolist(), strict=True):
        follow.setdefault(number, {}).setdefault(one, []).append(two)
    return {number: loops(graph) for number, graph in follow.items()}


def loops(follow: dict[int, list[int]]) -> list[list[int]]:
    """Simple loops of directed edges, every one used once; consumes ``follow``."""
    out: list[list[int]] = []
    while follow:
        first = next(iter(follow))
        trail, place = [first], {first: 0}
        while trail:
            v = trail[-1]
            if v not in follow:
                break  # nothing is left at the start of this trail
            to = follow[v].pop()
            if not follow[v]:
                del follow[v]
            if to not in place:
                place[to] = len(trail)
                trail.append(to)
                continue
            ring = trail[place[to] :]
            out.append(ring)
            for vertex in ring[1:]:
                del place[vertex]
            del trail[place[to] + 1 :]
    return out
