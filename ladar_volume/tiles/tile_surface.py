"""The triangles of each tile at rest, so that what a ground needs of them is asked many times."""

from __future__ import annotations

import contextlib
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.tiles.array_file import ENDING, Array, read_arrays, write_arrays
from ladar_volume.tiles.tile_stars import TileStars, tile_stars
from ladar_volume.tiles.tile_store import Tile, TileIndex, digest
from ladar_volume.tin.full_tin import corners_of, places_in
from ladar_volume.tin.relevant import relevant_triangles

#: Across a side of a triangle lies one of another tile, or the hull: this tile does not know.
UNKNOWN = -2
#: Arrays of its triangles, and of the vertices that a ground may be fitted to.
ARRAYS = ("vertices", "triangles", "neighbours", "relevant", "row")
USED = ("used_xyz", "used_shared", "used_row")


@dataclass(frozen=True)
class Limits:
    """Which triangles count, and the limits of that."""

    relevant: str = "all"
    max_edge_m: float = math.inf
    max_circumdiameter_m: float = math.inf


@dataclass(frozen=True)
class TileSurface:
    """tin : the triangles that meet a vertex of the tile, with those that count as relevant; across
    a side -1 for the hull, which is told at the tile's own vertices, :data:`UNKNOWN` for what is
    not · shared : (n,) points at each vertex · own : (n,) which vertices lie in the tile · counted
    : (m,) triangles that belong to it · row : (n,) number of the first point of the file there, -1
    for vertices of other tiles · points, rounds : counts
    """

    tin: Tin
    shared: F64
    own: Bool
    counted: Bool
    row: I64
    points: int
    rounds: int

    @property
    def used(self) -> Bool:
        """The tile's own vertices (n,) of triangles that count."""
        out = np.zeros(len(self.own), np.bool_)
        out[self.tin.triangles[self.tin.relevant]] = True
        return out & self.own


def surface_folder(index: TileIndex, limits: Limits) -> Path:
    """Where the surfaces of all tiles are at rest."""
    return index.cloud.folder / f"surface_{digest(asdict(limits))}"


def surface_path(index: TileIndex, limits: Limits, tile: Tile) -> Path:
    """Where the surface of a tile is at rest."""
    return surface_folder(index, limits) / f"{tile[0]}_{tile[1]}{ENDING}"


def surface_of(index: TileIndex, limits: Limits, tile: Tile) -> TileSurface:
    """The surface of a tile, read where it is at rest; made anew where it is not or is damaged."""
    path = surface_path(index, limits, tile)
    with contextlib.suppress(InputError):
        found = read_arrays(path)
        vertices, triangles, neighbours, relevant, row = (found[n] for n in ARRAYS)
        tin = Tin(vertices, triangles, neighbours, relevant, row)
        points, rounds = found["counts"].tolist()
        shared, own, counted = (found[n] for n in ("shared", "own", "counted"))
        return TileSurface(tin, shared, own, counted, row, points, rounds)
    made = make_surface(index, limits, tile)
    tin = made.tin
    arrays: dict[str, Array] = {
        "vertices": tin.vertices,
        "triangles": tin.triangles,
        "neighbours": tin.neighbours,
        "relevant": tin.relevant,
        "row": made.row,
        "shared": made.shared,
        "own": made.own,
        "counted": made.counted,
        "counts": np.array([made.points, made.rounds]),
    }
    write_arrays(path, arrays | dict(zip(USED, of_used(made), strict=True)))
    return made


def of_used(made: TileSurface) -> tuple[F64, F64, I64]:
    """Of the tile's own vertices that count: places (k, 3) m, points at each (k,), rows (k,)."""
    used = made.used
    return made.tin.vertices[used], made.shared[used], made.row[used]


def used_of(index: TileIndex, limits: Limits, tile: Tile) -> tuple[F64, F64, I64]:
    """:func:`of_used` of the surface of a tile at rest."""
    with contextlib.suppress(InputError):
        xyz, shared, row = read_arrays(surface_path(index, limits, tile), USED).values()
        return xyz, shared, row
    return of_used(surface_of(index, limits, tile))


def make_surface(index: TileIndex, limits: Limits, tile: Tile) -> TileSurface:
    """Triangulate a tile and keep what belongs to it."""
    stars, first = tile_stars(index, tile), index.place_rows(tile)
    tin = stars.tin
    row = np.full(len(tin.vertices), -1, np.int64)
    row[stars.own] = first[tin.source[stars.own]]
    counts = relevant_triangles(
        tin, limits.relevant, limits.max_edge_m, limits.max_circumdiameter_m
    )
    return part_of_tile(stars, row, counts, index.count[tile])


def part_of_tile(stars: TileStars, row: I64, counts: Bool, points: int) -> TileSurface:
    """The triangles that meet a tile's vertices, and their corners, numbered anew."""
    tin, star = stars.tin, stars.star
    corners = corners_of(tin.triangles[star], len(tin.vertices))
    number = np.full(len(star) + 1, UNKNOWN, np.int32)
    number[np.flatnonzero(star)] = np.arange(np.count_nonzero(star))
    number[-1] = -1  # the hull
    triangles = places_in(corners, len(tin.vertices))[tin.triangles[star]]
    across, own = number[tin.neighbours[star]], stars.own[corners]
    for k in range(3):  # beyond a side of other tiles' vertices there may be more
        at = ~own[triangles[:, (k + 1) % 3]] & ~own[triangles[:, (k + 2) % 3]]
        across[at & (across[:, k] == -1), k] = UNKNOWN
    small = Tin(tin.vertices[corners], triangles, across, counts[star], row[corners])
    return TileSurface(
        small,
        stars.shared[corners],
        own,
        stars.counted[star],
        row[corners],
        points,
        stars.rounds,
    )
