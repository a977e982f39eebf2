"""A sender waits for its listener, but for no listener for ever."""

import threading
import time

from ladar_volume.nodes import flow_control
from ladar_volume.nodes.flow_control import AHEAD_BYTES, Ahead


def test_what_was_taken_makes_room():
    one = Ahead()
    for t_ns in (10, 20, 30):
        assert one.may_send()
        one.sent(t_ns, AHEAD_BYTES // 2 - 1)
    assert one.may_send() is False and one.bytes == 3 * (AHEAD_BYTES // 2 - 1)
    one.taken(9)
    assert not one.may_send()
    one.taken(25)  # the first two
    assert one.may_send() and one.bytes == AHEAD_BYTES // 2 - 1
    one.sent(40, 2 * AHEAD_BYTES)
    one.forget()
    assert one.may_send() and one.bytes == 0


def test_waiting_ends_with_the_news():
    one, went = Ahead(), threading.Event()
    one.sent(1, AHEAD_BYTES + 1)

    def wait():
        assert one.may_send(wait=True)
        went.set()

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    assert not went.wait(0.1)
    one.taken(1)
    assert went.wait(10.0) and one.bytes == 0
    thread.join()


def test_without_news_one_at_a_time_goes_on(monkeypatch):
    monkeypatch.setattr(flow_control, "NEWS_S", 0.2)
    one, began = Ahead(), time.monotonic()
    one.sent(1, AHEAD_BYTES + 1)
    assert one.may_send(wait=True) and time.monotonic() - began >= 0.15
    assert one.may_send() is False  # the next one waits as long again
