"""Volumes between two triangulated surfaces over their common footprint, by the exact overlay of
their triangulations.

Every triangle of one surface is clipped by every triangle of the other that it meets (Sutherland &
Hodgman 1974). On such a piece the difference of heights is linear; what lies above and below its
zero line has a closed form. No grid, no cells, no empty cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Tin
from ladar_volume.tin.locate import TriangleIndex, triangle_index
from ladar_volume.volume.overlay_kernel import overlay_kernel
from ladar_volume.volume.prismoids import CutFill


@dataclass(frozen=True)
class VolumesBetween(CutFill):
    """Volumes between an upper and a lower surface, over their common footprint, which is held
    fixed too.

    lower_cut, lower_fill : (k, 3) m², by the vertices of the lower surface in the map frame
    """

    lower_cut: F64
    lower_fill: F64

    @property
    def lower_net(self) -> F64:
        """Gradient (k, 3) m² of the net volume by the lower vertices."""
        return self.lower_cut - self.lower_fill


def integrals(
    one: F64, other: Tin, two: F64, index: TriangleIndex, sign: float, both: bool
) -> tuple[F64, F64]:
    """:func:`overlay_kernel` of a surface's corners ``one`` (m, 3, 3) and the other's, ``two`` (k,
    3, 3), in the order of its index.
    """
    parts, back = overlay_kernel(
        one, two, placed_neighbours(other.neighbours, index.order), index.boxes, sign, both
    )
    return np.asarray(parts), np.asarray(back)


@kernel
def placed_corners(vertices: F64, triangles: I32, order: I64) -> F64:
    """Corners (m, 3, 3) of triangles ``order`` (m,)."""
    out = np.empty((len(order), 3, 3))
    for i in range(len(order)):
        for k in range(3):
            v = triangles[order[i], k]
            out[i, k, 0], out[i, k, 1], out[i, k, 2] = (
                vertices[v, 0],
                vertices[v, 1],
                vertices[v, 2],
            )
    return out


@kernel
def placed_neighbours(neighbours: I32, order: I64) -> I64:
    """Neighbours (m, 3) of triangles ``order`` (m,) as places in that order; −1 where there is none
    or it is not in the order.
    """
    place = np.full(len(neighbours), -1, np.int64)
    for i in range(len(order)):
        place[order[i]] = i
    out = np.empty((len(order), 3), np.int64)
    for i in range(len(order)):
        for k in range(3):
            t = neighbours[order[i], k]
            out[i, k] = place[t] if t >= 0 else -1
    return out


@kernel
def vertex_gradients(
    n: int, triangles: I32, order: I64, corners: F64, parts: F64, sign: float
) -> F64:
    """Gradients (2, n, 3) m² above and below from integrals (m, 2, 3 or more) of 1 and of the
    second and third barycentric coordinate of triangles ``order`` (m,) with corners (m, 3, 3):
    vertical ``∫λ``, horizontal ``−∫λ`` times the surface's own slope; above with ``sign``, below
    against it.
    """
    out = np.zeros((2, n, 3))
    for i in range(len(order)):
        a, b, c = triangles[order[i], 0], triangles[order[i], 1], triangles[order[i], 2]
        ux, uy = corners[i, 1, 0] - corners[i, 0, 0], corners[i, 1, 1] - corners[i, 0, 1]
        vx, vy = corners[i, 2, 0] - corners[i, 0, 0], corners[i, 2, 1] - corners[i, 0, 1]
        p, q, det = (
            corners[i, 1, 2] - corners[i, 0, 2],
            corners[i, 2, 2] - corners[i, 0, 2],
            ux * vy - uy * vx,
        )
        sx, sy = (p * vy - q * uy) / det, (q * ux - p * vx) / det
        if not (
            np.isfinite(sx) and np.isfinite(sy)
        ):  # slivers whose area rounds to nothing have no slope, and no share
            sx = sy = 0.0
        for side in range(2):
            one, two = parts[i, side, 1], parts[i, side, 2]
            for v, share in ((a, parts[i, side, 0] - one - two), (b, one), (c, two)):
                weight = share * sign * (1.0 - 2.0 * side)
                out[side, v, 0] -= weight * sx
                out[side, v, 1] -= weight * sy
                out[side, v, 2] += weight
    return out


def volumes_between(upper: Tin, lower: Tin, gradients: bool = True) -> VolumesBetween:
    """Cut and fill of ``upper`` against ``lower`` over the intersection of their footprints
    (relevant triangles, counter-clockwise).

    Without ``gradients`` these are zero. Raises :class:`VolumeError` where a surface has no
    relevant triangle or the two have no area in common.
    """
    if not upper.relevant.any() or not lower.relevant.any():
        raise VolumeError("a surface has no relevant triangle", reason="volume_no_triangle")
    one, two = triangle_index(upper, upper.relevant), triangle_index(lower, lower.relevant)
    high, low = (
        placed_corners(s.vertices, s.triangles, i.order) for s, i in ((upper, one), (lower, two))
    )
    parts, back = integrals(high, lower, low, two, 1.0, gradients)
    (area_cut, _, _, cut), (area_fill, _, _, fill) = parts.sum(axis=0)
    area = float(area_cut + area_fill)
    if area <= 0.0:
        raise VolumeError(
            "the two surfaces have no area in common", reason="volume_no_common_footprint"
        )
    g = [
        np.zeros_like(upper.vertices),
        np.zeros_like(upper.vertices),
        np.zeros_like(lower.vertices),
        np.zeros_like(lower.vertices),
    ]
    if gradients:
        up = vertex_gradients(len(upper.vertices), upper.triangles, one.order, high, parts, 1.0)
        down = vertex_gradients(len(lower.vertices), lower.triangles, two.order, low, back, -1.0)
        g = [up[0], up[1], down[0], down[1]]
    return VolumesBetween(float(cut), float(fill), area, *g)
