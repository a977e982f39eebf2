"""Where the sampled area ends, and what that does to a volume.

The last points stand inside what was surveyed. Beyond an open side of length l a strip of width w
was empty; where points lie at random, with an area a to each, that has the probability
exp(-w l / a): the strip is a / l wide in the mean, and its area is a, whatever l. Points in lines
and grids make sides as short as their spacing, which then is the width. Many points just inside a
long side are a line of that kind, so flat triangles at the outline are passed over.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.boundary import border, boundary_sides
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


@kernel
def fine_kernel(
    triangles: I32, neighbours: I32, mask: Bool, area: F64, cell: F64, t: I64, k: I64
) -> I32:
    """Sides (s, 2) of the outline, from those opposite corners k (b,) of triangles t (b,), with the
    other two sides of every flat triangle in the place of its first.
    """
    out = np.empty((len(t) + 2 * len(triangles), 2), np.int32)
    gone = np.zeros(len(triangles), np.bool_)
    stack = np.empty(len(t) + 2 * len(triangles), np.int64)
    count, top = 0, len(t)
    for i in range(len(t)):
        stack[i] = 3 * t[i] + k[i]
    while top > 0:
        top -= 1
        here, corner = stack[top] // 3, stack[top] % 3
        a, b = triangles[here, (corner + 1) % 3], triangles[here, (corner + 2) % 3]
        if gone[here] or 2.0 * area[here] >= FLAT * 0.5 * (cell[a] + cell[b]):
            out[count, 0], out[count, 1] = a, b
            count += 1
            continue
        gone[here] = True
        for j in range(1, 3):
            c = (corner + j) % 3
            beyond = neighbours[here, c]
            if beyond < 0 or not mask[beyond]:
                continue  # a side of the outline itself
            for s in range(3):
                if neighbours[beyond, s] == here:
                    stack[top] = 3 * beyond + s
                    top += 1
    return out[:count].copy()


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


def strips_of(tin: Tin, mask: Bool, height: F64, median_m2: float, own: Bool | None = None) -> F64:
    """What the strips beyond the open sides of triangles (m,) hold by direction
    (:data:`DIRECTIONS`,), m³. height : (n,) m of the vertices above the base · median_m2 : area of
    a triangle that counts · own : (n,) vertices; only sides whose first end by x, then y is one of
    them count
    """
    is_open = border(tin, mask)[2]
    t, k = (side[is_open] for side in boundary_sides(tin, mask))
    area = np.where(mask, footprint_areas(tin.vertices, tin.triangles), 0.0)
    least = 0.5 * FLAT * median_m2
    cell = np.asarray(cell_kernel(tin.triangles, area, mask, least, len(tin.vertices)))
    ends = np.asarray(fine_kernel(tin.triangles, tin.neighbours, mask, area, cell, t, k))
    if own is not None:
        a, b = (tin.vertices[ends[:, j], :2] for j in (0, 1))
        second = (b[:, 0] < a[:, 0]) | ((b[:, 0] == a[:, 0]) & (b[:, 1] < a[:, 1]))
        ends = ends[own[np.where(second, ends[:, 1], ends[:, 0])]]
    d = tin.vertices[ends[:, 1], :2] - tin.vertices[ends[:, 0], :2]
    strip = cell[ends].mean(axis=1) * height[ends].mean(axis=1)
    turn = np.arctan2(d[:, 1], d[:, 0]) / (2.0 * np.pi)
    direction = np.floor((turn % 1.0) * DIRECTIONS).astype(np.int64) % DIRECTIONS
    return np.bincount(direction, strip, minlength=DIRECTIONS).astype(np.float64)
