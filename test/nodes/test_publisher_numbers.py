"""The log counts what the numbers of a topic's messages lack, where one publisher gives them."""

import pytest

pytest.importorskip("rclpy")

from ladar_volume.nodes.logger_node import TopicSubscription

A, B = b"a", b"b"


def topic(*publishers):
    found = TopicSubscription("std_msgs/msg/String", True, False)
    found.see_publishers(publishers)
    return found


def missing(known, numbers, there=(A,)):
    return [known.missing_before(n, lambda: there) for n in numbers]


def test_what_one_publisher_sent_and_did_not_come_is_missing():
    assert missing(topic(A), [4, 5, 8, 9, 9]) == [0, 0, 2, 0, 0]


def test_numbers_of_several_publishers_mean_nothing_also_when_one_is_left():
    known = topic(A, B)
    assert missing(known, [3, 9]) == [0, 0]
    known.see_publishers([B])
    assert missing(known, [3, 9], (B,)) == [0, 0]


def test_a_second_publisher_is_asked_for_where_numbers_jump():
    assert missing(topic(A), [3, 30, 4, 31], (A, B)) == [0, 0, 0, 0]


def test_a_successor_begins_anew():
    known = topic(A)
    assert missing(known, [3, 4]) == [0, 0]
    known.see_publishers([])
    known.see_publishers([B])
    assert missing(known, [7, 8, 10], (B,)) == [0, 0, 1]
    assert missing(topic(A), [3, 30, 32], (B,)) == [0, 0, 1]  # a successor not seen before
