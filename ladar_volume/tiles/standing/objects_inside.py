"""Which of the things that were taken out of tiles are of an outline, and what walls that they
leave there may hide.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.cloud_noise import FEWEST, robust_sigma
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.ground_cover import CLIMB, MOST, steep_edges
from ladar_volume.clouds.sampling.objects_beside import REACH
from ladar_volume.clouds.volume_verdict import missing_lines, with_lines
from ladar_volume.ground.heights import height_above
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Bool, Plane, StandingObject
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.readings.tile_body import MOST_OF_BODY, gathered
from ladar_volume.tiles.readings.tiled_body import scatter_at
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_patch import inside_of
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import surface_of, used_of
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask


def tiled_within(
    workers: Workers, of: TiledCloud, outline: Path | None, objects: Sequence[StandingObject]
) -> tuple[StandingObject, ...]:
    """:func:`~ladar_volume.clouds.sampling.objects_beside.objects_within` the triangles of all
    tiles that are inside an outline, all for None.
    """
    if not objects:
        return ()
    asked = np.array([(one.x_m, one.y_m, REACH * one.size_m) for one in objects])
    found = np.any(ask(workers, of, reached_by, [(outline, asked)] * len(of.tiles)), axis=0)
    return tuple(
        dataclasses.replace(one, inside=True)
        for one, is_near in zip(objects, found.tolist(), strict=True)
        if is_near
    )


def reached_by(of: TiledCloud, tile: Tile, outline: Path | None, asked: F64) -> Bool:
    """Which of places, x and y, m, and a distance, m (k, 3), have a triangle of a tile within that,
    by its middle.
    """
    surface, out = surface_of(of.index, of.limits, tile), np.zeros(len(asked), np.bool_)
    tin = surface.tin
    corners = tin.triangles[inside_of(surface, tile, outline) & surface.counted]
    if not len(corners):
        return out
    middle = tin.vertices[corners, :2].mean(axis=1)
    low, high = middle.min(axis=0), middle.max(axis=0)
    apart = np.maximum(low - asked[:, :2], asked[:, :2] - high).max(axis=1)
    some = np.flatnonzero(apart <= asked[:, 2])
    if len(some):
        out[some] = np.asarray(cKDTree(middle).query(asked[some, :2])[0]) <= asked[some, 2]
    return out


def used_count(of: TiledCloud, tile: Tile) -> int:
    """How many vertices of a tile count."""
    return len(used_of(of.index, of.limits, tile)[0])


def with_walls(
    volume: CloudVolume,
    fitter: GroundFitter,
    base: Plane,
    parameters: Parameters,
    doubts: Sequence[Doubt],
) -> tuple[CloudVolume, list[Doubt]]:
    """A volume of all that counts with what the steep faces hide that objects left, where these are
    doubted; and a doubt where that is not told.
    """
    of = fitter.of
    if not any(doubt.name == "object" for doubt in doubts):
        return volume, []
    count = sum(ask(fitter.workers, of, used_count))
    if count > MOST_OF_BODY:
        words = (
            f"what steep faces hide is not told of {count:,} points, more than {MOST_OF_BODY:,}, "
            "and not in sigma: hold a part of the cloud against ladar_volume volume"
        )
        return volume, [Doubt("tiles_not_judged", words, float(count))]
    tin, inside = gathered(of, None, of.tiles)
    rise = parameters.volume.object_height_m
    high = vertex_mask(tin, inside) & (height_above(tin.vertices, base) > rise)
    rows, scatter = np.flatnonzero(high), 0.0
    if len(rows) >= FEWEST:
        some = rows[:: max(1, math.ceil(len(rows) / MOST))]
        scatter = robust_sigma(scatter_at(fitter, tin.vertices[some]), 0.0)
    faces = steep_edges(tin, max(2.0 * rise, CLIMB * scatter))
    area = np.where(inside, footprint_areas(tin.vertices, tin.triangles), 0.0)
    size = abs(volume.cut_m3 - volume.fill_m3)
    lines = missing_lines(size, tin, base, (area, faces), list(doubts), parameters)
    return (with_lines(volume, lines) if lines else volume), []
