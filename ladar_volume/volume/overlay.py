"""Volumes between two triangulated surfaces over their common footprint, by the exact overlay of their triangulations.

Every triangle of one surface is clipped by every triangle of the other that it meets (Sutherland & Hodgman 1974). On such a piece
the difference of heights is linear; what lies above and below its zero line has a closed form.
No grid, no cells, no empty cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Tin
from ladar_volume.surface.locate import TriangleIndex, triangle_index
from ladar_volume.volume.overlay_kernel import overlay_kernel
from ladar_volume.volume.polygon import height_slopes
from ladar_volume.volume.prismoids import gather


@dataclass(frozen=True)
class Between:
    """Volumes between an upper and a lower surface, where both are.

    cut_m3 : where the upper surface is above the lower one, fill_m3 : where it is below, both positive; net = cut − fill · area_m2 :
    of the common footprint · gradient_cut, gradient_fill : (n, 3) m² by the vertices of the upper surface, lower_cut, lower_fill :
    (k, 3) m² by those of the lower one; in the map frame, triangulations and common footprint held fixed.
    """

    cut_m3: float
    fill_m3: float
    area_m2: float
    gradient_cut: F64
    gradient_fill: F64
    lower_cut: F64
    lower_fill: F64

    @property
    def net_m3(self) -> float:
        """Cut minus fill, m³."""
        return self.cut_m3 - self.fill_m3

    @property
    def gradient_net(self) -> F64:
        """Gradient (n, 3) m² of the net volume by the upper vertices."""
        return self.gradient_cut - self.gradient_fill

    @property
    def lower_net(self) -> F64:
        """Gradient (k, 3) m² of the net volume by the lower vertices."""
        return self.lower_cut - self.lower_fill


def integrals(subject: Tin, index: TriangleIndex, other: Tin, other_index: TriangleIndex, sign: float) -> F64:
    """:func:`overlay_kernel` of two surfaces, in the order of the subject's tree."""
    z = np.ascontiguousarray(subject.vertices[:, 2][subject.triangles[index.order]])
    other_z = np.ascontiguousarray(other.vertices[:, 2][other.triangles[other_index.order]])
    return np.asarray(overlay_kernel(index.corners, z, other_index.corners, other_z, other_index.boxes, sign))


def vertex_gradient(tin: Tin, index: TriangleIndex, parts: F64) -> F64:
    """Gradient (n, 3) m² from integrals (m, 4) of the barycentric coordinates: vertical ``∫λ``, horizontal ``−∫λ`` times the
    surface's own slope."""
    triangles = tin.triangles[index.order]
    with np.errstate(divide="ignore", invalid="ignore"):  # slivers whose area rounds to nothing have no slope, and no share
        slopes = np.nan_to_num(height_slopes(index.corners, tin.vertices[:, 2][triangles]), nan=0.0, posinf=0.0, neginf=0.0)
    w = np.stack([parts[:, 0] - parts[:, 2] - parts[:, 3], parts[:, 2], parts[:, 3]], axis=1)
    corner = np.concatenate([-w[..., None] * slopes[:, None], w[..., None]], axis=2)
    return gather(corner, triangles, len(tin.vertices))


def between(upper: Tin, lower: Tin, gradients: bool = True) -> Between:
    """Cut and fill of ``upper`` against ``lower`` over the intersection of their footprints (relevant triangles, counter-clockwise).

    Without ``gradients``, which take a second overlay, these are zero. Raises :class:`VolumeError` where a surface has no relevant
    triangle or the two have no area in common.
    """
    if not upper.relevant.any() or not lower.relevant.any():
        raise VolumeError("a surface has no relevant triangle", reason="volume_no_triangle")
    one, two = triangle_index(upper, upper.relevant), triangle_index(lower, lower.relevant)
    parts = integrals(upper, one, lower, two, 1.0)
    (area_cut, cut), (area_fill, fill) = parts[:, :, :2].sum(axis=0)
    area = float(area_cut + area_fill)
    if area <= 0.0:
        raise VolumeError("the two surfaces have no area in common", reason="volume_no_common_footprint")
    g = [np.zeros_like(upper.vertices), np.zeros_like(upper.vertices), np.zeros_like(lower.vertices), np.zeros_like(lower.vertices)]
    if gradients:
        back = integrals(lower, two, upper, one, -1.0)
        g = [vertex_gradient(upper, one, parts[:, 0]), -vertex_gradient(upper, one, parts[:, 1])]
        g += [-vertex_gradient(lower, two, back[:, 0]), vertex_gradient(lower, two, back[:, 1])]
    return Between(float(cut), float(fill), area, *g)
