"""Time that begins again, clocks that differ, and returns with corrupt times."""

import dataclasses

import numpy as np
import pytest

from ladar_volume.georeference.clock_check import Lead, SweepTimes
from ladar_volume.georeference.clock_restart import Restart
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Fix, ImuSample, Returns, concatenate
from ladar_volume.pipeline import Engine

S = 1_000_000_000
T0 = 1_700_000_000 * S


def survey(seconds, start=0.0, lidar_s=0.0):
    """Events (arrival, kind, sample) of a platform over a plane; a cloud arrives when its turn is
    complete.
    """
    rng = np.random.default_rng(3)
    events = []
    for k in range(round(seconds * 10) + 6):
        t = T0 + round((start + k * 0.1) * S)
        events.append((t, "fix", Fix(t, 50.0, 14.0 + 1e-6 * k, 20.0, np.eye(3) * 1e-4)))
    for k in range(round(seconds * 50) + 26):
        t = T0 + round((start + k * 0.02) * S)
        events.append(
            (t, "imu", ImuSample(t, np.array([0.0, 0, 0, 1]), np.zeros(3), np.eye(3) * 1e-6))
        )
    for k in range(round(seconds * 10)):
        t = T0 + round((start + k * 0.1) * S) + np.arange(60) * 1_600_000 - round(lidar_s * S)
        r = np.column_stack([rng.uniform(-4, 4, (60, 2)), np.full(60, -20.0)])
        events.append(
            (
                int(t[-1]) + round(lidar_s * S) + 3_000_000,
                "cloud",
                Returns(t, r, rng.integers(0, 16, 60).astype(np.uint16), np.ones(60, np.float32)),
            )
        )
    return [e[1:] for e in sorted(events, key=lambda e: e[0])]


def feed(stage, events):
    take = {"fix": stage.add_fix, "imu": stage.add_imu, "cloud": stage.add_returns}
    for kind, sample in events:
        take[kind](sample)


def parameters(**calibration):
    return Parameters.read(
        {
            "georeference": {
                "datum_latitude_deg": 50.0,
                "datum_longitude_deg": 14.0,
                "datum_height_m": 0.0,
            },
            "calibration": calibration,
            "filter": {"radius_m": 2.0},
        }
    )


def same(a, b):
    return all(
        np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
    )


def test_a_looping_recording_begins_anew_and_the_second_pass_equals_the_first():
    events = survey(6.0)
    once, looped = Georeferencer(parameters()), Georeferencer(parameters())
    feed(once, events)
    feed(looped, events)
    first = concatenate(looped.take_points())
    feed(looped, events)
    assert (
        looped.restarts == 1 and not looped.losses.total("fix") and not looped.losses.total("imu")
    )
    assert same(first, concatenate(once.take_points())) and same(
        first, concatenate(looped.take_points())
    )
    assert same(looped.take_platform(), once.take_platform())


def test_the_volume_stages_begin_anew_with_it():
    events = survey(5.0)
    once, looped = Engine(parameters()), Engine(parameters())
    for engine, passes in ((once, 1), (looped, 3)):
        for kind, sample in events * passes:
            feed(engine, [(kind, sample)])
            engine.step()
    assert looped.georeferencer.restarts == 2
    assert looped.filter.stats == once.filter.stats and looped.points_mapped == once.points_mapped
    assert same(looped.filter.update().points, once.filter.update().points)


def test_stragglers_of_the_pass_before_are_dropped_by_name():
    events = survey(6.0)
    stage = Georeferencer(parameters())
    late = [e for e in events if e[0] == "cloud"][-1]
    feed(stage, [e for e in events if e is not late])
    stage.take_points()
    begun = [e for e in events if e[0] != "cloud"][:40]
    feed(stage, [*begun[:30], late, *begun[30:]])
    assert stage.restarts == 1 and stage.losses.as_dict()["point_before_restart"] == 60


def test_one_topic_whose_clock_is_set_back_restarts_nothing_and_is_counted():
    stage = Georeferencer(parameters())
    events = survey(12.0)
    step = T0 + 6 * S
    shifted = [
        (k, dataclasses.replace(s, t_ns=s.t_ns - 5 * S) if k == "fix" and s.t_ns >= step else s)
        for k, s in events
    ]
    feed(stage, shifted)
    stage.finish()
    lost = stage.losses.as_dict()
    assert stage.restarts == 0
    # every fix that claims to be older than the last one before the step, and the one that repeats
    # its time
    assert lost["fix_time_backwards"] + lost["fix_duplicate"] == 50
    assert stage.fix_lead.state == "offset" and stage.fix_lead.estimate_s[0] == pytest.approx(
        5.0, abs=0.02
    )
    assert stage.cloud_lead.state == "good"


def test_late_messages_are_no_restart():
    events = survey(6.0)
    fixes = [i for i, (k, _) in enumerate(events) if k == "fix"]
    cut = events[fixes[30]]
    late = [e for i, e in enumerate(events) if i not in fixes[10:13]]
    at = late.index(cut)
    stage = Georeferencer(parameters())
    feed(stage, late[:at] + [events[i] for i in fixes[10:13]] + late[at:])
    stage.finish()
    assert stage.restarts == 0 and stage.losses.as_dict()["fix_time_backwards"] == 3


def test_a_corrupt_stamp_ahead_makes_no_later_sample_look_old():
    door = Restart()
    for topic in ("fix", "imu"):
        door.push(topic, T0, topic)
        door.push(topic, T0 + 3600 * S, topic)
    for k in range(1, 5):
        for topic in ("fix", "imu"):
            again, samples, dropped = door.push(topic, T0 + k * S, k)
            assert not again and samples == [(topic, k)] and not dropped
    assert door.finish() == []


def test_an_earlier_corrupt_stamp_does_not_confirm_a_later_one():
    door = Restart()
    for t_ns in (0, 3600 * S, 1800 * S):
        door.push("fix", T0 + t_ns, t_ns)
    for k in range(1, 5):
        assert door.push("fix", T0 + k * S, k) == (False, [("fix", k)], [])


def test_held_samples_come_out_in_the_order_of_arrival():
    door = Restart()
    for topic in "ab":
        door.push(topic, T0 + 100 * S, None)
    assert door.push("a", T0, 1) == (False, [], []) and door.push("b", T0 + 1, 2) == (False, [], [])
    assert door.push("a", T0 + S, 3) == (False, [], [])
    assert door.push("b", T0 + S, 4) == (True, [("a", 1), ("b", 2), ("a", 3), ("b", 4)], [])
    assert door.push("a", T0 + 2 * S, 5) == (False, [("a", 5)], [])


@pytest.mark.parametrize("offset", [-0.5, -0.1, 0.0, 0.1, 0.5, 3600.0, 1.7e9])
def test_a_constant_offset_of_the_lidar_clock_is_estimated(offset):
    stage = Georeferencer(parameters())
    feed(stage, survey(5.0, lidar_s=offset))
    lead, sigma = stage.cloud_lead.estimate_s
    # arrival 3 ms after the last return, attitudes every 20 ms
    assert lead == pytest.approx(offset, abs=0.011) and sigma < 0.02
    assert stage.cloud_lead.state == ("good" if offset == 0 else "offset")
    assert stage.fix_lead.state == "good"


def test_a_declared_offset_is_taken_off():
    stage = Georeferencer(parameters(clock_offset_s=0.5))
    feed(stage, survey(5.0, lidar_s=0.5))
    assert stage.cloud_lead.state == "good" and stage.cloud_lead.estimate_s[0] == pytest.approx(
        0.0, abs=0.011
    )


def test_stamps_that_scatter_are_named_and_too_few_are_no_verdict():
    lead, rng = Lead(), np.random.default_rng(1)
    for k in range(9):
        lead.reference(T0 + k * S // 10)
        lead.add_reference_clock(T0 + k * S // 10)
    assert lead.estimate_s is None and lead.state == "unknown"
    for k in range(9, 60):
        lead.reference(T0 + k * S // 10)
        lead.add_reference_clock(T0 + k * S // 10 + round(rng.normal(0, 0.3) * S))
    assert lead.state == "unsteady"


def test_returns_with_corrupt_times_cost_neither_their_cloud_nor_the_others():
    stage = Georeferencer(parameters())
    events = survey(4.0)
    index = [i for i, (k, _) in enumerate(events) if k == "cloud"]
    for i in index[::5]:
        t = events[i][1].t_ns.copy()
        t[[3, 40]] = [T0 * 3, 0]
        events[i] = ("cloud", dataclasses.replace(events[i][1], t_ns=t))
    feed(stage, events)
    stage.finish()
    assert stage.losses.as_dict() == {"point_time": 2 * len(index[::5])}
    assert sum(len(p) for p in stage.take_points()) == 60 * len(index) - 2 * len(index[::5])


def test_overlapping_sweeps_are_counted():
    sweeps = SweepTimes()
    for first, last in ((0, 100), (100, 200), (150, 250), (250, 350)):
        sweeps.add(first * 1_000_000, last * 1_000_000)
    assert sweeps.overlapping == 1
    assert sweeps.corrupt(np.array([0, 5 * S, 6 * S])).tolist() == [True, False, False]
    assert sweeps.corrupt(np.zeros(0, np.int64)) is None
