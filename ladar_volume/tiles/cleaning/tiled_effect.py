"""What the strays of all tiles would change in a volume:
:mod:`ladar_volume.clouds.sampling.stray_effect` by tiles.

A triangle with them belongs to the tile of its first corner that is none. The neighbours of a
vertex with strays are strays, or were its neighbours without. So a tile finds its triangles from
the vertices around, and the strays in the circumcircles of these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ladar_volume.clouds.sampling.stray_effect import (
    held_below,
    inner_places,
    plan_areas,
    triangles_over,
)
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.tiles.array_file import at_rest, read_arrays, write_arrays
from ladar_volume.tiles.cleaning.cleaned_tiles import CleanedTiles, strays_in
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import Box, box_of, reach
from ladar_volume.tiles.tile_patch import inside_of, patch_of
from ladar_volume.tiles.tile_stars import circle_boxes
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_folder, surface_of
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.predicates import incircle, workspace

#: Edges from a tile's own vertices within which lies what its triangles with strays cover.
EDGES = 6


def tiled_effect(workers: Workers, of: TiledCloud, outline: Path | None, base: Plane) -> float:
    """Net volume without strays less that with them, m³, above a base and within an outline; of
    tiles whose strays were left out.
    """
    folder = surface_folder(of.index, of.limits) / "strays"
    boxes = ask(workers, of, strays_over, [(folder,)] * len(of.tiles))
    some = [(tile, box) for tile, box in zip(of.tiles, boxes, strict=True) if box is not None]
    if not some:
        return 0.0
    return math.fsum(ask(workers, of, effect_here, [(outline, base, folder, some)] * len(of.tiles)))


def strays_over(of: TiledCloud, tile: Tile, folder: Path) -> Box | None:
    """The strays over the triangles of a tile that count, at rest; returns their box."""
    index = of.index.cleaned
    assert isinstance(index, CleanedTiles)
    strays = strays_in(index, reach(of, tile))
    if len(strays):
        surface = surface_of(of.index, of.limits, tile)
        counted = surface.tin.relevant & surface.counted
        over: Bool = np.zeros(len(strays), np.bool_)
        if counted.any():
            over = locate(triangle_index(surface.tin, counted), strays[:, :2]) >= 0
        strays = strays[over]
    write_arrays(at_rest(folder, "over", tile), {"strays": strays[np.argsort(strays[:, 0])]})
    return box_of(strays[:, :2])


@kernel
def circles_with(corners: F64, boxes: F64, points: F64, w: F64) -> tuple[Bool, Bool]:
    """The triangles, corners (m, 3, 2), in or on whose circumcircle a point lies of (s, 3), these
    ascending by x; and the points (s,) that lie so. boxes : (m, 4) of the circles, NaN where that
    is not known
    """
    gone, held = np.zeros(len(corners), np.bool_), np.zeros(len(points), np.bool_)
    xy = np.empty((4, 2))
    for t in range(len(corners)):
        x0, y0, x1, y1 = boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3]
        first = np.searchsorted(points[:, 0], x0) if x0 == x0 else 0
        xy[:3] = corners[t]
        for p in range(first, len(points)):
            if points[p, 0] > x1:
                break
            if points[p, 1] < y0 or points[p, 1] > y1:
                continue
            xy[3] = points[p, :2]
            if incircle(xy, 0, 1, 2, 3, w) >= 0.0:
                gone[t], held[p] = True, True
    return gone, held


def effect_here(
    of: TiledCloud,
    tile: Tile,
    outline: Path | None,
    base: Plane,
    folder: Path,
    some: Sequence[tuple[Tile, Box]],
) -> float:
    """What the triangles of a tile give to it, m³. some : tiles with strays over them, and their
    boxes
    """
    surface = surface_of(of.index, of.limits, tile)
    strays, gone, _ = strays_about(surface.tin, folder, some)
    if not gone.any():
        return 0.0
    inside, tin = inside_of(surface, tile, outline), surface.tin
    own = gone & inside & surface.counted
    area = footprint_areas(tin.vertices, tin.triangles)
    old = held_below(tin.vertices[tin.triangles[own]], area[own], base)
    patch = patch_of(of, tile, surface, outline, EDGES)
    strays, ground, held = strays_about(patch.tin, folder, some)
    fresh = triangles_over(np.vstack([patch.tin.vertices, strays[held]]))
    fresh = fresh[mine(of, tile, fresh, strays)]
    at = locate(triangle_index(patch.tin, ground), inner_places(fresh))
    share = np.where(at >= 0, patch.inside[at], False)
    return old - held_below(fresh, share * plan_areas(fresh), base)


def strays_about(
    tin: Tin, folder: Path, some: Sequence[tuple[Tile, Box]]
) -> tuple[F64, Bool, Bool]:
    """Strays (s, 3) m that may lie in circumcircles of a surface, which of its triangles (m,) have
    one there, and which strays (s,) lie so.
    """
    corners = np.ascontiguousarray(tin.vertices[tin.triangles, :2])
    boxes = np.asarray(circle_boxes(corners))
    every = not np.isfinite(boxes).all()  # the circle of a flat triangle may reach anywhere
    low, high = boxes[:, :2].min(axis=0).tolist(), boxes[:, 2:].max(axis=0).tolist()
    near = [np.zeros((0, 3))]
    for other, b in some:
        if every or (b[0] <= high[0] and b[2] >= low[0] and b[1] <= high[1] and b[3] >= low[1]):
            near.append(read_arrays(at_rest(folder, "over", other), ("strays",))["strays"])
    strays = np.concatenate(near)
    strays = strays[np.lexsort(strays.T[::-1])]
    return strays, *circles_with(corners, boxes, strays, workspace())


def mine(of: TiledCloud, tile: Tile, fresh: F64, strays: F64) -> Bool:
    """Which of triangles (m, 3, 3) have their first corner in a tile, by x, then y, of those that
    are no strays (s, 3); of all where all are.
    """
    name = np.ascontiguousarray(fresh[:, :, :2] + 0.0).view(np.complex128)[:, :, 0]
    stray = np.isin(name, np.ascontiguousarray(strays[:, :2] + 0.0).view(np.complex128))
    order = np.lexsort((name.imag, name.real, stray), axis=1)
    first = np.take_along_axis(fresh[:, :, :2], order[:, :1, None], axis=1)[:, 0]
    return np.asarray((np.floor(first / of.index.cloud.tile_m) == tile).all(axis=1))
