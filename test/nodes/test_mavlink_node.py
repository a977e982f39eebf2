"""mavlink_node between a real pymavlink peer on UDP loopback and real DDS."""

import math
from pathlib import Path

import numpy as np
import pytest
from own_process import result_of

ROOT = Path(__file__).parents[2]

SCRIPT = """
import os

os.environ["MAVLINK20"] = "1"
import json, math, socket, sys, threading, time
import numpy as np, rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from pymavlink import mavutil
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix
from ladar_volume.io.sensor_messages import (
    fix_from_message,
    imu_from_message,
    odometry_from_message,
)
from ladar_volume.nodes.mavlink_node import MavlinkNode
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner

probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
probe.bind(("127.0.0.1", 0))
port = probe.getsockname()[1]
probe.close()
rclpy.init(args=[])
settings = {
    "mavlink.url": f"udpin:127.0.0.1:{port}",
    "mavlink.clock_settle_s": 0.6,
    "mavlink.roll_pitch_sigma_deg": 0.5,
    "mavlink.heartbeat_timeout_s": 0.5,
    "node.diagnostics_period_s": 0.2,
}
node = MavlinkNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
node.autostart()
bad = MavlinkNode(parameter_overrides=[Parameter("mavlink.height", value="msl")])
refused = int(bad.trigger_configure())
tester = rclpy.create_node("tester")
lines, got = {}, {"fix": [], "imu": [], "raw": [], "odometry": []}
tester.create_subscription(
    DiagnosticArray,
    "/diagnostics",
    lambda m: lines.update({s.name: {v.key: v.value for v in s.values} for s in m.status}),
    50,
)
for name, kind, topic in (
    ("fix", NavSatFix, "gnss/fix"),
    ("imu", Imu, "imu/data"),
    ("raw", Imu, "imu/data_raw"),
    ("odometry", Odometry, "odometry"),
):
    tester.create_subscription(kind, topic, lambda m, name=name: got[name].append(m), STREAM)
spinners = [Spinner(n) for n in (node, tester)]
until = lambda done, s=60.0: [time.sleep(0.02) for _ in range(int(s / 0.02)) if not done()]
link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=1, source_component=1)
boot = time.time() - 50.0
began = time.time()
i, commands = 0, 0
heard = lambda: i > 110 and commands >= 3 and all(len(messages) > 5 for messages in got.values())
while (flown := time.time() - began) < 2.5 or (flown < 60.0 and not heard()):
    now = time.time() - boot
    ms = int(now * 1000)
    if i % 10 == 0:
        link.mav.heartbeat_send(2, 3, 0, 0, 4)
        link.mav.system_time_send(int(time.time() * 1e6), ms)
        link.mav.gps_raw_int_send(
            ms * 1000,
            6,
            501234567,
            141234567,
            250000,
            80,
            90,
            0,
            0,
            17,
            295000,
            14,
            20,
            50,
            50000,
            9000,
        )
        link.write(b"noise")
    link.mav.attitude_send(ms, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.1)
    link.mav.highres_imu_send(ms * 1000, 0, 0, -9.81, 0, 0, 0.1, 0, 0, 0, 0, 0, 0, 0, 63)
    link.mav.odometry_send(
        ms * 1000,
        1,
        12,
        1.0,
        2.0,
        -3.0,
        [1, 0, 0, 0],
        1,
        0,
        0,
        0,
        0,
        0,
        [math.nan] * 21,
        [math.nan] * 21,
    )
    while (m := link.recv_match(blocking=False)) is not None:
        if m.get_type() == "TIMESYNC" and m.tc1 == 0:
            link.mav.timesync_send(int((time.time() - boot) * 1e9), m.ts1)
        commands += m.get_type() == "COMMAND_LONG"
    i += 1
    time.sleep(0.02)
until(lambda: "lost_mavlink_heartbeat_lost" in lines.get("mavlink_node", {}))
for s in spinners:
    s.close()
rclpy.try_shutdown()
fix, imu, odometry = (
    fix_from_message(got["fix"][-1]),
    imu_from_message(got["imu"][-1]),
    odometry_from_message(got["odometry"][-1]),
)
print(
    json.dumps(
        {
            "refused": refused,
            "commands": commands,
            "counts": {k: len(v) for k, v in got.items()},
            "fix": [
                fix.latitude_deg,
                fix.longitude_deg,
                fix.height_m,
                fix.C_enu.tolist(),
                fix.status,
            ],
            "age": time.time() - imu.t_ns * 1e-9,
            "forward": [
                imu.q_map_body.tolist(),
                imu.omega_body.tolist(),
                np.sqrt(np.diag(imu.C_axes)).tolist(),
            ],
            "raw": [got["raw"][-1].orientation_covariance[0], got["raw"][-1].linear_acceleration.z],
            "order": all(
                fix_from_message(b).t_ns > fix_from_message(a).t_ns
                for a, b in zip(got["fix"], got["fix"][1:])
            ),
            "odometry": [odometry.p_map_body.tolist(), odometry.C_pose is None],
            "lines": lines["mavlink_node"],
        }
    )
)
"""


def test_a_peer_on_loopback_becomes_ros_messages():
    seen = result_of(SCRIPT, timeout_s=300)
    assert (
        seen["fix"][:3] == pytest.approx([50.1234567, 14.1234567, 295.0])
        and seen["fix"][4] == 2
        and seen["order"]
    )
    np.testing.assert_allclose(np.sqrt(np.diag(seen["fix"][3])), [0.014, 0.014, 0.020])
    q, omega, sigma = seen["forward"]
    np.testing.assert_allclose(np.abs(q), [0, 0, 0, 1], atol=1e-6)  # heading east
    np.testing.assert_allclose(omega, [0, 0, -0.1], atol=1e-7)
    np.testing.assert_allclose(sigma, np.radians([0.5, 0.5, 0.5]), rtol=1e-6)
    assert seen["raw"] == [-1.0, pytest.approx(9.81)] and seen["odometry"] == [
        [2.0, 1.0, 3.0],
        True,
    ]
    assert all(n > 5 for n in seen["counts"].values()) and seen["commands"] >= 3
    assert (
        0 < seen["age"] < 30
    )  # stamped with this computer's clock, not with fifty seconds since boot
    lines = seen["lines"]
    assert (
        lines["fix_type"] == "RTK fixed"
        and int(lines["lost_mavlink_noise_byte"]) >= 50
        and int(lines["lost_mavlink_heartbeat_lost"]) == 1
    )
    assert lines["autopilot"] == "no heartbeat" and int(lines["lost_imu_clock_unsettled"]) > 5
    assert math.isfinite(float(lines["clock_sigma_s"])) and float(lines["clock_sigma_s"]) < 0.1
    assert seen["refused"] != 0  # mean sea level without the geoid: not configured
