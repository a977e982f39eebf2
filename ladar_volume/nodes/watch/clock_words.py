"""What the order of arrival says of the clocks, in words. Arrival alone cannot tell a message that
comes late from a clock that is off, so no correction is advised from it.
"""

from __future__ import annotations

from ladar_volume.georeference.clock_check import LATENCY_S, Lead


def clock_words(cloud: Lead, fix: Lead) -> list[str]:
    """cloud, fix : how far the newest attitude is ahead of a cloud's last return, and of a fix, on
    their arrival.
    """
    clouds, fixes = cloud.estimate_s, fix.estimate_s
    off = {name: lead.state == "offset" for name, lead in (("cloud", cloud), ("fix", fix))}
    if clouds and fixes and all(off.values()) and _leads_agree(clouds, fixes):
        late = clouds[0] < 0
        return [
            f"attitudes are {abs(clouds[0]):.2f} s {'older' if late else 'newer'} than clouds and "
            f"fixes that come with them: the IMU's messages are {'late' if late else 'early'}, or "
            f"its clock is {'behind' if late else 'ahead'}; calibration.clock_offset_s is of the "
            "LiDAR and mends neither: look at the IMU's driver and clock"
        ]
    out = []
    if clouds and off["cloud"]:
        out.append(
            f"clouds are {abs(clouds[0]):.3f} s {'older' if clouds[0] > 0 else 'newer'} than "
            "attitudes that come with them: one driver is late, or a clock is off; arrival cannot "
            "tell which, let `ladar_volume calibrate strips` find calibration.clock_offset_s"
        )
    elif cloud.state == "unsteady":
        out.append("the times of the clouds scatter against those of the poses")
    if fix.state in ("offset", "unsteady") and fixes is not None:
        out.append(f"fixes are {fixes[0]:.2f} s older than attitudes when they come ({fix.state})")
    return out


def _leads_agree(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether two leads (s) with their sigmas are the same, up to latency."""
    return abs(a[0] - b[0]) < max(3.0 * (a[1] + b[1]), 4.0 * LATENCY_S)
