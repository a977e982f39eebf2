"""Map messages written from arrays read back as the messages they claim to be."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from volume_surfaces import cone, platform, surface_update

from ladar_volume.io import cdr
from ladar_volume.model.parameters import Parameters
from ladar_volume.volume.estimator import VolumeEstimator

TYPES = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope="module")
def estimate():
    stage = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}}))
    stage.add_platform(platform())
    stage.add(surface_update(cone))
    return stage.estimate()


def test_marker(estimate):
    kind, tin = "visualization_msgs/msg/Marker", estimate.tin
    value = np.hypot(*tin.vertices[:, :2].T)
    data = cdr.tin_marker(estimate, value, "map")
    marker = TYPES.deserialize_cdr(data, kind)
    corners = tin.vertices[tin.triangles[tin.relevant].ravel()]
    assert (
        marker.type == 11
        and marker.action == 0
        and marker.ns == "tin"
        and marker.header.frame_id == "map"
    )
    assert marker.header.stamp.sec * 10**9 + marker.header.stamp.nanosec == estimate.volume.t_ns
    assert np.array_equal([[p.x, p.y, p.z] for p in marker.points], corners)
    assert (
        len(marker.colors) == len(corners)
        and marker.pose.orientation.w == 1.0
        and marker.scale.z == 1.0
    )
    red = np.array([c.r for c in marker.colors])
    assert (
        np.diff(red[np.argsort(value[tin.triangles[tin.relevant].ravel()], kind="stable")]) >= 0
    ).all() and all(c.a == 1.0 for c in marker.colors)
    assert marker.text == marker.mesh_file.filename == marker.texture.format == ""
    assert bytes(TYPES.serialize_cdr(marker, kind)) == data


def test_a_large_surface_is_shown_coarser(estimate, monkeypatch):
    tin = estimate.tin
    every = cdr.shown_triangles(tin)
    assert np.array_equal(every, tin.triangles[tin.relevant])
    monkeypatch.setattr(cdr, "MOST_SHOWN", len(every) // 6)
    fewer = cdr.shown_triangles(tin)
    assert len(every) // 12 < len(fewer) < len(every) // 5
    a, b, c = (tin.vertices[fewer[:, k], :2] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    span = np.ptp(tin.vertices[:, :2], axis=0)
    assert (area >= -1e-9).mean() > 0.95 and area.sum() == pytest.approx(
        float(np.prod(span)), rel=0.25
    )  # but for the rim, all is covered


def test_mesh(estimate):
    kind = "shape_msgs/msg/Mesh"
    data = cdr.mesh(estimate)
    mesh = TYPES.deserialize_cdr(data, kind)
    assert np.array_equal(
        [t.vertex_indices for t in mesh.triangles], estimate.tin.triangles[estimate.tin.relevant]
    )
    assert np.array_equal([[p.x, p.y, p.z] for p in mesh.vertices], estimate.tin.vertices)
    assert bytes(TYPES.serialize_cdr(mesh, kind)) == data


def test_members_align_to_their_own_size():
    w = cdr.Writer()
    w.numbers("B", 1)
    w.numbers("d", math.pi)
    w.text("abc")
    w.numbers("I", 7)
    assert (
        w.bytes()[4:]
        == b"\x01"
        + bytes(7)
        + np.float64(math.pi).tobytes()
        + b"\x04\x00\x00\x00abc\x00\x07\x00\x00\x00"
    )


def base_pose(estimate, beta, C=None):
    """Height, rotation and covariance of the message of a plane with these parameters."""
    C = np.eye(3) if C is None else C
    base = dataclasses.replace(estimate.base, beta=np.asarray(beta), C_beta=C)
    data = cdr.ground_plane(dataclasses.replace(estimate, base=base), "map")
    pose = TYPES.deserialize_cdr(data, "geometry_msgs/msg/PoseWithCovarianceStamped").pose
    q = pose.pose.orientation
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    return pose.pose.position.z, turn, np.asarray(pose.covariance).reshape(6, 6)


def test_the_pose_of_a_base_lies_in_it(estimate):
    for beta in ([1.0, 0.0, 0.0], [1.0, 0.2, -0.3], [-2.0, -0.4, 0.1]):
        height, turn, _ = base_pose(estimate, beta)
        x, y, z = turn.as_matrix().T
        for axis in (x, y):
            assert axis[2] == pytest.approx(beta[1] * axis[0] + beta[2] * axis[1])
        assert z[2] > 0.0 and x[1] == pytest.approx(0.0) and height == beta[0]


def test_the_covariance_of_a_base_is_of_its_height_and_its_tilts(estimate):
    """By small changes of each parameter of a level base."""
    root, h = np.array([[0.02, 0.0, 0.0], [0.01, 0.003, 0.0], [-0.004, 0.001, 0.002]]), 1e-6
    C = root @ root.T
    _, level, found = base_pose(estimate, [3.0, 0.0, 0.0], C)
    J = np.zeros((6, 3))
    for k in range(3):
        height, turn, _ = base_pose(estimate, np.array([3.0, 0.0, 0.0]) + h * np.eye(3)[k])
        J[2, k] = (height - 3.0) / h
        J[3:, k] = (turn * level.inv()).as_rotvec() / h
    np.testing.assert_allclose(found, J @ C @ J.T, atol=1e-9)
