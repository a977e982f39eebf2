"""Mean sensitivities of the patches to calibration and navigation (UNCERTAINTY step 4), as compiled kernels.

A shared error moves the returns, and with them the patch, in three dimensions. Along the normal the movement changes over the patch as a
fit of the returns' own movements does; along the tangents the mean of them counts. On a smooth surface the latter changes no volume, but
where a point's triangles do not all lie on its patch, as along an edge, it does.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.filtering.frame import across, row
from ladar_volume.filtering.kernels import rotate
from ladar_volume.model.kernels import kernel, parallel_kernel


@kernel
def distinct_bins(members: Any, n: Any, t_ns: Any, bin_ns: Any, bins: Any) -> Any:
    """Sorted distinct time bins of a patch's inliers; returns how many."""
    m = 0
    for i in range(n):
        b = np.int64(np.floor_divide(t_ns[members[i]], bin_ns))
        lo = m
        while lo > 0 and bins[lo - 1] > b:
            lo -= 1
        if lo > 0 and bins[lo - 1] == b:
            continue
        for k in range(m, lo, -1):
            bins[k] = bins[k - 1]
        bins[lo] = b
        m += 1
    return m


@parallel_kernel
def count_bins(rows: Any, start: Any, used: Any, members: Any, t_ns: Any, bin_ns: Any, out: Any) -> None:
    """Distinct navigation time bins of each patch."""
    for i_row in numba.prange(len(rows)):
        a = rows[i_row]
        bins = np.empty(used[a] + 1, np.int64)
        out[i_row] = distinct_bins(members[start[a] : start[a] + used[a]], used[a], t_ns, bin_ns, bins)


#: Columns of a return's sensitivities: shared calibration, the beam's vertical angle, position, attitude; its range is that of column 0.
SHARED, VERTICAL, POSITION, ATTITUDE, ALL = 11, 11, 12, 15, 18


@kernel
def along_axis(g: Any, axis: Any, shift: Any, axis_body: Any, h: Any) -> None:
    """``axis·∂r/∂theta`` (18,) of one return for a unit vector of the map, with its geometry g (13,): attitude xyzw, v_body, antenna
    velocity, body rates.

    With m = Rᵀaxis and arm = v + b − a, ``shift`` = b − a: range u·m, boresight v x m, b m, a −m, clock axis·velocity + (omega x arm)·m,
    vertical angle m·(range (z − u sin eps)/cos eps) with z, ``axis_body``, the laser's z axis; position axis, attitude arm x m.
    """
    conj, m = np.empty(4), np.empty(3)
    conj[0], conj[1], conj[2], conj[3] = -g[0], -g[1], -g[2], g[3]
    rotate(conj, axis, m)
    v0, v1, v2 = g[4], g[5], g[6]
    w0, w1, w2 = v0 + shift[0], v1 + shift[1], v2 + shift[2]
    length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    u0, u1, u2 = v0 / length, v1 / length, v2 / length
    h[0] = u0 * m[0] + u1 * m[1] + u2 * m[2]
    h[1], h[2], h[3] = v1 * m[2] - v2 * m[1], v2 * m[0] - v0 * m[2], v0 * m[1] - v1 * m[0]
    for k in range(3):
        h[4 + k] = m[k]
        h[7 + k] = -m[k]
        h[POSITION + k] = axis[k]
    h[ATTITUDE], h[ATTITUDE + 1], h[ATTITUDE + 2] = w1 * m[2] - w2 * m[1], w2 * m[0] - w0 * m[2], w0 * m[1] - w1 * m[0]
    # (omega x arm)·m = omega·(arm x m)
    h[10] = axis[0] * g[7] + axis[1] * g[8] + axis[2] * g[9]
    h[10] += g[10] * h[ATTITUDE] + g[11] * h[ATTITUDE + 1] + g[12] * h[ATTITUDE + 2]
    sine = u0 * axis_body[0] + u1 * axis_body[1] + u2 * axis_body[2]
    along = axis_body[0] * m[0] + axis_body[1] * m[1] + axis_body[2] * m[2]
    h[VERTICAL] = length * (along - sine * h[0]) / np.sqrt(max(1.0 - sine * sine, 1e-12))


@kernel
def add_return(h: Any, weight: Any, beam: Any, beams: Any, cal: Any, nav: Any) -> None:
    """Adds a return's sensitivities h (18,), weighted, to rows cal (11 + 2 beams,) and nav (6,)."""
    for c in range(SHARED):
        cal[c] += weight * h[c]
    cal[SHARED + beam] += weight * h[0]
    cal[SHARED + beams + beam] += weight * h[VERTICAL]
    for c in range(6):
        nav[c] += weight * h[POSITION + c]


@kernel
def solved(inverse: Any, p: Any, count: Any, rows: Any, out: Any) -> None:
    """Sums ``rows`` (p + 2, c) to sensitivities: ``inverse`` (p, p) times those along the normal, the mean over ``count`` of the others."""
    for c in range(rows.shape[1]):
        for k in range(p):
            s = 0.0
            for l in range(p):
                s += inverse[k, l] * rows[l, c]
            out[k, c] = s
        out[p, c], out[p + 1, c] = rows[p, c] / count, rows[p + 1, c] / count


@parallel_kernel
def sensitivities(
    rows: Any, start: Any, used: Any, members: Any, r: Any, t_ns: Any, ring: Any, aux: Any, centre: Any, normal: Any, tangent: Any,
    inverse: Any, p: Any, beams: Any, lever_laser: Any, lever_antenna: Any, axis_body: Any, bin_ns: Any, nav_start: Any, nav_bin: Any,
    M_cal: Any, M_nav: Any,
) -> None:  # fmt: skip
    """Mean sensitivities M_cal (m, p + 2, 11 + 2 beams) over all inliers, and M_nav (l, p + 2, 6) per time bin: of beta,
    ``(XᵀX)⁻¹ Σ_j x_j n·∂r_j/∂theta``, and of the place along tangent and binormal, the mean of ``tangent·∂r_j/∂theta``."""
    shift = lever_laser - lever_antenna
    for i_row in numba.prange(len(rows)):
        a = rows[i_row]
        first, nb = nav_start[i_row], nav_start[i_row + 1] - nav_start[i_row]
        mine = members[start[a] : start[a] + used[a]]
        bins = np.empty(used[a] + 1, np.int64)
        distinct_bins(mine, used[a], t_ns, bin_ns, bins)
        nav_bin[first : first + nb] = bins[:nb]
        cal, nav, x, h, axes = np.zeros((p + 2, 11 + 2 * beams)), np.zeros((nb, p + 2, 6)), np.zeros(6), np.empty(ALL), np.empty((3, 3))
        axes[0], axes[1] = normal[a], tangent[a]
        across(normal[a], tangent[a], axes[2])
        for i in range(used[a]):
            slot = mine[i]
            row(r, slot, centre[a], tangent[a], axes[2], p, x)
            b = np.searchsorted(bins[:nb], np.int64(np.floor_divide(t_ns[slot], bin_ns)))
            beam = min(np.int64(ring[slot]), beams - 1)
            along_axis(aux[slot], axes[0], shift, axis_body, h)
            for k in range(p):
                add_return(h, x[k], beam, beams, cal[k], nav[b, k])
            for k in range(2):
                along_axis(aux[slot], axes[1 + k], shift, axis_body, h)
                add_return(h, 1.0, beam, beams, cal[p + k], nav[b, p + k])
        solved(inverse[a], p, used[a], cal, M_cal[i_row])
        for e in range(nb):
            solved(inverse[a], p, used[a], nav[e], M_nav[first + e])
