"""Named arrays in one file, which are there whole or not at all and are read without being copied.

What tiles have at rest is read some twenty-five times: by their neighbours, and by one question
after the other. So a file is mapped into memory, and each process adds up its checksum once. A file
that a power cut left incomplete is found out by that, and made anew: nobody waits for the disk.

Layout: :data:`MAGIC`, length of the head and its CRC-32 (8 bytes each), head (JSON: name, dtype,
shape and place of each array, size and CRC-32 of what follows), the arrays, each from a multiple of
64 bytes on.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import secrets
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import unwritable
from ladar_volume.model.errors import InputError, short_repr

Array = npt.NDArray[Any]

#: Ending of the files, first bytes of one, and the bytes before its head.
ENDING, MAGIC, BEFORE = ".arrays", b"LVARRAY2", 24
#: Arrays begin at multiples of so many bytes; kinds of their numbers.
ALIGNED, KINDS = 64, "biufcU"
#: Files of this process whose checksum was right: when they were written, and their size.
_sound: dict[Path, tuple[int, int, int]] = {}


def _aligned(place: int) -> int:
    return -(-place // ALIGNED) * ALIGNED


def _pieces(arrays: Mapping[str, Array]) -> Iterator[tuple[str, int, Array]]:
    """Name and place of each array after the head, and its bytes in order."""
    place = 0
    for name, array in arrays.items():
        yield name, place, np.ascontiguousarray(array)
        place = _aligned(place + array.nbytes)


def _bytes_of(array: Array) -> memoryview:
    plain = array.reshape(-1).view(np.uint8) if array.size else np.zeros(0, np.uint8)
    return plain.data


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Write arrays of numbers or text, whole or not at all; folders are made. Raises
    :class:`OutputError` where that cannot be.
    """
    pieces, table, crc, end = list(_pieces(arrays)), [], 0, 0
    for name, place, array in pieces:
        assert array.dtype.kind in KINDS, name
        crc = zlib.crc32(bytes(place - end), crc)
        crc, end = zlib.crc32(_bytes_of(array), crc), place + array.nbytes
        table.append([name, array.dtype.str, np.shape(arrays[name]), place])
    head = json.dumps({"arrays": table, "size": end, "crc": crc}).encode()
    part = path.with_name(f".{path.name}.{secrets.token_hex(8)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            first = _aligned(BEFORE + len(head))
            numbers = (n.to_bytes(8, "little") for n in (len(head), zlib.crc32(head)))
            file.write(b"".join((MAGIC, *numbers, head)).ljust(first, b"\0"))
            for _, place, array in pieces:
                file.write(bytes(first + place - file.tell()))
                file.write(_bytes_of(array))
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise unwritable(path, error) from error


def read_arrays(path: Path, names: Sequence[str] | None = None) -> dict[str, Array]:
    """Arrays of a file, all or some, which may be written to without the file changing. Raises
    :class:`InputError` (``input_damaged``) for one that is missing or damaged.
    """
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            held = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        size, crc = (int.from_bytes(held[k : k + 8], "little") for k in (8, 16))
        words, first = held[BEFORE : BEFORE + size], _aligned(BEFORE + size)
        if held[: len(MAGIC)] != MAGIC or zlib.crc32(words) != crc:
            raise ValueError("no such head")
        head = json.loads(words)
        _check(path, held, (first, head["size"], head["crc"]), status)
        table = {name: (dtype, shape, place) for name, dtype, shape, place in head["arrays"]}
        return {
            name: _array(held, first, *table[name]) for name in (table if names is None else names)
        }
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        text = f"{path}: missing or damaged ({short_repr(error)})"
        raise InputError(text, reason="input_damaged", value=str(path)) from error


def _check(path: Path, held: mmap.mmap, said: tuple[int, int, int], status: os.stat_result) -> None:
    """Raise ValueError where size or checksum are others than the head says."""
    first, size, crc = said
    if first + size != len(held):
        raise ValueError("another size")
    mark = (status.st_mtime_ns, status.st_size, status.st_ino)
    if _sound.get(path) == mark:
        return
    with memoryview(held) as whole, whole[first:] as part:
        if zlib.crc32(part) != crc:
            raise ValueError("another checksum")
    _sound[path] = mark


def _array(held: mmap.mmap, first: int, dtype: str, shape: Sequence[int], place: int) -> Array:
    of = np.dtype(dtype)
    count = math.prod(shape)
    if of.kind not in KINDS or min(shape, default=0) < 0:
        raise ValueError("no such array")
    if not count:
        return np.zeros(shape, of)
    return np.frombuffer(held, of, count, first + place).reshape(shape)


def at_rest(folder: Path, name: str, tile: tuple[int, int]) -> Path:
    """Where an array of a tile is at rest."""
    return folder / name / f"{tile[0]}_{tile[1]}{ENDING}"


def write(folder: Path, name: str, tile: tuple[int, int], values: Array) -> None:
    """Write an array of a tile."""
    write_arrays(at_rest(folder, name, tile), {"values": values})


def read(folder: Path, name: str, tile: tuple[int, int]) -> Array:
    """Read it."""
    return read_arrays(at_rest(folder, name, tile), ("values",))["values"]
