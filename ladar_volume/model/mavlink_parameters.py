"""The parameters of the autopilot link; a section of :mod:`ladar_volume.model.parameters`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ladar_volume.model.parameter import param


@dataclass(frozen=True)
class MavlinkParameters:
    """The autopilot: where its messages come from and how they are read."""

    url: str = param(
        "udpin:127.0.0.1:14550",
        (
            "udpin:HOST:PORT (listen), udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT "
            "(listen), serial:DEVICE:BAUD, or a .tlog or .bin file."
        ),
    )
    system: int = param(
        1, "System id of the vehicle; 0 for the first autopilot that is heard.", low=0, high=255
    )
    component: int = param(1, "Component id of the autopilot; 0 for any.", low=0, high=255)
    position: str = param(
        "GPS_RAW_INT",
        (
            "Where positions come from: a receiver (antenna, with accuracies), or the "
            "autopilot's filter (no accuracies)."
        ),
        choices=("GPS_RAW_INT", "GPS2_RAW", "GLOBAL_POSITION_INT"),
    )
    attitude: str = param(
        "auto",
        "Where attitudes come from; auto: the quaternion wherever it is sent.",
        choices=("auto", "ATTITUDE", "ATTITUDE_QUATERNION"),
    )
    height: str = param(
        "auto",
        (
            "Which height is taken: the receiver's ellipsoidal one (ellipsoidal: a fix without "
            "it is refused), mean sea level plus geoid_undulation_m (msl), or the first there is "
            "of the receiver's, geoid_undulation_m, PROJ's geoid, and plain mean sea level (auto)."
        ),
        choices=("auto", "ellipsoidal", "msl"),
    )
    geoid_undulation_m: float = param(
        math.nan,
        "Geoid above the ellipsoid at the site; must be given with height msl.",
        unit="m",
        low=-200,
        high=200,
    )
    horizontal_accuracy: str = param(
        "per_axis",
        "What h_acc means: sigma of each axis (the careful reading), or of the distance.",
        choices=("per_axis", "radial"),
    )
    gnss_delay_s: float = param(
        0.0,
        "How much later than its epoch the autopilot stamps a receiver's fix; subtracted.",
        unit="s",
        low=-1,
        high=1,
    )
    roll_pitch_sigma_rad: float = param(
        0.0,
        "Sigma of roll and pitch; 0 for unknown: the covariance is then unknown.",
        low=0,
        high=90,
    )
    heading_sigma_rad: float = param(
        0.0,
        "Sigma of the heading where the receiver gives none (yaw with hdg_acc); 0 for unknown.",
        low=0,
        high=90,
    )
    clock: str = param(
        "ros",
        (
            "Clock of the stamps: this computer's, or UTC as the autopilot knows it "
            "(SYSTEM_TIME). A .bin is always UTC."
        ),
        choices=("ros", "utc"),
    )
    clock_settle_s: float = param(
        2.0, "How long clocks are compared before the first stamp.", unit="s", low=0.1, high=60
    )
    clock_window_s: float = param(
        60.0, "How far back the comparison of the clocks looks.", unit="s", low=2, high=3600
    )
    link_delay_s: float = param(
        0.0,
        "Shortest delay of the link, where TIMESYNC does not measure it; subtracted.",
        unit="s",
        low=0,
        high=1,
    )
    link_delay_sigma_s: float = param(0.005, "Sigma of link_delay_s.", unit="s", low=0, high=1)
    heartbeat_timeout_s: float = param(
        3.0,
        "Without a heartbeat for this long, the autopilot counts as lost.",
        unit="s",
        low=0.5,
        high=60,
    )
    position_hz: float = param(
        10.0, "Rate to ask for positions; 0 to ask for nothing.", unit="Hz", low=0, high=100
    )
    attitude_hz: float = param(
        100.0, "Rate to ask for attitudes; 0 to ask for nothing.", unit="Hz", low=0, high=500
    )
    imu_hz: float = param(
        0.0, "Rate to ask for raw inertial data; 0 to ask for nothing.", unit="Hz", low=0, high=1000
    )
    odometry_hz: float = param(
        0.0, "Rate to ask for ODOMETRY; 0 to ask for nothing.", unit="Hz", low=0, high=200
    )
    signing_key_file: str = param(
        "",
        "File with the key of MAVLink 2 signing, 64 hexadecimal digits: what is sent is signed, "
        "unsigned or wrongly signed messages are refused; empty for none.",
    )
    playback_rate: float = param(
        1.0, "A log file: times real time; 0 for as fast as possible.", low=0, high=1000
    )
