"""Whether anything may stand on the surface of all tiles, which one process takes out
(:mod:`ladar_volume.clouds.sampling.cloud_objects`): where no edge is a steep step nothing does.

Points that lie closer than a step is high are thinned to one in each cell of that size first, as
there: on the faces of a thing they leave no step between neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.sampling.cloud_objects import CLEAR, STEP
from ladar_volume.math.kernels import kernel
from ladar_volume.math.own_axes import raster_between
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, Bool
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import at_rest, read, read_arrays, write, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_patch import inside_of, rows_at
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull, places
from ladar_volume.tiles.tile_stars import tile_stars
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_folder, surface_of
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen.tile_spacing import Cells, KeptPoints, first_of_cells, winners
from ladar_volume.tin.full_tin import any_corner, vertex_mask
from ladar_volume.volume.field_checks.standing_objects import STEEP


class Highest(NamedTuple):
    """count : of steps · rise : of the highest, m · x, y : of its middle, m"""

    steps: int
    rise: float
    x: float
    y: float


NOTHING = Highest(0, 0.0, 0.0, 0.0)


@kernel
def highest_step(triangles: I32, vertices: F64, step_m: float, steep: float) -> Highest:
    """The edges of triangles (m, 3) that are higher than a step, m, and steeper than a slope; those
    that two triangles have count twice.
    """
    steps, most, x, y = 0, 0.0, 0.0, 0.0
    for t in range(len(triangles)):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            rise = abs(vertices[b, 2] - vertices[a, 2])
            dx, dy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
            if rise > step_m and rise * rise > steep * steep * (dx * dx + dy * dy):
                steps += 1
                if rise > most:
                    most = rise
                    x = 0.5 * (vertices[a, 0] + vertices[b, 0])
                    y = 0.5 * (vertices[a, 1] + vertices[b, 1])
    return Highest(steps, most, x, y)


def step_doubts(
    fitter: GroundFitter, outline: Path | None, object_height_m: float, spacing_m: float
) -> list[Doubt]:
    """Something may stand on the surface: on a body or its ground, or anywhere where there is no
    outline. outline : where the triangles inside are at rest, None for all · spacing_m : of the
    points, in the median
    """
    of, workers = fitter.of, fitter.workers
    step = max(STEP * object_height_m, CLEAR * fitter.sigma_m)
    if spacing_m < step:
        kept = thinned(fitter, step)
        found = ask(workers, of, steps_of_thinned, [(kept, outline, step)] * len(of.tiles))
    else:
        found = ask(workers, of, steps_of, [(outline, step)] * len(of.tiles))
    if not sum(f.steps for f in found):
        return []
    one = max(found, key=lambda f: f.rise)
    words = (
        f"the surface has steps above {step:.2g} m, the highest of {one.rise:.3g} m about "
        f"({one.x:.1f}, {one.y:.1f}) m: what stands on it, as machines, walls and trees do, is "
        "counted by tiles, and taken out by ladar_volume volume; hold the place against that, or "
        "set volume.objects to count"
    )
    return [Doubt("tiles_not_judged", words, one.rise)]


def asked_about(surface: TileSurface, tile: Tile, outline: Path | None) -> Bool:
    """The vertices (n,) of a tile that something may stand at: inside the outline, and its own in
    the ring of ground around; all without an outline.
    """
    if outline is None:
        return np.ones(len(surface.own), np.bool_)
    out = vertex_mask(surface.tin, inside_of(surface, tile, outline))
    out[np.flatnonzero(surface.used)[read(outline, "ring", tile)]] = True
    return out


def steps_of(of: TiledCloud, tile: Tile, outline: Path | None, step_m: float) -> Highest:
    """The steps of a tile."""
    surface = surface_of(of.index, of.limits, tile)
    t = surface.tin.triangles
    own = surface.own & asked_about(surface, tile, outline)
    return Highest(*highest_step(t[any_corner(t, own)], surface.tin.vertices, step_m, STEEP))


def steps_of_thinned(
    of: TiledCloud, tile: Tile, kept: KeptPoints, outline: Path | None, step_m: float
) -> Highest:
    """The steps round the points of a tile that are kept."""
    if tile not in kept.box:
        return NOTHING
    try:
        stars = tile_stars(kept, tile)
    except SurfaceError:  # all that are kept are on one line
        return NOTHING
    surface = surface_of(of.index, of.limits, tile)
    about = surface.tin.vertices[asked_about(surface, tile, outline)]
    own = stars.own & (rows_at(about, stars.tin.vertices) >= 0)
    t = stars.tin.triangles
    return Highest(*highest_step(t[any_corner(t, own)], stars.tin.vertices, step_m, STEEP))


def thinned(fitter: GroundFitter, cell_m: float) -> KeptPoints:
    """Of all points the nearest to the middle of each cell."""
    of, workers = fitter.of, fitter.workers
    index = of.index.every_point
    boxes = np.array(list(index.box.values()))
    low, _ = raster_between((boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)), cell_m)
    folder = surface_folder(of.index, of.limits) / f"thinned_{cell_m:g}"
    asked: Sequence[tuple[object, ...]] = [(low, cell_m, folder)] * len(of.tiles)
    cells = ask(workers, of, nearest_in_tile, asked)
    every = Cells(*(np.concatenate([c[k] for c in cells]) for k in range(3)))
    loses = np.split(~winners(every), np.cumsum([len(c.row) for c in cells])[:-1])
    lost = [c.row[loses] for c, loses in zip(cells, loses, strict=True)]
    found = ask(workers, of, keep, [(folder, rows) for rows in lost])
    box = {t: b for t, (b, _) in zip(of.tiles, found, strict=True) if b is not None}
    return KeptPoints(of.index.cloud, box, joined_hull([hull for _, hull in found]), folder)


def nearest_in_tile(of: TiledCloud, tile: Tile, low: F64, cell_m: float, folder: Path) -> Cells:
    """In each cell the point of a tile nearest to its middle, at rest; those in cells that reach
    into other tiles.
    """
    index = of.index.every_point
    points, rows = index.points(tile), index.rows(tile)
    at = (points[:, :2] - low) / cell_m
    cell = np.floor(at)
    off = ((at - cell - 0.5) ** 2).sum(axis=1)
    name = np.column_stack([np.zeros(len(cell), np.int64), cell.astype(np.int64)])
    best = first_of_cells(name, off, rows)
    write_arrays(at_rest(folder, "nearest", tile), {"points": points[best], "row": rows[best]})
    side = of.index.cloud.tile_m
    inner = points[best, :2] - np.array(tile) * side
    edge = np.minimum(inner, side - inner).min(axis=1) <= np.sqrt(2.0) * cell_m
    return Cells(name[best[edge]], off[best[edge]], rows[best[edge]])


def keep(of: TiledCloud, tile: Tile, folder: Path, lost: F64) -> tuple[Box | None, F64]:
    """Put the footprints kept of a tile at rest, without the rows that ``lost`` to those of other
    tiles. Returns their box, and the corners (h, 2) m of their hull.
    """
    found = read_arrays(at_rest(folder, "nearest", tile), ("points", "row"))
    left: Bool = ~np.isin(found["row"], lost)
    kept = places(found["points"][left])
    write(folder, "kept", tile, kept)
    return box_of(kept[:, :2]), hull_of_places(kept[:, :2])
