"""A sender waits for its listener, but for no listener for ever."""

import threading
import time

from ladar_volume.nodes import flow_control
from ladar_volume.nodes.flow_control import MAX_IN_FLIGHT_BYTES, UnacknowledgedBytes


def test_what_was_taken_makes_room():
    one = UnacknowledgedBytes()
    for t_ns in (10, 20, 30):
        assert one.may_send()
        one.record_sent(t_ns, MAX_IN_FLIGHT_BYTES // 2 - 1)
    assert one.may_send() is False and one.bytes == 3 * (MAX_IN_FLIGHT_BYTES // 2 - 1)
    one.acknowledge(9)
    assert not one.may_send()
    one.acknowledge(25)  # the first two
    assert one.may_send() and one.bytes == MAX_IN_FLIGHT_BYTES // 2 - 1
    one.record_sent(40, 2 * MAX_IN_FLIGHT_BYTES)
    one.forget()
    assert one.may_send() and one.bytes == 0


def test_waiting_ends_with_the_news():
    one, went = UnacknowledgedBytes(), threading.Event()
    one.record_sent(1, MAX_IN_FLIGHT_BYTES + 1)

    def wait():
        assert one.may_send(wait=True)
        went.set()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    assert not went.wait(0.1)
    one.acknowledge(1)
    assert went.wait(10.0) and one.bytes == 0
    thread.join()


def test_without_news_one_at_a_time_goes_on(monkeypatch):
    monkeypatch.setattr(flow_control, "ACKNOWLEDGEMENT_TIMEOUT_S", 0.2)
    one, began = UnacknowledgedBytes(), time.monotonic()
    one.record_sent(1, MAX_IN_FLIGHT_BYTES + 1)
    went = threading.Event()
    waiting = threading.Thread(target=lambda: one.may_send(wait=True) and went.set(), daemon=True)
    waiting.start()
    assert went.wait(10.0) and time.monotonic() - began >= 0.15
    assert one.may_send() is False  # the next one waits as long again


def test_a_sender_that_ends_learns_whether_all_was_taken():
    one = UnacknowledgedBytes()
    assert one.all_taken(0.0)
    one.record_sent(1, 10)
    one.record_sent(2, 10)
    one.acknowledge(1)
    assert not one.all_taken(0.01)
    later = threading.Timer(0.05, one.acknowledge, (2,))
    later.start()
    assert one.all_taken(10.0)
    later.join()
