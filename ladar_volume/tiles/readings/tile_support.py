"""What one tile knows of the points that a ground was fitted to, for other readings of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import base_height, design
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, I64, Bool, Plane
from ladar_volume.tiles.array_file import write
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_fit import VertexSelection, chosen_of
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_of
from ladar_volume.tiles.tile_volume import Squares
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.tin.relevant import longest_sides
from ladar_volume.uncertainty.ground_field import squares_grid
from ladar_volume.volume.field_checks.terrace import mean_heights


@dataclass(frozen=True)
class Higher:
    """A polynomial of a higher degree through the same points. base : the ground · chosen : the
    points · origin : (2,) m · scale : m · degree
    """

    base: Plane
    chosen: VertexSelection
    origin: F64
    scale: float
    degree: int

    def design(self, xy: F64) -> F64:
        """Design rows (k, p) at places (k, 2) m."""
        return design((xy - self.origin) / self.scale, np.zeros(2), self.degree)


def extent(of: TiledCloud, tile: Tile, chosen: VertexSelection) -> F64:
    """How many points there are, the sums of x and y, and their least and greatest, m (7,)."""
    xy = np.ascontiguousarray(chosen_of(of, tile, chosen)[0][:, :2])
    low, high = extent_of(xy)
    return np.array([len(xy), *xy.sum(axis=0), *low, *high])


def products(of: TiledCloud, tile: Tile, to: Higher) -> F64:
    """``XᵀX`` and ``Xᵀe`` (p, p + 1) of the residuals e of the ground."""
    xyz = chosen_of(of, tile, to.chosen)[0]
    X, e = to.design(xyz[:, :2]), xyz[:, 2] - base_height(to.base, xyz[:, :2])
    return np.column_stack([X.T @ X, X.T @ e])


def left_of(of: TiledCloud, tile: Tile, to: Higher, beta: F64) -> F64:
    """Sizes (k,) m of what that polynomial leaves of the residuals."""
    xyz = chosen_of(of, tile, to.chosen)[0]
    e = xyz[:, 2] - base_height(to.base, xyz[:, :2])
    return np.abs(e - to.design(xyz[:, :2]) @ beta)


def weights_on(of: TiledCloud, tile: Tile, to: Higher, by_term: F64, grid: Squares) -> F64:
    """Weights ``X by_term``, m², of the points by squares, one after the other; then the sum of
    their squares, m⁴.
    """
    xy = np.ascontiguousarray(chosen_of(of, tile, to.chosen)[0][:, :2])
    w = to.design(xy) @ by_term
    return np.append(squares_grid(xy, w, grid.low, grid.side, grid.shape), w @ w)


@dataclass(frozen=True)
class TerraceSearch:
    """outline : where the triangles inside are at rest, None for all · base : the ground · widest_m
    : longest side of a triangle that counts
    """

    outline: Path | None
    base: Plane
    widest_m: float

    def triangles(self, surface: TileSurface, tile: Tile) -> tuple[I64, F64, F64]:
        """Those (k,) of a tile that count, with areas (k,) m² and mean heights (k,) m."""
        tin = surface.tin
        rows = np.flatnonzero(inside_of(surface, tile, self.outline))
        rows = rows[longest_sides(tin.vertices, tin.triangles, rows) <= self.widest_m]
        height = mean_heights(height_above(tin.vertices, self.base), tin.triangles, rows)
        return rows, footprint_areas(tin.vertices, tin.triangles[rows]), np.asarray(height)

    def counted(self, of: TiledCloud, tile: Tile) -> tuple[F64, F64]:
        """Areas and mean heights of those that count in the tile."""
        surface = surface_of(of.index, of.limits, tile)
        rows, area, height = self.triangles(surface, tile)
        own = surface.counted[rows]
        return area[own], height[own]


def sides_of(of: TiledCloud, tile: Tile, outline: Path | None) -> F64:
    """Longest sides (k,) m of the tile's triangles inside the outline."""
    surface = surface_of(of.index, of.limits, tile)
    rows = np.flatnonzero(inside_of(surface, tile, outline) & surface.counted)
    return np.asarray(longest_sides(surface.tin.vertices, surface.tin.triangles, rows))


def area_by_height(
    of: TiledCloud, tile: Tile, search: TerraceSearch, low: float, high: float, bins: int
) -> F64:
    """Area, m², of the tile's triangles by mean height, in so many bins (bins,)."""
    area, height = search.counted(of, tile)
    out: F64 = np.histogram(height, bins, (low, high), weights=area)[0].astype(np.float64)
    return out


def about_height(of: TiledCloud, tile: Tile, search: TerraceSearch, at: float, half: float) -> F64:
    """Area of the tile's triangles about a height, m², and what they hold above it and above the
    base, m³ (3,).
    """
    area, height = search.counted(of, tile)
    more, total = (area @ np.maximum(height - low, 0.0) for low in (at, 0.0))
    return np.array([area[np.abs(height - at) <= half].sum(), more, total])


def terrace_vertices(
    of: TiledCloud, tile: Tile, folder: Path, search: TerraceSearch, at: float, half: float
) -> int:
    """Which of the tile's vertices that count lie on a terrace, at rest; returns how many."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    rows, _, height = search.triangles(surface, tile)
    mask: Bool = np.zeros(len(tin.triangles), np.bool_)
    mask[rows[np.abs(height - at) <= half]] = True
    on = vertex_mask(tin, mask) & (np.abs(height_above(tin.vertices, search.base) - at) <= half)
    write(folder, "terrace", tile, on[surface.used])
    return int(np.count_nonzero(on[surface.used]))
