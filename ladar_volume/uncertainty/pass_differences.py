"""What position, attitude, boresight and beams do to how passes lie over each other, as one linear
system of unit errors.

A patch holds the mean residual of its returns in each time bin and of each beam. Errors z of unit
variance, those of one source correlated in time, move the bins of patch i by ``u_ie · z_e``; the
fit to all of them takes their mean, so that the residuals are ``A z`` plus noise, with A the
effects less their mean over the patch. The normal equations of all patches, turned so that their
noise has one variance, are all that is kept: as many numbers as there are errors, whatever the
number of patches. Beams are held against each other within bins alone, where the platform's errors
are the same for all of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I64, PatchTable
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.packing import (
    SHARED,
    beam_count,
    calibration_rows,
    navigation_units,
)

#: Patches that are asked at most, fewest that answer, fewest returns of one, least upward
#: component of its normal, and time bins at most: those that most patches were seen in.
ASKED, FEWEST, RETURNS, UPWARD, BINS = 250, 30, 20, 0.7, 40
#: Bins of a patch from which on some of them may stand for several.
MOST_BINS = 20
#: Least determinant of a bin's mean rotation: where the platform turns in a bin there is no one
#: pose of it.
STEADY = 0.94
#: Share of the effect of a constant that may be anything in each bin, as the pose of a bin is a
#: mean; least share of a patch's scatter that is noise; least share of the largest eigenvalue.
INEXACT, NOISE, DIGITS = 0.05, 0.3, 1e-9
#: Blocks of neighbouring patches, which may have noise in common.
BLOCKS = 16
#: Share of a beam's variance that the mean of those of one look has.
FEW_BEAMS = 0.25
#: Returns of a patch that a beam which saw it has, more than; least share of the returns that is
#: their degrees of freedom.
SEEN, LEAST_FREE = 0.5, 0.3
#: Least speed that is counted, m/s.
SLOW = 1.0


class UnitErrors(NamedTuple):
    """What residuals say of errors of unit variance, in k directions in which their noise is alike
    and independent. y : (k,) · noise : its variance · part : (k, k) by group, what the group adds
    to the covariance of y by the budget
    """

    y: F64
    noise: float
    part: dict[str, F64]


class Residuals(NamedTuple):
    """Mean residuals of patches' parts. d : (l,) m · returns : (l,) how many · patch : (l,)
    ascending · A : (l, k) effects of the errors, m · own : (l,) m², variance of what else each
    part has of its own by the budget · scatter : (m,) m² of the returns of each patch
    """

    d: F64
    returns: F64
    patch: I64
    A: F64
    own: F64
    scatter: F64


def less_mean(x: F64, weight: F64, start: I64) -> F64:
    """Rows x (l, k) less their weighted mean over each run from start (r + 1,) on."""
    first, count = start[:-1], np.diff(start)
    mean = np.add.reduceat(x * weight[:, None], first) / np.add.reduceat(weight, first)[:, None]
    out: F64 = x - np.repeat(mean, count, axis=0)
    return out


def told_by(found: Residuals, covariance: dict[str, F64]) -> UnitErrors | None:
    """What residuals tell of errors with covariances (k, k) by group; None where it is nothing."""
    start = np.flatnonzero(np.diff(found.patch, prepend=-1, append=found.patch.max(initial=0) + 1))
    if len(start) < 2:
        return None
    patches, m = found.patch, len(found.scatter)
    off = less_mean(found.d[:, None], found.returns, start)[:, 0]
    seen = np.maximum(np.bincount(patches, found.returns, m), 1e-9)
    own = found.scatter - np.bincount(patches, found.returns * off**2, m) / seen
    noise = np.maximum(own, NOISE**2 * found.scatter)[patches] / found.returns
    weight = 1.0 / np.maximum(noise + found.own, 1e-12)
    A = less_mean(found.A, weight, start)
    d = less_mean(found.d[:, None], weight, start)[:, 0]
    value, vector = np.linalg.eigh(A.T @ (A * weight[:, None]))
    good = value > DIGITS * max(float(value[-1]), 1e-300)
    root = np.sqrt(value[good])
    y = vector[:, good].T @ (A.T @ (weight * d)) / root
    left = len(d) - (len(start) - 1) - len(y)
    if left < FEWEST or not len(y):
        return None
    variance = max(float(weight @ d**2 - y @ y), 0.0) / left
    unit = A @ (vector[:, good] / root)
    variance *= likeness(unit, weight, d - unit @ y, patches * BLOCKS // m, variance)
    turn = vector[:, good] * root
    return UnitErrors(y, max(variance, 0.1), {g: turn.T @ C @ turn for g, C in covariance.items()})


def likeness(unit: F64, weight: F64, left: F64, block: I64, variance: float) -> float:
    """By how much the noise of sums over patches is larger than that of independent ones, 1 at
    least: ground that is rough over metres moves neighbours alike. Told from what blocks of
    neighbours add to the sums ``unitᵀ W d`` beyond the fit (Liang & Zeger, Biometrika 73, 1986).
    unit : (l, k), with ``unitᵀ W unit`` the unit matrix · left : (l,) m, residuals of the fit ·
    block : (l,) of each · variance : of residuals with weight 1
    """
    found, alone = 0.0, 0.0
    for b in range(BLOCKS):
        own = block == b
        if own.any():
            scores = unit[own].T @ (weight[own] * left[own])
            share = unit[own].T @ (unit[own] * weight[own][:, None])
            found += float(scores @ scores)
            alone += float(np.trace(share) - np.sum(share * share))
    return max(1.0, found / max(variance * alone, 1e-300))


def asked_patches(patches: PatchTable) -> I64:
    """Patches (k,) whose residuals are known and tell something, spread evenly."""
    if not len(patches.nav_residual):
        return np.zeros(0, np.int64)
    bins = np.diff(patches.nav_start)
    good = (bins >= 2) & (bins < MOST_BINS) & (patches.used >= RETURNS)
    good &= (np.abs(patches.normal[:, 2]) > UPWARD) & np.isfinite(patches.beam_residual).all(axis=1)
    rows = np.flatnonzero(good).astype(np.int64)
    rows = rows[:: max(1, math.ceil(len(rows) / ASKED))]
    return rows if len(rows) >= FEWEST else rows[:0]


class Sizes(NamedTuple):
    """How much one standard deviation of position, attitude and boresight moves heights, m, that
    of the pitch, rad, and the speed of the platform, m/s.
    """

    position_m: float
    attitude_m: float
    boresight_m: float
    pitch_rad: float
    speed_mps: float


class Looks(NamedTuple):
    """Bins that patches were seen in. entry : (l,) of the table's sensitivities · patch : (l,)
    which of the patches asked · slot : (l,) which of the bins · bins : (b,) · state : (l,) row of
    the navigation
    """

    entry: I64
    patch: I64
    slot: I64
    bins: I64
    state: I64


def steady_looks(patches: PatchTable, rows: I64, nav: NavigationBins) -> Looks | None:
    """The looks of patches ``rows`` (k,) in the bins that most of them were seen in, without those
    in which the platform turned; None where there are too few.
    """
    count = np.diff(patches.nav_start)[rows]
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    entry = np.repeat(patches.nav_start[rows] - first[:-1], count) + np.arange(first[-1])
    patch = np.repeat(np.arange(len(rows)), count)
    index, states, _, pose = nav.sums()
    seen, which, times = np.unique(patches.nav_bin[entry], return_inverse=True, return_counts=True)
    at = np.minimum(np.searchsorted(index, seen), len(index) - 1)
    turned = np.linalg.det(pose[at, 1:] / np.maximum(states[at], 1)[:, None, None])
    times = np.where((turned > STEADY) & (index[at] == seen), times, 0)
    kept = np.argsort(-times, kind="stable")[:BINS]
    kept = np.sort(kept[times[kept] > 0])
    if len(kept) < 2:
        return None
    slot = np.full(len(seen), -1)
    slot[kept] = np.arange(len(kept))
    good = slot[which] >= 0
    return Looks(entry[good], patch[good], slot[which][good], seen[kept], at[which][good])


def turning_effects(patches: PatchTable, owner: I64, entry: I64, R: F64) -> tuple[F64, F64, F64]:
    """How heights (l,) of patches ``owner`` (l,) change with a turn of the platform, (l, 3) m per
    rad, with its place in its own axes, (l, 3), and the share of the returns (l,): from the
    sensitivities ``entry`` (l,) of their places along tangent and binormal, which are plain means.
    R : (l, 3, 3) body to map.
    """
    n, t = patches.normal[owner], patches.tangent[owner]
    mn, mt, mb = (np.einsum("lij,li->lj", R, axis) for axis in (n, t, np.cross(n, t)))
    unit = navigation_units(patches)[owner][:, -2:].astype(np.float64)
    M = patches.M_nav[entry][:, -2:]
    share = np.maximum(M[:, 0, 0] * unit[:, 0, 0], 1e-6)
    by = M[:, :, 1:] * (unit[:, :, 1] / share[:, None])[:, :, None]
    # with arm a: a x mt = by[0] and a x mb = by[1], so that a x mn = -(by[0]·mn) mt - (by[1]·mn) mb
    turned = -(by[:, 0] * mn).sum(axis=1)[:, None] * mt - (by[:, 1] * mn).sum(axis=1)[:, None] * mb
    return turned, mn, share


def times_root(C: F64, v: F64) -> F64:
    """``Lᵀ v`` (l, 3) with ``L Lᵀ`` = C (l, 3, 3), of vectors v (l, 3)."""
    L = np.linalg.cholesky(C + 1e-18 * np.eye(3))
    out: F64 = np.ascontiguousarray(np.einsum("lij,li->lj", L, v))
    return out


def bin_residuals(
    patches: PatchTable, rows: I64, looks: Looks, nav: NavigationBins, b: BudgetParameters
) -> tuple[Residuals, Sizes]:
    """Mean residuals of the bins of patches ``rows``, with the effects of boresight (3), lever arms
    (3), clock (1), and by bin of position (3) and attitude (3), and how large these are.
    """
    index, states, C, pose = nav.sums()
    owner, per = rows[looks.patch], states[looks.state, None, None]
    R, C = pose[looks.state, 1:] / per, C[looks.state] / per
    turned, mn, share = turning_effects(patches, owner, looks.entry, R)
    n = patches.normal[owner]
    apart_s = np.gradient(index.astype(np.float64)) * (nav.bin_ns * 1e-9)
    speed = np.gradient(pose[:, 0] / states[:, None], axis=0) / apart_s[:, None]
    speed = speed[looks.state]
    lever = np.hypot(b.lever_laser_sigma_m, b.lever_antenna_sigma_m)
    # smaller ones than the beams' errors, which bins take for them, cannot be told
    clock_s = b.clock_sigma_s + b.beam_range_sigma_m / max(rms(speed), SLOW)
    fixed = [
        turned * np.array(b.boresight_sigma_rad),
        mn * np.hypot(lever, b.beam_range_sigma_m),
        ((speed * n).sum(axis=1) * clock_s)[:, None],
    ]
    k, every = len(looks.bins), np.arange(len(owner))
    A = np.zeros((len(owner), 7 + 6 * k))
    A[:, :7] = np.concatenate(fixed, axis=1)
    position, attitude = times_root(C[:, :3, :3], n), times_root(C[:, 3:, 3:], turned)
    for first, of in ((7, position), (7 + 3 * k, attitude)):
        for c in range(3):
            A[every, first + 3 * looks.slot + c] = of[:, c]
    d = patches.nav_residual[looks.entry].astype(np.float64)
    pitch = max(math.sqrt(float(C[:, 4, 4].mean())), 1e-9)
    sizes = Sizes(rms(position), rms(attitude), rms(fixed[0]), pitch, rms(speed))
    # what changes within a bin, of which a patch sees some: no more than a third of it
    own = b.position_white_fraction * (position**2).sum(axis=1) / 3.0
    fast = b.attitude_white_fraction + nav.bin_ns * 1e-9 / (6.0 * b.tau_attitude_s)
    own += fast * (attitude**2).sum(axis=1) / 3.0
    count = np.maximum(share * patches.used[owner], 1e-3)
    return Residuals(d, count, looks.patch, A, own, patches.sigma[rows] ** 2), sizes


def rms(v: F64) -> float:
    """Root of the mean square length of vectors (l, 3)."""
    return math.sqrt(float((v * v).sum(axis=1).mean()))


def bin_covariances(
    bins: I64, bin_s: float, white: tuple[F64, F64], sizes: Sizes, b: BudgetParameters
) -> dict[str, F64]:
    """Covariances (7 + 6 k, 7 + 6 k) of the unit errors of k bins, by group. white : (k,) each, of
    how many white errors a bin has the mean, in position and in attitude. What a group's errors
    change within a bin looks like other errors of that bin: a position that wanders while the
    platform moves on like a slope, an attitude that turns like a place.
    """
    k = len(bins)
    apart = np.abs(bins[:, None] - bins) * bin_s

    def correlation(constant: float, share: float, tau_s: float, independent: F64) -> F64:
        own = constant + (1.0 - constant - share) * np.exp(-apart / tau_s)
        out: F64 = np.kron(own + np.diag(share / independent), np.eye(3))
        return out

    blocks = {
        "boresight": (0, np.eye(3)),
        "lever_arms": (3, np.eye(3)),
        "clock": (6, np.eye(1)),
        "position": (
            7,
            correlation(
                b.position_bias_fraction, b.position_white_fraction, b.tau_position_s, white[0]
            ),
        ),
        "attitude": (
            7 + 3 * k,
            correlation(
                b.attitude_bias_fraction, b.attitude_white_fraction, b.tau_attitude_s, white[1]
            ),
        ),
    }
    out = {}
    for name, (first, block) in blocks.items():
        out[name] = np.zeros((7 + 6 * k, 7 + 6 * k))
        last = first + len(block)
        out[name][first:last, first:last] = block
    place, turn = 7 + np.arange(3 * k), 7 + 3 * k + np.arange(3 * k)
    # the slope of a random walk of variance 2 t / tau, fitted over T, has 12 / (5 T tau)
    wandering = 1.0 - b.position_bias_fraction - b.position_white_fraction
    slope = sizes.position_m**2 * wandering * 2.4 / (bin_s * b.tau_position_s)
    pitch = turn[1::3]
    out["position"][pitch, pitch] += slope / (max(sizes.speed_mps, SLOW) * sizes.pitch_rad) ** 2
    wandering = 1.0 - b.attitude_bias_fraction - b.attitude_white_fraction
    turned = sizes.attitude_m**2 * wandering * bin_s / (3.0 * b.tau_attitude_s)
    out["attitude"][place, place] += turned / max(sizes.position_m, 1e-9) ** 2
    # the beams that look at a bin's patches have errors in common
    out["attitude"][pitch, pitch] += FEW_BEAMS * (b.beam_vertical_sigma_rad / sizes.pitch_rad) ** 2
    bent = (INEXACT * sizes.boresight_m) ** 2
    out["boresight"][turn, turn] += bent / max(sizes.attitude_m, 1e-9) ** 2
    out["boresight"][place, place] += bent / max(sizes.position_m, 1e-9) ** 2
    return out


def beam_effects(patches: PatchTable, rows: I64) -> F64:
    """Sensitivities (k, 3, 2 b) of patches ``rows`` (k,) to range and vertical angle of b beams."""
    out: F64 = calibration_rows(patches, rows)[:, [0, -2, -1], SHARED:].astype(np.float64)
    return out


def beam_shares(to_range: F64) -> F64:
    """Shares (k, b) of the returns of k patches that each beam has, from their sensitivities
    (k, 3, b) to its range.
    """
    share: F64 = np.linalg.norm(to_range, axis=1)
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-9)
    return share


def beam_residuals(patches: PatchTable, rows: I64, b: BudgetParameters) -> Residuals:
    """Mean residuals of the beams of patches ``rows`` within their bins, with the effects of the
    range and of the vertical angle of each beam.
    """
    beams, M = beam_count(patches), beam_effects(patches, rows)
    share = beam_shares(M[:, :, :beams])
    patch, beam = np.nonzero(share * patches.used[rows][:, None] > SEEN)
    part = share[patch, beam]
    A = np.zeros((len(patch), 2 * beams))
    every = np.arange(len(patch))
    A[every, beam] = b.beam_range_sigma_m * M[patch, 0, beam] / part
    A[every, beams + beam] = b.beam_vertical_sigma_rad * M[patch, 0, beams + beam] / part
    d = patches.beam_residual[rows[patch], beam].astype(np.float64)
    count, own = part * patches.used[rows[patch]], np.zeros(len(patch))
    return Residuals(d, count, patch, A, own, patches.sigma[rows] ** 2)


def between_bins(patches: PatchTable, rows: I64) -> F64 | None:
    """Mean squares (k,) m² of the mean residuals of the time bins of patches ``rows`` (k,): how far
    passes lie apart there; None where that is not known.
    """
    count = np.diff(patches.nav_start)[rows]
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    entry = np.repeat(patches.nav_start[rows] - first[:-1], count) + np.arange(first[-1])
    if not len(patches.nav_residual) or not np.isfinite(patches.nav_residual[entry]).all():
        return None
    unit = navigation_units(patches)[np.repeat(rows, count), -2, 0].astype(np.float64)
    square = patches.nav_residual[entry].astype(np.float64) ** 2
    out: F64 = np.add.reduceat(patches.M_nav[entry, -2, 0] * unit * square, first[:-1])
    return out


def scatter_within_bins(patches: PatchTable, rows: I64) -> F64 | None:
    """Mean squares (k,) m² of the returns of patches ``rows`` (k,) about the mean of their bins,
    whatever differs between bins; None where it is not known.
    """
    between = between_bins(patches, rows)
    return None if between is None else np.maximum(patches.sigma[rows] ** 2 - between, 0.0)


def scatter_of_looks(patches: PatchTable, rows: I64) -> F64 | None:
    """Mean squares (k,) m² of each return of patches ``rows`` (k,) of its own, by the degrees of
    freedom: beside what differs between their time bins and between their beams, whatever that is;
    None where it is not known.
    """
    within = scatter_within_bins(patches, rows)
    if within is None:
        return None
    used = patches.used[rows].astype(np.float64)
    share = beam_shares(beam_effects(patches, rows)[:, :, : beam_count(patches)])
    seen = share * used[:, None] > SEEN
    mean = np.where(seen, patches.beam_residual[rows].astype(np.float64), 0.0)
    mean -= (share * mean).sum(axis=1, keepdims=True)
    between = np.sum(share * np.where(seen, mean, 0.0) ** 2, axis=1)
    free = used - np.diff(patches.nav_start)[rows] - seen.sum(axis=1) + 1
    out: F64 = np.maximum(within - between, 0.0) * used / np.maximum(free, LEAST_FREE * used)
    return out


def pass_differences(
    patches: PatchTable, nav: NavigationBins, b: BudgetParameters, max_fix_gap_s: float
) -> list[UnitErrors]:
    """What the patches of a survey tell of its errors: between time bins, and between beams."""
    rows = asked_patches(patches)
    if not len(rows):
        return []
    out, looks, bin_s = [], steady_looks(patches, rows, nav), nav.bin_ns * 1e-9
    if looks is not None:
        found, sizes = bin_residuals(patches, rows, looks, nav, b)
        states = np.maximum(nav.mean(looks.bins)[1], 1).astype(np.float64)
        white = nav.fixes(looks.bins, max_fix_gap_s), states
        out.append(told_by(found, bin_covariances(looks.bins, bin_s, white, sizes, b)))
    beams = 2 * beam_count(patches)
    out.append(told_by(beam_residuals(patches, rows, b), {"beams": np.eye(beams)}))
    return [found for found in out if found is not None]
