"""Mean sensitivities of the patches to calibration and navigation (UNCERTAINTY step 4), as compiled kernels."""

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


@parallel_kernel
def sensitivities(
    rows: Any, start: Any, used: Any, members: Any, r: Any, t_ns: Any, ring: Any, aux: Any, centre: Any, normal: Any, tangent: Any,
    inverse: Any, p: Any, beams: Any, lever_laser: Any, lever_antenna: Any, axis_body: Any, bin_ns: Any, nav_start: Any, nav_bin: Any,
    M_cal: Any, M_nav: Any,
) -> None:  # fmt: skip
    """Mean sensitivities of beta (UNCERTAINTY step 4): ``(XᵀX)⁻¹ Σ_j x_j n·∂r_j/∂theta``, over all inliers and per time bin.

    With m = Rᵀn and arm = v + b − a: position n, attitude arm x m, boresight v x m, b m, a −m, range u·m, clock
    n·velocity + (omega x arm)·m, vertical angle m·(range (axis − u sin eps)/cos eps) with ``axis_body`` the laser's z axis.
    """
    shift = lever_laser - lever_antenna
    for i_row in numba.prange(len(rows)):
        a = rows[i_row]
        n = normal[a]
        nb = nav_start[i_row + 1] - nav_start[i_row]
        bins = nav_bin[nav_start[i_row] : nav_start[i_row + 1]]
        all_bins = np.empty(used[a] + 1, np.int64)
        distinct_bins(members[start[a] : start[a] + used[a]], used[a], t_ns, bin_ns, all_bins)
        bins[:] = all_bins[:nb]
        cal = np.zeros((6, 11 + 2 * beams))
        nav = np.zeros((nb, 6, 6))
        x, h = np.zeros(6), np.zeros(13)
        side = np.empty(3)
        across(n, tangent[a], side)
        m, conj = np.empty(3), np.empty(4)
        for i in range(used[a]):
            slot = members[start[a] + i]
            row(r, slot, centre[a], tangent[a], side, p, x)
            g = aux[slot]
            conj[0], conj[1], conj[2], conj[3] = -g[0], -g[1], -g[2], g[3]
            rotate(conj, n, m)
            v0, v1, v2 = g[4], g[5], g[6]
            w0, w1, w2 = v0 + shift[0], v1 + shift[1], v2 + shift[2]
            length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            u0, u1, u2 = v0 / length, v1 / length, v2 / length
            h[0] = u0 * m[0] + u1 * m[1] + u2 * m[2]
            h[1], h[2], h[3] = v1 * m[2] - v2 * m[1], v2 * m[0] - v0 * m[2], v0 * m[1] - v1 * m[0]
            for k in range(3):
                h[4 + k] = m[k]
                h[7 + k] = -m[k]
            o0, o1, o2 = g[10], g[11], g[12]
            h[10] = (
                n[0] * g[7] + n[1] * g[8] + n[2] * g[9]
                + (o1 * w2 - o2 * w1) * m[0] + (o2 * w0 - o0 * w2) * m[1] + (o0 * w1 - o1 * w0) * m[2]
            )  # fmt: skip
            sine = u0 * axis_body[0] + u1 * axis_body[1] + u2 * axis_body[2]
            along = axis_body[0] * m[0] + axis_body[1] * m[1] + axis_body[2] * m[2]
            h[12] = length * (along - sine * h[0]) / np.sqrt(max(1.0 - sine * sine, 1e-12))
            b = np.searchsorted(bins, np.int64(np.floor_divide(t_ns[slot], bin_ns)))
            beam = min(np.int64(ring[slot]), beams - 1)
            for k in range(p):
                for c in range(11):
                    cal[k, c] += x[k] * h[c]
                cal[k, 11 + beam] += x[k] * h[0]
                cal[k, 11 + beams + beam] += x[k] * h[12]
                for c in range(3):
                    nav[b, k, c] += x[k] * n[c]
                nav[b, k, 3] += x[k] * (w1 * m[2] - w2 * m[1])
                nav[b, k, 4] += x[k] * (w2 * m[0] - w0 * m[2])
                nav[b, k, 5] += x[k] * (w0 * m[1] - w1 * m[0])
        for k in range(p):
            for c in range(11 + 2 * beams):
                s = 0.0
                for l in range(p):
                    s += inverse[a, k, l] * cal[l, c]
                M_cal[i_row, k, c] = s
            for e in range(nb):
                for c in range(6):
                    s = 0.0
                    for l in range(p):
                        s += inverse[a, k, l] * nav[e, l, c]
                    M_nav[nav_start[i_row] + e, k, c] = s
