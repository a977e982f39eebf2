"""What the order of arrival says of the clocks, in words. Arrival alone cannot tell a message that
comes late from a clock that is off: the turns that LiDAR and attitudes both saw can, and without
them no correction is advised.
"""

from __future__ import annotations

from ladar_volume.georeference.clock_check import LATENCY_S, Lead
from ladar_volume.georeference.turn_check import TurnLag

#: Stamps that agree within this, or three sigma, are of clocks that agree, s.
SAME_S = 0.02
#: Stamps of two inputs further apart than this are of two clocks, s: no message is so late, and no
#: offset is to be declared.
APART_S = 60.0
#: Differences of time scales, s (leap seconds as of 2017 on), and how near a difference must be.
STEPS = {
    18.0: "GPS time is 18 s ahead of UTC",
    19.0: "TAI is 19 s ahead of GPS time",
    37.0: "TAI, which PTP hands out, is 37 s ahead of UTC",
    315_964_782.0: "GPS time counts from 1980, UTC from 1970",
    315_964_800.0: "GPS time counts from 1980, UTC from 1970",
}
NEAR_S, HOUR_S, ZONE_H = 0.5, 3600.0, 14.0


def known_step(apart_s: float) -> str:
    """What a difference of clocks looks like, in brackets; empty where nothing is known."""
    apart_s = abs(apart_s)
    for step_s, words in STEPS.items():
        if abs(apart_s - step_s) < NEAR_S:
            return f" ({words})"
    hours = round(apart_s / HOUR_S)
    if 1 <= hours <= ZONE_H and abs(apart_s - hours * HOUR_S) < NEAR_S:
        return f" ({hours} h: local time in place of UTC)"
    return ""


def stamps_off_s(turns: TurnLag | None, declared_s: float) -> float | None:
    """How far the LiDAR's stamps are off by the turns, beyond the declared offset, s: 0 where they
    agree, None where the turns do not tell.
    """
    if turns is None:
        return None
    rest = turns.lag_s - declared_s
    return rest if abs(rest) > max(SAME_S, 3.0 * turns.sigma_s) else 0.0


def clock_state(cloud: Lead, turns: TurnLag | None, declared_s: float) -> str:
    """The LiDAR's clock in a word: that of its arrival, ``latency`` where the turns say that a
    difference is the way of the messages alone.
    """
    late = cloud.state == "offset" and stamps_off_s(turns, declared_s) == 0.0
    return "latency" if late else cloud.state


def clock_words(
    cloud: Lead, fix: Lead, turns: TurnLag | None = None, declared_s: float = 0.0
) -> list[str]:
    """cloud, fix : how far the newest attitude is ahead of a cloud's last return, and of a fix, on
    their arrival · turns : what the turns say · declared_s : calibration.clock_offset_s.
    """
    clouds, fixes = cloud.estimate_s, fix.estimate_s
    off = {name: lead.state == "offset" for name, lead in (("cloud", cloud), ("fix", fix))}
    off_s = stamps_off_s(turns, declared_s)
    both = bool(clouds and fixes and all(off.values()) and _leads_agree(clouds, fixes))
    if clouds and off["cloud"] and turns is not None and off_s is not None:
        out = _by_turns(clouds[0], off_s, both, turns)
        if both:
            return out
    elif both and clouds:
        return [_imu_or_late(clouds[0])]
    else:
        out = _by_arrival(cloud)
    if fix.state in ("offset", "unsteady") and fixes is not None and abs(fixes[0]) < APART_S:
        way = "older" if fixes[0] > 0 else "newer"
        out.append(
            f"fixes are {abs(fixes[0]):.2f} s {way} than attitudes when they come ({fix.state})"
            f"{known_step(fixes[0])}"
        )
    return out


def _by_turns(lead_s: float, off_s: float, imu: bool, turns: TurnLag) -> list[str]:
    """A difference of arrival that the turns explain. imu : fixes come as clouds do."""
    if off_s == 0.0:
        return []  # late messages are waited for, and what is lost is counted
    seen = (
        f"by {turns.pairs} turns that LiDAR and attitudes both saw ({100 * turns.explained:.0f} % "
        f"of them explained)"
    )
    rest = f"; {abs(lead_s - off_s):.2f} s more are the way of the messages"
    rest = rest if abs(lead_s - off_s) > LATENCY_S + 3.0 * turns.sigma_s else ""
    if imu:
        way = "behind" if off_s < 0 else "ahead"
        return [
            f"the stamps of the attitudes are {abs(off_s):.2f} +- {turns.sigma_s:.2f} s {way} "
            f"{seen}, and fixes agree with the clouds: set the IMU's clock or driver, "
            f"calibration.clock_offset_s is of the LiDAR and mends nothing{rest}"
        ]
    way = "behind" if off_s > 0 else "ahead"
    return [
        f"the stamps of the clouds are {abs(off_s):.2f} +- {turns.sigma_s:.2f} s {way} {seen}: set "
        f"the scanner's clock, or calibration.clock_offset_s to {turns.lag_s:.2f} and refine it "
        f"with `ladar_volume calibrate strips`{rest}"
    ]


def _imu_or_late(lead_s: float) -> str:
    late = lead_s < 0
    return (
        f"attitudes are {abs(lead_s):.2f} s {'older' if late else 'newer'} than clouds and "
        f"fixes that come with them{known_step(lead_s)}: the IMU's messages are "
        f"{'late' if late else 'early'}, or its clock is {'behind' if late else 'ahead'}; a turn "
        "that the LiDAR sees, too, will tell; calibration.clock_offset_s is of the LiDAR and "
        "mends neither: look at the IMU's driver and clock"
    )


def _by_arrival(cloud: Lead) -> list[str]:
    clouds = cloud.estimate_s
    if clouds and abs(clouds[0]) >= APART_S:  # the stamps say so themselves
        return []
    if clouds and cloud.state == "offset":
        return [
            f"clouds are {abs(clouds[0]):.3f} s {'older' if clouds[0] > 0 else 'newer'} than "
            f"attitudes that come with them{known_step(clouds[0])}: one driver is late, or a clock "
            "is off; arrival cannot tell which, a turn that the LiDAR sees, too, will, or let "
            "`ladar_volume calibrate strips` find calibration.clock_offset_s"
        ]
    if cloud.state == "unsteady":
        return ["the times of the clouds scatter against those of the poses"]
    return []


def _leads_agree(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether two leads (s) with their sigmas are the same, up to latency."""
    return abs(a[0] - b[0]) < max(3.0 * (a[1] + b[1]), 4.0 * LATENCY_S)
