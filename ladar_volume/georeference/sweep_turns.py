"""The turn of a scanner from one sweep to the next: both are laid on a grid of rings and azimuths,
and the second is moved until its points lie in the planes of the first.

Coarse, quick and for turns alone: where a sweep has no ring or sees one plane, there is no answer
about that axis, and the scatter says so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.records import F64, I64, Bool, Returns

#: Cells of a sweep by azimuth, and the most rings that are looked at.
CELLS, RINGS = 720, 16
CELL_RAD = 2.0 * math.pi / CELLS
#: Fewest returns of a ring; a gap between two is bridged where the longer range is at most so many
#: times the shorter.
RING_RETURNS, STEP = 20, 1.2
#: Share of the cells that two sweeps must both have, and the fewest pairs of points.
COMMON, PAIRS = 0.2, 200
#: A point's partner is within this, m, and this share of its range.
REACH_M, REACH_SHARE = 0.5, 0.05
#: Of the second sweep each such cell is taken; a point this near to a plane lies in it, m.
THIN, IN_PLANE_M = 3, 0.05
#: Rounds of the fit; a round below this turn is the last, rad.
ROUNDS, SETTLED_RAD = 25, math.radians(0.01)


class Sweep(NamedTuple):
    """t_s : middle of its times, s · points, normals : (rings, CELLS, 3) · log_range : (rings,
    CELLS), 0 where not seen · seen : (rings, CELLS), 1 or 0 · flat : (rings, CELLS), where there is
    a normal
    """

    t_s: float
    points: F64
    normals: F64
    log_range: F64
    seen: F64
    flat: Bool


def sweep_image(returns: Returns, t_s: float) -> Sweep:
    """Some of the rings of a sweep by azimuth, straight between its returns."""
    azimuth = np.arctan2(returns.r_laser[:, 1], returns.r_laser[:, 0])
    there = np.flatnonzero(np.bincount(returns.ring) >= RING_RETURNS)
    chosen = there[:: max(1, -(-len(there) // RINGS))]
    points, seen = np.zeros((len(chosen), CELLS, 3)), np.zeros((len(chosen), CELLS))
    for row, ring in enumerate(chosen):
        own = np.flatnonzero(returns.ring == ring)
        own = own[np.argsort(azimuth[own], kind="stable")]
        points[row], seen[row] = ring_profile(azimuth[own], returns.r_laser[own])
    order = np.argsort(np.median(points[:, :, 2], axis=1)) if len(chosen) else slice(0)
    points, seen = points[order], seen[order]
    normals, flat = grid_normals(points, seen)
    log_range = np.log(np.maximum(np.linalg.norm(points, axis=2), 1e-3)) * seen
    return Sweep(t_s, points, normals, log_range, seen, flat)


def ring_profile(azimuth: F64, r: F64) -> tuple[F64, F64]:
    """Points (CELLS, 3) of a ring's returns (n,), (n, 3) in order of azimuth, and where it is seen,
    1 or 0.
    """
    centres = (np.arange(CELLS) + 0.5) * CELL_RAD - math.pi
    turn = 2.0 * math.pi
    a = np.concatenate([[azimuth[-1] - turn], azimuth, [azimuth[0] + turn]])
    p = np.concatenate([r[-1:], r, r[:1]])
    after = np.clip(np.searchsorted(a, centres), 1, len(a) - 1)
    gap = a[after] - a[after - 1]
    share = (centres - a[after - 1]) / np.maximum(gap, 1e-12)
    length = np.linalg.norm(p, axis=1)
    longer = np.maximum(length[after], length[after - 1])
    shorter = np.minimum(length[after], length[after - 1])
    near = gap <= max(3.0 * float(np.median(np.diff(a))), 2.0 * CELL_RAD)
    near &= longer <= STEP * shorter
    points = p[after - 1] + share[:, None] * (p[after] - p[after - 1])
    return points * near[:, None], near.astype(np.float64)


def grid_normals(points: F64, seen: F64) -> tuple[F64, Bool]:
    """Normals (rings, CELLS, 3) of the grid, from a cell's neighbours to left and right, above and
    below; and where there is one.
    """
    normals, flat = np.zeros_like(points), np.zeros(seen.shape, np.bool_)
    if len(points) < 3:
        return normals, flat
    right, left = np.roll(points, -2, axis=1)[1:-1], np.roll(points, 2, axis=1)[1:-1]
    sides = np.roll(seen, -2, axis=1)[1:-1] * np.roll(seen, 2, axis=1)[1:-1]
    across, up = right - left, points[2:] - points[:-2]
    cross = np.cross(across, up)
    size = np.linalg.norm(cross, axis=2)
    lengths = np.linalg.norm(across, axis=2) * np.linalg.norm(up, axis=2)
    good = (seen[1:-1] * sides * seen[2:] * seen[:-2] > 0.0) & (size > 0.1 * lengths)
    middle = 0.5 * (points[2:] + points[:-2])
    normals[1:-1] = cross / np.maximum(size, 1e-12)[:, :, None]
    off = np.abs(((points[1:-1] - middle) * normals[1:-1]).sum(axis=2))
    flat[1:-1] = good & (off <= 0.05 + 0.01 * np.linalg.norm(points[1:-1], axis=2))
    return normals, flat


def turn_between(old: Sweep, new: Sweep) -> F64 | None:
    """The turn (3,) rad of the scanner about its axes from one sweep to the next. None where they
    have too little in common.
    """
    if old.seen.shape != new.seen.shape or not len(old.seen):
        return None
    start = shift_about_axis(old, new)
    if start is None:
        return None
    fits = [_fit(old, new, start), _fit(old, new, 0.0)]
    return max((f for f in fits if f is not None), key=lambda f: f[0], default=(0.0, None))[1]


def _fit(old: Sweep, new: Sweep, about_axis: float) -> tuple[float, F64] | None:
    """How many points lie in planes of the sweep before, and the turn (3,) rad, from a first guess
    of the turn about the axis. None where too few have a partner.
    """
    R, t, kept = exp_so3(np.array([0.0, 0.0, about_axis])), np.zeros(3), 0.0
    rows, cells = np.nonzero(new.seen[:, ::THIN])
    points = new.points[rows, THIN * cells]
    for _ in range(ROUNDS):
        found = plane_step(points, rows, old, R, t)
        if found is None:
            return None
        kept, step = found
        turn = exp_so3(step[:3])
        R, t = turn @ R, turn @ t + step[3:]
        if np.abs(step[:3]).max() < SETTLED_RAD:
            break
    return kept, rotation_vector(R)


def plane_step(points: F64, rows: I64, old: Sweep, R: F64, t: F64) -> tuple[float, F64] | None:
    """How many points lie in planes, and the turn and shift (6,) that bring the points (n, 3) of
    rings (n,) into the planes of the sweep before, by Cauchy's weights; None where few meet one.
    """
    moved = points @ R.T + t
    azimuth = np.arctan2(moved[:, 1], moved[:, 0])
    cell = np.floor((azimuth + math.pi) / CELL_RAD).astype(np.int64) % CELLS
    apart = moved - old.points[rows, cell]
    reach = REACH_M + REACH_SHARE * np.linalg.norm(moved, axis=1)
    meets = old.flat[rows, cell] & (np.linalg.norm(apart, axis=1) < reach)
    if np.count_nonzero(meets) < PAIRS:
        return None
    moved, n = moved[meets], old.normals[rows, cell][meets]
    rest = -(apart[meets] * n).sum(axis=1)
    scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-3
    weight = 1.0 / (1.0 + (rest / (2.4 * scale)) ** 2)
    A = np.hstack([np.cross(moved, n), n])
    normal = (A * weight[:, None]).T @ A
    normal[np.diag_indices(6)] += 1e-6 * np.trace(normal)  # what a plane leaves open stays
    kept = float(np.count_nonzero(np.abs(rest) < IN_PLANE_M))
    return kept, np.asarray(np.linalg.solve(normal, A.T @ (weight * rest)))


def rotation_vector(R: F64) -> F64:
    """Of a turn below half a circle."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    size = float(np.linalg.norm(v))
    angle = math.atan2(size, float(np.trace(R)) - 1.0)
    return v * (angle / size if size > 0.0 else 0.5)


def shift_about_axis(old: Sweep, new: Sweep) -> float | None:
    """The turn (rad) about the axis of the scanner, to a cell: where the mean square difference of
    log ranges is least. None where the sweeps have too little in common.
    """
    misfit, common = misfit_by_shift(old, new)
    enough = common > COMMON * CELLS * len(old.seen)
    if not enough.any():
        return None
    shift = int(np.argmin(np.where(enough, misfit / np.maximum(common, 1.0), np.inf)))
    return -(shift - CELLS * round(shift / CELLS)) * CELL_RAD


def misfit_by_shift(old: Sweep, new: Sweep) -> tuple[F64, F64]:
    """Sum of squared differences (CELLS,) for each shift of the second sweep, and in how many cells
    both are seen: sums of products, by Fourier transforms.
    """
    v, w = np.fft.rfft(old.log_range), np.fft.rfft(new.log_range)
    v2, w2 = np.fft.rfft(old.log_range**2), np.fft.rfft(new.log_range**2)
    m, n = np.fft.rfft(old.seen), np.fft.rfft(new.seen)
    squares = np.conj(v2) * n + np.conj(m) * w2 - 2.0 * np.conj(v) * w
    return (
        np.fft.irfft(squares.sum(axis=0), CELLS),
        np.fft.irfft((np.conj(m) * n).sum(axis=0), CELLS),
    )
