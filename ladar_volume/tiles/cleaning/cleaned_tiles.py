"""The points of a cloud without its strays, as tiles at rest like those of a file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import ENDING, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.cleaning.curve_tiles import Curve, good_of_pass, numbered
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_store import CloudParts, Tile, TileIndex, member


@dataclass(frozen=True)
class CleanedTiles(TileIndex):
    """The tiles of a cloud without its strays; ``cloud.folder`` is where they are. strays, isolated
    : how many points were left out, and how many of these were isolated · sigma_m : noise of the
    heights, NaN where it is not told · sigma_words : where it comes from
    """

    strays: int = 0
    isolated: int = 0
    sigma_m: float = float("nan")
    sigma_words: str = ""

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
    """count : of the points of a tile that are kept · box : of them, None for none"""

    count: int
    box: Box | None


def keep(of: TiledCloud, tile: Tile, curve: Curve, good: str | None, cloud: CloudParts) -> KeptTile:
    """Put the good points of a tile at rest, all for None, with their numbers."""
    points, rank = numbered(curve, tile)
    if good is not None:
        some = good_of_pass(curve, tile, good)
        points, rank = points[some], rank[some]
    write_arrays(at_rest(cloud.folder, "kept", tile), {"points": points, "rank": rank})
    return KeptTile(len(points), box_of(points[:, :2]))


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
        "sigma_m": index.sigma_m,
        "sigma_words": index.sigma_words,
    }
    arrays = {
        "cells": np.array(tiles, np.int64).reshape(-1, 2),
        "count": np.array([index.count[t] for t in tiles], np.int64),
        "box": np.array([index.box[t] for t in tiles]).reshape(-1, 4),
        "notes": np.array(json.dumps(notes)),
    }
    write_arrays(index.cloud.folder / f"index{ENDING}", arrays)


def read_index(cloud: CloudParts) -> CleanedTiles:
    """It. Raises :class:`InputError` where it is missing or damaged."""
    found = read_arrays(cloud.folder / f"index{ENDING}")
    tiles = [(int(i), int(j)) for i, j in found["cells"].tolist()]
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
        float(notes["sigma_m"]),
        notes["sigma_words"],
    )


@lru_cache(maxsize=2)
def cleaned_at_rest(cloud: CloudParts, hull: bytes) -> CleanedTiles:
    """The index of a process, with the hull's corners."""
    corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
    return dataclasses.replace(read_index(cloud), hull=corners)
