"""A brute-force twin of the published volumes: vertical rays through the exact linear
interpolation, nothing of the package's geometry.

Qhull triangulates the vertices (with the map's corners), rays fall on a fine grid with one random
place per cell, so that the sum is unbiased and its error follows from the differences of
neighbouring rays. Heights adjusted to all points come from LSQR on the barycentric coordinates that
Qhull's own search gives.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsqr
from scipy.spatial import Delaunay


class Surface:
    """Linear interpolation over the Delaunay triangles of vertices (n, 3) that meet no corner of
    the map of ``points``.
    """

    def __init__(self, vertices, points, adjust):
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        self.middle = 0.5 * (low + high)
        self.tri = Delaunay(np.r_[vertices[:, :2], corners] - self.middle)
        self.good = (self.tri.simplices < len(vertices)).all(axis=1)
        self.low, self.high = low - self.middle, high - self.middle
        z = vertices[:, 2]
        if adjust:
            # the search may name any triangle about a vertex, also one that does not count: a
            # vertex is its own row
            used = np.unique(self.tri.simplices[self.good])
            own = np.isin(points[:, 0] + 1j * points[:, 1], vertices[:, 0] + 1j * vertices[:, 1])
            cell, weight = self.where(points[:, :2] - self.middle)
            inside = np.flatnonzero((cell >= 0) & ~own)
            row = np.r_[np.repeat(np.arange(len(inside)), 3), len(inside) + np.arange(len(used))]
            column = np.r_[self.tri.simplices[cell[inside]].ravel(), used]
            B = csr_array(
                (np.r_[weight[inside].ravel(), np.ones(len(used))], (row, column)),
                shape=(len(inside) + len(used), len(z)),
            )
            z = z + lsqr(B, np.r_[points[inside, 2], z[used]] - B @ z, atol=1e-12, btol=1e-12)[0]
        self.z = np.r_[z, np.zeros(4)]

    def where(self, xy):
        """Triangle (n,) and barycentric coordinates (n, 3) of points; −1 off the footprint."""
        cell = self.tri.find_simplex(xy)
        cell = np.where((cell >= 0) & self.good[cell], cell, -1)
        T = self.tri.transform[cell]
        first = np.einsum("nij,nj->ni", T[:, :2], xy - T[:, 2])
        return cell, np.c_[first, 1.0 - first.sum(axis=1)]

    def heights(self, xy):
        """Heights (n,) at positions, NaN off the footprint."""
        cell, weight = self.where(xy - self.middle)
        return np.where(cell >= 0, (weight * self.z[self.tri.simplices[cell]]).sum(axis=1), np.nan)

    def rays(self, step, rng):
        """Two random places in each cell of a grid over the map: (2, n, 2)."""
        size = self.high - self.low
        n = np.ceil(size / step).astype(int)
        corner = np.stack([g.ravel() for g in np.meshgrid(*(np.arange(k) for k in n))], axis=1)
        return (corner + rng.random((2, len(corner), 2))) * step + self.low + self.middle

    def area(self):
        """Area of the footprint, from its triangles' corners."""
        p = self.tri.points[self.tri.simplices[self.good]]
        return 0.5 * np.abs(np.linalg.det(p[:, 1:] - p[:, :1])).sum()

    def integral(self, level, step, rng):
        """∫(z − level) over the footprint by two stratified samples, and the error of their mean.
        Rays only see the heights about their mean: the rest of it is the footprint times the depth
        of the level.
        """
        z = np.array([self.heights(xy) for xy in self.rays(step, rng)])
        middle = float(np.nanmean(z))
        d = np.nan_to_num(z - middle, nan=0.0)
        value = step**2 * d.mean(axis=0).sum() + (middle - level) * self.area()
        return value, 0.5 * step**2 * np.sqrt(((d[0] - d[1]) ** 2).sum())


def cut_difference(vertices, points, level, adjust, step, rng):
    """Volume with minus without, and its error, from cut volumes above a level below everything: of
    (with, without) pairs.
    """
    a, b = (
        Surface(v, p, adjust).integral(level, step, rng)
        for v, p in zip(vertices, points, strict=True)
    )
    return a[0] - b[0], float(np.hypot(a[1], b[1]))


def fill_difference(vertices, points, level, adjust, step, rng):
    """Volume by fill below a level, without minus with, and its error; the cut above the level by
    rays, the rest as in a cut.
    """
    out = []
    for v, p in zip(vertices, points, strict=True):
        surface = Surface(v, p, adjust)
        net, error = surface.integral(level, step, rng)
        above = [
            np.nan_to_num(np.maximum(surface.heights(xy) - level, 0.0), nan=0.0)
            for xy in surface.rays(step, rng)
        ]
        out.append(
            (
                step**2 * np.mean(above, axis=0).sum() - net,
                error,
                0.5 * step**2 * np.sqrt(((above[0] - above[1]) ** 2).sum()),
            )
        )
    return out[1][0] - out[0][0], float(np.linalg.norm([o[1:] for o in out]))
