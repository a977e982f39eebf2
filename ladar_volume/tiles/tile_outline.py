"""Where the volume of one tile counts: its share of bodies that span tiles, widened so that their
toes are inside.

Parts of a tile's triangles are joined to those of other tiles by the triangles that both know: two
triangles with a common side have a vertex in common, and the tile of that vertex knows both.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.ground.heights import height_above
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, I64, Bool, Plane, Tin
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_of
from ladar_volume.tin.boundary import part_numbers
from ladar_volume.tin.full_tin import any_corner, footprint_areas, vertex_mask

#: x and y low, x and y high, m.
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class TileParts:
    """Parts of some triangles of a tile, joined by sides. count : of parts · corners : (b, 6) of
    the triangles that other tiles know too, m · label : (b,) the part of each · total : (count,)
    of what is asked of each part
    """

    count: int
    corners: F64
    label: I64
    total: F64


def parts_of(surface: TileSurface, label: I64, total: F64) -> TileParts:
    """The parts with labels (m,), -1 for none."""
    tin = surface.tin
    shared = (label >= 0) & any_corner(tin.triangles, ~surface.own)
    xy = tin.vertices[tin.triangles[shared], :2]
    order = np.lexsort((xy[..., 1], xy[..., 0]), axis=1)
    corners = np.take_along_axis(xy, order[..., None], axis=1).reshape(-1, 6)
    return TileParts(len(total), corners, label[shared], total)


def rising_parts(
    of: TiledCloud, tile: Tile, folder: Path, base: Plane, object_height_m: float
) -> TileParts:
    """Parts that rise above a base, and their volumes, m³: labels at rest."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    height = height_above(tin.vertices, base)
    high = tin.relevant & ~any_corner(tin.triangles, ~(height > object_height_m))
    label = np.asarray(part_numbers(tin.neighbours, high), np.int64)
    own = np.flatnonzero(high & surface.counted)
    t = tin.triangles[own]
    volume = footprint_areas(tin.vertices, t) * height[t].mean(axis=1)
    total = np.bincount(label[own], volume, minlength=label.max(initial=-1) + 1).astype(np.float64)
    write(folder, "rising", tile, label)
    return parts_of(surface, label, total)


class Pit(NamedTuple):
    """What lies deeper below a base: its area, m², its first moments (2,), m³, and how deep, m"""

    area_m2: float
    first_m3: F64
    depth_m: float


def pit(of: TiledCloud, tile: Tile, base: Plane, depth_m: float) -> Pit:
    """The triangles of a tile that lie deeper than so much below a base."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    height = height_above(tin.vertices, base)
    falling = tin.relevant & surface.counted & ~any_corner(tin.triangles, ~(height < -depth_m))
    t = tin.triangles[falling]
    area = footprint_areas(tin.vertices, t)
    first = area @ tin.vertices[t, :2].mean(axis=1)
    return Pit(float(area.sum()), first, -float(height[t].min(initial=0.0)))


def box_of(xy: F64) -> Box | None:
    """The box of places (k, 2); None for none."""
    if not len(xy):
        return None
    (x0, y0), (x1, y1) = (corner.tolist() for corner in extent_of(xy))
    return x0, y0, x1, y1


def write_vertices(folder: Path, name: str, tile: Tile, tin: Tin, some: Bool) -> Box | None:
    """Write the places of some vertices (n,) of a tile; returns their box."""
    xy = tin.vertices[some, :2]
    write(folder, name, tile, xy)
    return box_of(xy)


def chosen_parts(label: I64, chosen: Bool) -> Bool:
    """The triangles (m,) of the chosen parts."""
    return np.append(chosen, False)[label]


def body(of: TiledCloud, tile: Tile, folder: Path, chosen: Bool) -> Box | None:
    """The tile's own vertices of the chosen parts, at rest; returns their box."""
    surface = surface_of(of.index, of.limits, tile)
    mask = chosen_parts(read(folder, "rising", tile), chosen)
    some = vertex_mask(surface.tin, mask) & surface.own
    return write_vertices(folder, "body", tile, surface.tin, some)


def near_stored_places(
    xy: F64, folder: Path, name: str, neighbours: Sequence[Tile], distance_m: float
) -> Bool:
    """Which of the places (k, 2) lie within a distance of one at rest of the tiles beside."""
    out = np.zeros(len(xy), np.bool_)
    for tile in neighbours:
        some = read(folder, name, tile)
        left = np.flatnonzero(~out)
        if len(left) == 0:
            break
        bound = 1.001 * distance_m + 1e-6  # the search excludes its bound
        low, high = some.min(axis=0) - bound, some.max(axis=0) + bound
        left = left[((xy[left] > low) & (xy[left] < high)).all(axis=1)]
        if len(left):
            tree = cKDTree(some, balanced_tree=False, compact_nodes=False)
            away = tree.query(xy[left], distance_upper_bound=bound)[0]
            out[left] = np.asarray(away) <= distance_m
    return out


def grow(
    of: TiledCloud,
    tile: Tile,
    folder: Path,
    chosen: Bool,
    neighbours: Sequence[Tile],
    margin_m: float,
) -> TileParts:
    """The chosen parts with the triangles that count within a margin, at rest; and the parts of
    the other triangles, whose totals tell which lead to the edge of what counts.
    """
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    mask = chosen_parts(read(folder, "rising", tile), chosen)
    close = near_stored_places(tin.vertices[:, :2], folder, "body", neighbours, margin_m)
    grown = tin.relevant & (mask | any_corner(tin.triangles, close))
    label = np.asarray(part_numbers(tin.neighbours, ~grown), np.int64)
    leads = (label >= 0) & (~tin.relevant | (tin.neighbours == -1).any(axis=1))
    total = np.bincount(label[leads], minlength=label.max(initial=-1) + 1).astype(np.float64)
    write(folder, "grown", tile, label)
    return parts_of(surface, label, total)


def fill(of: TiledCloud, tile: Tile, folder: Path, holes: Bool) -> tuple[Box | None, bytes]:
    """What grew, with its holes: the triangles inside and their own vertices at rest; returns the
    box of these, and a digest of which triangles of the tile are inside.
    """
    surface = surface_of(of.index, of.limits, tile)
    label = read(folder, "grown", tile)
    inside = (label < 0) | chosen_parts(label, holes)
    write(folder, "inside", tile, inside)
    some = vertex_mask(surface.tin, inside) & surface.own
    counted = inside & surface.counted
    name = hashlib.blake2b(np.packbits(counted).tobytes(), digest_size=16).digest()
    return write_vertices(folder, "outline", tile, surface.tin, some), name


def volume_between(of: TiledCloud, tile: Tile, base: Plane, one: Path, two: Path) -> float:
    """Net volume of a tile above a base, m³, within the second of two outlines less that within the
    first.
    """
    surface = surface_of(of.index, of.limits, tile)
    first, second = (read(folder, "inside", tile) for folder in (one, two))
    corners = surface.tin.triangles[surface.counted & (first != second)]
    height = height_above(surface.tin.vertices, base)[corners].mean(axis=1)
    sign = np.where(second[surface.counted & (first != second)], 1.0, -1.0)
    return float((sign * footprint_areas(surface.tin.vertices, corners)) @ height)


def ring_vertices(
    of: TiledCloud, tile: Tile, folder: Path, neighbours: Sequence[Tile], ring_m: float
) -> int:
    """Which of the tile's vertices that count lie around the outline, at rest; returns how many."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    around = ~vertex_mask(tin, read(folder, "inside", tile))[surface.used]
    if ring_m > 0:
        xy = tin.vertices[surface.used, :2][around]
        around[around] = near_stored_places(xy, folder, "outline", neighbours, ring_m)
    write(folder, "ring", tile, around)
    return int(np.count_nonzero(around))


def reach(of: TiledCloud, tile: Tile) -> Box:
    """The box of all vertices of the triangles of a tile."""
    box = box_of(surface_of(of.index, of.limits, tile).tin.vertices[:, :2])
    return of.index.box[tile] if box is None else box
