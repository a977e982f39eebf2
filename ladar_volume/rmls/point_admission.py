"""Which points the filter takes in, and the geometry kept with each: one compiled pass each over
the points.

``point_jacobian.bracket`` and ``point_jacobian.point_geometry`` are the plain twins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ladar_volume.math.array_types import F32, F64, I8, I64
from ladar_volume.math.interpolation import arc_between, knot_before, on_arc, rotation_rows
from ladar_volume.math.kernels import kernel

TAKEN, NOT_FINITE, TOO_FAR, UNCOVERED = 0, 1, 2, 3


class Bracket(NamedTuple):
    """Where points lie between platform states: index (n,) of the state before, and the share (n,)
    of the way to the next.
    """

    state: I64
    fraction: F64


class StateArrays(NamedTuple):
    """Platform states: place, attitude xyzw, velocity, turn rate; map frame and body frame."""

    p: F64
    q: F64
    v: F64
    omega: F64


@kernel
def admit(
    t_ns: I64,
    r: F64,
    C: F32,
    limit: float,
    knots: I64,
    segment: I64,
    verdict: I8,
    at: Bracket,
) -> None:
    """Verdict of each point, and where it lies between platform states (see
    ``point_jacobian.bracket``).
    """
    hint = -1
    last = len(knots) - 1
    for i in range(len(t_ns)):
        size = max(abs(r[i, 0]), abs(r[i, 1]), abs(r[i, 2]))
        total = r[i, 0] + r[i, 1] + r[i, 2]
        for k in range(6):
            total += C[i, k]
        if not np.isfinite(total):
            verdict[i] = NOT_FINITE
            continue
        if not size < limit:
            verdict[i] = TOO_FAR
            continue
        t = t_ns[i]
        k = knot_before(knots, t, hint)
        hint = k
        verdict[i] = UNCOVERED
        if k < 0 or segment[k] < 0:
            continue
        if knots[k] == t:
            verdict[i], at.state[i], at.fraction[i] = TAKEN, k, 0.0
        elif k < last and segment[k] == segment[k + 1]:
            verdict[i], at.state[i], at.fraction[i] = (
                TAKEN,
                k,
                (t - knots[k]) / max(knots[k + 1] - knots[k], 1),
            )


@kernel
def geometry(
    rows: I64, r: F64, at: Bracket, states: StateArrays, lever_laser: F64, out: F64
) -> None:
    """Attitude xyzw, v_body = B r_laser and motion with the platform (m/s, map) of points ``rows``
    (n,) to out (n, 10).
    """
    p, q, v, omega = states
    d, m, w, s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for j in range(len(rows)):
        i = rows[j]
        k, f = at.state[i], at.fraction[i]
        l = min(k + 1, len(p) - 1)
        x, y, z, e = on_arc(q, k, l, f, arc_between(q, k, l))
        for c in range(3):
            d[c] = r[i, c] - (p[k, c] + f * (p[l, c] - p[k, c]))
            m[c] = v[k, c] + f * (v[l, c] - v[k, c])
            w[c] = omega[k, c] + f * (omega[l, c] - omega[k, c])
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = rotation_rows((x, y, z, e))
        s[0] = r00 * d[0] + r10 * d[1] + r20 * d[2]
        s[1] = r01 * d[0] + r11 * d[1] + r21 * d[2]
        s[2] = r02 * d[0] + r12 * d[1] + r22 * d[2]
        m[0] += w[1] * s[2] - w[2] * s[1]
        m[1] += w[2] * s[0] - w[0] * s[2]
        m[2] += w[0] * s[1] - w[1] * s[0]
        out[j, 0], out[j, 1], out[j, 2], out[j, 3] = x, y, z, e
        for c in range(3):
            out[j, 4 + c] = s[c] - lever_laser[c]
        out[j, 7] = r00 * m[0] + r01 * m[1] + r02 * m[2]
        out[j, 8] = r10 * m[0] + r11 * m[1] + r12 * m[2]
        out[j, 9] = r20 * m[0] + r21 * m[1] + r22 * m[2]
