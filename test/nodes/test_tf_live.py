"""/tf and /tf_static of the real graph, where the package tf2_msgs is installed."""

import pytest
from own_process import result_of

pytest.importorskip("rclpy")
pytest.importorskip("tf2_msgs.msg")

SCRIPT = """
import json, math, time
import numpy as np, rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix
from tf2_msgs.msg import TFMessage
from ladar_volume.nodes.convert import header
from ladar_volume.nodes.frames.static_mounting import STATIC
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
robot, heard = rclpy.create_node("robot"), {"tf": [], "fixed": [], "platform": []}
fixed = robot.create_publisher(TFMessage, "/tf_static", STATIC)


def transform(parent, child, x, z, pitch=0.0):
    one = TransformStamped(header=header(0, parent), child_frame_id=child)
    one.transform.translation.x, one.transform.translation.z = x, z
    one.transform.rotation.y, one.transform.rotation.w = math.sin(pitch / 2), math.cos(pitch / 2)
    return one


tree = [("imu_link", 0.1, 0.0), ("velodyne", 0.3, 0.5, math.pi / 2), ("gnss", 0.0, 1.0)]
fixed.publish(TFMessage(transforms=[transform("base_link", *edge) for edge in tree]))
names = {"node.lidar_frame": "velodyne", "node.imu_frame": "imu_link", "node.gnss_frame": "gnss"}
names["node.input_reliability"] = "reliable"


def node(**calibration):
    given = names | {f"calibration.{k}": v for k, v in calibration.items()}
    one = GeoreferenceNode(parameter_overrides=[Parameter(k, value=v) for k, v in given.items()])
    one.kernels = None
    one.trigger_configure()
    return one


wrong = node(lever_laser_m=[0.9, 0.0, 0.5])
right = node()
right.trigger_activate()
c = right.parameters.calibration
found = {"laser": c.lever_laser_m, "antenna": c.lever_antenna_m, "pitch": c.boresight_pitch_rad}
take = lambda kind: lambda m: heard[kind].extend(m.transforms)
robot.create_subscription(TFMessage, "/tf", take("tf"), 100)
robot.create_subscription(TFMessage, "/tf_static", take("fixed"), STATIC)
robot.create_subscription(Odometry, "platform", heard["platform"].append, 100)
fix_out = robot.create_publisher(NavSatFix, "gnss/fix", 50)
imu_out = robot.create_publisher(Imu, "imu/data", 50)
spinners = [Spinner(n) for n in (right, robot)]
until = lambda done, s=60.0: [time.sleep(0.02) for _ in range(int(s / 0.02)) if not done()]
until(lambda: fix_out.get_subscription_count() and imu_out.get_subscription_count())
until(lambda: right.count_subscribers("/tf") > 1 and right.count_subscribers("platform"))
for i in range(20):
    t = 10**15 + i * 10**8
    fix = NavSatFix(header=header(t, "gnss"), latitude=50.0 + 1e-6 * i, longitude=14.0)
    fix.status.status = 0
    fix.position_covariance, fix.position_covariance_type = np.eye(3).ravel() * 1e-4, 2
    imu = Imu(header=header(t, "imu_link"), orientation_covariance=np.eye(3).ravel() * 1e-6)
    imu.orientation.z, imu.orientation.w = math.sin(0.02 * i), math.cos(0.02 * i)
    fix_out.publish(fix)
    imu_out.publish(imu)
until(lambda: len(heard["platform"]) > 10 and len(heard["tf"]) >= len(heard["platform"]))
for s in spinners:
    s.close()
vector = lambda v: [v.x, v.y, v.z]
print(json.dumps(found | {
    "refused": wrong.failure,
    "fixed": [[o.header.frame_id, o.child_frame_id] for o in heard["fixed"]],
    "frames": sorted({(o.header.frame_id, o.child_frame_id) for o in heard["tf"]}),
    "base": [vector(o.transform.translation) for o in heard["tf"]],
    "imu": [vector(o.pose.pose.position) for o in heard["platform"]],
}))
rclpy.try_shutdown()
"""


@pytest.fixture(scope="module")
def seen():
    return result_of(SCRIPT)


def test_static_transforms_are_the_mounting(seen):
    assert seen["laser"] == pytest.approx([0.2, 0.0, 0.5])
    assert seen["antenna"] == pytest.approx([-0.1, 0.0, 1.0])
    assert seen["pitch"] == pytest.approx(1.5707963267948966)


def test_a_configuration_that_contradicts_them_is_refused_with_both(seen):
    assert "0.900, 0.000, 0.500 m" in seen["refused"] and "0.200, 0.000" in seen["refused"]


def test_the_pose_of_the_base_is_published(seen):
    assert ["map", "odom"] in seen["fixed"] and seen["frames"] == [["odom", "base_link"]]
    assert len(seen["base"]) > 10
    for base, imu in zip(seen["base"], seen["imu"], strict=False):
        # the IMU sits 0.1 m ahead of the base
        assert sum((a - b) ** 2 for a, b in zip(base, imu, strict=True)) == pytest.approx(0.01)
