"""What the strays of all tiles would change in a volume:
:mod:`ladar_volume.clouds.sampling.stray_effect` by tiles. A triangle with or without them belongs
to the tile of its first corner.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from ladar_volume.clouds.sampling.stray_effect import AROUND, effect_about
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.tiles.cleaning.cleaned_tiles import CleanedTiles, strays_in
from ladar_volume.tiles.cleaning.curve_tiles import around_tile
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_patch import inside_of, joined, parts_beside, whole_part
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tin.full_tin import footprint_areas


def tiled_effect(workers: Workers, of: TiledCloud, outline: Path | None, base: Plane) -> float:
    """Net volume without strays less that with them, m³, above a base and within an outline; of
    tiles whose strays were left out.
    """
    found = np.array(ask(workers, of, relevant_area))
    spacing = math.sqrt(2.0 * math.fsum(found[:, 0]) / max(found[:, 1].sum(), 1.0))
    more = [(outline, base, spacing)] * len(of.tiles)
    return math.fsum(ask(workers, of, effect_here, more))


def relevant_area(of: TiledCloud, tile: Tile) -> tuple[float, int]:
    """Area, m², of the triangles of a tile that count, and how many these are."""
    surface = surface_of(of.index, of.limits, tile)
    own = surface.tin.triangles[surface.tin.relevant & surface.counted]
    return float(footprint_areas(surface.tin.vertices, own).sum()), len(own)


def effect_here(
    of: TiledCloud, tile: Tile, outline: Path | None, base: Plane, spacing_m: float
) -> float:
    """What the triangles of a tile give to it, m³."""
    index = of.index.every_point
    assert isinstance(index, CleanedTiles)
    strays = strays_in(index, around_tile(of, tile, AROUND * spacing_m))
    if not len(strays):
        return 0.0
    surface = surface_of(of.index, of.limits, tile)
    parts = [whole_part(surface, inside_of(surface, tile, outline))]
    parts += parts_beside(of, tile, around_tile(of, tile, 2.5 * AROUND * spacing_m), outline)
    patch, _ = joined(parts)
    tin = dataclasses.replace(patch.tin, relevant=patch.relevant)
    area = np.where(patch.inside, footprint_areas(tin.vertices, tin.triangles), 0.0)

    def own(xy: F64) -> Bool:
        return np.asarray((np.floor(xy / of.index.cloud.tile_m) == tile).all(axis=1))

    return effect_about(tin, area, strays, base, spacing_m, own)
