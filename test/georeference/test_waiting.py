"""Returns that wait for poses are bounded, and what is lost is counted."""

import numpy as np
import pytest

from ladar_volume.georeference import georeferencer
from ladar_volume.model.parameters import GeoreferenceParameters, Parameters
from ladar_volume.model.records import OdometrySample, Returns


def test_a_clock_that_stands_still_fills_no_memory(monkeypatch):
    monkeypatch.setattr(georeferencer, "MOST_WAITING", 1000)
    stage = georeferencer.Georeferencer(Parameters())
    t = np.full(100, 10**12, np.int64)
    r = np.tile([5.0, 1.0, 0.0], (100, 1))
    for _ in range(50):
        stage.add_returns(Returns(t, r, np.zeros(100, np.uint16), np.full(100, 9.0, np.float32)))
    assert stage.pending <= 1000
    stage.finish()
    assert sum(stage.losses.as_dict().values()) == 5000
    assert stage.losses.as_dict()["point_waiting_full"] > 0


def pose(stage, t_ns):
    stage.add_odometry(
        OdometrySample(
            t_ns,
            np.array([1.0, 2.0, 3.0]),
            np.array([0.0, 0.0, 0.0, 1.0]),
            np.zeros(3),
            np.zeros(3),
            1e-4 * np.eye(6),
        )
    )


def standing(t_ns):
    r = np.tile([5.0, 1.0, 0.0], (100, 1))
    t = np.full(100, t_ns, np.int64)
    return Returns(t, r, np.zeros(100, np.uint16), np.full(100, 9.0, np.float32))


def test_what_poses_never_reach_expires_by_their_clock():
    given = GeoreferenceParameters(pose_source="odometry", max_pending_s=2.0)
    stage = georeferencer.Georeferencer(Parameters(georeference=given))
    S = 10**9
    stage.add_returns(standing(900 * S))  # ahead of all poses, and it stands still
    for k in range(300):
        pose(stage, 100 * S + k * S // 20)
        stage.add_returns(standing(900 * S))
    assert 0 < stage.pending <= 100 * 20 * 5
    lost = stage.losses.as_dict()
    assert lost["point_pose_timeout"] + stage.pending == 30_100
    stage.finish()
    assert sum(stage.losses.as_dict().values()) == 30_100


def test_one_large_cloud_is_mapped_where_poses_are_there(monkeypatch):
    monkeypatch.setattr(georeferencer, "MOST_WAITING", 50)
    given = GeoreferenceParameters(pose_source="odometry")
    stage = georeferencer.Georeferencer(Parameters(georeference=given))
    S = 10**9
    for k in range(40):
        pose(stage, 100 * S + k * S // 20)
    stage.add_returns(standing(101 * S))
    stage.finish()
    mapped = sum(len(p) for p in stage.take_points())
    assert mapped == 100 and not stage.losses.as_dict().get("point_waiting_full")


def test_many_small_clouds_are_bounded_as_well(monkeypatch):
    monkeypatch.setattr(georeferencer, "MOST_CLOUDS", 7)
    stage = georeferencer.Georeferencer(Parameters())
    for _ in range(20):
        stage.add_returns(standing(10**12))
    assert stage.pending == 700
    assert stage.losses.as_dict() == {"point_waiting_full": 1300}


@pytest.mark.parametrize(
    ("gaps_s", "jump_s"), [((0.6, 0.15), 10), ((8.0, 0.15), 16), ((0.6, 8.0), 16)]
)
def test_a_step_of_time_is_a_jump_beyond_both_gaps_twice_and_ten_seconds(gaps_s, jump_s):
    S = 10**9
    given = GeoreferenceParameters(
        pose_source="odometry", max_position_gap_s=gaps_s[0], max_attitude_gap_s=gaps_s[1]
    )
    for more_ns, refused in ((0, 1), (1, 2)):
        stage = georeferencer.Georeferencer(Parameters(georeference=given))
        for t_ns in (S, (1 + jump_s) * S + more_ns, 1000 * S):  # nothing confirms the last
            pose(stage, t_ns)
        stage.finish()
        assert stage.losses.as_dict()["odometry_time_jump"] == refused
