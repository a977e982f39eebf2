"""LAS and LAZ, by laspy, with the header checked against the file before laspy believes it."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import laspy
import numpy as np

from ladar_volume.io.pointfiles.ply import Columns, narrow
from ladar_volume.model.errors import CloudError, OutputError

#: Finest step of the stored integers, m: rounding of 0.05 mm is far below any sensor's noise.
SCALE_M = 1e-4
#: Bytes unpacked at a time: a damaged header must not ask for all memory at once.
CHUNK_BYTES = 2**26


def read_las(path: Path, columns: bool = True) -> Columns:
    """x, y, z as float64 (scaled and shifted) and, where ``columns``, every other dimension of the
    points, (n,), in file order.

    Raises :class:`CloudError` (cloud_header, cloud_short, cloud_values) and OSError.
    """
    _check_header(path)
    try:
        with laspy.open(path) as file:
            names = (
                [n for n in file.header.point_format.dimension_names if n not in ("X", "Y", "Z")]
                if columns
                else []
            )
            parts: dict[str, list[np.ndarray]] = {name: [] for name in ["x", "y", "z", *names]}
            for points in file.chunk_iterator(max(1, CHUNK_BYTES // file.header.point_format.size)):
                for name, part in parts.items():
                    part.append(np.array(points[name]))
            announced = file.header.point_count
    except (
        laspy.errors.LaspyException,
        RuntimeError,
        ValueError,
        EOFError,
        struct.error,
        MemoryError,
        KeyError,
    ) as error:
        raise CloudError(
            f"cannot be decoded, damaged or cut short: {error}", reason="cloud_values"
        ) from error
    out = {name: np.concatenate(part) if part else np.zeros(0) for name, part in parts.items()}
    if len(out["x"]) != announced:
        raise CloudError(
            f"{len(out['x'])} points where {announced} are announced",
            reason="cloud_short",
            value=len(out["x"]),
        )
    return out


def _check_header(path: Path) -> None:
    """Offsets, record counts and sizes against the file's length: laspy takes them as they are, and
    a wrong one means an endless loop.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(375)
    if head[:4] != b"LASF" or len(head) < 227:
        raise CloudError("does not begin with a LAS header", reason="cloud_header")
    minor, compressed = head[25], bool(head[104] & 0x80)
    (header_bytes, first), (records,), (row_bytes, count) = (
        struct.unpack_from(f, head, at) for f, at in (("<HI", 94), ("<I", 100), ("<HI", 105))
    )
    good = header_bytes <= first <= size and records * 54 <= first - header_bytes
    if minor >= 4:
        if len(head) < 375:
            raise CloudError("the header ends early", reason="cloud_short")
        (start, extended), (count,) = (
            struct.unpack_from("<QI", head, 235),
            struct.unpack_from("<Q", head, 247),
        )
        good &= extended == 0 or (start <= size and extended * 60 <= size - start)
    if not good:
        raise CloudError("the header points beyond the file", reason="cloud_header")
    if not compressed and count * row_bytes > size - first:
        raise CloudError(
            f"{size - first} bytes for {count} points of {row_bytes}: the file ends early",
            reason="cloud_short",
            value=count,
        )


def write_las(path: Path, columns: Columns, comments: list[str], encoding: str) -> None:
    """Write LAS 1.4; columns other than x, y, z become extra bytes, comments a record of user
    "ladar_volume". LAZ by the file's ending.

    Coordinates are integers of 0.1 mm about the cloud's middle (coarser only where the cloud is
    wider than 400 km). Raises OSError and :class:`OutputError`.
    """
    header = laspy.LasHeader(point_format=6, version="1.4")
    columns = {name: narrow(c) for name, c in columns.items()}
    r = np.column_stack([columns.pop(axis) for axis in "xyz"])
    low, high = (r.min(axis=0), r.max(axis=0)) if len(r) else (np.zeros(3), np.zeros(3))
    header.offsets = np.round(0.5 * (low + high))
    header.scales = np.maximum(SCALE_M, np.ceil((high - low) / 4.0e9 / SCALE_M) * SCALE_M)
    if any(len(name.encode()) > 32 for name in columns):
        raise OutputError(
            "a column's name is longer than the 32 bytes LAS has for it", value=list(columns)
        )
    header.add_extra_dims(
        [laspy.ExtraBytesParams(name, c.dtype.str[1:]) for name, c in columns.items()]
    )
    if comments:
        text = json.dumps(comments).encode()
        header.vlrs.append(
            laspy.VLR(
                user_id="ladar_volume",
                record_id=1,
                description="names of the codes",
                record_data=text,
            )
        )
    points = laspy.ScaleAwarePointRecord.zeros(len(r), header=header)
    points.x, points.y, points.z = r.T
    for name, c in columns.items():
        points[name] = c
    las = laspy.LasData(header, points)
    las.write(str(path))
