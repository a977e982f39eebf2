"""What lies between the points: how far a surface may be from the truth where nothing was measured,
told from what becomes of it when points are left out.

One point is kept of each cell that is wider than the spacing; the volume of the coarser surface
differs, cell by cell. Where a step crosses the cells at random the differences are independent and
their variance goes with the cube of the spacing (as for pixel counts along an edge); where the
surface is curved they add up, with its square (the chord of a parabola). Both are taken back to the
spacing of all points. What the noise of the points does to the differences is taken off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.cloud_noise import thinned
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.locate import barycentric, locate, triangle_index
from ladar_volume.tin.relevant import circumdiameters
from ladar_volume.tin.sampled_area import FEWEST, spacings

#: Cells of the coarser surface, in spacings; blocks of differences, in such cells.
CELL, BLOCK = 1.5, 3.0
#: Places in a triangle, and their weights: exact for quadratics.
PLACES = np.array([(1, 1, 1), (3, 0, 0), (0, 3, 0), (0, 0, 3)]) / 3.0
WEIGHTS = np.array([9, 1, 1, 1]) / 12.0


@dataclass(frozen=True)
class BetweenPoints:
    """random_m6 : variance of the volume from steps between points · drift_m3 : what curvature
    between them may do to it, all in one direction · coarser : how many times the spacing of the
    coarser surface is that of the points
    """

    random_m6: float
    drift_m3: float
    coarser: float

    @property
    def variance_m6(self) -> float:
        """Both, as a variance."""
        return self.random_m6 + self.drift_m3**2


def thinned_by_spacing(points: F64) -> I64:
    """Rows (k,) of points (n, 3): one of each cell of 1.5 spacings."""
    spacing = spacings(points[:, :2])
    out = []
    for size in np.unique(spacing[np.isfinite(spacing)]).tolist():
        own = np.flatnonzero(spacing == size)
        out.append(own[thinned(points[own], CELL * size)])
    return np.concatenate(out) if out else np.zeros(0, np.int64)


def wide(tin: Tin, area: F64) -> float:
    """Circumdiameter, m, that half of an area (m,) m² of triangles is below."""
    size = circumdiameters(tin)
    order = np.argsort(size)
    share = np.cumsum(area[order])
    return float(size[order][min(np.searchsorted(share, share[-1] / 2), len(size) - 1)])


def between_points(surface: CloudSurface, inside: F64) -> BetweenPoints | None:
    """What lies between the points of a surface within an outline; ``inside`` (m,) m² is the area of
    each triangle in it. None where the points are too few to tell.
    """
    tin = surface.made.tin
    kept = thinned_by_spacing(tin.vertices)
    if len(kept) < FEWEST // 4:
        return None
    coarse = build_tin(tin.vertices[kept])
    own = np.flatnonzero(inside > 0)
    corners = tin.triangles[own]
    index = triangle_index(coarse, np.ones(len(coarse.triangles), bool))
    differences, gradient = np.zeros(len(own)), np.zeros(len(tin.vertices))
    covered = np.zeros(len(coarse.triangles))
    for place, weight in zip(PLACES, WEIGHTS, strict=True):
        p = np.einsum("k,mkc->mc", place, tin.vertices[corners])
        where = locate(index, p[:, :2])
        some = np.flatnonzero(where >= 0)
        b = barycentric(coarse, where[some], p[some, :2])
        vertex = kept[coarse.source[coarse.triangles[where[some]]]]
        part = weight * inside[own[some]]
        differences[some] += part * (p[some, 2] - (b * tin.vertices[vertex, 2]).sum(axis=1))
        gradient += np.bincount(vertex.ravel(), (-part[:, None] * b).ravel(), len(gradient))
        np.add.at(gradient, corners[some], part[:, None] * place)
        covered += np.bincount(where[some], part, len(covered))
    coarser = wide(coarse, covered) / max(wide(tin, inside), 1e-300)
    if not coarser > 1.2:
        return None
    noise = noise_of(surface, gradient)
    return told(differences, tin.vertices[corners, :2].mean(axis=1), coarse, noise, coarser, covered)


def noise_of(surface: CloudSurface, gradient: F64) -> float:
    """Variance, m⁶, that the noise gives a result with a gradient (n,) by the vertex heights, each
    with the noise of its own point.
    """
    if surface.sigma_m is None:
        return 0.0
    source = surface.made.tin.source
    sigma = np.where(source >= 0, surface.sigma_m[source], 0.0)
    return float(((gradient * sigma) ** 2).sum())


def told(
    differences: F64, places: F64, coarse: Tin, noise_m6: float, coarser: float, covered: F64
) -> BetweenPoints:
    """Both parts from the differences (k,) m³ of the triangles at places (k, 2)."""
    size = BLOCK * wide(coarse, covered)
    cell = np.floor((places - places.min(axis=0)) / size).astype(np.int64)
    number = np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
    block = np.bincount(number, differences)
    squares, total = float((block**2).sum()), float(block.sum())
    random = max(squares - noise_m6, 0.0) / (coarser**3 - 1.0)
    drift = math.sqrt(max(total**2 - max(squares, noise_m6), 0.0)) / (coarser**2 - 1.0)
    return BetweenPoints(random, drift, coarser)


def in_holes(surface: CloudSurface, mask: Bool) -> float:
    """Area, m², of the triangles of the mask (m,) that bridge holes of the sampled area."""
    found = surface.made.sampled
    tin = surface.made.tin
    if found is None or len(found.in_hole) != len(tin.triangles):
        return math.nan if found is None else found.hole_m2
    return float(footprint_areas(tin.vertices, tin.triangles)[mask & found.in_hole].sum())
