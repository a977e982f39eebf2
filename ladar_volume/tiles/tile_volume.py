"""What one tile gives to the volume above a level, a plane, or a ground of the same cloud.

Each triangle is counted in one tile. The gradient by a vertex' height is complete in the tile that
the vertex lies in, since that tile knows all triangles round its vertices: variances add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import degree_of, design
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_fit import VertexSelection, vertices
from ladar_volume.tiles.tile_near import NearSums, add_cut, near_sums
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_of
from ladar_volume.tin.full_tin import corners_of, footprint_areas
from ladar_volume.uncertainty.ground_field import OCCUPIED, spread_kernel, squares_grid
from ladar_volume.volume.prismoids import prismoids


@dataclass(frozen=True)
class Above:
    """What is asked of each tile: the base, where the triangles inside the outline are at rest
    (None: all that count), standard deviation of the heights, m, NaN where it is not known; where
    the derivatives near the base are to be at rest, None for no correction there.
    """

    base: Plane
    folder: Path | None
    sigma_m: float
    near: Path | None = None


@dataclass(frozen=True)
class TileSums:
    """cut_m3, fill_m3, area_m2 : of the tile's triangles · by_beta : (p, 2) derivatives of
    net and cut by the coefficients of the base · box : (4,) of its triangles, infinite for none ·
    near : what it gives to the correction near the base, None for nothing · points, vertices,
    triangles, rounds : counts
    """

    cut_m3: float
    fill_m3: float
    area_m2: float
    by_beta: F64
    box: F64
    near: NearSums | None
    points: int
    vertices: int
    triangles: int
    rounds: int


def tile_sums(of: TiledCloud, tile: Tile, above: Above) -> TileSums:
    """The sums of a tile."""
    surface, base = surface_of(of.index, of.limits, tile), above.base
    tin = surface.tin
    inside = inside_of(surface, tile, above.folder)
    counted, n = inside & surface.counted, len(base.beta)
    cut = fill = area = 0.0
    by_beta, box = np.zeros((n, 2)), np.array([np.inf, np.inf, -np.inf, -np.inf])
    if counted.any():
        solid = prismoids(tin, base, counted)
        cut, fill, area = solid.cut_m3, solid.fill_m3, solid.area_m2
        by_beta[:, 0] = solid.base_net
        corners = corners_of(tin.triangles[counted], len(tin.vertices))
        box = np.concatenate(extent_of(tin.vertices[corners]))
    near = None
    if above.near is not None:
        asked = (base, above.sigma_m, above.folder, above.near)
        near = near_sums(of, tile, surface, asked)
    if near is not None:
        by_beta[:, 1] = near.by_beta
    elif inside.any():
        at = design(tin.vertices[surface.own, :2], base.origin_xy, degree_of(base))
        by_beta[:, 1] = -at.T @ gradients(surface, base, inside)[:, 1]
    return TileSums(
        cut,
        fill,
        area,
        by_beta,
        box,
        near,
        surface.points,
        int(np.count_nonzero(surface.own)),
        int(np.count_nonzero(counted)),
        surface.rounds,
    )


def gradients(surface: TileSurface, base: Plane, inside: Bool) -> F64:
    """Derivatives (k, 2) of net and cut by the heights of the tile's own vertices, the base held
    fixed, without what the noise near it does.
    """
    if not inside.any():
        return np.zeros((int(np.count_nonzero(surface.own)), 2))
    found = prismoids(surface.tin, base, inside)
    both = [g[surface.own, 2] for g in (found.gradient_net, found.gradient_cut)]
    return np.stack(both, axis=1)


@dataclass(frozen=True)
class Beside:
    """near : whether the derivatives of cut of a tile are at rest · tiles : those that give
    something to it
    """

    near: bool
    tiles: list[Tile]


def squares(
    of: TiledCloud,
    tile: Tile,
    above: Above,
    beside: Beside,
    chosen: VertexSelection | None,
    by_sums: F64,
) -> F64:
    """Sums of the squared derivatives of net, cut and fill by the heights of the tile's points (3,)
    m⁴: through the surface, and through the ground. chosen : what that was fitted to, if to any ·
    by_sums : (p, 2) derivatives of net and cut by the sums ``Xᵀz``
    """
    surface = surface_of(of.index, of.limits, tile)
    g = gradients(surface, above.base, inside_of(surface, tile, above.folder))
    if above.near is not None:
        xy = surface.tin.vertices[surface.own, :2]
        g[:, 1] = add_cut(tile, above.near, xy, g[:, 1], beside.near, beside.tiles)
    if chosen is not None:
        some, weight = support_of(of, tile, surface, chosen, by_sums)
        g[some] += weight
    shared = surface.shared[surface.own]
    return np.array([c @ (c / shared) for c in (g[:, 0], g[:, 1], g[:, 1] - g[:, 0])])


def support_of(
    of: TiledCloud, tile: Tile, surface: TileSurface, chosen: VertexSelection, by_sums: F64
) -> tuple[Bool, F64]:
    """Which of the tile's own vertices (k,) the ground was fitted to, and the derivatives (s, j) of
    results by their heights through it.
    """
    xyz, _, row = vertices(of, tile, chosen.ring)
    mask = chosen.mask(xyz, row)
    some = np.isin(surface.row[surface.own], row[mask])
    xy = surface.tin.vertices[surface.own, :2][some]
    degree = (1, 3, 6, 10).index(len(by_sums))
    return some, design(xy, np.array(chosen.origin_xy), degree) @ by_sums


def field_facts(
    of: TiledCloud, tile: Tile, base: Plane, chosen: VertexSelection, by_sums: F64
) -> F64:
    """Of the tile's part of the ground: box (4,), number of points, sums of their squared
    residuals, m², of 1 / points at each, and of their squared weights, m⁴: (8,).
    """
    xyz, shared, row = vertices(of, tile, chosen.ring)
    mask = chosen.mask(xyz, row)
    xyz, shared = xyz[mask], shared[mask]
    if not len(xyz):
        return np.array([np.inf, np.inf, -np.inf, -np.inf, 0.0, 0.0, 0.0, 0.0])
    r = height_above(xyz, base)
    w = design(xyz[:, :2], base.origin_xy, degree_of(base)) @ by_sums
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    return np.array([*low, *high, len(xyz), r @ r, (1.0 / shared).sum(), w @ w])


def points_per_square(
    of: TiledCloud, tile: Tile, chosen: VertexSelection, low: F64, side: float
) -> F64:
    """How many points of the ground lie on each square (OCCUPIED + 1,) of a side from ``low``."""
    xyz, _, row = vertices(of, tile, chosen.ring)
    xy = xyz[chosen.mask(xyz, row), :2]
    shape = (OCCUPIED + 1, OCCUPIED + 1)
    return np.asarray(squares_grid(np.ascontiguousarray(xy), np.ones(len(xy)), low, side, shape))


@dataclass(frozen=True)
class Squares:
    """low : (2,) m corner · side : m · shape : how many"""

    low: F64
    side: float
    shape: tuple[int, int]


def field_grid(
    of: TiledCloud, tile: Tile, above: Above, chosen: VertexSelection, by_sums: F64, grid: Squares
) -> F64:
    """Weights, m², with which the deviation of the ground enters the volume, by squares: at the
    points of the ground, and with the area inside the outline.
    """
    xyz, _, row = vertices(of, tile, chosen.ring)
    xy = np.ascontiguousarray(xyz[chosen.mask(xyz, row), :2])
    w = design(xy, above.base.origin_xy, degree_of(above.base)) @ by_sums
    out = np.asarray(squares_grid(xy, w, grid.low, grid.side, grid.shape))
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    counted = inside_of(surface, tile, above.folder) & surface.counted
    area = np.where(counted, footprint_areas(tin.vertices, tin.triangles), 0.0)
    spread_kernel(tin.vertices, tin.triangles, area, grid.low, grid.side, out)
    return out
