"""Passes of a looping recording seen from its outputs, and the health of a node; without ROS."""

from ladar_volume.nodes.stream_passes import StreamPasses
from ladar_volume.nodes.watch.health import Health
from ladar_volume.nodes.watch.loss_shares import LossShares

S = 1_000_000_000


def test_a_leader_that_goes_back_begins_a_new_pass_and_the_rest_of_the_old_one_is_dropped():
    p = StreamPasses("platform")
    for k in range(10):
        assert p.take("platform", k * S) == "same" and p.take("points", k * S) == "same"
    assert p.take("platform", 0) == "new" and p.begun == 1
    assert p.take("points", 9 * S) == "old"
    assert (
        p.take("points", 0) == "same"
        and p.take("points", S) == "same"
        and p.take("platform", S) == "same"
    )
    assert p.begun == 1


def test_a_follower_that_goes_back_waits_for_the_leaders():
    p = StreamPasses("platform")
    for k in range(10):
        p.take("platform", k * S)
        p.take("points", k * S)
    assert p.take("points", 5 * S) == "wait" and p.begun == 0
    assert p.take("platform", 10 * S) == "same"  # it was a late cloud
    assert p.take("points", 0) == "wait"
    assert p.take("platform", 0) == "new"  # it was the next pass


def test_health_counts_rates_delays_and_whether_the_worker_keeps_up():
    h = Health()
    h.expect("cloud", 2.0)
    assert h.silent(0.0) == (["no cloud yet"], [])
    h.record_arrival("cloud", 0.0, 100 * S)
    h.record_work("cloud", 0.05, 100 * S)
    h.lines(0.0, 100 * S)
    for k in range(1, 11):
        h.record_arrival("cloud", 0.1 * k, 100 * S + k * S // 10)
        h.record_work("cloud", 0.02, 100 * S + k * S // 10)
    lines = h.lines(1.0, 101 * S + S // 4)
    assert (
        lines["rate_cloud_hz"] == "10.0"
        and lines["delay_cloud_s"] == "0.250"
        and lines["received_cloud"] == 11
    )
    assert (
        lines["load"] == "0.200" and lines["real_time_factor"] == "5.0"
    )  # a second of data in 0.2 s of work
    assert h.silent(1.5) == ([], []) and h.silent(3.5) == (["no cloud for 2.5 s"], [])
    assert h.lines(2.0, 102 * S)["real_time_factor"] == "-"


def test_only_new_losses_that_are_no_routine_are_named():
    h = Health()
    assert h.newly_lost({"fix_nan": 2, "point_region": 500, "cloud_short": 7}) == [
        "lost 7 cloud_short",
        "lost 2 fix_nan",
    ]
    assert h.newly_lost({"fix_nan": 2, "point_region": 900, "cloud_short": 7}) == []
    assert h.newly_lost({"fix_nan": 3, "point_region": 900, "cloud_short": 7}) == ["lost 1 fix_nan"]


def test_an_input_that_is_missing_while_another_comes_is_an_error():
    h = Health()
    h.expect("cloud", 2.0)
    h.expect("fix", 2.0)
    for k in range(40):
        h.record_arrival("cloud", 0.1 * k)
    assert h.silent(2.0)[0] == ["no fix yet"]
    assert h.silent(4.0) == ([], ["no fix yet"])


def test_a_share_lost_for_one_reason_is_judged_by_what_came_lately():
    s = LossShares()
    assert s.judge({"point_ring": 750}, {"point": 1000}, 1.0)[1] == [
        "75 % of returns lost as point_ring: set georeference.beams to the number of rings of the "
        "scanner"
    ]
    s = LossShares()
    assert s.judge({"point_region": 900, "fix_nan": 1}, {"point": 1000, "fix": 10}, 1.0) == (
        ["10 % of fixes lost as fix_nan"],
        [],
    )
    for second in range(2, 9):  # nothing more is lost: after a while nothing is said
        found = s.judge({"fix_nan": 1}, {"fix": 10 * second}, float(second))
    assert found == ([], [])
