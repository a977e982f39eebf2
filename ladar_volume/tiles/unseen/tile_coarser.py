"""By how much the surface of a tile differs from the one that is left when points are left out:
:mod:`ladar_volume.clouds.between_points` by tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.between_points import (
    CENTRE,
    CORNER,
    Compared,
    Differences,
    Places,
    add_kernel,
    centres_of,
    chosen_squares,
    middles_of,
    number_vertices,
    places_in_triangles,
    row_step,
    volume_by_block,
)
from ladar_volume.math.own_axes import OwnAxes, extent_of
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tiles.array_file import ENDING, at_rest, read, write
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_fit import bins_of
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_patch import (
    SurfacePart,
    inside_of,
    joined,
    read_shares,
    rows_at,
    tiles_in,
    write_shares,
)
from ladar_volume.tiles.tile_stars import tile_stars
from ladar_volume.tiles.tile_store import Tile, arrays_at_rest
from ladar_volume.tiles.tile_surface import TileSurface, surface_of
from ladar_volume.tiles.unseen.tile_spacing import KeptPoints, NearRaster, distinct_cells
from ladar_volume.tin.full_tin import corners_of, first_corners, footprint_areas, places_in
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.relevant import circumdiameters


@dataclass(frozen=True)
class Squares:
    """Some squares stand for all. axes : along which they lie · low : (2,) m corner · side : m ·
    every : one of so many, 1 for all
    """

    axes: OwnAxes
    low: F64
    side: float
    every: int


@dataclass(frozen=True)
class Seen:
    """outline : where the triangles inside are at rest, None for all that count · squares : those
    that are looked at · folder : where it is to be at rest which triangles lie in them
    """

    outline: Path | None
    squares: Squares
    folder: Path

    def of_tile(self, surface: TileSurface, tile: Tile) -> Bool:
        """The triangles (m,) of a tile that are looked at."""
        out = inside_of(surface, tile, self.outline) & surface.counted & ~surface.bridged
        if self.squares.every == 1:
            return out

        def made() -> dict[str, np.ndarray]:
            xy = np.ascontiguousarray(surface.tin.vertices[:, :2])
            at = self.squares.axes.along(xy[first_corners(xy, surface.tin.triangles)])
            s = self.squares
            return {"seen": out & chosen_squares(at, s.low, s.side, s.every, row_step(s.every))}

        return arrays_at_rest(at_rest(self.folder, "seen", tile), ("seen",), made)[0]


class Widths(NamedTuple):
    """Bins (k,) of how wide triangles are, ascending with it, and the area (k,) m² in each."""

    bins: I64
    area: F64


def in_bins(width: F64, area: F64) -> Widths:
    """Triangles of widths (m,) m and areas (m,) m² by bins."""
    bins, at = np.unique(bins_of(width), return_inverse=True)
    return Widths(bins, np.asarray(np.bincount(at.reshape(-1), area, len(bins)), np.float64))


def together(widths: Sequence[Widths]) -> Widths:
    """The widths of several tiles by bins."""
    bins, at = np.unique(np.concatenate([w.bins for w in widths]), return_inverse=True)
    area = np.concatenate([w.area for w in widths])
    return Widths(bins, np.asarray(np.bincount(at.reshape(-1), area, len(bins)), np.float64))


def facts_together(found: Sequence[F64]) -> F64:
    """What :func:`seen_facts` tells of several tiles."""
    facts = np.stack(found)
    low, high = facts[:, 2:4].min(axis=0), facts[:, 4:].max(axis=0)
    return np.array([*facts[:, :2].sum(axis=0), *low, *high])


def seen_facts(of: TiledCloud, tile: Tile, seen: Seen) -> F64:
    """How many triangles of a tile are looked at, their area, m², and the least and greatest
    coordinates of their middles along the axes (6,).
    """
    surface = surface_of(of.index, of.limits, tile)
    t = surface.tin.triangles[seen.of_tile(surface, tile)]
    area = footprint_areas(surface.tin.vertices, t)
    middle = middles_of(seen.squares.axes.along(surface.tin.vertices[:, :2])[t])
    low, high = extent_of(middle)
    return np.array([len(t), area.sum(), *low, *high])


def seen_cells(of: TiledCloud, tile: Tile, seen: Seen, near: NearRaster) -> I64:
    """The cells (k,) that hold a corner of one of these."""
    surface = surface_of(of.index, of.limits, tile)
    corners = np.unique(surface.tin.triangles[seen.of_tile(surface, tile)])
    return distinct_cells(near.cells(surface.tin.vertices[corners, :2]), near.shape[1])


def seen_widths(of: TiledCloud, tile: Tile, seen: Seen) -> Widths:
    """How wide these are."""
    surface = surface_of(of.index, of.limits, tile)
    t = surface.tin.triangles[seen.of_tile(surface, tile)]
    return in_bins(
        circumdiameters(surface.tin.vertices, t), footprint_areas(surface.tin.vertices, t)
    )


def widths_in(of: TiledCloud, tile: Tile, seen: Seen, one: int) -> F64:
    """Width, m, and area, m², (k, 2) of the triangles looked at whose width is in one bin."""
    surface = surface_of(of.index, of.limits, tile)
    t = surface.tin.triangles[seen.of_tile(surface, tile)]
    width = circumdiameters(surface.tin.vertices, t)
    some = bins_of(width) == one
    out: F64 = np.column_stack([width, footprint_areas(surface.tin.vertices, t)])[some]
    return out


class CoarserPart(NamedTuple):
    """Vertices (n, 3) m and triangles (m, 3) of the coarser surface round the vertices of a tile
    that were kept, and the ends (e, 4) m of the sides of its hull at these.
    """

    vertices: F64
    triangles: I32
    hull: F64


def coarser_of(kept: KeptPoints, tile: Tile) -> CoarserPart:
    """What a tile knows of the coarser surface, read where it is at rest, made where it is not."""
    path = kept.folder / "coarser" / f"{tile[0]}_{tile[1]}{ENDING}"
    found = arrays_at_rest(path, CoarserPart._fields, lambda: make_coarser(kept, tile)._asdict())
    return CoarserPart(*found)


def make_coarser(kept: KeptPoints, tile: Tile) -> CoarserPart:
    """Triangulate it."""
    stars = tile_stars(kept, tile)
    tin, star = stars.tin, stars.star
    corners = corners_of(tin.triangles[star], len(tin.vertices))
    triangles = places_in(corners, len(tin.vertices))[tin.triangles[star]]
    ends = [
        np.stack([tin.triangles[:, (k + 1) % 3], tin.triangles[:, (k + 2) % 3]], axis=1)[
            star & (tin.neighbours[:, k] < 0)
        ]
        for k in range(3)
    ]
    hull = np.concatenate(ends)
    hull = hull[stars.own[hull].any(axis=1)]
    return CoarserPart(tin.vertices[corners], triangles, tin.vertices[hull, :2].reshape(-1, 4))


def tiles_below(of: TiledCloud, tile: Tile, kept: KeptPoints, seen: Seen) -> list[Tile]:
    """The tiles whose coarser surface the triangles of a tile that are looked at lie over."""
    tin = (surface := surface_of(of.index, of.limits, tile)).tin
    corners = tin.triangles[seen.of_tile(surface, tile)]
    return tiles_in(kept, wider(reach_of(tin, corners), 1.0)) if len(corners) else []


def coarser_here(of: TiledCloud, tile: Tile, kept: KeptPoints, wanted: bool) -> None:
    """Put the coarser surface of a tile at rest, where it is wanted."""
    if wanted:
        coarser_of(kept, tile)


def coarser_around(kept: KeptPoints, tiles: list[Tile]) -> tuple[Tin, F64]:
    """The coarser surface that some tiles know, and the ends (e, 4) m of the sides of its hull."""
    found, parts = [coarser_of(kept, tile) for tile in tiles], []
    for one in found:
        none, every = np.zeros(len(one.vertices), np.bool_), np.ones(len(one.triangles), np.bool_)
        zero = none.astype(np.float64)
        parts.append(SurfacePart(one.vertices, one.triangles, zero, none, ~every, every, every))
    return joined(parts).patch(parts).tin, np.concatenate([one.hull for one in found])


def beyond_hull(xy: F64, sides: F64) -> Bool:
    """Which of places (n, 2) lie beyond one of the sides (e, 4) of a hull, the surface to their
    left.
    """
    out = np.zeros(len(xy), np.bool_)
    for ax, ay, bx, by in sides.tolist():
        out |= (bx - ax) * (xy[:, 1] - ay) - (by - ay) * (xy[:, 0] - ax) < 0.0
    return out


def reach_of(tin: Tin, corners: I32) -> Box:
    """The box of triangles (m, 3), one or more."""
    (x0, y0), (x1, y1) = extent_of(tin.vertices[corners, :2].reshape(-1, 2))
    return x0, y0, x1, y1


def wider(reach: Box, times: float) -> Box:
    """A box with so many eighths of its longer side around it."""
    x0, y0, x1, y1 = reach
    width = times * max(x1 - x0, y1 - y0) / 8.0
    return x0 - width, y0 - width, x1 + width, y1 + width


def on_coarser(kept: KeptPoints, places: F64, reach: Box) -> tuple[Tin, Places]:
    """Places (p, 3) m of a surface on the coarser one: its part that holds them."""
    times = 1.0
    while True:
        tiles = tiles_in(kept, wider(reach, times))
        if tiles:
            coarse, hull = coarser_around(kept, tiles)
            where = locate(triangle_index(coarse), places[:, :2])
            left = where < 0
            if len(tiles) == len(kept.box) or beyond_hull(places[left, :2], hull).all():
                return coarse, places_in_triangles(coarse, places, where)
        times *= 2.0


@dataclass(frozen=True)
class Shares:
    """Of one tile or more: beside : tiles to whose heights each gives something · wrote : whether
    each has something at rest · widths : of the triangles of the coarser surface, by the area that
    they have over those of the tiles
    """

    wrote: tuple[bool, ...]
    beside: tuple[tuple[Tile, ...], ...]
    widths: Widths


def shares_together(found: Sequence[Shares]) -> Shares:
    """The same of several tiles."""
    wrote, beside = (tuple(x for s in found for x in getattr(s, n)) for n in ("wrote", "beside"))
    return Shares(wrote, beside, together([s.widths for s in found]))


def compare(of: TiledCloud, tile: Tile, kept: KeptPoints, seen: Seen) -> Shares:
    """What the triangles of a tile that are looked at lie above the coarser surface, at rest, with
    the derivatives of its sum by all heights.
    """
    surface = surface_of(of.index, of.limits, tile)
    tin, mask = surface.tin, seen.of_tile(surface, tile)
    corners = tin.triangles[mask]
    if not len(corners):
        return Shares((False,), ((),), in_bins(np.zeros(0), np.zeros(0)))
    area, n = footprint_areas(tin.vertices, corners), len(tin.vertices)
    left_out = np.flatnonzero(rows_at(kept_around(kept, tin), tin.vertices) >= 0)
    rows, place = number_vertices(corners, n, left_out)
    centres = centres_of(tin.vertices, corners)
    places = np.concatenate([centres, tin.vertices[rows]])
    coarse, at = on_coarser(kept, places, reach_of(tin, corners))
    z = np.concatenate([tin.vertices[:, 2], coarse.vertices[:, 2]])
    two = Compared(z, corners, (n + coarse.triangles).astype(np.int64))
    sums = Differences(np.zeros(len(corners)), np.zeros(len(z)), np.zeros(len(coarse.triangles)))
    third = np.full(3, 1.0 / 3.0)
    add_kernel(two, at, np.arange(len(corners)), third, CENTRE * area, sums)
    place = np.where(place >= 0, place + len(corners), -1)
    for k in range(3):
        add_kernel(two, at, place[corners[:, k]], np.eye(3)[k], CORNER * area, sums)
    write(kept.folder, "volume", tile, sums.volume)
    every = np.concatenate([tin.vertices[:, :2], coarse.vertices[:, :2]])
    own = tin.vertices[surface.own, :2]
    beside = write_shares(of, tile, kept.folder, own, (every, sums.gradient))
    width = circumdiameters(coarse.vertices, coarse.triangles)
    some = sums.covered > 0.0
    write(kept.folder, "widths", tile, np.column_stack([width, sums.covered])[some])
    return Shares((True,), (beside,), in_bins(width[some], sums.covered[some]))


def kept_around(kept: KeptPoints, tin: Tin) -> F64:
    """The vertices (k, 2) m of a coarser surface in all tiles that a surface reaches."""
    low, high = extent_of(np.ascontiguousarray(tin.vertices[:, :2]))
    tiles = tiles_in(kept, (low[0], low[1], high[0], high[1]))
    return np.concatenate([np.zeros((0, 2)), *(kept.places(tile)[:, :2] for tile in tiles)])


def covered_in(of: TiledCloud, tile: Tile, kept: KeptPoints, wrote: bool, one: int) -> F64:
    """Width, m, and area, m², (k, 2) of the coarser triangles whose width is in one bin."""
    if not wrote:
        return np.zeros((0, 2))
    widths = read(kept.folder, "widths", tile)
    out: F64 = widths[bins_of(widths[:, 0]) == one]
    return out


@dataclass(frozen=True)
class Blocks:
    """extent : (2, 2) least and greatest coordinates of the middles of all triangles, along the
    axes, m · size : how wide the coarser triangles are, m
    """

    extent: F64
    size: float


def by_blocks(
    of: TiledCloud,
    tile: Tile,
    kept: KeptPoints,
    seen: Seen,
    blocks: Blocks,
    wrote: bool,
    beside: list[Tile],
) -> tuple[I64, F64, float]:
    """Names (k,) of blocks and the differences (k,) m³ of the tile's triangles in them; the sum of
    the squared derivatives by the heights of its vertices, m⁴.
    """
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    gradient = read_shares(tile, kept.folder, tin.vertices[surface.own, :2], wrote, beside)
    square = float((gradient**2).sum())
    if not wrote:
        return np.zeros(0, np.int64), np.zeros(0), square
    t = tin.triangles[seen.of_tile(surface, tile)]
    middle = middles_of(seen.squares.axes.along(tin.vertices[:, :2])[t])
    volume, extent = read(kept.folder, "volume", tile), (blocks.extent[0], blocks.extent[1])
    names, sums = volume_by_block(middle, volume, extent, blocks.size)
    return names, sums, square
