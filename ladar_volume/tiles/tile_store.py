"""A point cloud file as square tiles on disk.

The file is read in parts of so many points. Each part becomes one file of arrays, a tile's
points (k, 3) float64, m, in file order under the tile's name, with their places in the part,
written whole or not at all: a run that was interrupted goes on with the parts that are missing. The
folder's name holds a digest of the file's bytes and of how it was read, so points of another file
are never taken for these.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import laspy
import numpy as np

from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.io.pointfiles.geokeys import coordinates_of_records
from ladar_volume.io.pointfiles.las import MARKS, check_las_header, place_of_points
from ladar_volume.io.pointfiles.laz_layers import check_layers
from ladar_volume.io.pointfiles.point_file import assemble
from ladar_volume.io.pointfiles.raw_table import RawTable
from ladar_volume.model.errors import CloudError, ConfigurationError, InputError
from ladar_volume.model.records import F64, I32, I64
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.array_file import ENDING, read_arrays, write_arrays
from ladar_volume.tin.duplicates import places_and_rows

#: Points read at a time: about 100 bytes each while they are sorted.
PART = 1_000_000
#: Kinds of file that can be read from the middle.
ENDINGS = (".las", ".laz")
#: Layout of the archives; another number makes another folder.
LAYOUT = 4
#: A tile of a side that is not given holds about so many points, where these make tiles for all
#: workers, and so many at least; its side where it cannot be told, m.
FULL, EMPTY, TILES, USUAL_M = 100_000, 10_000, 64, 50.0
#: It is told from so many stretches of so many points, between these shares of their coordinates.
STRETCHES, STRETCH, MIDDLE = 16, 20_000, (0.01, 0.99)
#: Farthest tile from the origin, in tiles: names stay whole numbers.
FARTHEST = 2**40

Tile: TypeAlias = tuple[int, int]


@dataclass(frozen=True)
class CloudParts:
    """A file and how it is dealt out.

    path : LAS, LAZ or COPC · folder : of the tiles · tile_m : side of a tile, m; tile (i, j) holds
    ``i side <= x < (i + 1) side`` and so for y · points : in the file · part : read at a time ·
    reading : what the user says of CRS, units and classes
    """

    path: Path
    folder: Path
    tile_m: float
    points: int
    part: int
    reading: Reading

    @property
    def count(self) -> int:
        """Number of parts."""
        return -(-self.points // self.part)

    def archive(self, k: int) -> Path:
        """Where part k is at rest."""
        return self.folder / "parts" / f"{k:06d}{ENDING}"


def parts_of_file(
    path: Path, store: Path, tile_m: float | None, reading: Reading, part: int = PART
) -> CloudParts:
    """How a file is dealt out into tiles below the folder ``store``, of a side that suits its
    points for None. Raises :class:`InputError` and :class:`CloudError` for what is no sound LAS
    file, :class:`ConfigurationError` for the tile.
    """
    if path.suffix.lower() not in ENDINGS:
        words = (
            f"{path}: tiles are read from LAS, LAZ and COPC; convert it with ladar_volume filter"
        )
        raise InputError(words, reason="input_format", value=str(path))
    if tile_m is not None and not (math.isfinite(tile_m) and tile_m > 0.0):
        raise ConfigurationError(f"--tile {tile_m}: a side in m above 0", value=tile_m)
    if not path.exists():
        raise InputError(f"{path}: no such file", reason="input_missing", value=str(path))
    try:
        check_las_header(path)
        check_layers(path, *place_of_points(path))
        with laspy.open(path) as file:
            points = int(file.header.point_count)
        with path.open("rb") as raw:
            content = hashlib.file_digest(raw, "sha256").hexdigest()
    except CloudError as error:
        raise CloudError(f"{path}: {error}", reason=error.reason, value=error.value) from error
    except Exception as error:  # a damaged file fails anywhere inside laspy
        words = f"{path}: cannot be read: {error}"
        raise InputError(words, reason="input_unreadable", value=str(path)) from error
    if points == 0:
        raise CloudError(f"{path}: there is no point in it", reason="cloud_empty")
    if tile_m is None:
        tile_m = suitable_side(CloudParts(path, store, math.nan, points, part, reading))
    name = digest([content, tile_m, part, asdict(reading), LAYOUT])
    return CloudParts(path, store / name, tile_m, points, part, reading)


def suitable_side(cloud: CloudParts) -> float:
    """The side, m, of tiles that work goes fast with, from some stretches of the file: a few points
    far away do not matter.
    """
    part = min(cloud.points, STRETCH)
    short = dataclasses.replace(cloud, part=part)
    some = np.unique(np.linspace(0.0, short.count - 1.0, STRETCHES).astype(np.int64)).tolist()
    xy = np.concatenate([read_part(short, k)[0][:, :2] for k in some])
    if not len(xy):
        return USUAL_M
    low, high = np.quantile(xy, MIDDLE, axis=0)
    many = cloud.points * len(xy) / min(part * len(some), cloud.points)
    each = min(max(many / TILES, EMPTY), FULL)
    side = math.sqrt(float((high - low).prod()) * each / many)
    return float(f"{side:.2g}") or USUAL_M


def digest(values: object) -> str:
    """A name for plain values: 16 hexadecimal digits."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_part(cloud: CloudParts, k: int) -> tuple[F64, dict[str, int], tuple[Doubt, ...]]:
    """Points (n, 3) m of part k that count, in file order; how many do not, by reason; and what
    makes the coordinates doubtful.
    """
    first, many = k * cloud.part, min(cloud.part, cloud.points - k * cloud.part)
    try:
        with laspy.open(cloud.path) as file:
            header = file.header
            file.seek(first)
            points = file.read_points(many)
            marks = [n for n in header.point_format.dimension_names if n in MARKS]
            found = {name: np.array(points[name]) for name in ("x", "y", "z", *marks)}
            records = [*header.vlrs, *(header.evlrs or [])]
    except Exception as error:  # a damaged file fails anywhere inside laspy and its decompressor
        words = f"points {first:,} to {first + many:,} cannot be decoded: {error}"
        raise CloudError(f"{cloud.path}: {words}", reason="cloud_values") from error
    if len(found["x"]) != many:
        words = f"{len(found['x'])} points from {first:,} on where {many} are announced"
        raise CloudError(f"{cloud.path}: {words}", reason="cloud_short", value=len(found["x"]))
    said = coordinates_of_records(records, bool(header.global_encoding.wkt))
    x, y, z = (float(abs(s)) for s in header.scales)
    try:
        one = assemble(RawTable(found, said, (x, y, z), header), False, cloud.reading)
    except CloudError as error:
        if error.reason != "cloud_classes" or not isinstance(error.value, dict):
            raise CloudError(f"{cloud.path}: {error}", reason=error.reason) from error
        return np.zeros((0, 3)), error.value, ()  # other parts may have points that count
    except InputError as error:
        raise InputError(f"{cloud.path}: {error}", reason=error.reason) from error
    if one.coordinates.across is None:
        words = f"{cloud.path}: degrees have no tiles in m; reproject to a UTM zone first"
        raise InputError(words, reason="input_degrees")
    return one.r, one.left_out, one.doubts


def distribute_part(cloud: CloudParts, k: int) -> Path:
    """Write part k, tile by tile, where that is not done yet or was damaged."""
    archive = cloud.archive(k)
    with contextlib.suppress(InputError):
        read_arrays(archive, ())
        return archive
    r, left_out, doubts = read_part(cloud, k)
    cell = np.floor(r[:, :2] / cloud.tile_m)
    if len(r) and np.abs(cell).max() > FARTHEST:
        words = f"--tile {cloud.tile_m:g}: too small for coordinates of {np.abs(r).max():.3g} m"
        raise ConfigurationError(words, value=cloud.tile_m)
    cells = cell.astype(np.int64)
    order = np.lexsort((cells[:, 1], cells[:, 0]))  # stable: file order within a tile
    r, cells = r[order], cells[order]
    new = np.flatnonzero(np.r_[True, (np.diff(cells, axis=0) != 0).any(axis=1)][: len(r)])
    rows = np.split(r, new[1:]) if len(new) else []
    boxes = [(*own[:, :2].min(axis=0), *own[:, :2].max(axis=0)) for own in rows]
    notes = {"left_out": left_out, "doubts": [asdict(d) for d in doubts]}
    arrays: dict[str, F64 | I32] = {
        f"{i}_{j}": own for (i, j), own in zip(cells[new].tolist(), rows, strict=True)
    }
    places = np.split(order.astype(np.int32), new[1:]) if len(new) else []
    for (i, j), place in zip(cells[new].tolist(), places, strict=True):
        arrays[f"row_{i}_{j}"] = place
    of_all = {
        "cells": cells[new],
        "counts": np.array([len(own) for own in rows], np.int64),
        "boxes": np.array(boxes).reshape(-1, 4),
        "notes": np.array(json.dumps(notes)),
    }
    write_arrays(archive, of_all | arrays)
    return archive


@dataclass(frozen=True)
class TileIndex:
    """Where the points of each tile are.

    cloud : the parts · parts : by tile, the parts that hold points of it, ascending · count : by
    tile · box : by tile, x and y low, x and y high of its points, m · left_out : points that do not
    count, by reason · doubts : about the coordinates · hull : (h, 2) corners of the hull of all
    points, m
    """

    cloud: CloudParts
    parts: dict[Tile, list[int]]
    count: dict[Tile, int]
    box: dict[Tile, tuple[float, float, float, float]]
    left_out: dict[str, int]
    doubts: tuple[Doubt, ...]
    hull: F64

    def __reduce__(self) -> tuple[Callable[..., TileIndex], tuple[object, ...]]:
        """Workers read it from the parts at rest, once: it goes with every task."""
        return index_at_rest, (self.cloud, self.hull.tobytes())

    @property
    def every_point(self) -> TileIndex:
        """The tiles with the points that the surface was not made of, too."""
        return self

    @property
    def cleaned(self) -> TileIndex:
        """The tiles without strays, where these were left out, and with all other points."""
        return self

    def home(self, tile: Tile) -> Path:
        """The folder in which the surface of a tile is at rest."""
        return self.cloud.folder

    def points(self, tile: Tile) -> F64:
        """Points (n, 3) m of a tile in file order."""
        name = f"{tile[0]}_{tile[1]}"
        found = [member(self.cloud.archive(k), name) for k in self.parts.get(tile, [])]
        return np.concatenate(found) if found else np.zeros((0, 3))

    def rows(self, tile: Tile) -> I64:
        """Numbers (n,) of these points that order all of the file as they stand in it."""
        name, parts, each = f"row_{tile[0]}_{tile[1]}", self.parts.get(tile, []), self.cloud.part
        found = [k * each + member(self.cloud.archive(k), name).astype(np.int64) for k in parts]
        return np.concatenate(found) if found else np.zeros(0, np.int64)

    def places(self, tile: Tile) -> F64:
        """Footprints (k, 4) of a tile: :func:`~ladar_volume.tin.duplicates.places`."""
        return self._at_rest(tile, "places")

    def place_rows(self, tile: Tile) -> I64:
        """The least of the :meth:`rows` at each of these (k,)."""
        return self._at_rest(tile, "row")

    def _at_rest(self, tile: Tile, name: str) -> np.ndarray:
        """One of both: neighbours ask for them often, so they are sorted once. Made anew where they
        are not at rest or are damaged.
        """
        path = self.cloud.folder / "places" / f"{tile[0]}_{tile[1]}{ENDING}"

        def made() -> dict[str, np.ndarray]:
            found = places_and_rows(self.points(tile), self.rows(tile))
            return dict(zip(("places", "row"), found, strict=True))

        return arrays_at_rest(path, (name,), made)[0]


def arrays_at_rest(
    path: Path, names: Sequence[str], make: Callable[[], dict[str, np.ndarray]]
) -> list[np.ndarray]:
    """Some of the arrays of an archive; all are made anew where it is missing or damaged."""
    with contextlib.suppress(InputError):
        return list(read_arrays(path, names).values())
    made = make()
    write_arrays(path, made)
    return [made[name] for name in names]


def member(archive: Path, name: str) -> np.ndarray:
    """One array of an archive. Raises :class:`InputError` for one that is damaged."""
    try:
        return read_arrays(archive, (name,))[name]
    except InputError as error:
        words = f"{error}: run again"
        raise InputError(words, reason="input_unreadable", value=str(archive)) from error


def tile_index(cloud: CloudParts) -> TileIndex:
    """The index of all parts, which are there, without the hull. Raises :class:`CloudError` where
    no point counts.
    """
    parts: dict[Tile, list[int]] = {}
    count: dict[Tile, int] = {}
    box: dict[Tile, tuple[float, float, float, float]] = {}
    left_out: dict[str, int] = {}
    doubts: dict[tuple[str, str], Doubt] = {}
    for k in range(cloud.count):
        for tile, many, edges in tiles_of(cloud.archive(k)):
            parts.setdefault(tile, []).append(k)
            count[tile] = count.get(tile, 0) + many
            x0, y0, x1, y1 = box.get(tile, edges)
            a, b, c, d = edges
            box[tile] = (min(x0, a), min(y0, b), max(x1, c), max(y1, d))
        why_not, why_doubtful = notes_of(cloud.archive(k))
        for why, many in why_not.items():
            left_out[why] = left_out.get(why, 0) + many
        doubts |= {(doubt.name, doubt.text): doubt for doubt in why_doubtful}
    if not parts:
        words = f"{cloud.path}: none of {cloud.points} points counts; choose with --classes"
        raise CloudError(words, reason="cloud_classes", value=left_out)
    known = tuple(doubts.values())
    return TileIndex(cloud, parts, count, box, left_out, known, np.zeros((0, 2)))


@lru_cache(maxsize=2)
def index_at_rest(cloud: CloudParts, hull: bytes) -> TileIndex:
    """The index of a process, with the hull's corners."""
    corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
    return dataclasses.replace(tile_index(cloud), hull=corners)


def notes_of(archive: Path) -> tuple[dict[str, int], list[Doubt]]:
    """What does not count of one part, by reason, and its doubts."""
    try:
        notes = json.loads(str(member(archive, "notes")))
        left_out = {str(why): int(many) for why, many in notes["left_out"].items()}
        return left_out, [Doubt(**doubt) for doubt in notes["doubts"]]
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        words = f"{archive}: damaged notes: delete it and run again"
        raise InputError(words, reason="input_unreadable", value=str(archive)) from error


def tiles_of(archive: Path) -> Iterator[tuple[Tile, int, tuple[float, float, float, float]]]:
    """The tiles of one part, with how many points it has of each, and their box."""
    cells, counts, boxes = (member(archive, n).tolist() for n in ("cells", "counts", "boxes"))
    for cell, many, edges in zip(cells, counts, boxes, strict=True):
        yield tuple(cell), many, tuple(edges)
