"""The triangles of each tile at rest, so that what a ground needs of them is asked many times."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tiles.array_file import ENDING, Array, at_rest, read_arrays, write_arrays
from ladar_volume.tiles.tile_stars import TileStars, tile_stars
from ladar_volume.tiles.tile_store import Tile, TileIndex, arrays_at_rest, digest
from ladar_volume.tin.full_tin import corners_of, places_in, vertex_mask
from ladar_volume.tin.relevant import relevant_triangles

#: Across a side of a triangle lies one of another tile, or the hull: this tile does not know.
UNKNOWN = -2
#: Arrays of the triangles, of the vertices (the tile's own come first), and of what counts.
ARRAYS = ("vertices", "triangles", "neighbours", "row")
OWN = ("vertices", "shared", "row", "own")
COUNTS = ("relevant", "bridged", "used")


@dataclass(frozen=True)
class Limits:
    """Which triangles count, and the limits of that: all, those within a limit of their edges or
    circumcircles, or those where points were sampled (``sampled``).
    """

    relevant: str = "all"
    max_edge_m: float = math.inf
    max_circumdiameter_m: float = math.inf


#: All triangles count; those where points were sampled.
EVERY, SAMPLED = Limits(), Limits("sampled")


@dataclass(frozen=True)
class TileSurface:
    """tin : the triangles that meet a vertex of the tile, with those that count as relevant; across
    a side -1 for the hull, which is told at the tile's own vertices, :data:`UNKNOWN` for what is
    not · shared : (n,) points at each vertex · own : (n,) which vertices lie in the tile · counted
    : (m,) triangles that belong to it · row : (n,) number of the first point of the file there, -1
    for vertices of other tiles · bridged : (m,) triangles that count and bridge what was not
    sampled · points, rounds : counts
    """

    tin: Tin
    shared: F64
    own: Bool
    counted: Bool
    row: I64
    bridged: Bool
    points: int
    rounds: int

    @property
    def used(self) -> Bool:
        """The tile's own vertices (n,) of triangles that count."""
        return np.asarray(vertex_mask(self.tin, self.tin.relevant) & self.own)


def surface_folder(index: TileIndex, limits: Limits) -> Path:
    """Where what follows from the surfaces of all tiles is at rest."""
    return index.cloud.folder / f"surface_{digest(asdict(limits))}"


def surface_path(index: TileIndex, tile: Tile) -> Path:
    """Where the triangles of a tile are at rest."""
    return index.home(tile) / "surface" / f"{tile[0]}_{tile[1]}{ENDING}"


def surface_of(index: TileIndex, limits: Limits, tile: Tile) -> TileSurface:
    """The surface of a tile, read where it is at rest; made anew where it is not or is damaged."""
    path = surface_path(index, tile)
    try:
        found = read_arrays(path)
        vertices, triangles, neighbours, row = (found[n] for n in ARRAYS)
        every = np.ones(len(triangles), np.bool_)
        tin = Tin(vertices, triangles, neighbours, every, row)
        points, rounds = found["counts"].tolist()
        shared, own, counted = (found[n] for n in ("shared", "own", "counted"))
        made = TileSurface(tin, shared, own, counted, row, ~every, points, rounds)
    except InputError:
        made = make_surface(index, tile)
        write_surface(path, made)
    if limits == EVERY:
        return made
    relevant, bridged, _ = counts_of(index, limits, tile, made)
    tin = dataclasses.replace(made.tin, relevant=relevant)
    return dataclasses.replace(made, tin=tin, bridged=bridged)


def write_surface(path: Path, made: TileSurface) -> None:
    """Put the triangles of a tile at rest."""
    arrays: dict[str, Array] = {
        "vertices": made.tin.vertices,
        "triangles": made.tin.triangles,
        "neighbours": made.tin.neighbours,
        "row": made.row,
        "shared": made.shared,
        "own": made.own,
        "counted": made.counted,
        "counts": np.array([made.points, made.rounds]),
    }
    write_arrays(path, arrays)


def counts_path(index: TileIndex, limits: Limits, tile: Tile) -> Path:
    """Where it is at rest what counts of a tile."""
    return at_rest(surface_folder(index, limits), "counts", tile)


def counts_of(
    index: TileIndex, limits: Limits, tile: Tile, made: TileSurface | None = None
) -> list[Array]:
    """Which triangles of a tile count (m,), which of these bridge what was not sampled (m,), and
    which of its own vertices (k,) are of the former. ``made`` is its surface, of which all count.
    """
    path = counts_path(index, limits, tile)

    def within_limits() -> dict[str, Array]:
        if limits.relevant == "sampled":
            words = f"{path}: missing or damaged: run again"
            raise InputError(words, reason="input_unreadable", value=str(path))
        whole = surface_of(index, EVERY, tile) if made is None else made
        longest = limits.max_edge_m, limits.max_circumdiameter_m
        none = np.zeros(0, np.int64)  # is artificial
        relevant = relevant_triangles(whole.tin, limits.relevant, *longest, none)
        return dict(zip(COUNTS, counted_of(whole, relevant, ~whole.tin.relevant), strict=True))

    return arrays_at_rest(path, COUNTS, within_limits)


def counted_of(surface: TileSurface, relevant: Bool, bridged: Bool) -> tuple[Bool, Bool, Bool]:
    """What :func:`counts_of` has of a surface of which all triangles counted until now."""
    tin = dataclasses.replace(surface.tin, relevant=relevant)
    used = dataclasses.replace(surface, tin=tin).used[surface.used]
    return relevant, bridged & relevant, used


def used_of(index: TileIndex, limits: Limits, tile: Tile) -> tuple[F64, F64, I64]:
    """Of the tile's own vertices that count: places (k, 3) m, points at each (k,), rows (k,)."""
    try:
        xyz, shared, row, own = read_arrays(surface_path(index, tile), OWN).values()
    except InputError:
        made = surface_of(index, EVERY, tile)
        xyz, shared, row, own = made.tin.vertices, made.shared, made.row, made.own
    k = int(np.count_nonzero(own))  # they come first, and each is a corner of a triangle
    xyz, shared, row = xyz[:k], shared[:k], row[:k]
    if limits == EVERY:
        return xyz, shared, row
    used = counts_of(index, limits, tile)[2]
    return xyz[used], shared[used], row[used]


def make_surface(index: TileIndex, tile: Tile) -> TileSurface:
    """Triangulate a tile and keep what belongs to it."""
    stars, first = tile_stars(index, tile), index.place_rows(tile)
    row = np.full(len(stars.tin.vertices), -1, np.int64)
    row[stars.own] = first[stars.tin.source[stars.own]]
    return part_of_tile(stars, row, index.count[tile])


@kernel
def star_kernel(
    triangles: I32, neighbours: I32, number: I32, place: I32, own: Bool
) -> tuple[I32, I32]:
    """Triangles and what lies across their sides (k, 3): of those with a number (m,), -1 for none,
    over vertices at new places (n,). Across a side of other tiles' vertices there may be more.
    """
    k = int(number.max()) + 1 if len(number) else 0
    out, across = np.empty((k, 3), np.int32), np.empty((k, 3), np.int32)
    for t in range(len(triangles)):
        i = number[t]
        if i < 0:
            continue
        for c in range(3):
            a, b = triangles[t, (c + 1) % 3], triangles[t, (c + 2) % 3]
            beyond = neighbours[t, c]
            out[i, c], across[i, c] = place[triangles[t, c]], UNKNOWN
            if beyond >= 0 and number[beyond] >= 0:
                across[i, c] = number[beyond]
            elif beyond < 0 and (own[a] or own[b]):
                across[i, c] = -1
    return out, across


def part_of_tile(stars: TileStars, row: I64, points: int) -> TileSurface:
    """The triangles that meet a tile's vertices, and their corners, numbered anew."""
    tin, star = stars.tin, stars.star
    corners = corners_of(tin.triangles[star], len(tin.vertices))
    number = places_in(np.flatnonzero(star), len(star))
    place = places_in(corners, len(tin.vertices))
    triangles, across = star_kernel(tin.triangles, tin.neighbours, number, place, stars.own)
    own, every = stars.own[corners], np.ones(len(triangles), np.bool_)
    small = Tin(tin.vertices[corners], triangles, across, every, row[corners])
    return TileSurface(
        small,
        stars.shared[corners],
        own,
        stars.counted[star],
        row[corners],
        ~every,
        points,
        stars.rounds,
    )
