"""What one tile knows of the sampled area: which of its triangles are reached from the hull through
long sides, and which points stand alone outside what is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import read, write, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import TileParts, parts_of
from ladar_volume.tiles.tile_patch import names_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import (
    COUNTS,
    EVERY,
    SAMPLED,
    counted_of,
    counts_path,
    surface_of,
    used_of,
)
from ladar_volume.tiles.unseen.tile_spacing import Rasters
from ladar_volume.tin.boundary import part_numbers
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.sampled_area import ALONE, FEWEST, Corners, open_parts, wide_kernel


@dataclass(frozen=True)
class AreaTask:
    """rasters : that tell how far apart the points lie · folder : where what is told is at rest"""

    rasters: Rasters
    folder: Path

    def spacing(self, tile: Tile) -> F64:
        """How far apart points lie around the vertices (n,) of a tile, m."""
        return read(self.folder, "spacing", tile)


class OpenTile(NamedTuple):
    """parts : of triangles joined through long sides, with their areas · sums : (k, 3) as
    :class:`~ladar_volume.tin.sampled_area.OpenParts` has them · known : how many of the tile's
    vertices show a spacing
    """

    parts: TileParts
    sums: F64
    known: int


def open_tile(of: TiledCloud, tile: Tile, task: AreaTask) -> OpenTile:
    """The parts of a tile that may be open to the hull, at rest."""
    surface = surface_of(of.index, EVERY, tile)
    tin = surface.tin
    axes = task.rasters.axes
    spacing = task.rasters.spacings(axes.along(np.ascontiguousarray(tin.vertices[:, :2])))
    write(task.folder, "spacing", tile, spacing)
    area = np.maximum(footprint_areas(tin.vertices, tin.triangles), 0.0)
    found = open_parts(tin, spacing, np.where(surface.counted, area, 0.0), surface.own)
    label = found.number.astype(np.int64)
    write(task.folder, "open", tile, found.number)
    known = int(np.count_nonzero(np.isfinite(spacing[surface.own])))
    return OpenTile(parts_of(surface, label, found.sums[:, 0]), found.sums, known)


class SmallParts(NamedTuple):
    """parts : of the triangles that are left, those that are small in the tile, with how many
    triangles each has there · elsewhere : (b,) of their corners, how many tiles know the triangle
    """

    parts: TileParts
    tiles: I64


def left_parts(of: TiledCloud, tile: Tile, task: AreaTask, deep: Bool) -> SmallParts:
    """What is left of a tile without its parts (k,) that are ``deep``, at rest; and those of its
    parts that have few triangles in it.
    """
    surface = surface_of(of.index, EVERY, tile)
    tin = surface.tin
    left = ~np.append(deep, False)[read(task.folder, "open", tile)]
    label = np.asarray(part_numbers(tin.neighbours, left), np.int64)
    n = int(label.max(initial=-1)) + 1
    size = np.bincount(label[left & surface.counted], minlength=n)
    small = size <= FEWEST // 10
    number = np.append(np.where(small, np.cumsum(small) - 1, -1), -1)
    own = number[label]
    write(task.folder, "left", tile, left)
    write(task.folder, "small", tile, own.astype(np.int32))
    parts = parts_of(surface, own, size[small].astype(np.float64))
    cells = np.floor(parts.corners.reshape(-1, 3, 2) / of.index.cloud.tile_m).astype(np.int64)
    one, two, three = (cells[:, k] for k in range(3))
    same = [(a == b).all(axis=1) for a, b in ((one, two), (one, three), (two, three))]
    tiles = 3 - np.minimum(np.sum(same, axis=0), 2)
    return SmallParts(parts, tiles.astype(np.int64))


def counted_area(of: TiledCloud, tile: Tile, task: AreaTask, kept: Bool) -> int:
    """Which triangles and vertices of a tile count, at rest, of its small parts those (k,) that are
    ``kept``; returns how many vertices do not.
    """
    surface = surface_of(of.index, EVERY, tile)
    tin, small = surface.tin, read(task.folder, "small", tile)
    mask = read(task.folder, "left", tile) & np.append(kept, True)[small]
    spacing = task.spacing(tile)
    shown = np.where(np.isfinite(spacing), spacing, 0.0)
    bridged, gap = np.empty_like(mask), np.empty_like(mask)
    wide_kernel(0, len(mask), Corners(tin.vertices, tin.triangles), mask, shown, bridged, gap)
    counts = counted_of(surface, mask, bridged)
    path = counts_path(of.index, SAMPLED, tile)
    write_arrays(path, dict(zip(COUNTS, counts, strict=True)))
    return int(np.count_nonzero(~counts[2]))


def alone_points(of: TiledCloud, tile: Tile, task: AreaTask) -> I64:
    """The rows (k,) of the points of a tile that stand alone outside the sampled area."""
    surface = surface_of(of.index, SAMPLED, tile)
    tin = surface.tin
    rest = np.flatnonzero(surface.own & ~surface.used)
    if not len(rest):
        return np.zeros(0, np.int64)
    xy = tin.vertices[rest, :2]
    far, spacing = nearest_used(of, task, xy)
    rest = rest[far > ALONE * spacing]
    if not len(rest):
        return np.zeros(0, np.int64)
    there = names_of(of.index.points(tile) + 0.0)  # -0 is 0
    alone = np.isin(there, names_of(tin.vertices[rest] + 0.0))
    return of.index.rows(tile)[alone]


def nearest_used(of: TiledCloud, task: AreaTask, xy: F64) -> tuple[F64, F64]:
    """How far (k,) m places (k, 2) are from the nearest vertex that counts in any tile, and the
    spacing (k,) m there; infinite both where there is none.
    """
    tiles = of.tiles
    box = np.array([of.index.box[t] for t in tiles])
    low, high = xy.min(axis=0), xy.max(axis=0)
    apart = np.maximum(np.maximum(box[:, :2] - high, low - box[:, 2:]), 0.0)
    away = np.hypot(apart[:, 0], apart[:, 1])
    far, spacing = np.full(len(xy), np.inf), np.full(len(xy), np.inf)
    for k in np.argsort(away, kind="stable").tolist():
        if away[k] > far.max():
            break
        own = used_of(of.index, SAMPLED, tiles[k])[0][:, :2]
        if not len(own):
            continue
        tree = cKDTree(own, balanced_tree=False, compact_nodes=False)
        d, at = (np.asarray(found) for found in tree.query(xy))
        nearer = d < far
        far[nearer] = d[nearer]
        there = np.ascontiguousarray(own[at[nearer]])
        spacing[nearer] = task.rasters.spacings(task.rasters.axes.along(there))
    return far, spacing


def with_surface(of: TiledCloud, tile: Tile) -> None:
    """Triangulate a tile where its surface is not at rest."""
    surface_of(of.index, EVERY, tile)
