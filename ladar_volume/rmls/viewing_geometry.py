"""Where a return was seen from, as it is kept with it: what its sensitivities to calibration and
navigation are made of, in 24 bytes.

Attitude xyzw, the beam ``v_body = B r_laser`` (m) and the return's motion with the platform (m/s,
map), ten numbers, become twelve of 16 bits: attitude in units of 1/32767, each vector in a power of
two of its own, which follows it. So a rotation errs by 6.2e-5 rad at most, a vector by 2^-15 of its
largest component. No position depends on it: a mean over many returns errs by far less, and by that
share of itself.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ladar_volume.math.array_types import F64, I16
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Numbers of a return's geometry, and of what is kept of it.
NUMBERS, KEPT = 10, 12
#: Largest whole number.
LARGEST = 32767
#: Where each vector is among the numbers, and among those kept.
VECTORS = ((4, 4), (7, 8))


@kernel
def store_geometry(g: F64, kept: I16) -> None:
    """Geometry (n, 10) as it is kept, (n, 12) int16. What is not finite comes back as NaN."""
    for i in range(len(g)):
        for k in range(4):
            kept[i, k] = np.int16(np.rint(LARGEST * g[i, k]))
        for first, to in VECTORS:
            largest = 0.0
            for k in range(first, first + 3):
                largest = max(largest, abs(g[i, k]))
            finite = np.isfinite(g[i, first] + g[i, first + 1] + g[i, first + 2])
            exponent = math.frexp(largest)[1] if finite else LARGEST
            for k in range(3):
                whole = (
                    min(max(np.rint(math.ldexp(g[i, first + k], 15 - exponent)), -LARGEST), LARGEST)
                    if finite
                    else 0.0
                )
                kept[i, to + k] = np.int16(whole)
            kept[i, to + 3] = exponent


@leaf_kernel
def rotate_vector(
    x: float, y: float, z: float, w: float, v: F64 | tuple[float, float, float]
) -> Any:
    """``R v`` (3) of a vector (3,) by a unit quaternion; with x, y and z negated, ``Rᵀ v``.
    Numbers, not arrays: they stay in registers.
    """
    v0, v1, v2 = v[0], v[1], v[2]
    t0, t1, t2 = 2.0 * (y * v2 - z * v1), 2.0 * (z * v0 - x * v2), 2.0 * (x * v1 - y * v0)
    return (
        v0 + w * t0 + y * t2 - z * t1,
        v1 + w * t1 + z * t0 - x * t2,
        v2 + w * t2 + x * t1 - y * t0,
    )


@leaf_kernel
def viewing_geometry(kept: I16, g: F64) -> None:
    """The geometry (10,) of one return from what is kept (12,); the attitude is of unit length."""
    length = 0.0
    for k in range(4):
        g[k] = kept[k]
        length += g[k] * g[k]
    for k in range(4):
        g[k] /= math.sqrt(length)
    for first, at in VECTORS:
        unit = math.ldexp(1.0, int(kept[at + 3]) - 15)
        for k in range(3):
            g[first + k] = kept[at + k] * unit
