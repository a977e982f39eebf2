"""The topics of the nodes for Foxglove, live over a WebSocket: the messages as they are, nothing
from the internet.

It listens on loopback unless another address is given. Nothing that a client sends changes
anything: it may look, no more. The protocol has no token, so whoever reaches the address may look.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator

import foxglove
from foxglove import websocket

from ladar_volume.io.mcap_log import usual_definition
from ladar_volume.model.errors import OutputError
from ladar_volume.page.place import Place

#: Most messages that wait for a slow client; then it misses the oldest.
BACKLOG = 32
#: How often a stream of points is handed on, s.
EVERY_S = 1.0


class LiveTopics(websocket.ServerListener):
    """What was published last, and what is handed on. Any thread may write."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        self._lock = threading.Lock()
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, tuple[bytes, int]] = {}
        self._sent: dict[str, float] = {}

    def write(self, topic: str, kind: str, data: bytes, t_ns: int) -> None:
        """Hand on a message, CDR, of a type such as ``std_msgs/msg/Float64``."""
        self._channel(topic, kind).log(data, log_time=t_ns)

    def keep(self, topic: str, kind: str, data: bytes, t_ns: int) -> None:
        """The same, and again for whoever comes later."""
        with self._lock:
            self._last[topic] = data, t_ns
        self.write(topic, kind, data, t_ns)

    def thin(self, topic: str, kind: str, data: bytes, t_ns: int) -> None:
        """The same, but not more often than once in :data:`EVERY_S`."""
        now = time.monotonic()
        if now - self._sent.get(topic, -EVERY_S) >= EVERY_S:
            self._sent[topic] = now
            self.write(topic, kind, data, t_ns)

    def _channel(self, topic: str, kind: str) -> foxglove.Channel:
        with self._lock:
            if topic not in self._channels:
                schema = foxglove.Schema(
                    name=kind, encoding="ros2msg", data=usual_definition(kind).encode()
                )
                self._channels[topic] = foxglove.Channel(
                    topic, schema=schema, message_encoding="cdr", context=self.context
                )
            return self._channels[topic]

    def on_subscribe(self, client: websocket.Client, channel: websocket.ChannelView) -> None:
        """A client wants a topic: it gets the last message, where that still holds."""
        with self._lock:
            last, own = self._last.get(channel.topic), self._channels.get(channel.topic)
        if last is not None and own is not None:
            own.log(last[0], log_time=last[1])


@contextlib.contextmanager
def serve_topics(live: LiveTopics, place: Place) -> Iterator[int]:
    """Serve while the block runs; the port that was taken. Raises :class:`OutputError` where the
    address is not free.
    """
    try:
        server = foxglove.start_server(
            name="ladar_volume",
            host=place.host,
            port=place.port,
            capabilities=[],
            server_listener=live,
            context=live.context,
            message_backlog_size=BACKLOG,
        )
    except Exception as error:  # of the library's own class
        raise OutputError(
            f"--foxglove: {place.host}:{place.port} cannot be used: it is taken, or not ours",
            reason="output_address",
            value=place.port,
        ) from error
    try:
        yield int(server.port)
    finally:
        server.stop()
