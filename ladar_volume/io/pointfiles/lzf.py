"""LZF, the compression inside PCD files (format of M. Lehmann's liblzf).

A control byte c < 32 announces c + 1 plain bytes; a larger one a copy of 3 to 264 bytes that lie up
to 8192 bytes back. Own code, since no library at hand does it safely: Open3D 0.20 corrupts the heap
where it packs columns of different widths.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.math.kernels import kernel

U8 = npt.NDArray[np.uint8]

#: The most bytes that 3 packed ones can stand for, per byte.
RATIO = 88
HASH_BITS = 16


@kernel
def unpack(data: U8, size: int) -> tuple[int, U8]:
    """Unpack ``data`` into exactly ``size`` bytes: (size, bytes), or (-1, what came out) where the
    data do not unpack to that.
    """
    out = np.zeros(size, np.uint8)
    i, o, n = 0, 0, len(data)
    while i < n:
        c = int(data[i])
        i += 1
        if c < 32:
            if i + c + 1 > n or o + c + 1 > size:
                return -1, out
            for _ in range(c + 1):
                out[o] = data[i]
                o += 1
                i += 1
            continue
        length = (c >> 5) + 2
        if length == 9:
            if i >= n:
                return -1, out
            length += int(data[i])
            i += 1
        if i >= n:
            return -1, out
        back = o - ((c & 31) << 8) - int(data[i]) - 1
        i += 1
        if back < 0 or o + length > size:
            return -1, out
        for k in range(length):  # byte by byte: source and target may overlap
            out[o + k] = out[back + k]
        o += length
    return (size if o == size else -1), out


@kernel
def literals(data: U8, start: int, stop: int, out: U8, o: int) -> int:
    """Append plain bytes ``start`` to ``stop`` in runs of 32; returns the new length."""
    while start < stop:
        run = min(32, stop - start)
        out[o] = run - 1
        out[o + 1 : o + 1 + run] = data[start : start + run]
        o += run + 1
        start += run
    return o


@kernel
def pack(data: U8) -> U8:
    """Packed bytes that :func:`unpack` turns into ``data`` again; up to a 32nd larger where nothing
    repeats.
    """
    n = len(data)
    out = np.empty(n + n // 32 + 1, np.uint8)
    last = np.full(1 << HASH_BITS, -1, np.int64)
    i, start, o = 0, 0, 0
    while i + 2 < n:
        word = (int(data[i]) << 16) | (int(data[i + 1]) << 8) | int(data[i + 2])
        slot = ((word * 40503) >> 8) & ((1 << HASH_BITS) - 1)
        seen = last[slot]
        last[slot] = i
        if (
            seen < 0
            or i - seen > 8192
            or data[seen] != data[i]
            or data[seen + 1] != data[i + 1]
            or data[seen + 2] != data[i + 2]
        ):
            i += 1
            continue
        length = 3
        while length < 264 and i + length < n and data[seen + length] == data[i + length]:
            length += 1
        o = literals(data, start, i, out, o)
        back, code = i - seen - 1, length - 2
        out[o] = (min(code, 7) << 5) | (back >> 8)
        if code >= 7:
            o += 1
            out[o] = code - 7
        out[o + 1] = back & 255
        o += 2
        i += length
        start = i
    return out[: literals(data, start, n, out, o)].copy()
