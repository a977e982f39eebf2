"""Triangles that bridge what was not sampled, and the edge of what was, of all tiles: what may lie
there, to what one process gives.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.between_points import bridged_deviation
from ladar_volume.clouds.sampling.outline_place import DIRECTIONS, strip_variance, strips_of
from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.tiles.array_file import read
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged
from ladar_volume.tiles.tile_patch import inside_of, patch_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_ranks import median_of_tiles
from ladar_volume.tiles.unseen.tiled_gaps import FoundGaps
from ladar_volume.tin.full_tin import footprint_areas

#: Edges from a tile's own vertices within which the triangles along the edge are known.
EDGES = 4


class Bridged(NamedTuple):
    """hidden_m3 : what may lie under the triangles that bridge what was not sampled, but for gaps
    whose surface is told · bridged_m2, inside_m2 : area of these triangles, and of all inside
    """

    hidden_m3: float
    bridged_m2: float
    inside_m2: float


def bridged_of(fitter: GroundFitter, outline: Path | None, base: Plane, gaps: FoundGaps) -> Bridged:
    """Of all tiles."""
    more = [(outline, base, gaps.folder, told) for told in gaps.told]
    found = np.array(ask(fitter.workers, fitter.of, bridged_of_tile, more))
    return Bridged(*(math.fsum(found[:, k]) for k in range(3)))


def bridged_of_tile(
    of: TiledCloud, tile: Tile, outline: Path | None, base: Plane, folder: Path, told: Bool
) -> Bridged:
    """Of a tile; ``told`` : of which of its parts (p,) that are too wide the surface is told."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    inside = inside_of(surface, tile, outline) & surface.counted
    area = np.where(inside, footprint_areas(tin.vertices, tin.triangles), 0.0)
    bridged = surface.bridged & inside
    own = bridged.copy()
    if len(told):
        own &= ~np.append(told, False)[read(folder, "wide", tile)]
    hidden = bridged_deviation(tin, area, height_above(tin.vertices, base), own)
    return Bridged(hidden, float(area[bridged].sum()), float(area.sum()))


def outline_of(fitter: GroundFitter, outline: Path | None, base: Plane) -> float:
    """Variance, m⁶, of the volume by the place of the edge of what was sampled:
    :func:`~ladar_volume.clouds.sampling.outline_place.outline_variance`.
    """
    median = median_of_tiles(fitter.workers, fitter.of, areas_inside, outline)
    more = [(outline, base, median)] * len(fitter.of.tiles)
    return strip_variance(ask_merged(fitter.workers, fitter.of, strips, more))


def areas_inside(of: TiledCloud, tile: Tile, outline: Path | None) -> F64:
    """Areas (k,) m² of the tile's triangles inside the outline."""
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline) & surface.counted
    return footprint_areas(surface.tin.vertices, surface.tin.triangles[inside])


def strips(of: TiledCloud, tile: Tile, outline: Path | None, base: Plane, median_m2: float) -> F64:
    """What strips beyond the sides of the outline hold, m³, by direction (DIRECTIONS,): of those
    whose first end by x, then y is a vertex of the tile.
    """
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline)
    beyond = surface.tin.neighbours
    outside = (beyond == -1) | ((beyond >= 0) & ~surface.tin.relevant[beyond])
    if not (inside[:, None] & outside).any():
        return np.zeros(DIRECTIONS)
    patch = patch_of(of, tile, surface, outline, EDGES)
    mine = np.zeros(len(patch.tin.vertices), np.bool_)
    mine[patch.own] = True
    height = height_above(patch.tin.vertices, base)
    tin = dataclasses.replace(patch.tin, relevant=patch.relevant)
    return strips_of(tin, patch.inside, height, median_m2, mine)
