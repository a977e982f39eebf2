"""The returns of a survey at rest, tile by tile, for a filter of each.

A tile is a square column of voxels. A return is written to the tile of its voxel and to those whose
halo its voxel lies in, at most four, so that a tile reads its own rows alone. An archive is a
Parquet file with a row group for each tile, in the order of their names, and checksums; it is there
whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.model.records import I64, Bool
from ladar_volume.rmls.tile_filter import HALO
from ladar_volume.rmls.voxel_store import Candidates, unpack_key
from ladar_volume.tiles.tile_store import Tile

if TYPE_CHECKING:  # Arrow is needed with tiles alone
    import pyarrow as pa

#: Layout of the archives; another number makes another folder.
LAYOUT = 1
#: Key of the list of tiles in an archive.
TILES = "tiles"
#: Columns of rows of several numbers, and what one row of them is.
ROWS = {"C": (np.float32, 6), "aux": (np.int16, 12)}


def voxels_of_side(tile_m: float, radius_m: float) -> int:
    """Voxels along the side of a tile. Raises :class:`ConfigurationError` for a tile that is not
    larger than its halo.
    """
    side = round(tile_m / radius_m) if np.isfinite(tile_m) else 0
    if side < 2 * HALO:
        words = f"--tile {tile_m:g}: at least {2 * HALO * radius_m:g} m, {2 * HALO} filter.radius_m"
        raise ConfigurationError(words, value=tile_m)
    return side


def within_tile(keys: I64, tile: Tile, side: int, margin: int) -> Bool:
    """Which voxels lie in a tile or no more than ``margin`` voxels beside it."""
    out = np.ones(len(keys), np.bool_)
    ijk = unpack_key(keys)
    for axis in range(2):
        first = tile[axis] * side
        out &= (ijk[:, axis] >= first - margin) & (ijk[:, axis] < first + side + margin)
    return out


@dataclass(frozen=True)
class TileRows:
    """The rows of one tile in an archive: name of the archive, number of the row group, rows, and
    voxels that have some.
    """

    archive: str
    group: int
    rows: int
    voxels: int


def tiles_of_rows(keys: I64, side: int) -> tuple[I64, I64]:
    """Rows (m,) and tiles (m, 2): each row with the tile of its voxel and with those whose halo
    this lies in.
    """
    ij = unpack_key(keys)[:, :2]
    low, high = (ij - HALO) // side, (ij + HALO) // side
    rows, tiles = [], []
    for in_x in (False, True):
        for in_y in (False, True):
            also = np.ones(len(keys), np.bool_)
            if in_x:
                also &= high[:, 0] != low[:, 0]
            if in_y:
                also &= high[:, 1] != low[:, 1]
            at = np.flatnonzero(also)
            x, y = (high if in_x else low)[at, 0], (high if in_y else low)[at, 1]
            rows.append(at)
            tiles.append(np.stack([x, y], axis=1))
    return np.concatenate(rows), np.concatenate(tiles)


def table_of(points: Candidates) -> pa.Table:
    """Points as an Arrow table."""
    import pyarrow as pa

    columns = {name: getattr(points, name) for name in ("key", "hash", "t_ns", "ring")}
    arrays = {name: pa.array(column) for name, column in columns.items()}
    for axis in range(3):
        arrays["xyz"[axis]] = pa.array(np.ascontiguousarray(points.r[:, axis]))
    for name, (kind, width) in ROWS.items():
        flat = np.ascontiguousarray(getattr(points, name), kind)
        size = width * flat.itemsize
        buffers = [None, pa.py_buffer(flat)]
        arrays[name] = pa.FixedSizeBinaryArray.from_buffers(pa.binary(size), len(flat), buffers)
    return pa.table(arrays)


def points_of(table: pa.Table) -> Candidates:
    """The inverse of :func:`table_of`."""
    held = {name: table[name].to_numpy() for name in ("key", "hash", "t_ns", "ring")}
    r = np.stack([table[name].to_numpy() for name in "xyz"], axis=1)
    for name, (kind, width) in ROWS.items():
        column = table[name].combine_chunks()
        first, n = column.offset, len(column)
        flat = np.frombuffer(column.buffers()[1] or b"", kind)
        held[name] = flat[first * width : (first + n) * width].reshape(n, width)
    return Candidates(
        held["key"], held["hash"], held["t_ns"], held["ring"], r, held["C"], held["aux"]
    )


def write_returns(path: Path, points: Candidates, side: int) -> list[tuple[Tile, TileRows]]:
    """Write an archive; returns what it holds of each tile."""
    import pyarrow.parquet as pq

    rows, tiles = tiles_of_rows(points.key, side)
    order = np.lexsort((points.hash[rows], points.key[rows], tiles[:, 1], tiles[:, 0]))
    rows, tiles = rows[order], tiles[order]
    new = np.flatnonzero(np.r_[True, (np.diff(tiles, axis=0) != 0).any(axis=1)][: len(rows)])
    ends, table, found = np.r_[new[1:], len(rows)], table_of(points), []
    with (
        atomic_file(path) as part,
        pq.ParquetWriter(
            part,
            table.schema,
            compression="zstd",
            compression_level=1,
            use_dictionary=False,
            write_statistics=False,
            write_page_checksum=True,
        ) as writer,
    ):
        for group, (first, end) in enumerate(zip(new.tolist(), ends.tolist(), strict=True)):
            own = rows[first:end]
            writer.write_table(table.take(own), row_group_size=len(own))
            voxels = 1 + int(np.count_nonzero(np.diff(points.key[own])))
            tile = (int(tiles[first, 0]), int(tiles[first, 1]))
            found.append((tile, TileRows(path.name, group, len(own), voxels)))
        writer.add_key_value_metadata({TILES: json.dumps([list(tile) for tile, _ in found])})
    return found


def read_returns(folder: Path, tile: Tile, of: Sequence[TileRows]) -> Iterator[Candidates]:
    """The rows of a tile, archive by archive. Raises :class:`InputError` (input_damaged, with the
    archive as its value) for one that is damaged or not there.
    """
    import pyarrow.parquet as pq

    for part in of:
        path = folder / part.archive
        try:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                table = file.read_row_group(part.group)
                there = json.loads(file.metadata.metadata[TILES.encode()])[part.group]
            if tuple(there) != tile or len(table) != part.rows:
                raise ValueError("it holds other rows")
        except Exception as error:  # a damaged file fails anywhere inside the reader
            words = f"{path}: missing or damaged ({error})"
            raise InputError(words, reason="input_damaged", value=str(path)) from error
        yield points_of(table)
