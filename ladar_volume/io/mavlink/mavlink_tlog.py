"""The frames of a ground station's log (.tlog)."""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from pathlib import Path

from ladar_volume.io.mavlink.mavlink_stream import MARKERS, frame_is_good
from ladar_volume.model.errors import BagError
from ladar_volume.model.losses import Losses

#: Time stamps further apart than this are damage.
TLOG_GAP_US = 3 * 86400 * 1_000_000


def tlog_frames(path: Path, losses: Losses) -> Iterator[tuple[int, bytes]]:
    """(time of receipt in ns, frame) of a .tlog: eight bytes of microseconds, big-endian, before
    every frame. Bytes between are counted as noise. Raises BagError (bag_missing) where there is no
    such file.
    """
    try:
        with path.open("rb") as stream:
            if os.fstat(stream.fileno()).st_size == 0:
                return
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from _tlog_frames(data, losses)
    except OSError as error:
        raise BagError(f"{path}: {error}", reason="bag_missing", value=str(path)) from error


def _tlog_frames(data: mmap.mmap, losses: Losses) -> Iterator[tuple[int, bytes]]:
    position, last_us, size = 0, None, len(data)
    while position + 8 < size:
        end = _frame_end(data, position)
        # a frame is believed if the next one, or the end of the file, follows it, or its checksum
        # fits
        if (
            end is not None
            and end + 9 <= size
            and data[end + 8] not in MARKERS
            and not frame_is_good(data[position + 8 : end])
        ):
            end = None
        if end is None or not _is_timely(data, position, end, last_us):
            losses.add("mavlink_noise_byte")
            position += 1
            continue
        last_us = _stamp_us(data, position)
        yield last_us * 1000, data[position + 8 : end]
        position = end
    losses.add("mavlink_noise_byte", size - position)


def _stamp_us(data: mmap.mmap, position: int) -> int:
    return int.from_bytes(data[position : position + 8], "big")


def _is_timely(data: mmap.mmap, position: int, end: int, last_us: int | None) -> bool:
    """Whether a time stamp agrees with the one before or the one after: a stamp can be damaged as
    well as a frame.
    """
    us = _stamp_us(data, position)
    if last_us is not None and abs(us - last_us) <= TLOG_GAP_US:
        return True
    if end + 8 >= len(data) or data[end + 8] not in MARKERS:
        return last_us is None
    return abs(us - _stamp_us(data, end)) <= TLOG_GAP_US


def _frame_end(data: mmap.mmap, position: int) -> int | None:
    """Where the frame whose time stamp begins here ends; None where there is none, or not all of
    one.
    """
    if position + 11 > len(data) or data[position + 8] not in MARKERS:
        return None
    length = data[position + 9]
    if data[position + 8] == 0xFE:
        end = position + 8 + 8 + length
    else:
        end = position + 8 + 12 + length + (13 if data[position + 10] & 1 else 0)
    return end if end <= len(data) else None
