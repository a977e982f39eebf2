"""Copies of the first inputs that a node uses, for the log, which may have heard less of them, or
more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from ladar_volume.nodes.inputs.input_copies import InputCopy
from ladar_volume.nodes.inputs.publisher_streams import PublisherStreams

#: Where copies travel.
TOPIC = "~/inputs_heard"
#: How long after the first message of a publisher all of its topic are copied, s. Listeners find a
#: publisher within a second of each other.
WINDOW_S = 3.0
#: How long copies wait for a log, s, and how many bytes of them.
WAIT_S, WAIT_BYTES = 10.0, 32_000_000
#: Bytes of one topic that are copied after a publisher began.
WINDOW_BYTES = 64_000_000


@dataclass
class _Topic:
    streams: PublisherStreams = field(default_factory=PublisherStreams)
    heard: bool = False
    until_s: float = 0.0
    bytes: int = 0


class HeardInputs:
    """``take`` every message that the node uses; ``due`` gives the copies to be published. Times
    ``now_s`` are a steady clock's.
    """

    def __init__(self, publishers: Callable[[str], Iterable[bytes]]) -> None:
        """publishers : of a topic, now."""
        self._publishers = publishers
        self._topics: dict[str, _Topic] = {}
        self._waiting: deque[tuple[float, InputCopy]] = deque()
        self._bytes = 0

    def take(
        self,
        topic: str,
        kind: str,
        data: bytes,
        info: Mapping[str, Any],
        received_ns: int,
        now_s: float,
    ) -> None:
        """A message that the node uses, with what the middleware says of it."""
        sequence = int(info.get("publication_sequence_number") or 0)
        published_ns = int(info.get("source_timestamp") or 0)
        if sequence <= 0 or published_ns <= 0:  # the middleware does not tell messages apart
            return
        one = self._topics.setdefault(topic, _Topic())
        begins = ""
        if one.streams.begins(sequence, lambda: self._publishers(topic)):
            begins = "publisher" if one.heard else "topic"
            one.heard, one.until_s, one.bytes = True, now_s + WINDOW_S, 0
        if now_s > one.until_s or one.bytes > WINDOW_BYTES:
            return
        one.bytes += len(data)
        copy = InputCopy(topic, kind, data, published_ns, sequence, received_ns, begins)
        self._waiting.append((now_s, copy))
        self._bytes += len(data)

    @property
    def waits(self) -> bool:
        """Whether copies are to be published."""
        return bool(self._waiting)

    def due(self, heard: bool, now_s: float) -> Iterator[InputCopy]:
        """Copies to publish now. heard : whether a log listens; without one they wait a while."""
        while self._waiting:
            came_s, copy = self._waiting[0]
            if not heard and now_s - came_s <= WAIT_S and self._bytes <= WAIT_BYTES:
                return
            self._waiting.popleft()
            self._bytes -= len(copy.data)
            if heard:
                yield copy
