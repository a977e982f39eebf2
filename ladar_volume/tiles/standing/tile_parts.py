"""What a tile knows of a thinned surface that steep steps cut apart: its parts, the steps between
them, and which of its vertices stand on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.clouds.sampling.cloud_objects import beside
from ladar_volume.clouds.sampling.object_search import Located, Ring
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import at_rest, read, read_arrays, write, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import TileParts
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of
from ladar_volume.tin.full_tin import any_corner, footprint_areas, vertex_mask
from ladar_volume.volume.field_checks.standing_objects import between_parts, cut_apart


@dataclass(frozen=True)
class TileSteps:
    """parts : of vertices, with how many of each lie in the tile, joined to those of others by the
    vertices that both know · first : (count,) the least row of each · low, high, times : (k,) the
    parts between which steps lead, and how many, of the triangles that belong to the tile
    """

    parts: TileParts
    first: I64
    low: I64
    high: I64
    times: I64


def step_parts(
    of: TiledCloud, tile: Tile, folder: Path, longest_m: float, step_m: float
) -> TileSteps:
    """The parts of a tile, their labels at rest, and its steps. longest_m : of edges that join"""
    surface = surface_of(of.index, of.limits, tile)
    tin, own = surface.tin, surface.own
    cut = cut_apart(tin, longest_m, step_m, surface.counted)
    write(folder, "part", tile, cut.label)
    n = int(cut.label.max(initial=-1)) + 1
    total = np.bincount(cut.label[own], minlength=n).astype(np.float64)
    first = np.full(n, np.iinfo(np.int64).max)
    np.minimum.at(first, cut.label[own], surface.row[own])
    known = vertex_mask(tin, any_corner(tin.triangles, ~own))  # by other tiles, too
    xy = tin.vertices[known, :2] + 0.0
    parts = TileParts(n, xy, cut.label[known], total)
    once, size = np.ones(len(cut.low), np.int64), np.zeros(n, np.int64)
    steps = between_parts(cut.label[cut.low], cut.label[cut.high], once, size)
    return TileSteps(parts, first, steps.low, steps.high, steps.times)


def vertices_of_bodies(of: TiledCloud, tile: Tile, folder: Path, outline: Path, body: I64) -> I64:
    """How many vertices of the tile are of a body and of a part: (k, 3) of the body, the part, and
    their number. body : (count,) that of each part that rises above the base, -1 for none
    """
    surface, label = surface_of(of.index, of.limits, tile), read(folder, "part", tile)
    rising = np.append(body, -1)[read(outline, "rising", tile)]
    some = np.flatnonzero(rising >= 0)
    pairs = np.column_stack([np.repeat(rising[some], 3), surface.tin.triangles[some].reshape(-1)])
    pairs = np.unique(pairs[surface.own[pairs[:, 1]]], axis=0)
    named = np.column_stack([pairs[:, 0], label[pairs[:, 1]]])
    each, count = np.unique(named, axis=0, return_counts=True)
    return np.column_stack([each, count]).astype(np.int64)


def hidden_area(
    of: TiledCloud, tile: Tile, folder: Path, outline: Path | None, stands: Bool
) -> F64:
    """What lies inside the outline and has a vertex of the parts (count,) that stand, and all that
    lies inside, m² (2,).
    """
    surface = surface_of(of.index, of.limits, tile)
    standing = stands[read(folder, "part", tile)]
    counted = inside_of(surface, tile, outline) & surface.counted
    area = footprint_areas(surface.tin.vertices, surface.tin.triangles)
    over = counted & any_corner(surface.tin.triangles, standing)
    return np.array([area[over].sum(), area[counted].sum()])


def mark(of: TiledCloud, tile: Tile, folder: Path, outline: Path | None, stands: Bool) -> Located:
    """The tile's own vertices that stand; all of its own at rest, with that, and whether they are
    inside the outline.
    """
    surface = surface_of(of.index, of.limits, tile)
    own = np.flatnonzero(surface.own)
    standing = stands[read(folder, "part", tile)][own]
    counted = vertex_mask(surface.tin, inside_of(surface, tile, outline))[own]
    row, places = surface.row[own], surface.tin.vertices[own]
    arrays = {"row": row, "places": places, "standing": standing, "counted": counted}
    write_arrays(at_rest(folder, "marked", tile), arrays)
    return Located(row[standing], places[standing])


def ring_in_tile(
    of: TiledCloud, tile: Tile, folder: Path, there: F64, cell_m: float, low: F64
) -> Ring:
    """The tile's own vertices in or beside the cells, of a raster from a corner low (2,) m, that
    places ``there`` (m, 2) m lie in.
    """
    found = read_arrays(at_rest(folder, "marked", tile))
    near = np.zeros(0, np.int64)
    if len(there):
        near = beside(found["places"][:, :2], there, cell_m, low)
    located = Located(found["row"][near], found["places"][near])
    return Ring(located, found["standing"][near], found["counted"][near])


def ring_count(
    of: TiledCloud, tile: Tile, folder: Path, there: F64, cell_m: float, low: F64
) -> int:
    """How many these are."""
    return len(ring_in_tile(of, tile, folder, there, cell_m, low).standing)


def rows_beside(of: TiledCloud, tile: Tile, there: F64, cell_m: float, low: F64) -> Located:
    """The same of all points of a tile."""
    if not len(there):
        return Located(np.zeros(0, np.int64), np.zeros((0, 3)))
    points = of.index.points(tile)
    near = beside(points[:, :2], there, cell_m, low)
    return Located(of.index.rows(tile)[near], points[near])


def count_beside(of: TiledCloud, tile: Tile, there: F64, cell_m: float, low: F64) -> int:
    """How many these are."""
    return len(rows_beside(of, tile, there, cell_m, low).rows)
