"""What is let into the trajectory: content checks and time order of fixes, attitudes and odometry
poses.

A refusal is a typed error whose ``reason`` is the key under which the stage counts it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference import error_budget as bud
from ladar_volume.model.errors import AttitudeError, FixError, InputError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, Fix, ImuSample, OdometrySample

#: A float32 quaternion is off by 1e-7, a filter that lost its normalisation by far more.
UNIT_TOLERANCE = 1e-2
#: A step forward longer than this (s) needs a second sample that confirms it: one corrupt stamp
#: must not shut out what follows.
JUMP_S = 10.0
#: A step back longer than this (s) is no late message but a clock that was set, or a block of late
#: ones.
SET_BACK_S = 0.5
#: A clock set back for longer than this (s) is taken to be right from then on.
LASTING_S = 10.0

S = TypeVar("S")


def _covariance(C: F64 | None, size: int, error: type[InputError], topic: str) -> F64 | None:
    """A given covariance checked, or None where it is unknown; all zeros mean unknown
    (sensor_msgs).
    """
    if C is None:
        return None
    C = np.asarray(C, dtype=np.float64)
    if C.shape != (size, size) or not np.isfinite(C).all():
        raise error(
            f"{topic}: covariance is not a finite {size} x {size} matrix",
            reason=f"{topic}_bad_covariance",
            value=C,
        )
    scale = float(np.abs(C).max())
    if scale == 0.0:
        return None
    unit = C / scale
    if np.abs(unit - unit.T).max() > 1e-6 or np.linalg.eigvalsh(unit)[0] < -1e-6:
        raise error(
            f"{topic}: covariance is not symmetric and positive",
            reason=f"{topic}_bad_covariance",
            value=C,
        )
    return C


def _unknown(topic: str, policy: str, error: type[InputError]) -> None:
    if policy != "budget":
        raise error(
            (
                f"{topic}: the covariance is unknown; set unknown_covariance: budget to use "
                "the budget's sigma"
            ),
            reason=f"{topic}_unknown_covariance",
        )


def unit_quaternion(q: npt.ArrayLike, topic: str) -> F64:
    """A quaternion (4,) xyzw of norm 1. Raises :class:`AttitudeError` for one that is not finite
    (``<topic>_nan``) or whose norm is off by more than UNIT_TOLERANCE (``<topic>_not_unit``).
    """
    q = np.asarray(q, dtype=np.float64)
    if q.shape != (4,) or not np.isfinite(q).all():
        raise AttitudeError(
            f"{topic}: the orientation is not finite", reason=f"{topic}_nan", value=q
        )
    norm = math.hypot(*q.tolist())  # whose squares may be beyond what a double holds
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise AttitudeError(
            f"{topic}: the quaternion's norm is {norm:g}, not 1",
            reason=f"{topic}_not_unit",
            value=q,
        )
    return q / norm


def fix_covariance(fix: Fix, budget: BudgetParameters, policy: str) -> F64:
    """The fix's east, north, up covariance (3, 3) m². Raises :class:`FixError` where the fix cannot
    be used.
    """
    if fix.status < 0:
        raise FixError("the receiver has no fix", reason="fix_no_fix", value=fix.status)
    place = (fix.latitude_deg, fix.longitude_deg, fix.height_m)
    if not all(math.isfinite(v) for v in place):
        raise FixError(f"the fix is not finite: {place}", reason="fix_nan", value=place)
    if abs(fix.latitude_deg) > 90 or abs(fix.longitude_deg) > 360:
        raise FixError(
            f"the fix is not on the earth: {place}", reason="fix_out_of_range", value=place
        )
    C = _covariance(fix.C_enu, 3, FixError, "fix")
    if C is None:
        _unknown("fix", policy, FixError)
        C = np.diag(np.asarray(budget.position_sigma_m) ** 2)
    return C


def imu_attitude(imu: ImuSample, budget: BudgetParameters, policy: str) -> tuple[F64, F64]:
    """Unit quaternion (4,) and body rotation vector covariance (3, 3) rad². Raises
    :class:`AttitudeError`.
    """
    if np.isnan(imu.q_map_body).all():
        raise AttitudeError(
            "the IMU gives no orientation (orientation_covariance[0] = -1)",
            reason="imu_no_orientation",
        )
    q = unit_quaternion(imu.q_map_body, "imu")
    # a wholly missing rate is taken from the attitudes around
    if np.shape(imu.omega_body) != (3,) or not (
        np.isfinite(imu.omega_body).all() or np.isnan(imu.omega_body).all()
    ):
        raise AttitudeError(
            "the angular velocity is not finite", reason="imu_nan", value=imu.omega_body
        )
    C = _covariance(imu.C_axes, 3, AttitudeError, "imu")
    if C is None:
        _unknown("imu", policy, AttitudeError)
        return q, bud.attitude_covariance_from_euler(q, budget.attitude_sigma_rad)
    return q, bud.attitude_covariance_from_axes(q, C)


def odometry_pose(sample: OdometrySample, budget: BudgetParameters, policy: str) -> tuple[F64, F64]:
    """Unit quaternion (4,) and C (6, 6) of position (map) and body rotation vector. Raises
    :class:`AttitudeError`.
    """
    q = unit_quaternion(sample.q_map_body, "odometry")
    p, omega = sample.p_map_body, sample.omega_body
    shaped = np.shape(p) == np.shape(omega) == (3,)
    # rates that are all NaN are unknown: the trajectory takes them from the attitudes
    if not shaped or not (
        np.isfinite(p).all() and (np.isfinite(omega) | np.isnan(omega).all()).all()
    ):
        words = "position or angular velocity is not finite"
        raise AttitudeError(words, reason="odometry_nan", value=(p, omega))
    C = _covariance(sample.C_pose, 6, AttitudeError, "odometry")
    if C is None:
        _unknown("odometry", policy, AttitudeError)
        return q, bud.navigation_covariance(budget, q)
    return q, bud.pose_covariance_from_axes(q, C)


@dataclass(frozen=True)
class _SetBack:
    """A clock that was set back: by how much, and the first and the newest stamp since (ns)."""

    step_ns: int
    first_ns: int
    newest_ns: int


class TimeOrder(Generic[S]):
    """Keeps one topic strictly increasing in time.

    A repeated or earlier stamp is refused. A step forward beyond ``jump_s`` is held until the next
    sample confirms it; if the next sample continues the old time instead, the held one was a
    corrupt stamp and is refused. After a step back of more than ``SET_BACK_S`` the samples that
    pass the newest stamp again are refused too (``_clock_back``): the platform was there earlier
    than they say. That ends when the clock comes forward by half the step or more, or after
    ``LASTING_S``.
    """

    def __init__(self, topic: str, jump_s: float = JUMP_S) -> None:
        self._topic = topic
        self._jump_ns = round(jump_s * 1e9)
        self._last: int | None = None
        self._held: tuple[int, S] | None = None
        self._set_back: _SetBack | None = None

    def push(self, t_ns: int, sample: S) -> tuple[list[S], list[str]]:
        """The samples that may now be used, in order, and the reasons of those refused."""
        if self._clock_is_back(t_ns) and self._last is not None and t_ns > self._last:
            return [], [f"{self._topic}_clock_back"]
        if self._last is None or 0 < t_ns - self._last <= self._jump_ns:
            return self._accept(t_ns, [sample], self._drop_waiting())
        if t_ns <= self._last:
            return [], [
                f"{self._topic}_duplicate"
                if t_ns == self._last
                else f"{self._topic}_time_backwards"
            ]
        if self._held is None:
            self._held = (t_ns, sample)
            return [], []
        held_ns, held = self._held
        if 0 < t_ns - held_ns <= self._jump_ns:
            self._held = None
            return self._accept(t_ns, [held, sample], [])
        if t_ns == held_ns:
            return [], [f"{self._topic}_duplicate"]
        refused = self._drop_waiting()
        self._held = (t_ns, sample)
        return [], refused

    def _clock_is_back(self, t_ns: int) -> bool:
        back = self._set_back
        if back is None:
            if self._last is not None and self._last - t_ns > SET_BACK_S * 1e9:
                self._set_back = _SetBack(self._last - t_ns, t_ns, t_ns)
        elif t_ns < back.newest_ns:
            self._set_back = _SetBack(back.step_ns + back.newest_ns - t_ns, t_ns, t_ns)
        elif 2 * (t_ns - back.newest_ns) >= back.step_ns or t_ns - back.first_ns > LASTING_S * 1e9:
            self._set_back = None
        else:
            self._set_back = _SetBack(back.step_ns, back.first_ns, t_ns)
        return self._set_back is not None

    def finish(self) -> list[str]:
        """End of data: a held sample was never confirmed."""
        return self._drop_waiting()

    def _accept(self, t_ns: int, samples: list[S], refused: list[str]) -> tuple[list[S], list[str]]:
        self._last = t_ns
        return samples, refused

    def _drop_waiting(self) -> list[str]:
        dropped = [] if self._held is None else [f"{self._topic}_time_jump"]
        self._held = None
        return dropped
