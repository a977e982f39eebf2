"""Knots in time and the arc between two attitudes, compiled: the one search and the one slerp that
kernels use, and the rotation of a quaternion. ``np.searchsorted``, ``se3.slerp`` and
``se3.matrix_from_quaternion`` are the plain twins.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import leaf_kernel

#: Angle, one over its sine, sign of the second attitude, and whether the two are so near that the
#: arc is straight.
Arc: TypeAlias = tuple[float, float, float, bool]
Quaternion: TypeAlias = tuple[float, float, float, float]
Vector: TypeAlias = tuple[float, float, float]
Rows: TypeAlias = tuple[Vector, Vector, Vector]
#: Above this cosine the sines cancel; linear interpolation is exact to 1e-14.
_NEAR = 1.0 - 1e-9


@leaf_kernel
def knot_before(t: I64, value: int, hint: int) -> int:
    """Index of the last knot not after ``value``, −1 where all are later; ``hint`` is tried
    first.
    """
    n = len(t)
    if hint >= 0 and t[hint] <= value:
        if hint + 1 >= n or value < t[hint + 1]:
            return hint
        if hint + 2 >= n or value < t[hint + 2]:
            return hint + 1
    lo, hi = 0, n
    while lo < hi:
        mid = (lo + hi) >> 1
        if t[mid] <= value:
            lo = mid + 1
        else:
            hi = mid
    return lo - 1


@leaf_kernel
def arc_between(q: F64, k: int, l: int) -> Arc:
    """Constants of the slerp from attitude k to attitude l of q (n, 4) xyzw, the short way."""
    dot = 0.0
    for c in range(4):
        dot += q[k, c] * q[l, c]
    sign, dot = -1.0 if dot < 0.0 else 1.0, min(abs(dot), 1.0)
    theta, near = np.arccos(dot), dot > _NEAR
    return theta, 1.0 if near else 1.0 / np.sin(theta), sign, near


@leaf_kernel
def on_arc(q: F64, k: int, l: int, f: float, arc: Arc) -> Quaternion:
    """The unit quaternion a share f of the way from attitude k to attitude l."""
    theta, inv_sine, sign, near = arc
    if near:
        w0, w1 = 1.0 - f, sign * f
    else:
        w0, w1 = np.sin((1.0 - f) * theta) * inv_sine, sign * np.sin(f * theta) * inv_sine
    x, y = w0 * q[k, 0] + w1 * q[l, 0], w0 * q[k, 1] + w1 * q[l, 1]
    z, w = w0 * q[k, 2] + w1 * q[l, 2], w0 * q[k, 3] + w1 * q[l, 3]
    s = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    return x * s, y * s, z * s, w * s


@leaf_kernel
def rotation_rows(q: Quaternion) -> Rows:
    """Rows of the rotation of a unit quaternion xyzw."""
    x, y, z, w = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
