"""Which share of what came was lost for one reason lately, and what to do about it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from ladar_volume.nodes.watch.health import ROUTINE

#: Losses are judged over this time, s, and from so many offered on.
WINDOW_S, FEWEST = 5.0, 5
#: Before a survey has gone on for so long, s, what is lost may be its beginning: no error yet.
SETTLED_S = 2.0
#: A share above the first is worth a warning, above the second an error.
WARN_SHARE, ERROR_SHARE = 0.03, 0.25
#: Gates of the user and of the filter (:data:`ROUTINE`) are an error above this share only.
NOTHING_PASSES = 0.995
#: A ring that the configuration does not have is never a matter of the data.
WRONG_SETUP = frozenset({"point_ring"})
#: Units in the plural.
UNITS = {
    "point": "returns",
    "cloud": "clouds",
    "fix": "fixes",
    "imu": "attitudes",
    "odometry": "poses",
}
#: What to do, by reason.
ADVICE = {
    "point_ring": "set georeference.beams to the number of rings of the scanner",
    "point_pose_gap": "returns without a pose at their time: look at gnss/fix and imu/data",
    "point_waiting_full": "returns wait for poses that do not come: look at gnss/fix and imu/data",
    "point_range": "check georeference.range_min_m and range_max_m",
    "point_region": "check georeference.region_m and the datum",
    "point_vehicle": "check georeference.vehicle_box_m",
    "point_intensity": "check georeference.intensity_min and intensity_max",
    "cloud_no_time": "the driver sends no time for each return: update it, or switch its time "
    "field on",
    "cloud_one_time": "the driver sends one time for a whole sweep: update it",
    "cloud_no_xyz": "the topic is no cloud of a scanner: check its name",
    "fix_zero": "latitude and longitude are 0: the driver has not set them",
    "fix_no_fix": "the receiver has no fix: antenna, sky, corrections",
    "fix_unknown_covariance": "the receiver sends no accuracy: set "
    "georeference.unknown_covariance to budget, with sigmas in budget",
    "imu_unknown_covariance": "the IMU sends no accuracy: set "
    "georeference.unknown_covariance to budget, with sigmas in budget",
    "imu_no_orientation": "the topic has rates alone: remap imu/data to one with an attitude",
    "fix_time_backwards": "stamps go back: two receivers on one topic, or a clock that is set",
    "imu_time_backwards": "stamps go back: two IMUs on one topic, or a clock that is set",
}


class LossShares:
    """Losses and what was offered, both since the start, over the last :data:`WINDOW_S`."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, dict[str, int], dict[str, int]]] = deque()

    def judge(
        self, losses: Mapping[str, int], offered: Mapping[str, int], now_s: float
    ) -> tuple[list[str], list[str]]:
        """Warnings and errors in words. offered : by unit, the first word of a reason."""
        settled = bool(self._seen) and now_s - self._seen[0][0] >= SETTLED_S
        before = self._before(losses, offered, now_s)
        warnings, errors = [], []
        for reason, count in losses.items():
            unit = reason.partition("_")[0]
            came = offered.get(unit, 0) - before[1].get(unit, 0)
            lost = count - before[0].get(reason, 0)
            if came < FEWEST or lost <= 0:
                continue
            share = min(lost / came, 1.0)
            text = f"{100.0 * share:.0f} % of {UNITS.get(unit, unit)} lost as {reason}"
            text += f": {ADVICE[reason]}" if reason in ADVICE else ""
            warn, most = _limits(reason)
            if share > most and (settled or reason in WRONG_SETUP):
                errors.append(text)
            elif share > warn:
                warnings.append(text)
        return warnings, errors

    def _before(
        self, losses: Mapping[str, int], offered: Mapping[str, int], now_s: float
    ) -> tuple[dict[str, int], dict[str, int]]:
        self._seen.append((now_s, dict(losses), dict(offered)))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - WINDOW_S:
            self._seen.popleft()
        oldest = self._seen[0]
        return ({}, {}) if oldest[0] > now_s - WINDOW_S else (oldest[1], oldest[2])


def _limits(reason: str) -> tuple[float, float]:
    """Shares above which a loss is worth a warning, and an error."""
    if reason in ROUTINE:
        return NOTHING_PASSES, NOTHING_PASSES
    return WARN_SHARE, WARN_SHARE if reason in WRONG_SETUP else ERROR_SHARE
