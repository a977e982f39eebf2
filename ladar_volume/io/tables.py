"""PointCloud2 as what it is: a self-describing table of typed columns.

Works on any object with the attributes of sensor_msgs/PointCloud2, whichever library made it.
Decoding checks the layout before it allocates and raises a :class:`CloudError` with a reason;
encoding is bit-lossless.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.model.errors import CloudError

#: PointField datatype numbers.
DATATYPES: dict[int, str] = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
NUMBERS = {name: number for number, name in DATATYPES.items()}


@dataclass(frozen=True)
class Column:
    """One column: name, byte offset, numpy type code and values per row."""

    name: str
    offset: int
    code: str
    count: int


@dataclass(frozen=True)
class Table:
    """Rows as bytes with their columns, ready for a message."""

    columns: tuple[Column, ...]
    rows: int
    row_bytes: int
    data: npt.NDArray[np.uint8]


def encode(columns: dict[str, npt.NDArray[Any]]) -> Table:
    """Pack equally long columns, (n,) or (n, count), little-endian and without padding."""
    names, formats, described, offset = [], [], [], 0
    rows = len(next(iter(columns.values())))
    for name, values in columns.items():
        count = 1 if values.ndim == 1 else values.shape[1]
        code = values.dtype.str[1:]
        names.append(name)
        formats.append(f"<{code}" if values.ndim == 1 else f"({count},)<{code}")
        described.append(Column(name, offset, code, count))
        offset += count * values.dtype.itemsize
    packed = np.empty(rows, dtype=np.dtype({"names": names, "formats": formats}))
    for name, values in columns.items():
        packed[name] = values
    return Table(tuple(described), rows, packed.dtype.itemsize, packed.view(np.uint8).reshape(-1))


def _checked_bytes(
    raw: bytes | npt.NDArray[np.uint8], size: tuple[int, int], step: tuple[int, int]
) -> npt.NDArray[np.uint8]:
    """The bytes (n,) of a cloud that holds what its sizes say. size : width, height · step : bytes
    of a point, of a row
    """
    (width, height), (point_step, row_step) = size, step
    if width <= 0 or height <= 0:
        raise CloudError(
            f"cloud without points ({width} x {height})",
            reason="cloud_empty",
            value=(width, height),
        )
    if row_step < width * point_step:
        raise CloudError(
            f"row_step {row_step} < width {width} x point_step {point_step}",
            reason="cloud_row_step",
            value=row_step,
        )
    data = np.frombuffer(raw, dtype=np.uint8) if not isinstance(raw, np.ndarray) else raw
    if data.size < row_step * (height - 1) + width * point_step:
        raise CloudError(
            f"{data.size} bytes for {height} rows of {row_step}",
            reason="cloud_short",
            value=data.size,
        )
    return data


def decode(message: Any, wanted: Collection[str] | None = None) -> dict[str, npt.NDArray[Any]]:
    """Columns of a PointCloud2-like message, native byte order, row order kept; organised clouds
    are flattened. ``wanted``: only fields of these names are looked at.

    Raises
    ------
    CloudError : reasons cloud_empty, cloud_point_step, cloud_row_step, cloud_short, cloud_fields.
    """
    width, height = int(message.width), int(message.height)
    point_step, row_step = int(message.point_step), int(message.row_step)
    data = _checked_bytes(message.data, (width, height), (point_step, row_step))
    dtype = _dtype(
        message, point_step, wanted
    )  # after the sizes: a row that does not fit the data may be too long for any type
    if height == 1 or row_step == width * point_step:
        records = np.ascontiguousarray(data[: width * height * point_step]).view(dtype)
    else:
        rows = [data[i * row_step : i * row_step + width * point_step] for i in range(height)]
        records = np.concatenate(rows).view(dtype)
    native = {n: np.ascontiguousarray(records[n]) for n in dtype.names or ()}
    return {n: v.astype(v.dtype.newbyteorder("="), copy=False) for n, v in native.items()}


def _dtype(message: Any, point_step: int, wanted: Collection[str] | None) -> np.dtype[Any]:
    order = ">" if message.is_bigendian else "<"
    names: list[str] = []
    formats: list[str] = []
    offsets: list[int] = []
    for f in message.fields:
        if wanted is not None and f.name not in wanted:
            continue
        code, count = DATATYPES.get(int(f.datatype)), max(int(f.count), 1)
        if code is None:
            raise CloudError(
                f"field {f.name!r} has unknown datatype {f.datatype}",
                reason="cloud_fields",
                value=f.datatype,
            )
        if int(f.offset) < 0 or int(f.offset) + count * np.dtype(code).itemsize > point_step:
            raise CloudError(
                f"field {f.name!r} lies beyond point_step {point_step}",
                reason="cloud_point_step",
                value=point_step,
            )
        if f.name in names:
            raise CloudError(f"field {f.name!r} appears twice", reason="cloud_fields", value=f.name)
        names.append(str(f.name))
        formats.append(f"{order}{code}" if count == 1 else f"({count},){order}{code}")
        offsets.append(int(f.offset))
    if point_step <= 0 or not message.fields:
        raise CloudError(
            f"no fields or point_step {point_step}", reason="cloud_point_step", value=point_step
        )
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    )
