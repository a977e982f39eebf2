"""Whether the scanner is mounted as configured, to a quarter of a turn: a sweep is laid on an
earlier one by the poses alone, as the mounting is given and as it would be turned by the other 23
rotations of a cube. Where one of them brings the points far better into the planes of the sweep
before, the mounting, or the axes of the attitude, are not what they are said to be.

Both sweeps see the same place from nearly the same side, so no rotation gains by what it overlaps.
Without motion, or over a plane along which it moves, all fit alike and nothing is said.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.georeference.sweep_turns import (
    CELL_RAD,
    CELLS,
    PAIRS,
    REACH_M,
    REACH_SHARE,
    THIN,
    Sweep,
    sweep_image,
)
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.records import F64, I64, PlatformStates, Returns
from ladar_volume.model.verdict import Doubt, Verdict

#: Pause between pairs, s, once so many of them have told something.
PAUSES = ((40, 2.0), (12, 0.4), (0, 0.0))
#: A pair is laid on each other once the scanner has moved by this share of the median range, within
#: limits, m, or after so many s.
MOVED, MOVED_M, LONGEST_S = 0.02, (0.1, 1.0), 2.0
#: Sweeps that wait for poses, and times that are kept of these, s; states around a sweep are no
#: further apart than this, s.
WAITING, KEPT_S, GAP_S = 30, 12.0, 0.1
#: A point off its plane counts up to this, m.
MOST_M = 0.2
#: A pair tells two mountings apart that differ by this, m. So many pairs must speak for another
#: mounting, this share of them, by this ratio of the mean distances. (By wrong poses all mountings
#: are as far off as a point counts.)
TELLS_M, PAIRS_FOR, SHARE, RATIO = 0.01, 6, 0.85, 0.75
#: Of mountings whose distances differ by less, in parts, none is the best.
ALIKE = 0.05


def cube_rotations() -> F64:
    """The 24 rotations (24, 3, 3) that lay axes on axes; the first is none."""
    signed = np.concatenate([np.eye(3), -np.eye(3)])
    found = [
        np.column_stack([x, y, np.cross(x, y)]) for x in signed for y in signed if abs(x @ y) < 0.5
    ]
    return np.array(sorted(found, key=lambda R: -float(np.trace(R))))


class TurnedMounting(NamedTuple):
    """R_body (3, 3) : what turns the scanner as configured into the one that fits · own_m, other_m
    : mean distances from the planes in the pairs that tell both apart · pairs, better : how many
    they are, and those in which the other one fits better · alike : rotations that fit as well
    """

    R_body: F64
    own_m: float
    other_m: float
    pairs: int
    better: int
    alike: int


class _Placed(NamedTuple):
    """A sweep with the pose of the scanner in its middle."""

    sweep: Sweep
    R_map_laser: F64
    p_map: F64
    t_ns: int


class MountingCheck:
    """``add_returns`` every cloud in navigation time, ``add_states`` what the trajectory gives."""

    def __init__(self, mount: Mounting) -> None:
        self._mount = mount
        self._turns = cube_rotations()
        R = mount.R_body_laser
        self._in_laser = np.einsum("ji,njk,kl->nil", R, self._turns, R)
        self._again_ns: int | None = None
        self._waiting: deque[tuple[int, Returns]] = deque()
        self._t = np.zeros(0, np.int64)
        self._p, self._q = np.zeros((0, 3)), np.zeros((0, 4))
        self._segment = np.zeros(0, np.int64)
        self._last: _Placed | None = None
        n = len(self._turns)
        self._pairs, self._better = np.zeros(n, np.int64), np.zeros(n, np.int64)
        #: Sums of distances, m: of each rotation, and of the mounting as configured, in the pairs
        #: that tell them apart; of each in all pairs.
        self._other, self._own, self._all = np.zeros(n), np.zeros(n), np.zeros(n)

    @property
    def told(self) -> int:
        """Pairs that told some mounting from that as configured, the most of one."""
        return int(self._pairs.max())

    @property
    def sums(self) -> F64:
        """What the pairs told so far (5, 24), by rotation: counts of pairs and of those it is
        better in, and the three sums of distances, m.
        """
        return np.array([self._pairs, self._better, self._other, self._own, self._all], float)

    def merge(self, sums: F64) -> None:
        """Add the :attr:`sums` of another part of the recording."""
        self._pairs += sums[0].astype(np.int64)
        self._better += sums[1].astype(np.int64)
        self._other += sums[2]
        self._own += sums[3]
        self._all += sums[4]

    def add_returns(self, returns: Returns) -> None:
        """A cloud (n returns) in the laser frame."""
        first = int(returns.t_ns.min())
        self._waiting.append((first + int((returns.t_ns - first).mean()), returns))
        if len(self._waiting) > WAITING:
            self._waiting.popleft()

    def add_states(self, states: PlatformStates) -> None:
        """Platform states (n), after those before."""
        keep = self._t > states.t_ns[-1] - round(KEPT_S * 1e9)
        self._t = np.concatenate([self._t[keep], states.t_ns])
        self._p = np.concatenate([self._p[keep], states.p_map_body])
        self._q = np.concatenate([self._q[keep], states.q_map_body])
        self._segment = np.concatenate([self._segment[keep], states.segment])
        while self._waiting and self._waiting[0][0] <= self._t[-1]:
            self._place(*self._waiting.popleft())

    def _place(self, t_ns: int, returns: Returns) -> None:
        """Give a sweep its pose, and lay it on the one before where the scanner has moved."""
        if self._again_ns is not None and 0 < self._again_ns - t_ns <= PAUSES[0][1] * 1e9:
            return
        k = int(np.searchsorted(self._t, t_ns))
        if k == 0 or self._t[k] - self._t[k - 1] > GAP_S * 1e9:
            return
        if self._segment[k] != self._segment[k - 1]:
            return
        share = float(t_ns - self._t[k - 1]) / float(self._t[k] - self._t[k - 1])
        R = matrix_from_quaternion(self._q[k - 1 if share < 0.5 else k])
        p = self._p[k - 1] + share * (self._p[k] - self._p[k - 1]) + R @ self._mount.lever_laser
        last = self._last
        if last is not None:
            need = float(np.median(np.linalg.norm(returns.r_laser, axis=1))) * MOVED
            far = float(np.linalg.norm(p - last.p_map)) >= min(max(need, MOVED_M[0]), MOVED_M[1])
            if not far and 0 <= t_ns - last.t_ns < LONGEST_S * 1e9:
                return
        sweep = sweep_image(returns, t_ns * 1e-9)
        new = _Placed(sweep, R @ self._mount.R_body_laser, p, t_ns)
        self._last = new
        if last is not None and 0 < t_ns - last.t_ns <= 2.0 * LONGEST_S * 1e9:
            self._compare(last, new)
            pause = next(s for many, s in PAUSES if self.told >= many)
            self._last, self._again_ns = (None if pause else new), t_ns + round(pause * 1e9)

    def _compare(self, old: _Placed, new: _Placed) -> None:
        """Lay a sweep on an earlier one in every mounting."""
        if old.sweep.seen.shape != new.sweep.seen.shape or not len(new.sweep.seen):
            return
        rows, cells = np.nonzero(new.sweep.seen[:, ::THIN])
        points = new.sweep.points[rows, THIN * cells]
        R_old_new = old.R_map_laser.T @ new.R_map_laser
        shift = old.R_map_laser.T @ (new.p_map - old.p_map)
        off = np.array(
            [
                distance_from_planes(
                    points @ (S.T @ R_old_new @ S).T + S.T @ shift, rows, old.sweep
                )
                for S in self._in_laser
            ]
        )
        if np.isnan(off).any():
            return
        tells = np.abs(off - off[0]) > TELLS_M
        self._pairs += tells
        self._better += tells & (off < off[0])
        self._other += np.where(tells, off, 0.0)
        self._own += np.where(tells, off[0], 0.0)
        self._all += off

    def found(self) -> TurnedMounting | None:
        """Another mounting that fits far better; None where there is none."""
        pairs = np.maximum(self._pairs, 1)
        fits = (self._pairs >= PAIRS_FOR) & (self._better >= SHARE * pairs)
        fits &= self._other <= RATIO * self._own
        if not fits.any():
            return None
        best = int(np.argmin(np.where(fits, self._all, math.inf)))
        alike = int(np.count_nonzero(self._all <= (1.0 + ALIKE) * self._all[best]))
        n = int(self._pairs[best])
        own, other = float(self._own[best]) / n, float(self._other[best]) / n
        return TurnedMounting(self._turns[best], own, other, n, int(self._better[best]), alike)


def distance_from_planes(points: F64, rows: I64, old: Sweep) -> float:
    """Mean distance (m) of points (n, 3) of rings (n,) from the planes of a sweep where it has any,
    each up to :data:`MOST_M`, and that where a point is far from what the sweep saw. NaN where few
    meet a plane.
    """
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    cell = np.floor((azimuth + math.pi) / CELL_RAD).astype(np.int64) % CELLS
    flat = old.flat[rows, cell]
    if np.count_nonzero(flat) < PAIRS:
        return math.nan
    points, rows, cell = points[flat], rows[flat], cell[flat]
    apart = points - old.points[rows, cell]
    near = np.linalg.norm(apart, axis=1) < REACH_M + REACH_SHARE * np.linalg.norm(points, axis=1)
    off = np.abs((apart * old.normals[rows, cell]).sum(axis=1))
    return float(np.where(near, np.minimum(off, MOST_M), MOST_M).mean())


def angles_of(R: F64) -> tuple[int, int, int]:
    """Roll, pitch and yaw (whole degrees) of a rotation (3, 3), as calibration has them."""
    pitch = -math.asin(min(1.0, max(-1.0, float(R[2, 0]))))
    if abs(R[2, 0]) > 1.0 - 1e-6:  # roll and yaw are one
        roll, yaw = 0.0, math.atan2(-R[0, 1], R[1, 1])
    else:
        roll, yaw = math.atan2(R[2, 1], R[2, 2]), math.atan2(R[1, 0], R[0, 0])
    whole = [round(math.degrees(a)) for a in (roll, pitch, yaw)]
    return tuple(180 if a == -180 else a for a in whole)  # type: ignore[return-value]


def fitting_angles(found: TurnedMounting, R_body_laser: F64) -> str:
    """The angles that fit, in words. R_body_laser (3, 3) : as configured."""
    roll, pitch, yaw = angles_of(found.R_body @ R_body_laser)
    return f"roll {roll}, pitch {pitch}, yaw {yaw} deg"


def mounting_doubts(found: TurnedMounting | None, R_body_laser: F64) -> Verdict:
    """What is wrong and what to do. R_body_laser : as configured."""
    if found is None:
        return Verdict()
    also = f" ({found.alike - 1} more turns fit alike)" if found.alike > 1 else ""
    words = (
        f"the sweeps lie on each other to {1e3 * found.own_m:.0f} mm as the scanner is said to be "
        f"mounted, to {1e3 * found.other_m:.0f} mm turned to "
        f"{fitting_angles(found, R_body_laser)}{also}, better in {found.better} of {found.pairs} "
        "pairs: set calibration.boresight_* to that, or mend the axes of the attitude (x forward, "
        "y left, z up; yaw 0 east)"
    )
    return Verdict((Doubt("mounting_turned", words, found.own_m / max(found.other_m, 1e-9)),))
