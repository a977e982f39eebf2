"""The pose of the platform from /tf: straight, through odom, and as the poses of a survey."""

from types import SimpleNamespace as Message

import numpy as np
import pytest

from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter, wanted_topics
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.config import read_config
from ladar_volume.io.frames.moving_frames import MovingFrame, TransformPoses, inverse, product
from ladar_volume.math.se3 import (
    exp_so3,
    matrix_from_quaternion,
    quaternion_from_matrix,
    rotation_xyz,
)
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import SUITED
from ladar_volume.simulation.survey import Survey


def transform(parent, child, t_ns, pose):
    types = TYPESTORE.types
    stamp = types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)
    return types["geometry_msgs/msg/TransformStamped"](
        types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
        child,
        types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*map(float, pose[1])),
            types["geometry_msgs/msg/Quaternion"](*quaternion_from_matrix(pose[0]).tolist()),
        ),
    )


def pose(roll=0.0, pitch=0.0, yaw=0.0, at=(0.0, 0.0, 0.0)):
    return rotation_xyz(roll, pitch, yaw), np.array(at, dtype=float)


def said(*transforms):
    return Message(transforms=list(transforms))


def test_product_and_inverse_are_those_of_homogeneous_matrices():
    rng = np.random.default_rng(2)

    def matrix(p):
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = p
        return M

    for _ in range(20):
        a, b = ((exp_so3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(2))
        np.testing.assert_allclose(matrix(product(a, b)), matrix(a) @ matrix(b), atol=1e-12)
        np.testing.assert_allclose(matrix(inverse(a)), np.linalg.inv(matrix(a)), atol=1e-12)


def test_a_moving_frame_is_known_between_its_poses_and_nowhere_else():
    frame = MovingFrame()
    for step in range(3):
        R, p = pose(yaw=0.2 * step, at=(step, 0.0, -step))
        frame.add(step * 10**8, quaternion_from_matrix(R), p)
    R, p = frame.at(150_000_000)
    np.testing.assert_allclose(R, rotation_xyz(0.0, 0.0, 0.3), atol=1e-12)
    np.testing.assert_allclose(p, [1.5, 0.0, -1.5])
    assert frame.at(-1) is None and frame.at(200_000_001) is None
    frame.add(10**10, quaternion_from_matrix(np.eye(3)), np.zeros(3))
    assert frame.at(5 * 10**9) is None  # a gap tells nothing


def test_poses_come_straight_or_through_odom():
    odom, body = pose(yaw=0.5, at=(10.0, 2.0, 0.0)), pose(0.1, -0.2, 1.0, at=(1.0, 2.0, 3.0))
    straight = TransformPoses("map", "base_link")
    (sample,), reasons = straight.add(said(transform("/map", "base_link", 7, body)))
    assert not reasons and sample.t_ns == 7 and sample.C_pose is None
    through = TransformPoses("map", "base_link")
    assert through.add(said(transform("odom", "base_link", 7, body)))[1] == ["odometry_no_map"]
    both = said(transform("map", "odom", 7, odom), transform("odom", "base_link", 8, body))
    (sample,), reasons = through.add(both)
    R, p = product(odom, body)
    np.testing.assert_allclose(matrix_from_quaternion(sample.q_map_body), R, atol=1e-12)
    np.testing.assert_allclose(sample.p_map_body, p, atol=1e-12)
    other = said(transform("odom", "wheel", 9, body), transform("world", "map", 9, body))
    assert not reasons and through.add(other) == ([], [])


def test_a_corrected_map_and_a_broken_transform_are_named():
    poses = TransformPoses("map", "base_link")
    poses.add(said(transform("map", "odom", 1, pose())))
    assert poses.add(said(transform("map", "odom", 2, pose(at=(0.01, 0, 0)))))[1] == []
    moved = poses.add(said(transform("map", "odom", 3, pose(at=(0.5, 0, 0)))))[1]
    turned = poses.add(said(transform("map", "odom", 4, pose(yaw=0.02, at=(0.5, 0, 0)))))[1]
    assert moved == turned == ["odometry_map_moved"]
    broken = transform("map", "base_link", 5, pose())
    broken.transform.rotation.w = 2.0
    assert poses.add(said(broken)) == ([], ["odometry_not_unit"])
    broken.transform.rotation.w = float("nan")
    assert poses.add(said(broken)) == ([], ["odometry_nan"])


def survey_of_poses(folder):
    """A thinned flight whose poses come as Odometry, and on /tf through odom."""
    scene = make_scene("stockpile", 3)
    platform = make_platform("uav", scene.extent_m, 5.0)
    survey = Survey(scene, platform, BudgetParameters(), SurveyParameters(5.0, 16, seed=3))
    write_bag(
        survey,
        folder / "plain",
        {s: dict(v) for s, v in SUITED["pile"].items()},
        lambda share: None,
    )
    t_fix, p_fix = survey.fixes()[:2]
    odom, types = pose(yaw=0.3, at=(100.0, -50.0, 2.0)), TYPESTORE.types
    with BagReader(folder / "plain") as plain, BagWriter(folder / "poses") as out:
        fixed = types["tf2_msgs/msg/TFMessage"]([transform("map", "odom", 0, odom)])
        out.write("tf", fixed, plain.start_ns)
        for raw in plain.raw():
            if raw.topic == "velodyne_points":
                out.write_raw(raw.topic, raw.kind, raw.data, raw.t_ns)
            elif raw.topic == "imu/data":
                m = plain.message(raw)
                t_ns, q = stamp_ns(m), m.orientation
                at = np.array([np.interp(t_ns, t_fix, p) for p in p_fix.T])
                body = matrix_from_quaternion(np.array([q.x, q.y, q.z, q.w])), at
                moved = transform("odom", "base_link", t_ns, product(inverse(odom), body))
                out.write("tf", types["tf2_msgs/msg/TFMessage"]([moved]), raw.t_ns)
                out.write("odometry", odometry(m, at), raw.t_ns)
    return folder / "poses", folder / "plain" / "config.yaml"


def odometry(imu, at):
    types, unknown = TYPESTORE.types, np.zeros(36)
    vector = types["geometry_msgs/msg/Vector3"]
    place = types["geometry_msgs/msg/Point"](*map(float, at))
    still = types["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    return types["nav_msgs/msg/Odometry"](
        imu.header,
        "base_link",
        types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](place, imu.orientation), unknown
        ),
        types["geometry_msgs/msg/TwistWithCovariance"](still, unknown),
    )


def test_a_survey_with_poses_of_tf_is_that_with_the_same_poses_as_odometry(tmp_path):
    bag, config = survey_of_poses(tmp_path)
    found = {}
    for kind in ("Odometry", "TFMessage"):
        sets = {
            "georeference.pose_source": "odometry",
            "georeference.unknown_covariance": "budget",
            "node.odometry_message": kind,
            # TF has no velocities: the line of the clock is another, and passes may scale it
            "volume.budget_check": "warn",
        }
        parameters = read_config(config, [f"{k}={v}" for k, v in sets.items()])
        with BagReader(bag) as recording:
            topics = recording.roles(wanted_topics({}, parameters))
            found[kind] = Replay(recording, parameters, topics).run().volume
        assert topics["odometry"] == ("odometry" if kind == "Odometry" else "tf")
    by_tf, straight = found["TFMessage"], found["Odometry"]
    assert by_tf.volume_m3 == pytest.approx(straight.volume_m3, rel=1e-6)
    assert by_tf.sigma_m3 == pytest.approx(straight.sigma_m3, rel=1e-5)
