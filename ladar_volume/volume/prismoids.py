"""Cut, fill and net volume of a TIN above a base by exact prismoids, with their gradients (seed 000 section 4.1).

Over a triangle the height above the base is linear (a base of degree 2 or 3 is taken at the vertices). Where it changes sign the
triangle is cut along the zero line: the prismoid at the single vertex i on its side has the volume
``A h_i³ / (3 (h_i − h_j)(h_i − h_k))``. Gradients hold the triangulation fixed; the footprint moves with the vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.ground.polynomial import base_gradient, base_height, degree_of, design
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, Bool, Plane, Tin
from ladar_volume.surface.tin import footprint_areas


@dataclass(frozen=True)
class CutFill:
    """Volumes of a surface over something else.

    cut_m3 : above it, fill_m3 : below it, both positive; net = cut − fill · area_m2 : footprint · gradient_cut, gradient_fill : (n, 3) m²,
    by the vertices of the surface in the map frame, the triangulation held fixed.
    """

    cut_m3: float
    fill_m3: float
    area_m2: float
    gradient_cut: F64
    gradient_fill: F64

    @property
    def net_m3(self) -> float:
        """Cut minus fill, m³."""
        return self.cut_m3 - self.fill_m3

    @property
    def gradient_net(self) -> F64:
        """Gradient (n, 3) m² of the net volume."""
        return self.gradient_cut - self.gradient_fill


@dataclass(frozen=True)
class Prismoids(CutFill):
    """Volumes above a base. base_cut, base_fill : (p,), derivatives by the base's coefficients; the other gradients follow its formula."""

    base_cut: F64
    base_fill: F64

    @property
    def base_net(self) -> F64:
        """Derivative (p,) of the net volume by the base's coefficients."""
        return self.base_cut - self.base_fill


def positive_part(h: F64) -> tuple[F64, F64]:
    """Mean over a triangle of ``max(height, 0)`` for vertex heights h (m, 3): means (m,) and derivatives (m, 3) by h."""
    above = h > 0.0
    count = above.sum(axis=1)
    mean, slope = np.zeros(len(h)), np.zeros((len(h), 3))
    full = count == 3
    mean[full], slope[full] = h[full].sum(axis=1) / 3.0, 1.0 / 3.0
    for single, sign in ((count == 1, 1.0), (count == 2, -1.0)):
        rows = np.flatnonzero(single)
        # the lone vertex: the one above, or the one not above, whose tip is added to the signed mean
        i = np.argmax(above[rows] if sign > 0 else ~above[rows], axis=1)
        j, k = (i + 1) % 3, (i + 2) % 3
        hi, dj, dk = h[rows, i], h[rows, i] - h[rows, j], h[rows, i] - h[rows, k]
        tip = hi * (hi / dj) * (hi / dk) / 3.0
        mean[rows] = tip
        slope[rows, i] = (hi / dj) * (hi / dk) - tip / dj - tip / dk
        slope[rows, j], slope[rows, k] = tip / dj, tip / dk
        if sign < 0:  # mean of the positive part = signed mean + size of the tip below
            mean[rows] = h[rows].sum(axis=1) / 3.0 - tip
            slope[rows] = 1.0 / 3.0 - slope[rows]
    return mean, slope


def area_gradient(vertices: F64, triangles: I32) -> F64:
    """Derivatives (m, 3, 2) m of the footprint areas by x and y of each corner."""
    p = vertices[triangles, :2]
    edge = p[:, [1, 2, 0]] - p[:, [2, 0, 1]]
    out: F64 = 0.5 * np.stack([edge[..., 1], -edge[..., 0]], axis=-1)
    return out


def prismoids(tin: Tin, base: Plane, mask: Bool | None = None) -> Prismoids:
    """Volumes of the triangles in ``mask`` (m,) (default: the relevant ones) above ``base``.

    Raises :class:`VolumeError` where no triangle is chosen.
    """
    chosen = tin.relevant if mask is None else mask
    triangles = tin.triangles[chosen]
    if len(triangles) == 0:
        raise VolumeError("no triangle lies inside the outline", reason="volume_no_triangle")
    v, xy = tin.vertices, tin.vertices[:, :2]
    height = v[:, 2] - base_height(base, xy)
    slope_base = base_gradient(base, xy)
    X = design(xy, base.origin_xy, degree_of(base))
    area = footprint_areas(v, triangles)
    dA = area_gradient(v, triangles)
    h = height[triangles]
    parts = []
    for mean, slope in (positive_part(h), (h.sum(axis=1) / 3.0, np.full(h.shape, 1.0 / 3.0))):
        corner = np.empty((len(triangles), 3, 3))
        corner[..., :2] = mean[:, None, None] * dA
        corner[..., 2] = slope * area[:, None]
        gradient = gather(corner, triangles, len(v))
        gradient[:, :2] -= gradient[:, 2:] * slope_base
        parts.append((gradient, -(X.T @ gradient[:, 2])))
    (g_cut, b_cut), (g_net, b_net) = parts
    cut, fill = float(area @ positive_part(h)[0]), float(area @ positive_part(-h)[0])
    # fill = cut − net: at a height of exactly zero, where neither has a derivative, the net volume keeps its own
    return Prismoids(cut, fill, float(area.sum()), g_cut, g_cut - g_net, b_cut, b_cut - b_net)


def gather(corner: F64, triangles: I32, n: int) -> F64:
    """Sum per-corner rows (m, 3, k) at their vertices: (n, k); the order of the sum is that of the triangles."""
    index = triangles.ravel()
    rows = corner.reshape(len(index), corner.shape[-1])
    return np.stack([np.bincount(index, rows[:, c], n) for c in range(rows.shape[1])], axis=1)
