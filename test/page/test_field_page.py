"""The page in the field: who may see it, what it shows, and that it needs nothing from outside."""

from __future__ import annotations

import contextlib
import json
import re
import socket
import urllib.error
import urllib.request

import pytest

pytest.importorskip("starlette", reason="the extra 'page' is not installed")

from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.page import field_page
from ladar_volume.page.feed import KEPT, Cell, Feed, NodeHealth
from ladar_volume.page.field_page import MOST, PAGE, address_of, serve_page


def lines(t_s, volume=10.0, sigma=0.5):
    return {
        "volume_m3": f"{volume:.4f}",
        "sigma_m3": f"{sigma:.4f}",
        "verdict": "doubtful",
        "doubt_cut": "the pile is cut at 3 m",
        "seen_share": "0.9",
        "data_time_ns": str(int((100 + t_s) * 1e9)),
    }


def get(url, host=None):
    request = urllib.request.Request(url, headers={} if host is None else {"Host": host})
    return urllib.request.urlopen(request, timeout=5)


def test_the_page_and_its_events_come_from_loopback_alone():
    feed = Feed()
    feed.volume(lines(0.0))
    feed.node("filter_node", NodeHealth("warning", "no cloud yet <b>"))
    feed.cells([Cell(1.0, 2.0, 3.0, 0.02, 0.1, True)], 0.5)
    with serve_page(feed, address_of("0", None)) as at:
        assert at.host == "127.0.0.1" and at.port > 0
        page = get(at.url)
        assert "default-src 'none'" in page.headers["Content-Security-Policy"]
        assert page.read().decode() == PAGE.read_text()
        with get(at.url + "events") as stream:
            state = json.loads(stream.readline().decode().removeprefix("data: "))
        with pytest.raises(urllib.error.HTTPError, match="400"):
            get(at.url, host="evil.example")
        with pytest.raises(OutputError, match="cannot be used"):
            with serve_page(feed, at):
                pass
    assert (state["volume_m3"], state["sigma_m3"], state["verdict"]) == (10.0, 0.5, "doubtful")
    assert state["reasons"] == ["the pile is cut at 3 m"]
    assert state["cells"][0]["gap"] and state["nodes"]["filter_node"]["level"] == "warning"


def test_a_browser_that_looks_on_does_not_disturb_the_end(capfd):
    with serve_page(Feed(), address_of("0", None)) as at:
        stream = get(at.url + "events")
        assert stream.readline().startswith(b"data: ")
    assert stream.read() == b"\n"
    assert capfd.readouterr().err == ""


def test_another_address_needs_a_token_and_every_request_brings_it():
    with pytest.raises(ConfigurationError, match="--page-token"):
        address_of("0.0.0.0:8080", None)
    with pytest.raises(ConfigurationError, match="at least"):
        address_of("0.0.0.0:8080", "short")
    at = address_of("127.0.0.1:0", "abcdefgh12345")
    with serve_page(Feed(), at) as at:
        assert get(at.url).status == 200
        for path in ("", "events", "?token=abcdefgh1234x"):
            with pytest.raises(urllib.error.HTTPError, match="403"):
                get(f"http://127.0.0.1:{at.port}/{path}")


def test_strangers_who_hold_connections_are_few_and_not_for_long(monkeypatch):
    monkeypatch.setattr(field_page, "PATIENCE_S", 0.3)
    with serve_page(Feed(), address_of("0", None)) as at:
        held = [socket.create_connection(("127.0.0.1", at.port)) for _ in range(MOST + 8)]
        for one in held:
            one.settimeout(5.0)
            with contextlib.suppress(OSError):
                one.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n")  # and never the end of it
            with contextlib.suppress(ConnectionError):
                assert one.recv(10) == b""
            one.close()
        assert get(at.url).status == 200


def test_no_more_connections_than_the_page_may_have():
    with serve_page(Feed(), address_of("0", None)) as at:
        held = [socket.create_connection(("127.0.0.1", at.port)) for _ in range(MOST)]
        with pytest.raises(OSError, match=r"."):
            get(at.url)
        for one in held:
            one.close()


@pytest.mark.parametrize("text", ["", "x", "host.example:80", "127.0.0.1:99999", "127.0.0.1:-1"])
def test_an_address_that_is_none_is_refused(text):
    with pytest.raises(ConfigurationError, match="--page"):
        address_of(text, None)


def test_the_curve_keeps_first_and_last_and_begins_again_with_the_data():
    feed = Feed()
    for second in range(3 * KEPT):
        feed.volume(lines(second, volume=float(second)))
    curve = json.loads(feed.text())["curve"]
    assert len(curve) <= KEPT + 1
    assert (curve[0]["t_s"], curve[-1]["volume_m3"]) == (0.0, 3 * KEPT - 1.0)
    assert [p["t_s"] for p in curve] == sorted(p["t_s"] for p in curve)
    feed.volume(lines(5.0))
    assert len(json.loads(feed.text())["curve"]) == 1


def test_where_there_is_no_volume_none_is_shown():
    feed = Feed()
    feed.volume(lines(0.0, sigma=float("nan")))
    assert json.loads(feed.text())["sigma_m3"] is None
    feed.volume({"estimate": "no body above the ground"})
    state = json.loads(feed.text())
    assert state["volume_m3"] is None and state["why_none"] == "no body above the ground"


def test_the_page_fetches_nothing_but_its_own_events():
    text = PAGE.read_text()
    assert not re.search(r"https?:|@import|src=", text)
    assert set(re.findall(r'\$\("(\w+)"\)|canvas\("(\w+)"\)', text))
    wanted = {a or b for a, b in re.findall(r'\$\("(\w+)"\)|canvas\("(\w+)"\)', text)}
    assert wanted <= set(re.findall(r'id="(\w+)"', text))
