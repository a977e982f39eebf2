"""Rotations against closed forms and an independent library; records, losses and the exception
tree.
"""

import inspect
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from ladar_volume.math.se3 import (
    euler_rate_matrix,
    exp_so3,
    matrix_from_quaternion,
    multiply_quaternions,
    quaternion_from_matrix,
    rotation_xyz,
    skew,
    slerp,
)
from ladar_volume.model import errors
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import concatenate, select

angles = st.floats(-np.pi, np.pi)
vectors = arrays(np.float64, 3, elements=st.floats(-3, 3))


@given(vectors, vectors)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-12)


@given(angles, angles, angles)
def test_rotation_and_quaternion_agree_with_scipy(roll, pitch, yaw):
    R = rotation_xyz(roll, pitch, yaw)
    np.testing.assert_allclose(
        R, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-14
    )
    np.testing.assert_allclose(matrix_from_quaternion(quaternion_from_matrix(R)), R, atol=1e-14)


@given(vectors)
def test_exponential_agrees_with_scipy(v):
    np.testing.assert_allclose(exp_so3(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-13)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-5, 0.99e-4, 1.01e-4, 1e-3])
def test_exponential_of_small_vectors(size):
    v = size * np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(exp_so3(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-16)


def test_quaternion_product_and_slerp_agree_with_scipy():
    a, b = map(Rotation.from_quat, np.random.default_rng(1).normal(size=(2, 4)))
    q = multiply_quaternions(a.as_quat(), b.as_quat())
    np.testing.assert_allclose(matrix_from_quaternion(q), (a * b).as_matrix(), atol=1e-14)
    fractions = np.linspace(0, 1, 7)
    path = Slerp([0, 1], Rotation.concatenate([a, b]))(fractions)
    mine = slerp(np.tile(a.as_quat(), (7, 1)), np.tile(-b.as_quat(), (7, 1)), fractions)
    np.testing.assert_allclose(matrix_from_quaternion(mine), path.as_matrix(), atol=1e-12)


def test_slerp_between_nearly_equal_attitudes_is_linear_in_angle():
    q = slerp(np.array([0, 0, 0, 1.0]), np.array([0, 0, 1e-6, 1.0]), np.array(0.25))
    assert q[2] == pytest.approx(0.25e-6, rel=1e-9)


def test_euler_rates_map_to_the_body_rotation_vector():
    roll, pitch, yaw, h = 0.3, -0.7, 2.0, 1e-6
    R = rotation_xyz(roll, pitch, yaw)
    for i, step in enumerate(np.eye(3) * h):
        plus, minus = (rotation_xyz(*(np.array([roll, pitch, yaw]) + s * step)) for s in (1, -1))
        d = R.T @ (plus - minus) / (2 * h)
        np.testing.assert_allclose(
            [d[2, 1], d[0, 2], d[1, 0]], euler_rate_matrix(roll, pitch)[:, i], atol=1e-9
        )


@dataclass(frozen=True)
class Row:
    a: np.ndarray
    b: np.ndarray
    name: str = "kept"


def test_records_are_cut_and_joined_whole():
    record = Row(np.arange(4), np.arange(8.0).reshape(4, 2))
    cut = select(record, record.a % 2 == 1)
    assert cut.a.tolist() == [1, 3] and cut.b.tolist() == [[2, 3], [6, 7]] and cut.name == "kept"
    assert concatenate([cut, record]).a.tolist() == [1, 3, 0, 1, 2, 3]


def test_losses_add_up_and_leave_no_trace_of_nothing():
    losses = Losses()
    losses.add("point_nan", 3)
    losses.add("point_range", 0)
    other = Losses({"point_nan": 2, "cloud_empty": 1})
    losses.merge(other)
    assert losses.as_dict() == {"cloud_empty": 1, "point_nan": 5}
    assert losses.total("point_") == 5 and losses["absent"] == 0
    with pytest.raises(ValueError, match="negative"):
        losses.add("point_nan", -1)


def test_one_root_one_base_per_room_and_the_value_is_kept():
    tree = [c for _, c in inspect.getmembers(errors, inspect.isclass) if issubclass(c, Exception)]
    assert all(issubclass(c, errors.LadarVolumeError) for c in tree)
    assert len({c.reason for c in tree}) == len(tree)
    assert errors.CloudError("short", reason="cloud_short", value=7).value == 7
