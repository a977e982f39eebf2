"""Compressed parts of recordings, unpacked within bounds: a few kilobytes can claim, or be,
gigabytes of zeros.

rosbags unpacks whole chunks without a limit; its tables of unpackers are replaced by ours when this
module is loaded.
"""

from __future__ import annotations

import bz2
import os
from collections.abc import Callable
from typing import Any, BinaryIO, Protocol

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap

from ladar_volume.model.errors import BagError

#: Largest chunk, bytes: a cloud of 20 million points has half of it.
CHUNK = 2**30
#: Measurements stand for up to some ten times their packed size; beyond this, in more bytes than
#: that, nothing is unpacked.
RATIO, SMALL = 200, 2**26

#: The library that rosbags itself takes.
_ZSTD: Any = vars(storage_mcap)["zstd"]


class _Unpacker(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def unused_data(self) -> bytes | None: ...
    def decompress(self, data: bytes, max_length: int) -> bytes: ...


def check_claim(size: int, packed: int) -> None:
    """Refuse what cannot be measurements before it is unpacked. Raises :class:`BagError`
    (bag_chunk).
    """
    if not 0 <= size <= CHUNK or (size > SMALL and size > RATIO * packed):
        raise BagError(
            f"{packed:,} packed bytes claim to be {size:,}, more than measurements give: not "
            "unpacked",
            reason="bag_chunk",
            value=size,
        )


def largest_unpacked_size(packed: int) -> int:
    """What so many packed bytes may be at most."""
    return min(CHUNK, max(SMALL, RATIO * packed))


def decompress_bounded(start: Callable[[], Any], data: bytes, most: int) -> bytes:
    """Unpack frame after frame, at most ``most`` bytes. Raises :class:`BagError` (bag_chunk) where
    there are more.
    """
    out: list[bytes] = []
    size = 0
    while data:
        unpacker: _Unpacker = start()
        part = unpacker.decompress(data, most - size + 1)
        size += len(part)
        if size > most or not unpacker.eof:
            raise BagError(
                f"packed data are more than {most:,} bytes, or end early",
                reason="bag_chunk",
                value=size,
            )
        out.append(part)
        data = unpacker.unused_data or b""
    return b"".join(out)


class _Zstd:
    """Zstandard, one frame at a time."""

    def __init__(self) -> None:
        self._unpacker = _ZSTD.ZstdDecompressor()

    @property
    def eof(self) -> bool:
        return bool(self._unpacker.eof)

    @property
    def unused_data(self) -> bytes:
        return bytes(self._unpacker.unused_data)

    def decompress(self, data: bytes, max_length: int) -> bytes:
        return bytes(self._unpacker.decompress(data, max_length))


def zstd(data: bytes, size: int | None = None) -> bytes:
    """Zstandard; ``size`` where it is announced. Raises :class:`BagError` (bag_chunk)."""
    if size is not None:
        check_claim(size, len(data))
    return decompress_bounded(
        _Zstd, data, largest_unpacked_size(len(data)) if size is None else size
    )


def lz4_frames(data: bytes, size: int | None = None) -> bytes:
    """LZ4; ``size`` where it is announced. Raises :class:`BagError` (bag_chunk)."""
    if size is not None:
        check_claim(size, len(data))
    most = largest_unpacked_size(len(data)) if size is None else size
    return decompress_bounded(lz4.frame.LZ4FrameDecompressor, data, most)


def bzip2(data: bytes) -> bytes:
    """bzip2. Raises :class:`BagError` (bag_chunk)."""
    return decompress_bounded(bz2.BZ2Decompressor, data, largest_unpacked_size(len(data)))


def check_chunk(packed: bytes, compression: str, size: int) -> None:
    """What a chunk of an MCAP announces, in its record and in its frame, before other libraries
    unpack it. Raises :class:`BagError` (bag_chunk).
    """
    check_claim(size, len(packed))
    if compression == "zstd":
        inside = zstandard.get_frame_parameters(packed[:18]).content_size
        if inside not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise BagError(f"a chunk of {size:,} bytes says {inside:,}", reason="bag_chunk")


class _BoundedFile:
    """A compressed file as rosbags copies it, bounded."""

    def __init__(self, packed: BinaryIO, mode: str) -> None:
        self._most = max(SMALL, RATIO * os.fstat(packed.fileno()).st_size)
        self._file = _ZSTD.open(packed, mode)

    def __enter__(self) -> _BoundedFile:
        return self

    def __exit__(self, *what: object) -> None:
        self._file.close()

    def read(self, size: int) -> bytes:
        """The next bytes."""
        data = bytes(self._file.read(size))
        self._most -= len(data)
        if self._most < 0:
            raise BagError("a packed file that is more than measurements give", reason="bag_chunk")
        return data


class _MessageUnpacking:
    """What rosbags takes from its library, bounded."""

    open = _BoundedFile
    decompress = staticmethod(zstd)

    def __getattr__(self, name: str) -> Any:
        return getattr(_ZSTD, name)


storage_mcap.DECOMPRESSORS["zstd"] = zstd
storage_mcap.DECOMPRESSORS["lz4"] = lz4_frames
rosbag1.decompressors["bz2"] = bzip2
rosbag1.decompressors["lz4"] = lz4_frames
vars(rosbag2)["zstd"] = _MessageUnpacking()
