"""The books of the soak: a loss, or a count too many, at any node or in the log is found."""

import itertools

import pytest

from benchmarks.books import in_files, open_log, open_steps
from ladar_volume.io.recorder import Recorder
from ladar_volume.model.parameters import LoggerParameters

GOOD = {
    "georeference_node": {"sent_parts": "90", "sent_points": "9000", "sent_states": "700"},
    "filter_node": {
        "received_points": "88",
        "lost_message_lost_points": "2",
        "count_points": "9000",
        "count_states": "700",
        "count_parts": "40",
    },
    "volume_node": {"received_points": "40", "received_patches": "40", "count_parts": "40"},
}
PLACES = [(node, key) for node, lines in GOOD.items() for key in lines]


def changed(node, key, by):
    lines = {name: dict(values) for name, values in GOOD.items()}
    lines[node][key] = str(int(lines[node][key]) + by)
    return lines


def test_good_books_close():
    assert open_steps(GOOD, frozenset()) == []


@pytest.mark.parametrize(("place", "by"), itertools.product(PLACES, (-1, 1)))
def test_a_loss_or_a_count_too_many_is_found(place, by):
    assert open_steps(changed(*place, by), frozenset())


def test_steps_of_a_node_that_began_again_are_left_out():
    lines = changed("filter_node", "count_points", -50)
    assert open_steps(lines, frozenset({"filter_node"})) == []


def test_what_is_not_in_the_files_is_found(tmp_path):
    base = tmp_path / "log.mcap"
    recorder = Recorder(LoggerParameters(path=str(base), disk_reserve_bytes=0))
    for k in range(30):
        if k % 3:  # a logger that drops every third message, and says nothing
            recorder.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", k)
        if k == 15:
            recorder.split(k)
    recorder.close()
    logged = in_files(base)
    assert logged == {"chat": 20}
    assert open_log({"chat": 30}, logged, {}) == ["chat: 30 sent, 20 in the log, 0 named lost"]
    assert open_log({"chat": 30}, logged, {"chat": 10}) == []
    assert open_log({"chat": 30}, logged, {"chat": 11})  # too many
