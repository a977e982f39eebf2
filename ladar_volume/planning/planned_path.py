"""Planned paths: parallel lanes at a height, flown there and back."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, PlatformStates


@dataclass(frozen=True)
class Lanes:
    """Parallel lanes over the origin, along x, each the other way round; the scanner is off in the
    turns.

    height_m : of the IMU above the ground · lanes, spacing_m, length_m : number, distance and
    length · speed_mps · turn_s : of a turn · cross : whether the same lanes are flown once more
    along y · rate_hz : of the attitudes · aside_m : distance of the lanes' middle from the origin
    """

    height_m: float
    lanes: int = 3
    spacing_m: float = 10.0
    length_m: float = 40.0
    speed_mps: float = 5.0
    turn_s: float = 6.0
    cross: bool = False
    rate_hz: float = 100.0
    aside_m: float = 0.0

    def __post_init__(self) -> None:
        numbers = (self.length_m, self.speed_mps, self.rate_hz)
        good = (
            all(math.isfinite(v) and v > 0 for v in numbers)
            and self.lanes >= 1
            and math.isfinite(self.height_m + self.aside_m)
        )
        if not good or not 0.0 <= self.spacing_m < math.inf or not 0.0 <= self.turn_s < math.inf:
            raise VolumeError(
                (
                    "lanes need a number of 1 or more, length, speed and rate above 0, "
                    f"spacing and turns of 0 or more, not {self}"
                ),
                reason="plan_path",
                value=self,
            )

    def states(self) -> PlatformStates:
        """Level states along the lanes; one segment per lane; covariances zero, time from zero."""
        lane_s = self.length_m / self.speed_mps
        steps = max(2, math.ceil(lane_s * self.rate_hz) + 1)
        time = np.linspace(0.0, lane_s, steps)
        along = np.linspace(-self.length_m / 2.0, self.length_m / 2.0, steps)
        t: list[F64] = []
        p: list[F64] = []
        yaw: list[F64] = []
        for number in range(self.lanes * (2 if self.cross else 1)):
            second, lane = divmod(number, self.lanes)
            way = 1.0 if lane % 2 == 0 else -1.0
            across = np.full(steps, (lane - (self.lanes - 1) / 2.0) * self.spacing_m + self.aside_m)
            x, y = (way * along, across) if second == 0 else (across, way * along)
            t.append(number * (lane_s + max(self.turn_s, 2.0 / self.rate_hz)) + time)
            p.append(np.stack([x, y, np.full(steps, self.height_m)], axis=1))
            yaw.append(np.full(steps, (0.0 if way > 0 else math.pi) + second * math.pi / 2.0))
        angle = np.concatenate(yaw)
        n = len(angle)
        q = np.stack([np.zeros(n), np.zeros(n), np.sin(angle / 2.0), np.cos(angle / 2.0)], axis=1)
        v_body = np.tile([self.speed_mps, 0.0, 0.0], (n, 1))
        t_ns = np.rint(np.concatenate(t) * 1e9).astype(np.int64)
        segment = np.repeat(np.arange(len(t)), steps).astype(np.int64)
        return PlatformStates(
            t_ns, np.concatenate(p), q, v_body, np.zeros((n, 3)), np.zeros((n, 6, 6)), segment
        )


def with_fixes(states: PlatformStates, rate_hz: float, longest_s: float) -> PlatformStates:
    """The states between fixes of that rate. Raises :class:`VolumeError` (plan_path) for a rate
    that is none, or whose fixes lie further apart than ``longest_s``, which nothing bridges.
    """
    if not (0.0 < rate_hz < math.inf and rate_hz * longest_s >= 1.0):
        raise VolumeError(
            f"fixes need a rate of {1.0 / longest_s:.3g} Hz or more, not {rate_hz:g}: intervals "
            f"longer than georeference.max_position_gap_s, {longest_s:g} s, are not bridged",
            reason="plan_path",
            value=rate_hz,
        )
    return replace(states, fix_gap_s=np.full(len(states), 1.0 / rate_hz))
