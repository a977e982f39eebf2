"""Several recordings of one survey as one: flights one after another, or a file for each sensor."""

from __future__ import annotations

import hashlib
import heapq
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ladar_volume.io.bags import Raw, Recording
from ladar_volume.io.drivers.packet_capture import open_recording
from ladar_volume.model.errors import BagError


class RecordingSeries(Recording):
    """Recordings whose messages are taken together in receive order.

    Raises :class:`BagError` (bag_topic) for a topic of two types, and (bag_overlap) where two hold
    messages of one topic at the same time, as where a file is given twice.
    """

    def __init__(self, paths: Sequence[Path], all_messages: bool = False) -> None:
        self._open = ExitStack()
        with ExitStack() as stack:
            found = [stack.enter_context(open_recording(path, all_messages)) for path in paths]
            found.sort(key=lambda recording: recording.start_ns)
            self._check(found)
            self._open = stack.pop_all()
        self.parts = tuple(found)
        names = " + ".join(recording.path.name for recording in found)
        self.path = found[0].path.with_name(names)

    @staticmethod
    def _check(found: Sequence[Recording]) -> None:
        """Raises as the class says."""
        for k, later in enumerate(found):
            for earlier in found[:k]:
                common = earlier.topics().keys() & later.topics().keys()
                for topic in sorted(common):
                    one, two = earlier.topics()[topic][0], later.topics()[topic][0]
                    if one != two:
                        words = f"{later.path}: {topic} is {two}, and {one} in {earlier.path}"
                        raise BagError(words, reason="bag_topic", value=topic)
                end_ns = earlier.start_ns + round(earlier.duration_s * 1e9)
                if common and later.start_ns < end_ns:
                    words = (
                        f"{later.path}: begins before {earlier.path} ends, and both hold "
                        f"{', '.join(sorted(common))}: these would count twice"
                    )
                    raise BagError(words, reason="bag_overlap", value=sorted(common))

    def __enter__(self) -> RecordingSeries:
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    @property
    def start_ns(self) -> int:
        """Receive time of the first message."""
        return self.parts[0].start_ns

    @property
    def duration_s(self) -> float:
        """From first to last message."""
        return max(r.duration_s + (r.start_ns - self.start_ns) * 1e-9 for r in self.parts)

    def topics(self) -> dict[str, tuple[str, int]]:
        """Topic (without leading slash) → type and number of messages."""
        out: dict[str, tuple[str, int]] = {}
        for recording in self.parts:
            for topic, (kind, count) in recording.topics().items():
                out[topic] = (kind, out.get(topic, ("", 0))[1] + count)
        return dict(sorted(out.items()))

    def raw(
        self, topics: set[str] | None = None, span: tuple[int, int] | None = None
    ) -> Iterator[Raw]:
        """Messages in receive order; at one time those of the earlier recording first."""
        each = (recording.raw(topics, span) for recording in self.parts)
        return heapq.merge(*each, key=lambda raw: raw.t_ns)

    def message(self, raw: Raw) -> Any:
        """Deserialise, as the recording does that has such messages."""
        for recording in self.parts:
            if recording.topics().get(raw.topic, ("", 0))[0] == raw.kind:
                return recording.message(raw)
        return self.parts[0].message(raw)

    def digest(self) -> str:
        """sha256 over those of the recordings, in their order in time."""
        text = "".join(recording.digest() for recording in self.parts)
        return hashlib.sha256(text.encode()).hexdigest()


def open_recordings(paths: Sequence[Path], all_messages: bool = False) -> Recording:
    """One recording, or several as one. all_messages : of logs also what the nodes had not heard.
    Raises :class:`BagError` as they do.
    """
    if len(paths) == 1:
        return open_recording(paths[0], all_messages)
    return RecordingSeries(paths, all_messages)
