"""LAS and LAZ read by laspy, with the header checked against the file before laspy believes it."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np

from ladar_volume.io.pointfiles.geokeys import coordinates_of_records
from ladar_volume.io.pointfiles.laz_layers import check_layers
from ladar_volume.io.pointfiles.raw_table import RawTable
from ladar_volume.model.errors import CloudError

#: Bytes unpacked at a time: a damaged header must not ask for all memory at once.
CHUNK_BYTES = 2**26
#: Dimensions that say which points count, read always.
MARKS = ("classification", "withheld")
#: The compressor of files without chunks, which lazrs cannot read.
UNCHUNKED = 1


def read_las(path: Path, columns: bool = True) -> RawTable:
    """x, y, z as float64 (scaled and shifted), class and withheld flag, and where ``columns``,
    every other dimension of the points, (n,) or (n, count), in file order; the header's CRS.

    Raises :class:`CloudError` (cloud_header, cloud_short, cloud_values), :class:`InputError`
    (input_crs, input_units) and OSError.
    """
    check_las_header(path)
    try:
        check_layers(path, *place_of_points(path))
        with laspy.open(path) as file:
            header = file.header
            names = [
                n
                for n in header.point_format.dimension_names
                if n not in ("X", "Y", "Z") and (columns or n in MARKS)
            ]
            parts: dict[str, list[np.ndarray]] = {name: [] for name in ["x", "y", "z", *names]}
            for points in file.chunk_iterator(max(1, CHUNK_BYTES // header.point_format.size)):
                with np.errstate(over="ignore", invalid="ignore"):  # refused by the caller
                    for name, part in parts.items():
                        part.append(np.array(points[name]))
            announced, records = header.point_count, [*header.vlrs, *(header.evlrs or [])]
    except (OSError, CloudError):
        raise
    except Exception as error:  # a damaged file fails anywhere inside laspy and its decompressor
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
    x, y, z = (float(abs(s)) for s in header.scales)
    return RawTable(
        out, coordinates_of_records(records, bool(header.global_encoding.wkt)), (x, y, z), header
    )


def check_las_header(path: Path) -> None:
    """Offsets, record counts and sizes against the file's length: laspy takes them as they are, and
    a wrong one means an endless loop, or points that are left out without a word.
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
    end = size
    if minor >= 3 and len(head) >= 235:
        (waveforms,) = struct.unpack_from("<Q", head, 227)
        end = waveforms if first <= waveforms < end and waveforms > 0 else end
    if minor >= 4:
        if len(head) < 375:
            raise CloudError("the header ends early", reason="cloud_short")
        legacy = count
        (start, extended), (count,) = (
            struct.unpack_from("<QI", head, 235),
            struct.unpack_from("<Q", head, 247),
        )
        good &= extended == 0 or (start <= size and extended * 60 <= size - start)
        end = start if extended and first <= start < end else end
        if legacy not in (0, count):
            raise CloudError(
                f"the header announces {legacy} points and {count} points",
                reason="cloud_header",
                value=[legacy, count],
            )
    if not good:
        raise CloudError("the header points beyond the file", reason="cloud_header")
    if compressed:
        _check_chunks(path, first, count)
        return
    _check_rows(end - first, row_bytes, count)


def _check_rows(held_bytes: int, row_bytes: int, count: int) -> None:
    """The announced count against the bytes between the header and what follows the points."""
    if count * row_bytes > held_bytes:
        raise CloudError(
            f"{held_bytes} bytes for {count} points of {row_bytes}: the file ends early",
            reason="cloud_short",
            value=count,
        )
    held = held_bytes // row_bytes if row_bytes else count
    if held != count:
        raise CloudError(
            f"the header announces {count} points, the file holds {held}: one of them is wrong",
            reason="cloud_header",
            value=[count, held],
        )


def _check_chunks(path: Path, first: int, count: int) -> None:
    """The announced count against the number of chunks of a LAZ file, where all have one size."""
    data = _laszip_record(path)
    if len(data) < 16:
        return
    if struct.unpack_from("<H", data)[0] == UNCHUNKED:
        raise CloudError(
            "packed without chunks, as before laszip 2: pack it anew (PDAL, laszip)",
            reason="cloud_header",
        )
    (chunk,) = struct.unpack_from("<I", data, 12)
    with path.open("rb") as raw:
        raw.seek(first)
        at = raw.read(8)
        (table,) = struct.unpack("<q", at) if len(at) == 8 else (-1,)
        if table < 0:  # written to a stream: the place is at the end of the file
            raw.seek(-8, 2)
            (table,) = struct.unpack("<q", raw.read(8))
        raw.seek(min(max(table, 0), path.stat().st_size))
        words = raw.read(8)
    if len(words) < 8 or chunk in (0, 2**32 - 1):
        return
    many = struct.unpack("<II", words)[1]
    if many > path.stat().st_size:
        raise CloudError(f"{many} chunks announced in a smaller file", reason="cloud_header")
    if not (many - 1) * chunk < count <= many * chunk and (many or count):
        raise CloudError(
            f"the header announces {count} points, the file holds {many} chunks of {chunk}: one of "
            "them is wrong",
            reason="cloud_header",
            value=[count, many],
        )


def place_of_points(path: Path) -> tuple[int, bytes]:
    """Where the points of a LAS or LAZ file begin, and how they are packed; empty for not."""
    with path.open("rb") as file:
        head = file.read(105)
    return struct.unpack_from("<I", head, 96)[0], _laszip_record(path) if head[104] & 0x80 else b""


def _laszip_record(path: Path) -> bytes:
    """The record that says how a LAZ file is packed; empty where there is none."""
    with path.open("rb") as file:
        head = file.read(227)
        (at,), (records,) = struct.unpack_from("<H", head, 94), struct.unpack_from("<I", head, 100)
        for _ in range(records):
            file.seek(at)
            record = file.read(54)
            if len(record) < 54:
                break
            (size,) = struct.unpack_from("<H", record, 20)
            if record[2:18].rstrip(b"\0") == b"laszip encoded":
                return file.read(size)
            at += 54 + size
    return b""
