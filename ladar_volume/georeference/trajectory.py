"""The platform's path: antenna positions and attitudes as knots in time, interpolated, never
extrapolated.

An attitude knot becomes a *state* once the positions around it are known. A return is covered
between two states of one segment; a segment ends where positions or attitudes are further apart
than allowed. Every decision waits for the knots it needs, so it does not depend on the order in
which topics arrive.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.knot_table import Knots
from ladar_volume.math.se3 import matrix_from_quaternion, multiply_quaternions
from ladar_volume.model.parameters import GeoreferenceParameters
from ladar_volume.model.records import F64, I64, PlatformStates

#: Knots kept per topic, and for how long (s) at least, or for twice as long as returns may wait:
#: bounds memory, and how far a topic may run ahead of the clouds.
KNOT_LIMIT, KNOTS_KEPT_S = 131_072, 120.0
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


class PathWindow(NamedTuple):
    """The knots around one cloud, as the mapping kernel takes them.

    state_t : (k,) ns, state_q : (k, 4) map from body, state_segment : (k,) with −1 for no state ·
    position_t : (m,) ns and position : (m, 3) m of the antenna · leaving, arriving : (m, 3) m/s,
    its velocities at the beginning and the end of the interval after each position · cubic :
    positions are cubic with these velocities, else linear
    """

    state_t: I64
    state_q: F64
    state_segment: I64
    position_t: I64
    position: F64
    leaving: F64
    arriving: F64
    cubic: bool


def tangents(t_ns: I64, p: F64, gap_id: I64) -> F64:
    """Catmull-Rom tangents (n, 3) m/s for uneven knots: the slope at the middle of the parabola
    through three knots.

    At the ends of the data and of a segment, the slope of the one chord there is.
    """
    n = len(t_ns)
    if n < 2:
        return np.zeros((n, 3))
    h = np.diff(t_ns)[:, None] * 1e-9
    chord = np.diff(p, axis=0) / h
    joined = (np.diff(gap_id) == 0)[:, None]
    out = np.zeros((n, 3))
    out[:-1] = np.where(joined, chord, 0.0)
    out[1:] = np.where(joined, chord, out[1:])
    inner = joined[:-1] & joined[1:]
    parabola = (chord[:-1] * h[1:] + chord[1:] * h[:-1]) / (h[:-1] + h[1:])
    out[1:-1] = np.where(inner, parabola, out[1:-1])
    return out


def interval_velocities(t_ns: I64, p: F64, gap_id: I64, rule: str) -> tuple[F64, F64]:
    """Velocities (n, 3) m/s at the beginning and the end of the interval after each of positions
    (n, 3) m; those after the last one have no meaning.

    rule : ``hermite``, the tangents of both positions · ``parabola``, of the parabola through both
    and the one before, which needs no position of the future; the chord where none is before ·
    ``linear``, zero, for positions that are not cubic
    """
    leaving, arriving = np.zeros_like(p), np.zeros_like(p)
    if rule == "linear" or len(p) < 2:
        return leaving, arriving
    if rule == "hermite":
        m = tangents(t_ns, p, gap_id)
        return m, np.concatenate([m[1:], m[-1:]])
    h = np.diff(t_ns)[:, None] * 1e-9
    chord = np.diff(p, axis=0) / h
    joined = (np.diff(gap_id) == 0)[:, None]
    bend = np.zeros_like(chord)
    turn = (chord[1:] - chord[:-1]) * (h[1:] / (h[1:] + h[:-1]))
    bend[1:] = np.where(joined[:-1] & joined[1:], turn, 0.0)
    leaving[:-1], arriving[:-1] = chord - bend, chord + bend
    return leaving, arriving


def interpolate_position(window: PathWindow, t_ns: I64, j: I64) -> tuple[F64, F64]:
    """Antenna position (n, 3) m and velocity (n, 3) m/s at times inside ``[position_t[j],
    position_t[j + 1]]``.
    """
    t0, t1 = window.position_t[j], window.position_t[j + 1]
    h = (t1 - t0)[:, None] * 1e-9
    f = ((t_ns - t0) / (t1 - t0))[:, None]
    p0, p1 = window.position[j], window.position[j + 1]
    if not window.cubic:
        return p0 + f * (p1 - p0), (p1 - p0) / h
    m0, m1 = window.leaving[j] * h, window.arriving[j] * h
    f2, f3 = f * f, f * f * f
    p = p0 + (3 * f2 - 2 * f3) * (p1 - p0) + (f3 - 2 * f2 + f) * m0 + (f3 - f2) * m1
    v = ((6 * f - 6 * f2) * (p1 - p0) + (3 * f2 - 4 * f + 1) * m0 + (3 * f2 - 2 * f) * m1) / h
    return p, v


def rates_from_attitudes(t_ns: I64, q: F64, max_gap_ns: int) -> F64:
    """Body rates (n, 3) rad/s from attitudes (n, 4): mean of the turns to both neighbours, or of
    the one within the gap limit; else NaN.
    """
    out = np.full((len(t_ns), 3), np.nan)
    if len(t_ns) < 2:
        return out
    turn = multiply_quaternions(q[:-1] * np.array([-1.0, -1.0, -1.0, 1.0]), q[1:])
    turn = np.where(turn[:, 3:] < 0, -turn, turn)
    sine = np.linalg.norm(turn[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, turn[:, 3:])
    seconds = np.diff(t_ns)[:, None] * 1e-9
    rate = np.where(sine > 0, turn[:, :3] * (angle / np.where(sine > 0, sine, 1.0)), 0.0) / seconds
    rate[np.diff(t_ns) > max_gap_ns] = np.nan
    before, after = np.vstack([out[:1], rate]), np.vstack([rate, out[:1]])
    result: F64 = np.where(
        np.isnan(before), after, np.where(np.isnan(after), before, 0.5 * (before + after))
    )
    return result


class Trajectory:
    """Streaming knots. Times must be strictly increasing per topic (see
    ``sample_admission.TimeOrder``).
    """

    def __init__(self, parameters: GeoreferenceParameters, lever_antenna: F64) -> None:
        self._position_gap_ns = round(parameters.max_position_gap_s * 1e9)
        self._attitude_gap_ns = round(parameters.max_attitude_gap_s * 1e9)
        self._interpolation = parameters.position_interpolation
        self._hermite = self._interpolation == "hermite"  # needs a position more
        self._lever_antenna = lever_antenna
        # tag of a position: how many gaps lie before it; tag of an attitude: its segment, −1 until
        # it is a state
        keep_ns = round(max(KNOTS_KEPT_S, 2.0 * parameters.max_pending_s) * 1e9)
        self._position = Knots(KNOT_LIMIT, keep_ns, p=(3,), C=(3, 3), convergence=(4,))
        self.attitude = Knots(
            KNOT_LIMIT, keep_ns, q=(4,), q_map=(4,), omega=(3,), C=(3, 3), cross=(3, 3)
        )
        self._decided = 0
        self._segment = -1
        self._previous: tuple[int, int] | None = (
            None  # time and gap tag of the attitude before, if it is a state
        )
        self._first_state_ns: int | None = None

    def add_position(self, t_ns: int, p_map: F64, C_map: F64, convergence: F64 = _IDENTITY) -> None:
        """One antenna position: p_map (3,) m, C_map (3, 3) m²; ``convergence`` (4,) turns the local
        east, north, up into the map's.
        """
        gaps = 0
        if len(self._position):
            gap = t_ns - int(self._position.t_ns[-1]) > self._position_gap_ns
            gaps = int(self._position.tag[-1]) + int(gap)
        self._position.append(t_ns, gaps, p=p_map, C=C_map, convergence=convergence)

    def add_attitude(
        self, t_ns: int, q_local_body: F64, omega_body: F64, C_body: F64, cross: F64 | None = None
    ) -> None:
        """One attitude: quaternion (4,) to the local east, north, up, rate (3,) rad/s (NaN: from
        the attitudes around), body rotation vector covariance (3, 3) rad², and its covariance with
        the position (3, 3) where the pose comes as one.
        """
        forgotten = self.attitude.append(
            t_ns,
            -1,
            q=q_local_body,
            q_map=q_local_body,
            omega=omega_body,
            C=C_body,
            cross=np.zeros((3, 3)) if cross is None else cross,
        )
        self._decided -= min(forgotten, self._decided)

    @property
    def begin_ns(self) -> int | None:
        """Nothing before this time will ever be covered; None while it is not known."""
        firsts = [int(knots.t_ns[0]) for knots in (self._position, self.attitude) if len(knots)]
        if self._first_state_ns is not None:
            firsts.append(self._first_state_ns)
        return max(firsts, default=None)

    @property
    def decided_ns(self) -> int | None:
        """Up to this time it is known what is covered (the newest attitude with positions around
        it); None at the start.
        """
        count = self._decidable()
        return int(self.attitude.t_ns[count - 1]) if count else None

    def _decidable(self) -> int:
        need = 2 if self._hermite else 1
        if len(self._position) < need:
            return 0
        # the interval after the attitude must be known; a Hermite tangent at its end needs one knot
        # more, unless it has no weight there
        count = int(
            np.searchsorted(
                self.attitude.t_ns,
                self._position.t_ns[-need],
                side="right" if self._hermite else "left",
            )
        )
        if count and count == len(self.attitude) and np.isnan(self.attitude["omega"][count - 1, 0]):
            return count - 1  # its rate needs the next attitude
        return count

    def decide(self) -> PlatformStates | None:
        """Turn attitudes into states as far as the positions allow; returns the new states."""
        lo, hi = self._decided, self._decidable()
        if hi <= lo:
            return None
        self._decided = hi
        t = self.attitude.t_ns[lo:hi]
        pos_t, gap_id = self._position.t_ns, self._position.tag
        j = np.searchsorted(pos_t, t, side="right") - 1
        at = np.maximum(j, 0)
        right = (j >= 0) & (gap_id[at] == gap_id[np.minimum(at + 1, len(pos_t) - 1)])
        # exactly at the last knot before a gap: the interval on the left serves
        left = ~right & (j >= 1) & (pos_t[at] == t) & (gap_id[np.maximum(j - 1, 0)] == gap_id[at])
        valid = (right | left) & self._fill_rates(lo, hi)
        self.attitude.tag[lo:hi] = self._segments(t, valid, gap_id[at])
        turn = self._position["convergence"][at]
        turned = (turn[:, :3] != 0).any(axis=1)
        q = self.attitude["q"][lo:hi].copy()
        q[turned] = multiply_quaternions(turn[turned], q[turned])
        self.attitude["q_map"][lo:hi] = q
        rows = np.flatnonzero(valid)
        if len(rows) == 0:
            return None
        if self._first_state_ns is None:
            self._first_state_ns = int(t[rows[0]])
        return self._states(lo + rows, np.where(right, at, at - 1)[rows])

    def _fill_rates(self, lo: int, hi: int) -> npt.NDArray[np.bool_]:
        omega = self.attitude["omega"]
        missing = np.isnan(omega[lo:hi, 0])
        if missing.any():
            first = max(lo - 1, 0)
            around = slice(first, hi + 1)
            rates = rates_from_attitudes(
                self.attitude.t_ns[around], self.attitude["q"][around], self._attitude_gap_ns
            )
            omega[lo:hi][missing] = rates[lo - first : hi - first][missing]
        known: npt.NDArray[np.bool_] = np.isfinite(omega[lo:hi, 0])
        return known

    def _segments(self, t: I64, valid: npt.NDArray[np.bool_], gap_id: I64) -> I64:
        out = np.full(len(t), -1, np.int64)
        for i in range(len(t)):
            if not valid[i]:
                self._previous = None
                continue
            before = self._previous
            if before is None or t[i] - before[0] > self._attitude_gap_ns or gap_id[i] != before[1]:
                self._segment += 1
            out[i] = self._segment
            self._previous = (int(t[i]), int(gap_id[i]))
        return out

    def _states(self, k: I64, j: I64) -> PlatformStates:
        """States at attitudes ``k`` whose positions lie in the intervals after knots ``j``."""
        first = max(int(j[0]) - 1, 0)
        window = self._position_window(first, int(j[-1]) + 3)
        t = self.attitude.t_ns[k]
        p_antenna, v_map = interpolate_position(window, t, j - first)
        q, omega = self.attitude["q_map"][k], self.attitude["omega"][k]
        R = matrix_from_quaternion(q)
        gap_ns = self._position.t_ns[j + 1] - self._position.t_ns[j]
        f = ((t - self._position.t_ns[j]) / gap_ns)[:, None, None]
        C = np.zeros((len(k), 6, 6))
        C[:, :3, :3] = (1.0 - f) * self._position["C"][j] + f * self._position["C"][j + 1]
        C[:, 3:, 3:] = self.attitude["C"][k]
        C[:, :3, 3:] = self.attitude["cross"][k]
        C[:, 3:, :3] = np.swapaxes(C[:, :3, 3:], 1, 2)
        return PlatformStates(
            t_ns=t.copy(),
            p_map_body=p_antenna - np.einsum("nij,j->ni", R, self._lever_antenna),
            q_map_body=q,
            v_body=np.einsum("nji,nj->ni", R, v_map) - np.cross(omega, self._lever_antenna),
            omega_body=omega,
            C_nav=C,
            segment=self.attitude.tag[k],
            fix_gap_s=(gap_ns * 1e-9).astype(np.float64),
        )

    def _position_window(self, lo: int, hi: int) -> PathWindow:
        part = slice(lo, hi)
        t, p = self._position.t_ns[part], self._position["p"][part]
        ends = interval_velocities(t, p, self._position.tag[part], self._interpolation)
        empty = np.zeros(0, np.int64)
        cubic = self._interpolation != "linear"
        return PathWindow(empty, np.zeros((0, 4)), empty, t, p, *ends, cubic)

    def window(self, first_ns: int, last_ns: int) -> PathWindow:
        """The decided knots that cover times from ``first_ns`` to ``last_ns``, with one to spare on
        either side.
        """
        decided = self.attitude.t_ns[: self._decided]
        k0 = max(int(np.searchsorted(decided, first_ns, side="right")) - 1, 0)
        k1 = min(int(np.searchsorted(decided, last_ns, side="left")) + 1, self._decided)
        part = slice(k0, max(k1, k0))
        state_t = decided[part]
        lo = hi = 0
        if len(state_t):
            lo = max(int(np.searchsorted(self._position.t_ns, state_t[0], side="right")) - 2, 0)
            hi = int(np.searchsorted(self._position.t_ns, state_t[-1], side="right")) + 2
        path = self._position_window(lo, hi)
        return path._replace(
            state_t=state_t,
            state_q=self.attitude["q_map"][part],
            state_segment=self.attitude.tag[part],
        )
