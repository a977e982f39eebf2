"""Poses of the platform as messages and back: covariances about the axes of either frame."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.model.records import PlatformStates
from ladar_volume.nodes.convert import platform_messages, platform_state


def states():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 6, 6)) * 0.01
    C = root @ root.transpose(0, 2, 1)
    q = Rotation.random(4, random_state=3).as_quat()
    t = 10**9 * np.arange(1, 5)
    p, v, w = rng.normal(size=(3, 4, 3))
    return PlatformStates(t, p, q, v, w, C, np.array([5, 5, 6, 6]))


def test_what_turns_the_body_about_its_own_axis_turns_it_about_that_axis_in_the_map():
    given = states()
    for i, message in enumerate(platform_messages(given, 5, ("map", "base_link"))):
        C = np.asarray(message.pose.covariance).reshape(6, 6)
        turn = Rotation.from_quat(given.q_map_body[i])
        for axis in np.eye(3):
            there = turn.apply(axis)
            own = given.C_nav[i]
            assert there @ C[3:, 3:] @ there == pytest.approx(axis @ own[3:, 3:] @ axis)
            assert C[:3, 3:] @ there == pytest.approx(own[:3, 3:] @ axis)
        np.testing.assert_allclose(C[:3, :3], given.C_nav[i][:3, :3])


def test_messages_give_the_states_back():
    given = states()
    messages = platform_messages(given, 5, ("map", "base_link"))
    found, last = platform_state(messages, 5)
    for name in ("t_ns", "p_map_body", "q_map_body", "v_body", "omega_body", "C_nav", "segment"):
        np.testing.assert_allclose(getattr(found, name), getattr(given, name), atol=1e-15)
    assert last == 6 and np.isnan(found.fix_gap_s).all()
    begins = [m.twist.covariance[0] for m in messages]
    assert begins == [0.0, 0.0, -1.0, 0.0]


def test_the_time_between_fixes_goes_along():
    given = dataclasses.replace(states(), fix_gap_s=np.array([0.1, 0.1, 0.3, 0.1 + 1e-9]))
    found, _ = platform_state(platform_messages(given, 5, ("map", "base_link")), 5)
    np.testing.assert_array_equal(found.fix_gap_s, given.fix_gap_s)
