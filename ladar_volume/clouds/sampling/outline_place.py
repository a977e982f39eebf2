"""Where the sampled area ends, and what that does to a volume.

The last points stand inside what was surveyed. Beyond an open side of length l a strip of width w
was empty; where points lie at random, with an area a to each, that has the probability
exp(-w l / a): the strip is a / l wide in the mean, and its area is a, whatever l. Points in lines
and grids make sides as short as their spacing, which then is the width. Many points just inside a
long side are a line of that kind, so flat triangles at the outline are passed over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, Bool, Tin
from ladar_volume.tin.boundary import part_numbers, side_ends
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.sampled_area import SampledArea

#: Directions in which an outline is told apart.
DIRECTIONS = 8
#: A triangle is flat below this share of the area of a point.
FLAT = 0.05


@kernel
def cell_kernel(triangles: I32, area: F64, mask: Bool, least: float, n: int) -> F64:
    """Area (n,) to each of n vertices of triangles (m, 3): twice the mean of those around it, of
    which the ones below ``least`` do not count.
    """
    out, count = np.zeros(n), np.zeros(n)
    for t in range(len(triangles)):
        if mask[t] and area[t] > least:
            for k in range(3):
                out[triangles[t, k]] += 2.0 * area[t]
                count[triangles[t, k]] += 1.0
    return out / np.maximum(count, 1.0)


def open_sides(tin: Tin, mask: Bool) -> Bool:
    """The sides (m, 3) of triangles (m,) beyond which no surface is."""
    beyond = tin.neighbours
    return np.asarray(mask[:, None] & ((beyond == -1) | ((beyond >= 0) & ~tin.relevant[beyond])))


@dataclass(frozen=True)
class EdgeTriangles:
    """Triangles of a surface at the edge of what was sampled. area : (m,) m² of those that count, 0
    of others · cell : (n,) m², area to each vertex · flat : (m,) those that count and are flat ·
    open : (m, 3) their sides, and those of the others that count, beyond which no surface is
    """

    area: F64
    cell: F64
    flat: Bool
    open: Bool

    @classmethod
    def of(cls, tin: Tin, mask: Bool, median_m2: float) -> EdgeTriangles:
        """Of triangles (m,), whose area in the median is given."""
        area = np.where(mask, footprint_areas(tin.vertices, tin.triangles), 0.0)
        least = 0.5 * FLAT * median_m2
        cell = np.asarray(cell_kernel(tin.triangles, area, mask, least, len(tin.vertices)))
        flat = mask & (2.0 * area < FLAT * cell[tin.triangles].mean(axis=1))
        return cls(area, cell, flat, open_sides(tin, mask))

    def along(self, tin: Tin) -> Bool:
        """The flat triangles (m,) that lie along the edge: those with an open side, and all that
        are joined to them.
        """
        part = part_numbers(tin.neighbours, self.flat)
        at = np.flatnonzero(self.flat & self.open.any(axis=1))
        found = np.zeros(int(part.max(initial=-1)) + 2, np.bool_)
        found[part[at]] = True
        out: Bool = found[part]
        return out

    def sides(self, tin: Tin, mask: Bool, gone: Bool) -> I32:
        """The sides (s, 2) of the edge, the surface to their left, without the flat triangles
        ``gone`` (m,) of the mask (m,) that lie along it.
        """
        beyond = tin.neighbours
        edge = (mask & ~gone)[:, None] & (self.open | ((beyond >= 0) & gone[beyond]))
        t, k = np.nonzero(edge)
        return side_ends(tin, t, k)


def outline_variance(tin: Tin, mask: Bool, height: F64, areas: list[SampledArea | None]) -> float:
    """Variance, m⁶, of the volume of triangles (m,) by the place of their open sides; height (n,) m
    of the vertices above the base · areas : those that were sampled; 0 where one of them was not
    told from the points.

    Beyond each side lies a strip of the area of one point, which errs alike all along the outline;
    where the surface is below the base on one side and above it on another, in each direction
    alone.
    """
    told = [a for a in areas if a is not None and np.isfinite(a.spacing_m)]
    if len(told) < len(areas) or not mask.any():
        return 0.0
    median = float(np.median(footprint_areas(tin.vertices, tin.triangles[mask])))
    return strip_variance(strips_of(tin, mask, height, median))


def strip_variance(each: F64) -> float:
    """The variance, m⁶, from what the strips hold by direction (:data:`DIRECTIONS`,), m³."""
    return max(float(each.sum()) ** 2, float(each @ each))


def strips_of(tin: Tin, mask: Bool, height: F64, median_m2: float) -> F64:
    """What the strips beyond the open sides of triangles (m,) hold by direction
    (:data:`DIRECTIONS`,), m³. height : (n,) m of the vertices above the base · median_m2 : area of
    a triangle that counts
    """
    edge = EdgeTriangles.of(tin, mask, median_m2)
    sides = edge.sides(tin, mask, edge.along(tin))
    return strip_sums(tin.vertices, edge.cell, height, sides)


def strip_sums(vertices: F64, cell: F64, height: F64, ends: I32) -> F64:
    """The same of sides (s, 2). cell : (n,) m², area to each vertex"""
    d = vertices[ends[:, 1], :2] - vertices[ends[:, 0], :2]
    strip = cell[ends].mean(axis=1) * height[ends].mean(axis=1)
    turn = np.arctan2(d[:, 1], d[:, 0]) / (2.0 * np.pi)
    direction = np.floor((turn % 1.0) * DIRECTIONS).astype(np.int64) % DIRECTIONS
    return np.bincount(direction, strip, minlength=DIRECTIONS).astype(np.float64)
