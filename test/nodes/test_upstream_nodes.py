"""What volume_node knows of the nodes before it, from their reports."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ladar_volume.nodes.watch.upstream_nodes import UpstreamNodes


def reported(**lines):
    """The nodes by name, with the lines of each one's last status."""
    nodes = UpstreamNodes("/rover", ("georeference_node", "filter_node"))
    for name, values in lines.items():
        pairs = [KeyValue(key=k, value=str(v)) for k, v in values.items()]
        for space in ("rover", "other"):
            status = DiagnosticStatus(name=f"{space}/{name}", values=pairs)
            nodes.take(DiagnosticArray(status=[status]))
            pairs = []
    return nodes


@pytest.mark.parametrize(
    ("sent", "taken", "words"), [(90, 90, ""), (90, 95, ""), (90, 30, "30 of 90")]
)
def test_what_the_filter_did_not_take_is_named(sent, taken, words):
    nodes = reported(georeference_node={"sent_points": sent}, filter_node={"count_points": taken})
    text = nodes.untaken_text()
    assert words in text and bool(text) == bool(words)


def test_what_found_no_room_is_named():
    lost = {"lost_message_queue_full_cloud": 3, "lost_message_queue_full_fix": 2, "lost_fix_nan": 9}
    text = reported(
        georeference_node=lost, filter_node={"lost_message_lost_points": 1}
    ).untaken_text()
    assert text == "georeference_node lost 5 messages for which it had no room"


def test_a_node_that_ended_before_its_work_was_done_is_named():
    nodes = reported(georeference_node={"finished": 1}, filter_node={"finished": 0, "sent_ns": 77})
    assert nodes.untaken_text() == "filter_node ended before its work was done"
    assert nodes.sent_ns() == 77 and reported().sent_ns() == 0
    assert reported(filter_node={"finished": 1}).untaken_text() == ""


def test_a_georeference_node_that_was_started_again_is_named():
    nodes = UpstreamNodes("/", ("georeference_node", "filter_node"))
    for sent in (10, 40, 40, None, 0, 5):
        pairs = [] if sent is None else [KeyValue(key="sent_points", value=str(sent))]
        status = DiagnosticStatus(name="georeference_node", values=pairs)
        nodes.take(DiagnosticArray(status=[status]))
        assert bool(nodes.untaken_text()) == (sent in (0, 5))
    (doubt,) = nodes.verdict().doubts
    assert doubt.name == "georeference_restarted" and "started again" in doubt.text


def test_nodes_that_say_nothing_are_no_finding():
    assert reported().untaken_text() == ""
    assert reported(georeference_node={"sent_points": 5}).untaken_text() == ""


def ended(age="0.05", finished=1):
    return {"finished": finished, "age_cloud_s": age, "sent_points": 5}


def test_a_georeference_node_that_ends_alone_while_clouds_come_is_named():
    nodes = reported(georeference_node=ended())
    for now in (10.0, 14.9):
        nodes.watch(now, others_end=False)
        assert nodes.untaken_text() == "" and nodes.verdict().sound
    nodes.watch(41.0, others_end=False)
    assert "ended 31 s before the others" in nodes.untaken_text()
    (doubt,) = nodes.verdict().doubts
    assert doubt.name == "georeference_ended" and doubt.value == 31.0
    nodes.watch(90.0, others_end=True)  # their own end takes as long as it takes
    assert "ended 31 s before" in nodes.untaken_text()


@pytest.mark.parametrize(
    ("lines", "others_end"),
    [
        (ended(age="8.20"), False),
        (ended(finished=0), False),
        (ended(), True),
        (ended(age=""), False),
    ],
)
def test_an_end_after_the_data_or_with_the_others_is_in_order(lines, others_end):
    nodes = reported(georeference_node=lines)
    for now in (10.0, 60.0):
        nodes.watch(now, others_end)
    assert "before the others" not in nodes.untaken_text() and nodes.verdict().sound
