"""Where the sampled area of all tiles ends, and what that does to a volume:
:mod:`ladar_volume.clouds.sampling.outline_place` to what one process gives.

Flat triangles along the edge are passed over, with all that are joined to them. Tiles at the edge
tell theirs; where these lead into a tile that is not at the edge, that one is asked, too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ladar_volume.clouds.sampling.outline_place import (
    DIRECTIONS,
    EdgeTriangles,
    open_sides,
    strip_sums,
    strip_variance,
)
from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import TileParts, parts_of
from ladar_volume.tiles.tile_patch import inside_of, patch_of, rows_at
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_surface import surface_folder, surface_of
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import part_labels
from ladar_volume.tiles.tiled_ranks import median_of_tiles
from ladar_volume.tin.boundary import first_ends, part_numbers
from ladar_volume.tin.full_tin import footprint_areas


def outline_of(fitter: GroundFitter, outline: Path | None, base: Plane) -> float:
    """Variance, m⁶, of the volume by the place of the edge of what was sampled."""
    of, workers = fitter.of, fitter.workers
    median = median_of_tiles(workers, of, areas_inside, outline)
    folder = surface_folder(of.index, of.limits) / f"edge_{digest([str(outline)])}"
    asked, parts = set[Tile](), dict[Tile, TileParts]()
    while True:
        more = [(outline, folder, median, not asked, t in asked) for t in of.tiles]
        told = ask(workers, of, flat_parts, more)
        parts |= {t: one for t, one in zip(of.tiles, told, strict=True) if one is not None}
        if not parts:
            return 0.0
        along = along_edge([parts[t] for t in sorted(parts)])
        asked = tiles_of(of, [parts[t] for t in sorted(parts)], along) - set(parts)
        if not asked:
            break
    gone = dict(zip(sorted(parts), along, strict=True))
    found = ask(workers, of, strips, [(outline, folder, base, gone.get(t)) for t in of.tiles])
    return strip_variance(np.sum(found, axis=0))


def areas_inside(of: TiledCloud, tile: Tile, outline: Path | None) -> F64:
    """Areas (k,) m² of the tile's triangles inside the outline."""
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline) & surface.counted
    return footprint_areas(surface.tin.vertices, surface.tin.triangles[inside])


def flat_parts(
    of: TiledCloud,
    tile: Tile,
    outline: Path | None,
    folder: Path,
    median_m2: float,
    at_edge: bool,
    wanted: bool,
) -> TileParts | None:
    """Parts of the flat triangles of a tile, at rest, and how many of each have an open side; None
    where it is not wanted. at_edge : it is where a triangle has an open side
    """
    surface = surface_of(of.index, of.limits, tile)
    inside = inside_of(surface, tile, outline)
    is_open = open_sides(surface.tin, inside)
    if not (wanted or (at_edge and bool(is_open.any()))):
        return None
    patch = patch_of(of, tile, surface, outline, 2)
    around = dataclasses.replace(patch.tin, relevant=patch.relevant)
    edge = EdgeTriangles.of(around, patch.inside, median_m2)
    # the tile's own triangles come first, in their order
    flat = edge.flat[: len(inside)]
    at = rows_at(patch.tin.vertices, surface.tin.vertices)
    label = np.asarray(part_numbers(surface.tin.neighbours, flat), np.int64)
    write(folder, "flat", tile, label)
    write(folder, "cell", tile, edge.cell[at])
    at_side = is_open.any(axis=1) & flat
    n = int(label.max(initial=-1)) + 1
    return parts_of(surface, label, np.bincount(label[at_side], minlength=n).astype(np.float64))


def along_edge(parts: Sequence[TileParts]) -> list[Bool]:
    """Which parts (k,) of each tile lie along the edge, with all they are joined to."""
    label = part_labels(parts)
    n = int(label.max(initial=-1)) + 1
    is_open = np.bincount(label, np.concatenate([p.total for p in parts]), n) > 0
    along = is_open[label] if len(label) else np.zeros(0, np.bool_)
    return np.split(along, np.cumsum([p.count for p in parts])[:-1])


def tiles_of(of: TiledCloud, parts: Sequence[TileParts], along: Sequence[Bool]) -> set[Tile]:
    """The tiles that the shared triangles of the parts along the edge have a corner in."""
    corners = [p.corners[own[p.label]] for p, own in zip(parts, along, strict=True)]
    cells = np.floor(np.concatenate(corners).reshape(-1, 2) / of.index.cloud.tile_m)
    return {(i, j) for i, j in np.unique(cells.astype(np.int64), axis=0).tolist()}


def strips(
    of: TiledCloud, tile: Tile, outline: Path | None, folder: Path, base: Plane, gone: Bool | None
) -> F64:
    """What strips beyond the sides of the edge hold, m³, by direction (DIRECTIONS,): of those whose
    first end by x, then y is a vertex of the tile. gone : (k,) its flat parts along the edge, None
    where it is not at it
    """
    if gone is None:
        return np.zeros(DIRECTIONS)
    surface = surface_of(of.index, of.limits, tile)
    tin, inside = surface.tin, inside_of(surface, tile, outline)
    cell = read(folder, "cell", tile)
    none = np.zeros(len(inside), np.bool_)
    edge = EdgeTriangles(np.zeros(len(inside)), cell, none, open_sides(tin, inside))
    ends = edge.sides(tin, inside, np.append(gone, False)[read(folder, "flat", tile)])
    mine = ends[surface.own[first_ends(tin.vertices, ends)]]
    return strip_sums(tin.vertices, cell, height_above(tin.vertices, base), mine)
