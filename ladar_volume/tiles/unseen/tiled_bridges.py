"""Triangles that bridge what was not sampled, of all tiles: what may lie under them, to what one
process gives.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.between_points import bridged_deviation
from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import Bool, Plane
from ladar_volume.tiles.array_file import read
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tiled_gaps import FoundGaps
from ladar_volume.tin.full_tin import footprint_areas


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
