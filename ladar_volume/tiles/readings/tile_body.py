"""A body that is small enough for one process, as a surface of its own: whether it is cut, and
whether walls stand in it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.ground_cover import CLIMB, steep_edges
from ladar_volume.clouds.volume_verdict import missing_lines
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.readings.tile_outside import Region
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import near_stored_places
from ladar_volume.tiles.tile_patch import inside_of, joined, part_round, rows_at
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of
from ladar_volume.tin.full_tin import footprint_areas, places_in, vertex_mask
from ladar_volume.volume.field_checks.completeness import stands_on_faces, wall_doubts
from ladar_volume.volume.field_checks.cut_bodies import body_cut, cut_doubts
from ladar_volume.volume.field_checks.standing_objects import AROUND_M

#: Vertices of a body and what is beside it, at most.
MOST_OF_BODY = 1_000_000


def body_and_around(of: TiledCloud, tile: Tile, region: Region, beside: Sequence[Tile]) -> int:
    """Which of the tile's vertices lie inside the outline or beside it, at rest; returns how many.
    beside : tiles with vertices inside that may be near
    """
    assert region.outline is not None
    surface = surface_of(of.index, of.limits, tile)
    out = vertex_mask(surface.tin, read(region.outline, "inside", tile)) & surface.own
    rest = surface.own & ~out
    xy = surface.tin.vertices[rest, :2]
    out[rest] = near_stored_places(xy, region.outline, "outline", beside, AROUND_M)
    write(region.rest, "body_around", tile, out)
    return int(np.count_nonzero(out))


@dataclass(frozen=True)
class BodyTask:
    """region : ground and outline · tiles : with some of the body · parameters · sigma_m3 : of its
    volume · size_m3 : that · scatter_m : of its points · objects : doubts about what stood on it
    """

    region: Region
    tiles: list[Tile]
    parameters: Parameters
    sigma_m3: float
    size_m3: float
    scatter_m: float
    objects: Sequence[Doubt]


class JudgedBody(NamedTuple):
    """doubts : that it is cut, or walls are in it · lines : what these add to the budget, m⁶"""

    doubts: list[Doubt]
    lines: dict[str, float]


def gathered(of: TiledCloud, region: Region | None, tiles: Sequence[Tile]) -> tuple[Tin, Bool]:
    """The triangles of tiles that meet a vertex of the body or beside it, all for no region, the
    vertices in the order of the file, and which triangles lie inside the outline (m,).
    """
    parts, xy, rows = [], [], []
    for tile in tiles:
        s = surface_of(of.index, of.limits, tile)
        marked = s.own if region is None else read(region.rest, "body_around", tile)
        inside = inside_of(s, tile, None if region is None else region.outline)
        parts.append(part_round(s, inside, marked))
        xy.append(s.tin.vertices[s.own])
        rows.append(s.row[s.own])
    patch = joined(parts).patch(parts)
    tin = dataclasses.replace(patch.tin, relevant=patch.relevant)
    return in_order_of_file(tin, np.concatenate(xy), np.concatenate(rows)), patch.inside


def in_order_of_file(tin: Tin, xyz: F64, row: I64) -> Tin:
    """A surface with its vertices by their rows (k,) of the file, those at xyz (k, 3), the others
    last.
    """
    at = rows_at(xyz, tin.vertices)
    number = np.where(at >= 0, row[at], np.iinfo(np.int64).max)
    order = np.argsort(number, kind="stable")
    place = places_in(order, len(order))
    corners = place[tin.triangles]
    return Tin(tin.vertices[order], corners, tin.neighbours, tin.relevant, number[order])


def judged_body(of: TiledCloud, task: BodyTask) -> JudgedBody:
    """Whether a body is cut, and whether walls stand in it."""
    tin, inside = gathered(of, task.region, task.tiles)
    base, v = task.region.base, task.parameters.volume
    area = np.where(inside, footprint_areas(tin.vertices, tin.triangles), 0.0)
    faces = steep_edges(tin, max(2.0 * v.object_height_m, CLIMB * task.scatter_m))
    doubts = cut_doubts(body_cut(tin, base, inside, v), task.sigma_m3, task.parameters)
    if not stands_on_faces(tin, base, inside, v.object_height_m):
        doubts += wall_doubts(tin, base, inside, faces, v.object_height_m)
    every = [*task.objects, *doubts]
    lines = missing_lines(task.size_m3, tin, base, (area, faces), every, task.parameters)
    return JudgedBody(doubts, lines)
