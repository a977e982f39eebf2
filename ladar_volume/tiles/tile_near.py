"""Where the surface of a tile runs near the base: :mod:`ladar_volume.volume.near_base` by tiles.

A tile looks at the triangles near the base that meet its own vertices, with the neighbourhoods of
their corners. What its own triangles give to cut through the smoothed heights is written for the
tiles that these heights lie in.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import degree_of, design
from ladar_volume.math.sparse_diagonal import diagonal_matrix
from ladar_volume.model.records import F64, I32, I64, Bool, Plane
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_patch import TilePatch, inside_of, patch_of, read_shares, write_shares
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface
from ladar_volume.tin.full_tin import any_corner, footprint_areas, places_in
from ladar_volume.volume.near_base import (
    WholeFold,
    all_moments,
    edge_sums,
    load,
    loads,
    near_triangles,
    node_covariances,
    smooth_heights,
)
from ladar_volume.volume.neighbourhood import Part, Smooth, part_around
from ladar_volume.volume.remaining_fold import fold_of_sums, fold_sums

#: Rings of the neighbourhood from which true heights are estimated, as in ``near_base``.
RINGS = 4


@dataclass(frozen=True)
class NearSums:
    """What a tile gives to the correction. sums : (8,) the correction, m³, area near the base, m²,
    second-order variance, m⁶, and those of :func:`fold_sums` · by_beta : (p,) derivatives of cut by
    the coefficients of the base · beside : tiles to whose heights it gives something
    """

    sums: F64
    by_beta: F64
    beside: tuple[Tile, ...] = ()


def whole_fold(tiles: list[NearSums]) -> WholeFold | None:
    """The correction of all tiles; None where nothing is near."""
    if not tiles:
        return None
    total = np.sum([t.sums for t in tiles], axis=0)
    taken, area, curved = total[:3].tolist()
    return WholeFold(taken, area, curved, fold_of_sums(total[3:]))


@dataclass(frozen=True)
class NearTile:
    """patch : around the tile · height : (n,) m above the base · variance : (n,) m² · triangle :
    (s,) those inside the outline that meet one of its vertices · near : (s,) of these, near the
    base
    """

    patch: TilePatch
    height: F64
    variance: F64
    triangle: I64
    near: Bool


def comes_near(surface: TileSurface, base: Plane, inside: Bool, sigma_m: float) -> bool:
    """Whether a triangle inside the outline that meets one of the tile's vertices is near."""
    height, variance = height_above(surface.tin.vertices, base), sigma_m**2 / surface.shared
    return bool(near_triangles(surface.tin.triangles[inside], height, variance).any())


def near_of(
    of: TiledCloud, tile: Tile, surface: TileSurface, folder: Path | None, base: Plane, sigma: float
) -> NearTile:
    """What is near the base in a tile, and around it."""
    patch = patch_of(of, tile, surface, folder, RINGS + 2)
    height, variance = height_above(patch.tin.vertices, base), sigma**2 / patch.shared
    mine = np.zeros(len(height), np.bool_)
    mine[patch.own] = True
    star = np.flatnonzero(patch.inside & any_corner(patch.tin.triangles, mine))
    near = near_triangles(patch.tin.triangles[star], height, variance)
    return NearTile(patch, height, variance, star, near)


def near_sums(
    of: TiledCloud,
    tile: Tile,
    surface: TileSurface,
    asked: tuple[Plane, float, Path | None, Path],
) -> NearSums | None:
    """The sums of a tile; None where nothing is near. The derivatives of cut by the heights are at
    rest. asked : base, standard deviation of the heights, m, folders of the outline and of these.
    """
    base, sigma, outline, folder = asked
    inside = inside_of(surface, tile, outline)
    if not (sigma > 0.0 and comes_near(surface, base, inside, sigma)):
        return None
    at = near_of(of, tile, surface, outline, base, sigma)
    tin, t = at.patch.tin, at.patch.tin.triangles[at.triangle]
    part = part_around(tin, t[at.near], RINGS)
    variance = at.variance[part.vertex]
    smooth = smooth_heights(part.tin, at.height[part.vertex], variance, part.close, RINGS, variance)
    packed = node_covariances(diagonal_matrix(variance), part.close)
    found = all_moments(smooth, part.close, packed)
    area, counted = footprint_areas(tin.vertices, t), at.patch.counted[at.triangle[at.near]]
    close_area = area[at.near]
    cut, _ = loads(at.height, t, area, at.near, found[:, 1:4])
    through = load(found[counted, 4:7], close_area[counted], part.close[counted], len(variance))
    given = -smooth.adjoint(through)
    own = places_in(at.patch.own, len(at.height))[part.vertex] >= 0
    curvature = close_area[:, None] * found[:, 7:]
    sums = [close_area[counted] @ found[counted, 0], close_area[counted].sum()]
    sums += [second_order_of(curvature, part.close, smooth, variance, own)]
    sums += fold_sums(smooth, part.close, close_area, RINGS, own).tolist()
    by_beta, beside = write_cut(of, tile, folder, at, part, (cut, given), base)
    return NearSums(np.array(sums), by_beta, beside)


def second_order_of(
    curvature: F64, triangles: I32, smooth: Smooth, variance: F64, own: Bool
) -> float:
    """The part of ``½ tr(HCHC)`` of the rows ``own`` (n,), m⁶, for independent heights."""
    edge, at = edge_sums(curvature, triangles, smooth.start, smooth.link)
    row = np.repeat(np.arange(len(variance)), np.diff(smooth.start))
    by_edge = np.where(own[row], edge**2 * variance[row] * variance[smooth.link], 0.0)
    return 0.5 * float(by_edge.sum() + ((at * variance)[own] ** 2).sum())


def write_cut(
    of: TiledCloud,
    tile: Tile,
    folder: Path,
    at: NearTile,
    part: Part,
    cut: tuple[F64, F64],
    base: Plane,
) -> tuple[F64, tuple[Tile, ...]]:
    """Write the derivatives of cut by the heights: at the vertices of the patch (n,), which are
    complete at the tile's own, and through the smoothed ones of the part (k,). Returns those by the
    coefficients of the base and to which other tiles the latter belong.
    """
    direct, given = cut
    own, xy = at.patch.own, at.patch.tin.vertices[:, :2]
    rows = np.concatenate([own, part.vertex])
    values = np.concatenate([direct[own], given])
    X = design(xy[rows], base.origin_xy, degree_of(base))
    return -X.T @ values, write_shares(of, tile, folder, xy[own], (xy[rows], values))


def add_cut(tile: Tile, folder: Path, xy: F64, cut: F64, near: bool, beside: list[Tile]) -> F64:
    """The derivatives (k,) of cut by the heights of the tile's own vertices (k, 2) m: where it is
    ``near`` those at rest instead of those given, with what the tiles ``beside`` give.
    """
    shares = read_shares(tile, folder, xy, near, beside)
    return shares if near else cut + shares
