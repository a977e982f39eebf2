"""Whether anything may stand on the surface of all tiles: where no edge is a steep step nothing
does.

Points that lie closer than a step is high are thinned to one in each cell of that size first: on
the faces of a thing they leave no step between neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.sampling.object_search import ObjectSearch
from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, Bool
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import read
from ladar_volume.tiles.standing.thinned_tiles import ThinnedTiles, thinned
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_patch import inside_of, rows_at
from ladar_volume.tiles.tile_stars import tile_stars
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import TileSurface, surface_of
from ladar_volume.tiles.tile_work import Workers
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


def found_steps(
    workers: Workers, of: TiledCloud, how: ObjectSearch, outline: Path | None
) -> Sequence[Highest]:
    """The steps of each tile: those on a body and on the ground around it, or all where there is no
    outline. outline : where the triangles inside are at rest
    """
    if not how.thinned_m:
        return ask(workers, of, steps_of, [(outline, how.step_m)] * len(of.tiles))
    kept = thinned(workers, TiledCloud(of.index.every_point, of.limits), how.thinned_m)
    more = [(kept, outline, how.step_m)] * len(of.tiles)
    return ask(workers, of, steps_of_thinned, more)


def step_doubts(
    workers: Workers, of: TiledCloud, how: ObjectSearch, outline: Path | None
) -> list[Doubt]:
    """Something may stand on the surface."""
    found = found_steps(workers, of, how, outline)
    if not sum(f.steps for f in found):
        return []
    one = max(found, key=lambda f: f.rise)
    words = (
        f"the surface has steps above {how.step_m:.2g} m, the highest of {one.rise:.3g} m about "
        f"({one.x:.1f}, {one.y:.1f}) m: what stands on it, as machines, walls and trees do, is "
        "counted, since a site so large is not searched for it; hold the place against "
        "ladar_volume volume, or set volume.objects to count"
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
    of: TiledCloud, tile: Tile, kept: ThinnedTiles, outline: Path | None, step_m: float
) -> Highest:
    """The steps round the points of a tile that are kept."""
    if tile not in kept.box:
        return NOTHING
    try:
        stars = tile_stars(kept, tile)
    except SurfaceError:  # all that are kept are on one line
        return NOTHING
    own, t = stars.own, stars.tin.triangles
    if outline is not None:
        surface = surface_of(of.index, of.limits, tile)
        about = surface.tin.vertices[asked_about(surface, tile, outline)]
        own = own & (rows_at(about, stars.tin.vertices) >= 0)
    return Highest(*highest_step(t[any_corner(t, own)], stars.tin.vertices, step_m, STEEP))
