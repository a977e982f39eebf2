"""Map messages written from arrays read back as the messages they claim to be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
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
