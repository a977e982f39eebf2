"""Notches in the edge of what was measured, of all tiles:
:mod:`ladar_volume.volume.field_checks.notches` to what one process gives.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import read, write
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import TileParts, parts_of
from ladar_volume.tiles.tile_places import off_hull
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_surface import EVERY, surface_folder, surface_of
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import part_labels
from ladar_volume.tin.boundary import part_numbers
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.volume.field_checks.notches import large_bays, notch_doubt


def tiled_notches(fitter: GroundFitter, base: Plane, volume: CloudVolume) -> list[Doubt]:
    """:func:`~ladar_volume.volume.field_checks.notches.notch_doubts` of all tiles."""
    of, workers = fitter.of, fitter.workers
    if of.limits == EVERY:
        return []
    words = [base.beta.tolist(), base.origin_xy.tolist()]
    folder = surface_folder(of.index, of.limits) / f"bays_{digest(words)}"
    parts = ask(workers, of, bays, [(folder, base)] * len(of.tiles))
    label = part_labels(parts)
    if not len(label):
        return []
    held = np.bincount(label, np.concatenate([p.total for p in parts])).astype(np.float64)
    out = list[Doubt]()
    number = np.full(len(held), -1, np.int64)
    large = large_bays(held, volume.sigma_m3, volume.cut_m3 + volume.fill_m3)
    number[large] = np.arange(len(large))
    each = np.split(number[label], np.cumsum([p.count for p in parts])[:-1])
    found = ask(workers, of, bay_corners, [(folder, own) for own in each])
    bay, corners = (np.concatenate([f[k] for f in found]) for k in range(2))
    for k, row in enumerate(large):
        own = corners[bay == k]
        sides = boundary(own)
        hull = ~off_hull(sides, of.index.hull)
        out += notch_doubt(own, sides, hull, float(held[row]))
    return out


def bays(of: TiledCloud, tile: Tile, folder: Path, base: Plane) -> TileParts:
    """Parts of the triangles of a tile that do not count, at rest, and what they hold, m³."""
    surface = surface_of(of.index, of.limits, tile)
    tin = surface.tin
    label = np.asarray(part_numbers(tin.neighbours, ~tin.relevant), np.int64)
    n = int(label.max(initial=-1)) + 1
    own = np.flatnonzero(surface.counted & (label >= 0))
    t = tin.triangles[own]
    held = footprint_areas(tin.vertices, t) * height_above(tin.vertices, base)[t].mean(axis=1)
    write(folder, "bay", tile, label.astype(np.int32))
    return parts_of(surface, label, np.bincount(label[own], held, n).astype(np.float64))


class BayCorners(NamedTuple):
    """bay : (t,) of triangles · corners : (t, 3, 2) m"""

    bay: I64
    corners: F64


def bay_corners(of: TiledCloud, tile: Tile, folder: Path, number: I64) -> BayCorners:
    """The triangles of a tile in bays that are looked at; ``number`` : (p,) of the bay of each of
    its parts, -1 for others.
    """
    if not (number >= 0).any():
        return BayCorners(np.zeros(0, np.int64), np.zeros((0, 3, 2)))
    surface = surface_of(of.index, of.limits, tile)
    at = np.append(number, -1)[read(folder, "bay", tile)]
    rows = np.flatnonzero(surface.counted & (at >= 0))
    return BayCorners(at[rows], surface.tin.vertices[surface.tin.triangles[rows], :2])


def boundary(corners: F64) -> F64:
    """The sides (e, 2, 2) of triangles (t, 3, 2) that only one of them has, the triangle to their
    left.
    """
    ends = np.concatenate([corners[:, [(k + 1) % 3, (k + 2) % 3]] for k in range(3)])
    name = np.ascontiguousarray(ends).view(np.complex128).reshape(-1, 2)
    _, at, count = np.unique(np.sort(name, axis=1), axis=0, return_inverse=True, return_counts=True)
    out: F64 = ends[count[at.reshape(-1)] == 1]
    return out
