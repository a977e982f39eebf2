"""The mounting from /tf_static: taken where the configuration has none, refused where it has
another, and the same volume as when it is configured.
"""

import dataclasses
import io
import math
from pathlib import Path
from types import SimpleNamespace as Message

import numpy as np
import pytest
from rich.console import Console

from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter
from ladar_volume.io.frames.frame_mounting import from_frames, mounting_of_recording
from ladar_volume.io.frames.static_frames import StaticFrames, roll_pitch_yaw
from ladar_volume.math.se3 import exp_so3, quaternion_from_matrix, rotation_xyz
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.model.parameters import Parameters

ROOT = Path(__file__).parents[2]
SENSORS = {"cloud": "velodyne", "imu": "imu_link", "fix": "/gnss"}


def transform(parent, child, R, t):
    types = TYPESTORE.types
    x, y, z, w = quaternion_from_matrix(np.asarray(R)).tolist()
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    return types["geometry_msgs/msg/TransformStamped"](
        types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
        child,
        types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](*map(float, t)),
            types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )


def tree():
    """A rover: IMU turned by 90° and off the centre, LiDAR on a mast, antenna; and both mountings
    in the IMU's frame.
    """
    imu = rotation_xyz(0.0, 0.0, math.pi / 2), np.array([0.2, 0.0, 0.1])
    mast = np.eye(3), np.array([0.0, 0.0, 1.0])
    laser = rotation_xyz(0.02, -0.4, 0.3), np.array([0.1, 0.05, 0.2])
    antenna = np.array([-0.3, 0.0, 0.8])
    messages = [
        transform("base_link", "/imu_link", *imu),
        transform("base_link", "mast", *mast),
        transform("mast", "velodyne", *laser),
        transform("base_link", "gnss", np.eye(3), antenna),
    ]
    R = imu[0].T @ laser[0]
    return messages, R, imu[0].T @ (mast[1] + laser[1] - imu[1]), imu[0].T @ (antenna - imu[1])


def frames_of(messages):
    frames = StaticFrames()
    for one in messages:
        frames.add(Message(transforms=[one]))
    return frames


def same(one, other):
    """Equality of dataclasses asks NaN whether it is itself, from Python 3.13 on."""
    return repr(one) == repr(other)


def calibrated(**values):
    p = Parameters()
    return dataclasses.replace(p, calibration=dataclasses.replace(p.calibration, **values))


def test_a_silent_configuration_takes_boresight_and_lever_arms_of_the_frames():
    messages, R, lever, antenna = tree()
    found = from_frames(Parameters(), frames_of(messages), SENSORS)
    c = found.parameters.calibration
    angles = c.boresight_roll_rad, c.boresight_pitch_rad, c.boresight_yaw_rad
    assert np.allclose(rotation_xyz(*angles), R) and np.allclose(c.lever_laser_m, lever)
    assert np.allclose(c.lever_antenna_m, antenna)
    assert found.words == (
        "mounting of 'velodyne' on 'imu_link' from /tf_static",
        "place of '/gnss' on 'imu_link' from /tf_static",
    )


def test_what_the_configuration_says_stands_where_the_frames_agree_and_is_refused_where_not():
    messages, R, lever, antenna = tree()
    frames, (roll, pitch, yaw) = frames_of(messages), roll_pitch_yaw(R)
    own = {
        "boresight_roll_rad": roll + 0.005,
        "boresight_pitch_rad": pitch,
        "boresight_yaw_rad": yaw,
        "lever_laser_m": tuple(lever + 0.01),
        "lever_antenna_m": tuple(antenna),
    }
    assert same(from_frames(calibrated(**own), frames, SENSORS).parameters, calibrated(**own))
    with pytest.raises(ConfigurationError, match=r"lever_laser_m is 1\.000, 0\.000, 0\.000 m and "):
        from_frames(calibrated(**own | {"lever_laser_m": (1.0, 0.0, 0.0)}), frames, SENSORS)
    with pytest.raises(ConfigurationError, match=r"lever_antenna_m is .* '/gnss' at "):
        from_frames(calibrated(**own | {"lever_antenna_m": (1.0, 0.0, 0.0)}), frames, SENSORS)
    with pytest.raises(ConfigurationError, match=r"5\.7 deg apart"):
        from_frames(calibrated(**own | {"boresight_roll_rad": roll + 0.1}), frames, SENSORS)
    p = calibrated(lever_laser_m=(1.0, 0.0, 0.0))
    off = dataclasses.replace(p.georeference, mounting_from_tf=False)
    p = dataclasses.replace(p, georeference=off)
    assert same(from_frames(p, frames, SENSORS).parameters, p)


def test_frames_that_do_not_hang_together_say_so_and_change_nothing():
    messages, _, _, _ = tree()
    found = from_frames(Parameters(), frames_of(messages[:2]), SENSORS)
    assert same(found.parameters, Parameters())
    assert found.words == ("no static transforms lead from 'imu_link' to 'velodyne'",)
    circle = [transform("a", "b", np.eye(3), (1, 0, 0)), transform("b", "a", np.eye(3), (1, 0, 0))]
    assert frames_of(circle).pose("a", "c") is None
    bad = transform("a", "b", np.eye(3), (math.nan, 0, 0))
    with pytest.raises(InputError, match="static transform to 'b'"):
        frames_of([bad])


@pytest.mark.parametrize("seed", range(4))
def test_angles_come_back_from_any_rotation(seed):
    rng = np.random.default_rng(seed)
    for R in (exp_so3(rng.normal(0, 2, 3)), rotation_xyz(rng.normal(), math.pi / 2, rng.normal())):
        assert np.allclose(rotation_xyz(*roll_pitch_yaw(R)), R, atol=1e-7)


def mounted_recording(path):
    """The head of a recording, with the static transforms of a rover; the arm of its LiDAR."""
    messages, _, lever, _ = tree()
    types = TYPESTORE.types
    with BagReader(ROOT / "bags" / "leo_cut") as source, BagWriter(path) as bag:
        roles = source.roles()
        bag.write("tf_static", types["tf2_msgs/msg/TFMessage"](messages), source.start_ns)
        for topic in roles.values():
            raw = next(source.raw({topic}))
            message = source.message(raw)
            message.header.frame_id = {v: SENSORS[k] for k, v in roles.items()}[topic]
            bag.write(topic, message, raw.t_ns)
    return lever


def test_strips_are_calibrated_from_the_mounting_they_were_georeferenced_with(
    tmp_path, monkeypatch
):
    from ladar_volume.cli import calibrate_strips

    lever = mounted_recording(tmp_path / "bag")
    monkeypatch.setattr(calibrate_strips, "read_flight", lambda replay, *_: replay.parameters)
    asked = Message(bag=tmp_path / "bag", topic=[], start=0.0, duration=1.0, returns=1000)
    console = Console(file=io.StringIO())
    flown, parameters = calibrate_strips.recorded_flight(asked, Parameters(), console)
    assert same(parameters, flown)
    # what is written to the parameter file counts from this arm, not from none
    assert np.allclose(parameters.calibration.lever_laser_m, lever)


def test_a_recording_with_static_transforms_is_mounted_by_them(tmp_path):
    lever = mounted_recording(tmp_path / "bag")
    with BagReader(tmp_path / "bag") as bag:
        found = mounting_of_recording(bag, bag.roles(), Parameters(), autopilot=False)
    assert np.allclose(found.parameters.calibration.lever_laser_m, lever)
