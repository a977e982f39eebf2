"""Symmetric 3 x 3 matrices as six numbers: xx, xy, xz, yy, yz, zz."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ladar_volume.math.array_types import F64


def pack(C: F64) -> F64:
    """Symmetric (..., 3, 3) -> (..., 6)."""
    return C[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def unpack(packed: npt.ArrayLike) -> F64:
    """(..., 6) -> symmetric (..., 3, 3) float64; the inverse of :func:`pack`."""
    c = np.asarray(packed, dtype=np.float64)
    return c[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
