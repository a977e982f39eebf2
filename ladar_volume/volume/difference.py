"""The difference of two surfaces as one surface, for what needs its noise at every point: the correction near the base.

The vertices of both, where both surfaces are, get the difference of heights, one of them interpolated in the other, and a triangulation of
their own. The volumes themselves come from the exact overlay; only the noise that folds into cut and fill is taken from here.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.surface.locate import barycentric, locate, triangle_index
from ladar_volume.surface.ordering import hilbert_order
from ladar_volume.surface.tin import build_tin, footprint_areas, vertex_mask
from ladar_volume.volume.near_base import node_covariances


@dataclass(frozen=True)
class Difference:
    """tin : upper minus lower, m; relevant are the triangles whose centroid lies on both · by_upper, by_lower : sparse (k, n) and (k, l),
    its heights are ``by_upper z_upper − by_lower z_lower``"""

    tin: Tin
    by_upper: Any
    by_lower: Any

    def covariance(self, upper: Tin, C_upper: Any, lower: Tin, C_lower: Any) -> Any:
        """Covariance (k, k), sparse, m², of the differences from those of the two surfaces' heights.

        To interpolate what is interpolated already takes noise away: the whole is scaled so that its mean variance over the area is the sum
        of the two surfaces'.
        """
        C = sparse.csr_array(self.by_upper @ C_upper @ self.by_upper.T + self.by_lower @ C_lower @ self.by_lower.T)
        own = mean_variance(self.tin, C)
        scale = (mean_variance(upper, C_upper) + mean_variance(lower, C_lower)) / own if own > 0.0 else 1.0
        return scale * C


def mean_variance(tin: Tin, C: Any) -> float:
    """Mean over the relevant area of the variance, m², of the interpolated height, for a sparse covariance (n, n) of the vertex heights:
    ``(tr C + 1ᵀC1) / 12`` in each triangle."""
    t = tin.triangles[tin.relevant]
    packed, area = node_covariances(C, t), footprint_areas(tin.vertices, t)
    return float(area @ packed.sum(axis=1)) / 6.0 / float(area.sum())


def interpolation(tin: Tin, xy: F64) -> tuple[Any, Bool]:
    """Sparse (k, n): heights of a surface at points xy (k, 2) from those of its vertices; and which of the points it has (k,)."""
    order, where = hilbert_order(xy), np.empty(len(xy), np.int64)
    where[order] = locate(triangle_index(tin, tin.relevant), xy[order])  # neighbours in turn are found faster
    there = where >= 0
    weights, corner = barycentric(tin, where[there], xy[there]), tin.triangles[where[there]]
    row = np.repeat(np.flatnonzero(there), 3)
    P = sparse.csr_array((weights.ravel(), (row, corner.ravel())), shape=(len(xy), len(tin.vertices)))
    P.eliminate_zeros()
    return P, there


def difference(upper: Tin, lower: Tin) -> Difference:
    """The difference of two surfaces. Raises :class:`VolumeError` where the two have no area in common."""
    xy = np.concatenate([t.vertices[vertex_mask(t, t.relevant), :2] for t in (upper, lower)])
    (P, on_upper), (Q, on_lower) = interpolation(upper, xy), interpolation(lower, xy)
    both = np.flatnonzero(on_upper & on_lower)
    if len(both) < 3:
        raise VolumeError("the two surfaces have no area in common", reason="volume_no_common_footprint")
    P, Q = P[both], Q[both]
    tin = build_tin(np.c_[xy[both], P @ upper.vertices[:, 2] - Q @ lower.vertices[:, 2]])
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    relevant: Bool = interpolation(upper, middle)[1] & interpolation(lower, middle)[1]
    return Difference(dataclasses.replace(tin, relevant=relevant), P[tin.source], Q[tin.source])
