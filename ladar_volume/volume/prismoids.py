"""Cut, fill and net volume of a TIN above a base by exact prismoids, with their gradients (seed 000
section 4.1).

Over a triangle the height above the base is linear (a base of degree 2 or 3 is taken at the
vertices). Where it changes sign the triangle is cut along the zero line: the prismoid at the single
vertex i on its side has the volume ``A h_i³ / (3 (h_i − h_j)(h_i − h_k))``. Gradients hold the
triangulation fixed; the footprint moves with the vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.ground.heights import design_products, height_above
from ladar_volume.ground.polynomial import base_gradient, degree_of
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, Bool, Plane, Tin

#: Vertices at which the slope of the base is told at once.
BLOCK = 1 << 16


@dataclass(frozen=True)
class CutFill:
    """Volumes of a surface over something else.

    cut_m3 : above it, fill_m3 : below it, both positive; net = cut − fill · area_m2 : footprint ·
    gradient_cut, gradient_fill : (n, 3) m², by the vertices of the surface in the map frame, the
    triangulation held fixed; (n, 1) where those by the heights alone were asked for.
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
    """Volumes above a base. base_cut, base_fill : (p,), derivatives by the base's coefficients; the
    other gradients follow its formula.
    """

    base_cut: F64
    base_fill: F64

    @property
    def base_net(self) -> F64:
        """Derivative (p,) of the net volume by the base's coefficients."""
        return self.base_cut - self.base_fill


@leaf_kernel
def mean_above(h: F64, slope: F64) -> float:
    """Mean over a triangle of ``max(height, 0)`` for heights h (3,) of its vertices; its
    derivatives by them into slope (3,).
    """
    above = int(h[0] > 0.0) + int(h[1] > 0.0) + int(h[2] > 0.0)
    for c in range(3):
        slope[c] = 1.0 / 3.0 if above == 3 else 0.0
    whole: float = (h[0] + h[1] + h[2]) / 3.0
    if above == 0 or above == 3:
        return whole if above == 3 else 0.0
    # the lone vertex: the one above, or the one not above, whose tip is added to the signed mean
    i = 0
    while (h[i] > 0.0) != (above == 1):
        i += 1
    j, k = (i + 1) % 3, (i + 2) % 3
    dj, dk = h[i] - h[j], h[i] - h[k]
    tip: float = h[i] * (h[i] / dj) * (h[i] / dk) / 3.0
    slope[i], slope[j], slope[k] = (
        (h[i] / dj) * (h[i] / dk) - tip / dj - tip / dk,
        tip / dj,
        tip / dk,
    )
    if above == 1:
        return tip
    for c in range(3):  # mean of the positive part = signed mean + size of the tip below
        slope[c] = 1.0 / 3.0 - slope[c]
    return whole - tip


@kernel
def means_above(h: F64) -> tuple[F64, F64]:
    """See :func:`positive_part`."""
    mean, slope = np.empty(len(h)), np.empty((len(h), 3))
    for t in range(len(h)):
        mean[t] = mean_above(h[t], slope[t])
    return mean, slope


def positive_part(h: F64) -> tuple[F64, F64]:
    """Mean over a triangle of ``max(height, 0)`` for vertex heights h (m, 3): means (m,) and
    derivatives (m, 3) by h.
    """
    mean, slope = means_above(np.ascontiguousarray(h))
    return mean, slope


@kernel
def prismoid_kernel(
    vertices: F64, triangles: I32, chosen: Bool, height: F64, cut: F64, net: F64
) -> F64:
    """Cut, fill, footprint (3,) of the ``chosen`` triangles (m,) over vertices (n, 3) that stand so
    high (n,) above a base. Adds the gradients by the vertices to cut and net (n, 3), those by their
    heights alone to such of (n, 1), the base held fixed at each.
    """
    d, total = cut.shape[1], np.zeros(3)
    h, below, slope, other = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for t in range(len(triangles)):
        if not chosen[t]:
            continue
        for c in range(3):
            h[c] = height[triangles[t, c]]
            below[c] = -h[c]
        a, b, e = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        area = 0.5 * ((b[0] - a[0]) * (e[1] - a[1]) - (b[1] - a[1]) * (e[0] - a[0]))
        up, whole = mean_above(h, slope), (h[0] + h[1] + h[2]) / 3.0
        total[0] += area * up
        total[1] += area * mean_above(below, other)
        total[2] += area
        for c in range(3):
            v = triangles[t, c]
            cut[v, d - 1] += slope[c] * area
            net[v, d - 1] += area / 3.0
            if d == 1:
                continue
            one, two = vertices[triangles[t, (c + 1) % 3]], vertices[triangles[t, (c + 2) % 3]]
            east, north = (
                0.5 * (one[1] - two[1]),
                0.5 * (two[0] - one[0]),
            )  # of the area, by the corner's x and y
            cut[v, 0] += up * east
            cut[v, 1] += up * north
            net[v, 0] += whole * east
            net[v, 1] += whole * north
    return total


def prismoids(tin: Tin, base: Plane, mask: Bool | None = None, sideways: bool = True) -> Prismoids:
    """Volumes of the triangles in ``mask`` (m,) (default: the relevant ones) above ``base``; unless
    ``sideways``, the gradients are those by the heights alone, (n, 1).

    Raises :class:`VolumeError` where no triangle is chosen.
    """
    chosen = tin.relevant if mask is None else mask
    if not chosen.any():
        raise VolumeError("no triangle lies inside the outline", reason="volume_no_triangle")
    v = tin.vertices
    g_cut, g_net = (large_zeros((len(v), 3 if sideways else 1)) for _ in range(2))
    cut, fill, area = prismoid_kernel(v, tin.triangles, chosen, height_above(v, base), g_cut, g_net)
    b_cut, b_net = (
        -design_products(v, base.origin_xy, degree_of(base), g[:, -1:])[:, 0]
        for g in (g_cut, g_net)
    )
    for first in range(0, len(v) if sideways else 0, BLOCK):
        some = slice(first, first + BLOCK)
        slope_base = base_gradient(base, v[some, :2])
        for gradient in (g_cut[some], g_net[some]):
            gradient[:, :2] -= gradient[:, 2:] * slope_base
    # fill = cut − net: at a height of exactly zero, where neither has a derivative, the net volume
    # keeps its own
    g_fill = np.subtract(g_cut, g_net, out=g_net)
    return Prismoids(float(cut), float(fill), float(area), g_cut, g_fill, b_cut, b_cut - b_net)


def gather(corner: F64, triangles: I32, n: int) -> F64:
    """Sum per-corner rows (m, 3, k) at their vertices: (n, k); the order of the sum is that of the
    triangles.
    """
    out = np.zeros((n, corner.shape[2]))
    gather_kernel(corner, triangles, out)
    return out


@kernel
def gather_kernel(corner: F64, triangles: I32, out: F64) -> None:
    """See :func:`gather`."""
    for t in range(len(triangles)):
        for k in range(3):
            for c in range(out.shape[1]):
                out[triangles[t, k], c] += corner[t, k, c]
