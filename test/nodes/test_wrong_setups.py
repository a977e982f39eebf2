"""Set-ups that are wrong, each fed to the real nodes in a namespace of its own: each is named
in the diagnostics of five seconds of data, and the one that is right is not.
"""

import json
import re

import pytest
from own_process import result_of

SCRIPT = """
import json, socket, sys, time
import numpy as np, rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from ladar_volume.nodes.convert import header, table_message
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.mavlink_node import MavlinkNode
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner

S = 1_000_000_000
rclpy.init(args=[])
rng = np.random.default_rng(3)


def cloud(t, rings=16, frame="velodyne", timed=True, ringed=True):
    n = 320
    columns = {axis: rng.uniform(-20, 20, n).astype(np.float32) for axis in "xyz"}
    columns["intensity"] = np.ones(n, np.float32)
    if ringed:
        columns["ring"] = (np.arange(n) % rings).astype(np.uint16)
    if timed:
        columns["time"] = np.linspace(-0.1, 0.0, n).astype(np.float32)
    return table_message(columns, t, frame)


def fix(t):
    m = NavSatFix(header=header(t, "gnss"), latitude=50.0, longitude=14.0, altitude=30.0)
    m.status.status = 2
    m.position_covariance_type, m.position_covariance = 2, np.diag([1e-4] * 3).ravel()
    return m


def fix_at_zero(t):
    m = fix(t)
    m.latitude = m.longitude = 0.0
    return m


def imu(t, down=False):
    m = Imu(header=header(t, "base_link"))
    m.orientation.w, m.orientation_covariance = 1.0, np.diag([1e-6] * 3).ravel()
    m.linear_acceleration.z = -9.8 if down else 9.8
    return m


def imu_in_g(t):
    m = imu(t)
    m.linear_acceleration.z = 1.0
    return m


def turning(t):
    # an attitude that turns by 20 degrees a second, its rate in degrees
    m, half = imu(t), np.deg2rad(10.0) * (t % (60 * S)) / S
    m.orientation.z, m.orientation.w = np.sin(half), np.cos(half)
    m.angular_velocity.z = 20.0
    return m


right = {"cloud": cloud, "fix": fix, "imu": imu}
setups = {
    "right": {},
    "beams": {"cloud": lambda t: cloud(t, rings=64), "imu": turning},
    "gnss": {"fix": None, "imu": imu_in_g},
    "axes": {"imu": lambda t: imu(t, down=True)},
    "late": {"imu": lambda t: imu(t - 2 * S)},
    "frame": {"cloud": lambda t: cloud(t, frame="map")},
    "driver": {"cloud": lambda t: cloud(t, frame="", timed=False, ringed=False)},
    "time": {"cloud": lambda t: cloud(0)},
    "leap": {"cloud": lambda t: cloud(t + 37 * S)},
    "other": {"cloud": lambda t: cloud(t, frame="rover1/odom")},
    "unset": {"fix": fix_at_zero},
}
kinds = {
    "cloud": (PointCloud2, "velodyne_points"),
    "fix": (NavSatFix, "gnss/fix"),
    "imu": (Imu, "imu/data"),
}
fast = {"node.diagnostics_period_s": 0.25, "node.hardware_id": "rover"}


def values(**more):
    return [Parameter(k, value=v) for k, v in (fast | more).items()]


nodes, pubs = [], {}
tester, said = rclpy.create_node("tester"), {}


def take(message):
    for s in message.status:
        said.setdefault(s.name, {"hardware": s.hardware_id, "texts": []})["texts"].append(
            [int.from_bytes(s.level, "little"), s.message]
        )


tester.create_subscription(DiagnosticArray, "/diagnostics", take, 200)
for name, wrong in setups.items():
    nodes.append(
        GeoreferenceNode(
            namespace=f"/{name}",
            parameter_overrides=values(**{"node.input_reliability": "reliable"}),
        )
    )
    pubs[name] = {
        k: (tester.create_publisher(t, f"/{name}/{topic}", STREAM), (right | wrong)[k])
        for k, (t, topic) in kinds.items()
        if (right | wrong)[k]
    }
nodes.append(
    LoggerNode(
        namespace="/disk",
        parameter_overrides=values(
            **{"logger.path": sys.argv[1] + "/log.mcap", "logger.disk_reserve_bytes": 2**60}
        ),
    )
)
started = [n.autostart() for n in nodes]
taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
taken.bind(("127.0.0.1", 0))
port = MavlinkNode(
    namespace="/port",
    parameter_overrides=values(**{"mavlink.url": f"udpin:127.0.0.1:{taken.getsockname()[1]}"}),
)
said["port"] = {"started": port.autostart(), "errors": port.errors()}
port.stop()
for name, url in (("silent", "udpin:127.0.0.1:0"), ("refused", "tcp:127.0.0.1:9")):
    link = MavlinkNode(namespace=f"/{name}", parameter_overrides=values(**{"mavlink.url": url}))
    nodes.append(link)
    started.append(link.autostart())
spinners = [Spinner(n) for n in (*nodes, tester)]
for _ in range(3000):
    if all(p.get_subscription_count() for of in pubs.values() for p, _ in of.values()):
        break
    time.sleep(0.02)
awaited = json.loads(sys.argv[2])


def named():
    return all(
        any(
            found >= level and words in text
            for found, text in list(said.get(node, {"texts": []})["texts"])
        )
        for node, level, words in awaited
    )


# five seconds of data, and as long as a busy machine needs to say what it makes of them: then
# only what is right goes on
began = time.monotonic()
for step in range(300):
    if step >= 49 and named():
        break
    t = 1_700_000_000 * S + step * S // 10
    for setup, of in pubs.items():
        if step >= 48 and setup != "right":
            continue
        for kind, (publisher, make) in of.items():
            if kind == "cloud" and step == 0:
                continue  # its returns would lie before the first pose
            for part in range(5 if kind == "imu" else 1):
                publisher.publish(make(t + part * S // 50))
    time.sleep(max(0.0, began + 0.1 * step - time.monotonic()))
out = json.dumps({"said": said, "started": started})
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(out)
"""

#: Level (1 warning, 2 error) and words that must be said, by set-up.
NAMED = {
    "beams": (2, "rings up to 63 come and georeference.beams is 16"),
    "gnss": (2, "no fix yet"),
    "axes": (2, "180 deg away from up"),
    "late": (1, "attitudes are 2.0"),
    "frame": (2, "frame 'map'"),
    "driver": (2, "cloud_no_time"),
    "time": (2, "stamps of cloud are 0"),
    "leap": (1, "TAI, which PTP hands out, is 37 s ahead of UTC"),
    "other": (2, "frame 'rover1/odom', where no scanner measures"),
    "unset": (2, "lost as fix_zero: latitude and longitude are 0"),
    "silent": (2, "no heartbeat on udpin:127.0.0.1:0 for "),
    "refused": (2, "tcp:127.0.0.1:9 cannot be opened"),
}
#: What is said of times where the machine, not the set-up, is to blame.
UNEVEN = r"the times of the clouds scatter against|when they come \(unsteady\)"
#: What else is wrong in these set-ups.
ALSO = {
    "driver": (1, "without a frame"),
    "gnss": (1, "g in place of m/s²"),
    "beams": (2, "in degrees per second"),
}


WRONG = [*sorted(NAMED.items()), *sorted(ALSO.items())]


def node_of(setup):
    node = "mavlink_node" if setup in ("silent", "refused") else "georeference_node"
    return f"{setup}/{node}"


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    awaited = [("disk/logger_node", 2, "nothing is logged")]
    awaited += [(node_of(setup), level, words) for setup, (level, words) in WRONG]
    return result_of(SCRIPT, tmp_path_factory.mktemp("log"), json.dumps(awaited))


@pytest.mark.parametrize(("setup", "wrong"), WRONG)
def test_what_is_wrong_is_named(seen, setup, wrong):
    level, words = wrong
    texts = seen["said"][node_of(setup)]["texts"]
    assert any(found >= level and words in text for found, text in texts), texts[-1]


def test_a_right_setup_is_good_and_names_its_vehicle(seen):
    right = seen["said"]["right/georeference_node"]
    said = right["texts"]
    assert right["hardware"] == "rover" and [0, "good"] in said
    # a machine short of time hands clouds and poses on unevenly, and is told that alone
    last = said[-1][1].split("; ")
    assert all(text == "good" or re.search(UNEVEN, text) for text in last), last
    assert not [text for level, text in right["texts"] if level == 2]


def test_a_late_imu_gets_no_advice_for_the_clock_of_the_lidar(seen):
    texts = [text for _, text in seen["said"]["late/georeference_node"]["texts"]]
    assert not any("clock_offset_s should be" in text for text in texts)


def test_a_full_disk_is_an_error_and_a_busy_port_one_line(seen):
    texts = seen["said"]["disk/logger_node"]["texts"]
    assert any(level == 2 and "nothing is logged" in text for level, text in texts), texts[-1]
    port = seen["said"]["port"]
    (error,) = port["errors"]  # it is tried again: another program may let go of it
    assert port["started"] is True and "udpin:127.0.0.1" in error and "\n" not in error
