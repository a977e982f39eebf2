"""Mean sensitivities of the patches to calibration and navigation (UNCERTAINTY step 4), as compiled
kernels.

A shared error moves the returns, and with them the patch, in three dimensions. Along the normal the
movement changes over the patch as a fit of the returns' own movements does; along the tangents the
mean of them counts. On a smooth surface the latter changes no volume, but where a point's triangles
do not all lie on its patch, as along an edge, it does.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F32, F64, I32, I64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel, parallel_kernel
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.tangent_frame import arc_height, polynomial_row, second_tangent
from ladar_volume.rmls.viewing_geometry import NUMBERS, rotate_vector, viewing_geometry
from ladar_volume.rmls.voxel_store import BITS, VoxelArrays


class MountArrays(NamedTuple):
    """shift : (3,) m from antenna to laser, body · axis_body : (3,) the laser's z axis there ·
    beams : of the laser · bin_ns : length of a navigation time bin
    """

    shift: F64
    axis_body: F64
    beams: int
    bin_ns: int


class SensitivityArrays(NamedTuple):
    """Of m patches with l time bins in all: nav_start (m + 1,), nav_bin (l,), and the mean
    sensitivities M_cal (m, p + 2, 11 + 2 beams), M_nav (l, p + 2, 4); mean residuals nav_residual
    (l,), beam_residual (m, beams) and own_residual (m,), see :func:`mean_residuals`.
    """

    nav_start: I64
    nav_bin: I64
    M_cal: F32
    M_nav: F32
    nav_residual: F32
    beam_residual: F32
    own_residual: F32


#: Navigation time bins of a patch, at most: those of forty seconds. A patch that is seen for an
#: hour has inliers in hundreds.
MOST_BINS = 20


@kernel
def distinct_bins(members: I32, n: int, t_ns: I64, bin_ns: int, bins: I64) -> Any:
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
def count_bins(rows: I64, fits: Fits, t_ns: I64, bin_ns: int, most: int, out: I64) -> None:
    """Navigation time bins each patch will have: its distinct ones, or ``most`` that stand for
    them.
    """
    for i_row in numba.prange(len(rows)):
        a = rows[i_row]
        bins = np.empty(fits.used[a] + 1, np.int64)
        out[i_row] = min(
            distinct_bins(
                fits.members[fits.start[a] : fits.start[a] + fits.used[a]],
                fits.used[a],
                t_ns,
                bin_ns,
                bins,
            ),
            most,
        )


#: Columns of a return's sensitivities: place of the laser, that of the antenna, clock, the beam's
#: vertical angle, attitude; its range is column 0, the boresight follows.
LASER, ANTENNA, CLOCK, SHARED, VERTICAL, ATTITUDE, ALL = 4, 7, 10, 11, 11, 12, 15


#: Direction in the body (3), length, sine and cosine of the vertical angle of a return's beam.
Beam = tuple[float, float, float, float, float, float]


@leaf_kernel
def line_of_sight(g: F64, axis_body: F64) -> Beam:
    """Of a return with geometry g (10,): the beam's direction in the body (3), its length, sine and
    cosine of its vertical angle.
    """
    v0, v1, v2 = g[4], g[5], g[6]
    length = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
    u0, u1, u2 = v0 / length, v1 / length, v2 / length
    sine = u0 * axis_body[0] + u1 * axis_body[1] + u2 * axis_body[2]
    return u0, u1, u2, length, sine, np.sqrt(max(1.0 - sine * sine, 1e-12))


@leaf_kernel
def along_axis(
    g: F64,
    beam: Beam,
    axis: F64,
    shift: F64,
    axis_body: F64,
    h: F64,
) -> None:
    """``axis·∂r/∂theta`` (15,) of one return for a unit vector of the map, with its geometry g
    (10,): attitude xyzw, v_body, motion with the platform; ``beam`` : its :func:`line_of_sight`.
    What it is by the antenna's place is left out, as it is that by the laser's with the other
    sign; by the platform's position along the axis it is 1.

    With m = Rᵀaxis and arm = v + b − a, ``shift`` = b − a: range u·m, boresight v x m, b m, a −m,
    clock axis·motion, vertical angle m·(range (z − u sin eps)/cos eps) with z, ``axis_body``, the
    laser's z axis; attitude arm x m.
    """
    m0, m1, m2 = rotate_vector(-g[0], -g[1], -g[2], g[3], axis)
    u0, u1, u2, length, sine, cosine = beam
    v0, v1, v2 = g[4], g[5], g[6]
    w0, w1, w2 = v0 + shift[0], v1 + shift[1], v2 + shift[2]
    h[0] = u0 * m0 + u1 * m1 + u2 * m2
    h[1], h[2], h[3] = v1 * m2 - v2 * m1, v2 * m0 - v0 * m2, v0 * m1 - v1 * m0
    h[LASER], h[LASER + 1], h[LASER + 2] = m0, m1, m2
    h[CLOCK] = axis[0] * g[7] + axis[1] * g[8] + axis[2] * g[9]
    h[VERTICAL] = (
        length * (axis_body[0] * m0 + axis_body[1] * m1 + axis_body[2] * m2 - sine * h[0]) / cosine
    )
    h[ATTITUDE], h[ATTITUDE + 1], h[ATTITUDE + 2] = (
        w1 * m2 - w2 * m1,
        w2 * m0 - w0 * m2,
        w0 * m1 - w1 * m0,
    )


@leaf_kernel
def add_return(h: F64, weight: float, beam: int, beams: int, cal: F64, nav: F64) -> None:
    """Adds a return's sensitivities h (15,), weighted, to rows cal (11 + 2 beams,) but those by the
    antenna's place, and to nav (4,).
    """
    for c in range(ANTENNA):
        cal[c] += weight * h[c]
    cal[CLOCK] += weight * h[CLOCK]
    cal[SHARED + beam] += weight * h[0]
    cal[SHARED + beams + beam] += weight * h[VERTICAL]
    nav[0] += weight
    for c in range(3):
        nav[1 + c] += weight * h[ATTITUDE + c]


@leaf_kernel
def solve_sensitivities(inverse: F64, p: int, count: int, rows: F64, out: F32) -> None:
    """Sums ``rows`` (p + 2, c) to sensitivities: ``inverse`` (p, p) times those along the normal,
    the mean over ``count`` of the others.
    """
    for c in range(rows.shape[1]):
        for k in range(p):
            s = 0.0
            for l in range(p):
                s += inverse[k, l] * rows[l, c]
            out[k, c] = s
        out[p, c], out[p + 1, c] = rows[p, c] / count, rows[p + 1, c] / count


@leaf_kernel
def fraction_of(key: int) -> Any:
    """A number in [0, 1) for a voxel: those of neighbours, of any square of them, lie evenly (a
    Kronecker sequence along each axis, with powers of the inverses of the numbers with x³ = x + 1
    and, for z, x⁴ = x + 1).
    """
    mask = (1 << BITS) - 1
    x = (
        (key >> (2 * BITS)) * 0.7548776662466927
        + ((key >> BITS) & mask) * 0.5698402909980532
        + (key & mask) * 0.8191725133961645
    )
    return x - np.floor(x)


@kernel
def draw_per_run(run: I64, runs: int, u: float, drawn: I64) -> None:
    """The inlier (runs,) that is drawn from each run, for the run (n,) of each inlier and a
    fraction u, another one for each run.
    """
    held, turn = np.zeros(runs, np.int64), np.empty(runs, np.int64)
    for i in range(len(run)):
        held[run[i]] += 1
    for g in range(runs):
        x = u + g * 0.6180339887498949
        turn[g] = np.int64((x - np.floor(x)) * held[g])
    for i in range(len(run)):
        if turn[run[i]] == 0:
            drawn[run[i]] = i
        turn[run[i]] -= 1


@leaf_kernel
def viewing_inliers(g: F64, r: F64, other: F64, axis: F64, shift: F64, h: F64) -> None:
    """To h the attitude's part of ``axis·∂r/∂theta`` of a point r (3,), had it been seen when that
    of ``other`` (3,) was, whose geometry is g (10,). See :func:`along_axis`.
    """
    m0, m1, m2 = rotate_vector(-g[0], -g[1], -g[2], g[3], axis)
    v0, v1, v2 = rotate_vector(
        -g[0], -g[1], -g[2], g[3], (r[0] - other[0], r[1] - other[1], r[2] - other[2])
    )
    w0, w1, w2 = v0 + g[4] + shift[0], v1 + g[5] + shift[1], v2 + g[6] + shift[2]
    h[ATTITUDE], h[ATTITUDE + 1], h[ATTITUDE + 2] = (
        w1 * m2 - w2 * m1,
        w2 * m0 - w0 * m2,
        w0 * m1 - w1 * m0,
    )


class Runs(NamedTuple):
    """Runs of navigation time bins. run : (n,) of each inlier · representatives : (runs,) the
    inlier that stands for each · all_bins : each run is one bin
    """

    run: I64
    representatives: I64
    all_bins: bool


@kernel
def _runs_of(mine: I32, runs: int, key: int, t_ns: I64, bin_ns: int) -> Runs:
    """The runs of a patch with inliers ``mine`` (n,) in the voxel of this key."""
    n = len(mine)
    bins, run, drawn = np.empty(n + 1, np.int64), np.empty(n, np.int64), np.empty(runs, np.int64)
    nb = distinct_bins(mine, n, t_ns, bin_ns, bins)
    for i in range(n):
        b = np.searchsorted(bins[:nb], np.int64(np.floor_divide(t_ns[mine[i]], bin_ns)))
        run[i] = ((b + 1) * runs - 1) // nb
    draw_per_run(run, runs, fraction_of(key), drawn)
    return Runs(run, drawn, runs >= nb)


@inlined
def _sum_returns(
    a: int,
    mine: I32,
    store: VoxelArrays,
    fits: Fits,
    p: int,
    mount: MountArrays,
    runs: Runs,
    sums: tuple[F64, F64],
) -> None:
    """Add the sensitivities of the inliers of patch a to sums (p + 2, 11 + 2 beams) by calibration
    and (runs, p + 2, 4) by navigation.
    """
    cal, nav = sums
    x, h, axes = np.zeros(6), np.empty(ALL), np.empty((3, 3))
    own, others = np.empty(NUMBERS), np.empty((len(runs.representatives), NUMBERS))
    for k in range(len(runs.representatives)):
        viewing_geometry(store.aux[mine[runs.representatives[k]]], others[k])
    axes[0], axes[1] = fits.normal[a], fits.tangent[a]
    second_tangent(fits.normal[a], fits.tangent[a], axes[2])
    for i in range(len(mine)):
        slot, run, weight = mine[i], runs.run[i], fits.weights[fits.start[a] + i]
        polynomial_row(store.r, slot, fits.centre[a], fits.tangent[a], axes[2], p, x)
        beam = min(int(store.ring[slot]), mount.beams - 1)
        viewing_geometry(store.aux[slot], own)
        looked = line_of_sight(own, mount.axis_body)
        for k in range(3):
            along_axis(own, looked, axes[k], mount.shift, mount.axis_body, h)
            if not runs.all_bins:
                other = store.r[mine[runs.representatives[run]]]
                viewing_inliers(others[run], store.r[slot], other, axes[k], mount.shift, h)
            if k == 0:
                for l in range(p):
                    add_return(h, weight * x[l], beam, mount.beams, cal[l], nav[run, l])
            else:
                add_return(h, weight, beam, mount.beams, cal[p + k - 1], nav[run, p + k - 1])


@leaf_kernel
def residual(r: F64, slot: int, frame: F64, p: int, x: F64, beta: F64) -> Any:
    """How far a return lies above the patch's surface along its normal, m. frame : (4, 3) centre,
    normal and tangents · x : (6,) its row.
    """
    w = 0.0
    for k in range(3):
        w += (r[slot, k] - frame[0, k]) * frame[1, k]
    for l in range(p):
        w -= x[l] * beta[l]
    if p == 6:
        w -= arc_height(x[1], x[2], beta[3], beta[4], beta[5])[0]
    return w


@inlined
def mean_residuals(
    a: int, mine: I32, store: VoxelArrays, fits: Fits, p: int, run: I64, by_run: F32, by_beam: F32
) -> float:
    """Weighted mean residuals of the inliers of patch a: of each run, to by_run (runs,), and of
    each beam less what the runs of its returns are off, to by_beam (beams,): what differs between
    the beams of one time, whatever differs between times. Zero for a beam without a return.
    Returns the mean of those in the patch's own voxel, zero where there are none: what the fit to
    the voxel and its surroundings has smoothed away there.
    """
    x, frame, above = np.zeros(6), np.empty((4, 3)), np.empty(len(mine))
    weights = fits.weights[fits.start[a] : fits.start[a] + fits.used[a]]
    sums, counts = np.zeros(len(by_run)), np.zeros(len(by_run))
    of_beam, seen = np.zeros(len(by_beam)), np.zeros(len(by_beam))
    frame[0], frame[1], frame[2] = fits.centre[a], fits.normal[a], fits.tangent[a]
    second_tangent(frame[1], frame[2], frame[3])
    own, within = 0.0, 0.0
    for i in range(len(mine)):
        polynomial_row(store.r, mine[i], frame[0], frame[2], frame[3], p, x)
        above[i] = residual(store.r, mine[i], frame, p, x, fits.beta[a])
        if mine[i] // store.cap == a:
            own += weights[i] * above[i]
            within += weights[i]
        sums[run[i]] += weights[i] * above[i]
        counts[run[i]] += weights[i]
    for g in range(len(by_run)):
        sums[g] /= counts[g] if counts[g] > 0.0 else 1.0
        by_run[g] = sums[g]
    for i in range(len(mine)):
        beam = min(int(store.ring[mine[i]]), len(by_beam) - 1)
        of_beam[beam] += weights[i] * (above[i] - sums[run[i]])
        seen[beam] += weights[i]
    for k in range(len(by_beam)):
        by_beam[k] = of_beam[k] / seen[k] if seen[k] > 0.0 else 0.0
    return own / within if within > 0.0 else 0.0


@inlined
def _sensitivities_of(
    i_row: int,
    a: int,
    store: VoxelArrays,
    fits: Fits,
    p: int,
    mount: MountArrays,
    out: SensitivityArrays,
) -> None:
    """The mean sensitivities of patch a, to row ``i_row``."""
    first, number = out.nav_start[i_row], out.nav_start[i_row + 1] - out.nav_start[i_row]
    mine = fits.members[fits.start[a] : fits.start[a] + fits.used[a]]
    runs = _runs_of(mine, number, store.keys[a], store.t_ns, mount.bin_ns)
    for g in range(number):
        time = store.t_ns[mine[runs.representatives[g]]]
        out.nav_bin[first + g] = np.int64(np.floor_divide(time, mount.bin_ns))
    out.own_residual[i_row] = mean_residuals(
        a,
        mine,
        store,
        fits,
        p,
        runs.run,
        out.nav_residual[first : first + number],
        out.beam_residual[i_row],
    )
    cal, nav = np.zeros((p + 2, 11 + 2 * mount.beams)), np.zeros((number, p + 2, 4))
    _sum_returns(a, mine, store, fits, p, mount, runs, (cal, nav))
    for c in range(3):
        cal[:, ANTENNA + c] = -cal[:, LASER + c]
    solve_sensitivities(fits.inverse[a], p, fits.used[a], cal, out.M_cal[i_row])
    for g in range(number):
        solve_sensitivities(fits.inverse[a], p, fits.used[a], nav[g], out.M_nav[first + g])


@kernel
def sensitivities(
    index: I64,
    rows: I64,
    store: VoxelArrays,
    fits: Fits,
    p: int,
    mount: MountArrays,
    out: SensitivityArrays,
) -> None:
    """Of those of ``rows`` (m,) at ``index``: mean sensitivities M_cal (m, p + 2, 11 + 2 beams)
    over all inliers, and M_nav (l, p + 2, 4) per time bin: of beta, ``(XᵀWX)⁻¹ Σ_j w_j x_j
    n·∂r_j/∂theta``, and of the place along tangent and binormal, the weighted mean of
    ``tangent·∂r_j/∂theta``.

    A patch with inliers in more bins than it has room for gets runs of bins instead: of each run
    one inlier is drawn, and all count as if they had been seen when that one was. A common shift
    stays what it is. Averages over the run would be no substitute: a turn of the platform acts the
    other way round on what it has on its other side. Over patches, whose draws differ evenly, all
    bins have their say.
    """
    for i_row in index:
        _sensitivities_of(i_row, rows[i_row], store, fits, p, mount, out)
