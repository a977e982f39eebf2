"""The points of a cloud without its strays, as tiles at rest like those of a file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ladar_volume.clouds.cloud_noise import CloudNoise
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import ENDING, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.cleaning.curve_tiles import Curve, good_of_pass, numbered
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_patch import in_box
from ladar_volume.tiles.tile_store import CloudParts, Tile, TileIndex, member


@dataclass(frozen=True)
class CleanedTiles(TileIndex):
    """The tiles of a cloud without its strays; ``cloud.folder`` is where they are. strays, isolated
    : how many points were left out, and how many of these were isolated · stray_box : by tile, of
    these · noise : of the heights, None where it is not told
    """

    strays: int = 0
    isolated: int = 0
    stray_box: Mapping[Tile, Box] = field(default_factory=dict)
    noise: CloudNoise | None = None

    def __reduce__(self) -> tuple[Callable[..., TileIndex], tuple[object, ...]]:
        """Workers read it from what is at rest, once: it goes with every task."""
        return cleaned_at_rest, (self.cloud, self.hull.tobytes())

    def points(self, tile: Tile) -> F64:
        """Points (n, 3) m of a tile in the order of the curve."""
        return member(at_rest(self.cloud.folder, "kept", tile), "points")

    def rows(self, tile: Tile) -> I64:
        """Their numbers (n,) in the order of all."""
        return member(at_rest(self.cloud.folder, "kept", tile), "rank")


@dataclass(frozen=True)
class KeptTile:
    """count : of the points of a tile that are kept · box, stray_box : of them and of the others,
    None for none
    """

    count: int
    box: Box | None
    stray_box: Box | None


def strays_in(index: CleanedTiles, box: Box) -> F64:
    """The strays (s, 3), m, in a box, of all tiles."""
    found = [np.zeros((0, 3))]
    for tile, own in index.stray_box.items():
        if own[0] <= box[2] and own[2] >= box[0] and own[1] <= box[3] and own[3] >= box[1]:
            points = member(at_rest(index.cloud.folder, "kept", tile), "strays")
            found.append(points[in_box(points, box)])
    return np.concatenate(found)


def keep(of: TiledCloud, tile: Tile, curve: Curve, good: str | None, cloud: CloudParts) -> KeptTile:
    """Put the good points of a tile at rest, all for None, with their numbers."""
    points, rank = numbered(curve, tile)
    strays = read_arrays(at_rest(curve.folder, "placed", tile), ("far",))["far"]
    if good is not None:
        some = good_of_pass(curve, tile, good)
        strays = np.concatenate([strays, points[~some]])
        points, rank = points[some], rank[some]
    arrays = {"points": points, "rank": rank, "strays": strays}
    write_arrays(at_rest(cloud.folder, "kept", tile), arrays)
    return KeptTile(len(points), box_of(points[:, :2]), box_of(strays[:, :2]))


def whole(of: TiledCloud, tile: Tile, cloud: CloudParts) -> bool:
    """Whether what is kept of a tile is at rest and sound."""
    try:
        read_arrays(at_rest(cloud.folder, "kept", tile), ())
    except InputError:
        return False
    return True


def write_index(index: CleanedTiles) -> None:
    """Put it at rest, when all tiles are."""
    tiles = sorted(index.count)
    notes = {
        "left_out": index.left_out,
        "doubts": [dataclasses.asdict(d) for d in index.doubts],
        "strays": index.strays,
        "isolated": index.isolated,
        "noise": None if index.noise is None else dataclasses.asdict(index.noise),
    }
    arrays = {
        "cells": np.array(tiles, np.int64).reshape(-1, 2),
        "count": np.array([index.count[t] for t in tiles], np.int64),
        "box": np.array([index.box[t] for t in tiles]).reshape(-1, 4),
        "stray_cells": np.array(list(index.stray_box), np.int64).reshape(-1, 2),
        "stray_box": np.array(list(index.stray_box.values())).reshape(-1, 4),
        "notes": np.array(json.dumps(notes)),
    }
    write_arrays(index.cloud.folder / f"index{ENDING}", arrays)


def read_index(cloud: CloudParts) -> CleanedTiles:
    """It. Raises :class:`InputError` where it is missing or damaged."""
    found = read_arrays(cloud.folder / f"index{ENDING}")
    tiles = [(int(i), int(j)) for i, j in found["cells"].tolist()]
    with_strays = [(int(i), int(j)) for i, j in found["stray_cells"].tolist()]
    notes = json.loads(str(found["notes"]))
    return CleanedTiles(
        cloud,
        {},
        dict(zip(tiles, found["count"].tolist(), strict=True)),
        {t: tuple(b) for t, b in zip(tiles, found["box"].tolist(), strict=True)},
        notes["left_out"],
        tuple(Doubt(**d) for d in notes["doubts"]),
        np.zeros((0, 2)),
        notes["strays"],
        notes["isolated"],
        {t: tuple(b) for t, b in zip(with_strays, found["stray_box"].tolist(), strict=True)},
        None if notes["noise"] is None else CloudNoise(**notes["noise"]),
    )


@lru_cache(maxsize=2)
def cleaned_at_rest(cloud: CloudParts, hull: bytes) -> CleanedTiles:
    """The index of a process, with the hull's corners."""
    corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
    return dataclasses.replace(read_index(cloud), hull=corners)
