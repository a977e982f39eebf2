"""What one tile knows of the outline of a body and of the ground around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.own_axes import extent_of
from ladar_volume.model.records import F64, I64, Bool, Plane
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_fit import VertexSelection, vertices
from ladar_volume.tiles.tile_outline import Box, near_stored_places, write_vertices
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of, used_of
from ladar_volume.tin.boundary import border, first_ends
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.uncertainty.ground_field import OCCUPIED, squares_grid
from ladar_volume.volume.field_checks.base_readings import TOE, area_moments
from ladar_volume.volume.field_checks.completeness import DIRECTIONS, directions

#: Number of a cell along x, of which each cell along y is one.
ROW = 1 << 32


@dataclass(frozen=True)
class Region:
    """base : the ground · chosen : vertices it was fitted to · outline : where the triangles inside
    are at rest, None for all · rest : where what is told of its vertices is to be at rest
    """

    base: Plane
    chosen: VertexSelection
    outline: Path | None
    rest: Path


def support_of(of: TiledCloud, tile: Tile, chosen: VertexSelection) -> Bool:
    """Which of the tile's vertices that count (k,) a ground was fitted to."""
    xyz, _, row = used_of(of.index, of.limits, tile)
    out = np.zeros(len(xyz), np.bool_)
    some = np.arange(len(xyz))
    if chosen.ring is not None:
        some = np.flatnonzero(read(chosen.ring.parent, chosen.ring.name, tile))
    out[some[chosen.mask(xyz[some], row[some])]] = True
    return out


def ring_of(of: TiledCloud, tile: Tile, outline: Path | None) -> Bool:
    """Which of the tile's vertices that count (k,) lie around the outline; all without one."""
    if outline is None:
        return np.ones(len(used_of(of.index, of.limits, tile)[0]), np.bool_)
    return np.asarray(read(outline, "ring", tile), np.bool_)


def ring_facts(of: TiledCloud, tile: Tile, region: Region) -> F64:
    """How many vertices lie around the outline, how many of them the ground was fitted to, and the
    least and greatest x and y of the former, m (6,).
    """
    ring = ring_of(of, tile, region.outline)
    support = support_of(of, tile, region.chosen)
    low, high = extent_of(used_of(of.index, of.limits, tile)[0][ring][:, :2].copy())
    return np.array([np.count_nonzero(ring), np.count_nonzero(ring & support), *low, *high])


def ring_squares(of: TiledCloud, tile: Tile, outline: Path | None, low: F64, side: float) -> F64:
    """How many vertices around the outline lie on each square (OCCUPIED + 1,) from ``low``."""
    xy = used_of(of.index, of.limits, tile)[0][ring_of(of, tile, outline), :2]
    shape = (OCCUPIED + 1, OCCUPIED + 1)
    return np.asarray(squares_grid(np.ascontiguousarray(xy), np.ones(len(xy)), low, side, shape))


def near_base_of(of: TiledCloud, tile: Tile, region: Region, reach_m: float) -> tuple[F64, F64]:
    """Of the vertices around the outline within reach of the base: places (k, 2) m, and how far
    above it (k,) m.
    """
    xyz = used_of(of.index, of.limits, tile)[0][ring_of(of, tile, region.outline)]
    off = height_above(xyz, region.base)
    near = np.abs(off) <= reach_m
    return np.ascontiguousarray(xyz[near, :2]), off[near]


def near_extent(of: TiledCloud, tile: Tile, region: Region, reach_m: float) -> F64:
    """How many these are, and their least x and y, m (3,)."""
    xy, _ = near_base_of(of, tile, region, reach_m)
    return np.array([len(xy), *extent_of(xy)[0]])


def stretches(
    of: TiledCloud, tile: Tile, region: Region, reach_m: float, low: F64, length_m: float
) -> tuple[I64, F64]:
    """Names (k,) of stretches of ground, and how many of these vertices lie on each with the sum of
    their heights above the base, m (k, 2).
    """
    xy, off = near_base_of(of, tile, region, reach_m)
    cell = np.floor((xy - low) / length_m).astype(np.int64)
    names, at = np.unique(cell @ np.array([ROW, 1]), return_inverse=True)
    at, n = at.reshape(-1), len(names)
    return names, np.column_stack([np.bincount(at, minlength=n), np.bincount(at, off, n)])


def moments_inside(
    of: TiledCloud, tile: Tile, outline: Path | None, origin: F64, scale: float, degree: int
) -> F64:
    """Integrals (p,) of a polynomial's terms over the tile's triangles inside the outline."""
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline) & surface.counted
    area = np.where(inside, footprint_areas(surface.tin.vertices, surface.tin.triangles), 0.0)
    return area_moments(surface.tin, area, origin, scale, degree)


def border_vertices(of: TiledCloud, tile: Tile, outline: Path) -> Box | None:
    """The tile's vertices on the border of the outline, at rest; returns their box."""
    surface = surface_of(of.index, of.limits, tile)
    tin, inside = surface.tin, read(outline, "inside", tile)
    some = vertex_mask(tin, inside) & vertex_mask(tin, tin.relevant & ~inside) & surface.own
    return write_vertices(outline, "border", tile, tin, some)


def toe_vertices(
    of: TiledCloud, tile: Tile, outline: Path, beside: Sequence[Tile], radius_m: float
) -> int:
    """Which of the tile's vertices that count lie in the band along the toe, at rest; returns how
    many. beside : tiles with a border that may be near
    """
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    out = ~vertex_mask(tin, read(outline, "inside", tile))[surface.used]
    xy = tin.vertices[surface.used, :2]
    near, far = (t * radius_m for t in TOE)
    out[out] = near_stored_places(xy[out], outline, "border", beside, far)
    out[out] = ~near_stored_places(xy[out], outline, "border", beside, near)
    write(outline, "toe", tile, out)
    return int(np.count_nonzero(out))


def inside_vertices(of: TiledCloud, tile: Tile, region: Region, rise_m: float, name: str) -> F64:
    """Which of the tile's vertices that count lie inside the outline and rise more above the base,
    at rest under a name; returns how many, and the sums of their x and y (3,).
    """
    surface = surface_of(of.index, of.limits, tile)
    out = vertex_mask(surface.tin, inside_of(surface, tile, region.outline))[surface.used]
    xyz = surface.tin.vertices[surface.used]
    out &= height_above(xyz, region.base) > rise_m
    write(region.rest, name, tile, out)
    return np.array([np.count_nonzero(out), *xyz[out, :2].sum(axis=0)])


def border_sides(of: TiledCloud, tile: Tile, outline: Path | None) -> tuple[F64, F64]:
    """Ends (b, 4) m of the sides of the outline beyond which the surface goes on, whose first
    vertex by x, then y lies in the tile; and the lengths of these and of the others, m, with the
    area inside, m² (3,).
    """
    surface = surface_of(of.index, of.limits, tile)
    tin, inside = surface.tin, inside_of(surface, tile, outline)
    ends, length, is_open = border(tin, inside)
    xy = tin.vertices[:, :2]
    a, b = xy[ends[:, 0]], xy[ends[:, 1]]
    mine = surface.own[first_ends(tin.vertices, ends)]
    closed = mine & ~is_open
    area = footprint_areas(tin.vertices, tin.triangles[inside & surface.counted]).sum()
    facts = np.array([length[closed].sum(), length[mine & is_open].sum(), area])
    return np.column_stack([a, b])[closed], facts


def support_directions(of: TiledCloud, tile: Tile, chosen: VertexSelection, centre: F64) -> I64:
    """How many of the vertices that a ground was fitted to lie in each direction from a centre."""
    xyz, _, row = vertices(of, tile, chosen.ring)
    at = directions(xyz[chosen.mask(xyz, row), :2], centre)
    return np.bincount(at, minlength=DIRECTIONS).astype(np.int64)


def bodies_beside(of: TiledCloud, tile: Tile, region: Region, count: int) -> F64:
    """Of each of so many parts that rise above the ground: volume, m³, of the triangles that are
    not inside the outline, how many these are, and the sums of x and y of their middles, m
    (count, 4).
    """
    assert region.outline is not None
    surface = surface_of(of.index, of.limits, tile)
    tin, label = surface.tin, read(region.outline, "rising", tile)
    own = np.flatnonzero(
        (label >= 0) & surface.counted & ~read(region.outline, "inside", tile).astype(bool)
    )
    corners = tin.triangles[own]
    middle = tin.vertices[corners].mean(axis=1)
    volume = footprint_areas(tin.vertices, corners)
    volume = volume * height_above(tin.vertices, region.base)[corners].mean(axis=1)
    columns = [np.bincount(label[own], w, count) for w in (volume, None, *middle.T[:2])]
    return np.column_stack(columns).astype(np.float64)
