"""Editing the boundary of the relevant area (seed 000 section 3.1): ears go by the length of their
edges, islands and holes by their area.

Triangles are marked, never lost: an edit changes which of them are relevant and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.relevant import (
    LIMIT_SHARE,
    artificial_vertices,
    edge_lengths,
    mark_relevant,
    widened,
)


@dataclass(frozen=True)
class EditedBoundary:
    """tin : the surface with its new relevant triangles · ears, islands, holes : (m,) bool, the
    triangles each step changed
    """

    tin: Tin
    ears: Bool
    islands: Bool
    holes: Bool


@kernel
def boundary_kernel(neighbours: I32, inside: Bool) -> I64:
    """See :func:`boundary_sides`: ``3 t + k`` for the side opposite corner k of triangle t."""
    out = np.empty(3 * np.count_nonzero(inside), np.int64)
    count = 0
    for t in range(len(neighbours)):
        if not inside[t]:
            continue
        for k in range(3):
            beyond = neighbours[t, k]
            if beyond < 0 or not inside[beyond]:
                out[count] = 3 * t + k
                count += 1
    return out[:count].copy()


def boundary_sides(tin: Tin, inside: Bool) -> tuple[I64, I64]:
    """Triangles (b,) with a side, the one opposite the corner (b,), on the boundary of those
    ``inside`` (m,).
    """
    side = np.asarray(boundary_kernel(tin.neighbours, inside))
    return side // 3, side % 3


def side_ends(tin: Tin, t: I64, k: I64) -> I32:
    """The vertices (b, 2) at the ends of the sides opposite corners k (b,) of triangles t (b,)."""
    return np.stack([tin.triangles[t, (k + 1) % 3], tin.triangles[t, (k + 2) % 3]], axis=1)


def first_ends(vertices: F64, ends: I32) -> I64:
    """Of sides with ends (b, 2) the end (b,) that comes first by x, then y."""
    a, b = vertices[ends[:, 0]], vertices[ends[:, 1]]
    second = (b[:, 0] < a[:, 0]) | ((b[:, 0] == a[:, 0]) & (b[:, 1] < a[:, 1]))
    return np.where(second, ends[:, 1], ends[:, 0]).astype(np.int64)


def border(tin: Tin, mask: Bool) -> tuple[I32, F64, Bool]:
    """The sides of triangles (m,) that bound them: their ends (b, 2), counter-clockwise
    about the triangles, their lengths (b,) m, and whether there is no surface beyond.
    """
    t, k = boundary_sides(tin, mask)
    ends = side_ends(tin, t, k)
    d = tin.vertices[ends[:, 1], :2] - tin.vertices[ends[:, 0], :2]
    beyond = tin.neighbours[t, k]
    return ends, np.hypot(d[:, 0], d[:, 1]), (beyond < 0) | ~tin.relevant[beyond]


@kernel
def open_sides(neighbours: I32, mask: Bool, lengths: F64, t: int) -> tuple[int, float]:
    """How many sides of triangle t border no triangle of the mask, and the longest of them, m."""
    count, longest = 0, 0.0
    for k in range(3):
        o = neighbours[t, k]
        if o < 0 or not mask[o]:
            count, longest = count + 1, max(longest, lengths[t, k])
    return count, longest


@kernel
def ears_kernel(neighbours: I32, lengths: F64, mask: Bool, limit: float) -> None:
    """Take ears out of ``mask`` until none is left: triangles with two or three open sides, one of
    them longer than the limit.

    A triangle that is such an ear stays one while others go, so the result does not depend on the
    order.
    """
    stack = np.empty(len(mask) + 3, np.int64)
    for first in range(len(mask)):
        stack[0], top = first, 1
        while top > 0:
            top -= 1
            t = stack[top]
            if not mask[t]:
                continue
            count, longest = open_sides(neighbours, mask, lengths, t)
            if count >= 2 and longest > limit:
                mask[t] = False
                # one side at most was closed: one neighbour to look at again
                for k in range(3):
                    o = neighbours[t, k]
                    if o >= 0 and mask[o]:
                        stack[top] = o
                        top += 1


def part_numbers(neighbours: I32, mask: Bool) -> I32:
    """Number (m,) of the part each triangle of the mask belongs to, parts joined by edges, numbered
    by their first triangle; -1 off it.
    """
    part, stack = (large_zeros(mask.shape, np.int32) for _ in range(2))
    parts_kernel(neighbours, mask, part, stack)
    return part


@kernel
def parts_kernel(neighbours: I32, mask: Bool, part: I32, stack: I32) -> None:
    """See :func:`part_numbers`; stack : (m,) room."""
    parts = 0
    part[:] = -1
    for first in range(len(mask)):
        if not mask[first] or part[first] >= 0:
            continue
        part[first], stack[0], top = parts, first, 1
        while top > 0:
            top -= 1
            t = stack[top]
            for k in range(3):
                o = neighbours[t, k]
                if o >= 0 and mask[o] and part[o] < 0:
                    part[o], stack[top] = parts, o
                    top += 1
        parts += 1


def ears(tin: Tin, mask: Bool, max_edge_m: float) -> Bool:
    """Triangles (m,) of the mask that are ears with an open side longer than ``max_edge_m``, or
    become one when others go.
    """
    left = mask.copy()
    ears_kernel(tin.neighbours, edge_lengths(tin), left, widened(tin, float(max_edge_m)))
    return mask & ~left


def islands(tin: Tin, mask: Bool, min_area_m2: float) -> Bool:
    """Triangles (m,) in parts of the mask, joined by edges, whose horizontal area is below
    ``min_area_m2``.
    """
    part = part_numbers(tin.neighbours, mask)
    area = np.bincount(part[mask], footprint_areas(tin.vertices, tin.triangles)[mask])
    out = mask.copy()
    out[mask] = area[part[mask]] * (1.0 + LIMIT_SHARE) < min_area_m2
    return out


def holes(tin: Tin, mask: Bool, max_area_m2: float) -> Bool:
    """Triangles (m,) off the mask in parts, joined by edges, that the mask encloses and whose
    horizontal area is no more than ``max_area_m2``; parts that reach the hull or an artificial
    vertex are no holes.
    """
    off: Bool = np.logical_not(mask)
    part = part_numbers(tin.neighbours, off)[off]
    if len(part) == 0:
        return off
    area = np.bincount(part, footprint_areas(tin.vertices, tin.triangles)[off])
    outside: Bool = np.any(
        (tin.neighbours < 0) | np.isin(tin.triangles, artificial_vertices(tin)), axis=1
    )
    closed = np.bincount(part, outside[off]) == 0
    fill: Bool = np.logical_and(area <= max_area_m2 * (1.0 + LIMIT_SHARE), closed)
    off[off] = fill[part]
    return off


def edit_boundary(
    tin: Tin, max_ear_edge_m: float = np.inf, min_island_m2: float = 0.0, max_hole_m2: float = 0.0
) -> EditedBoundary:
    """Smooth the outline of the relevant area: first ears go (:func:`ears`), then islands
    (:func:`islands`), then holes are filled.

    By default nothing changes. Raises :class:`SurfaceError` for a limit that is not a number >= 0,
    or where no triangle is left.
    """
    for limit in (max_ear_edge_m, min_island_m2, max_hole_m2):
        if not limit >= 0.0:
            raise SurfaceError(
                f"the limit {limit} of an edit must be 0 or more",
                reason="surface_limit",
                value=limit,
            )
    mask: Bool = tin.relevant.copy()
    gone = ears(tin, mask, max_ear_edge_m)
    mask &= ~gone
    small = islands(tin, mask, min_island_m2)
    mask &= ~small
    filled = holes(tin, mask, max_hole_m2) if max_hole_m2 > 0.0 else np.zeros(len(mask), bool)
    return EditedBoundary(
        mark_relevant(tin, mask | filled, "boundary editing"), gone, small, filled
    )
