"""What a log has of a sensor that georeference_node did not hear live: messages that came to the
log alone before the node's first of a driver. The log names them, and a replay leaves them out, so
that it is the live survey.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

#: The topic of a log on which logger_node names them, and its type.
TOPIC, KIND = "logger_node/unheard", "std_msgs/msg/String"
#: Bytes of a digest of a message.
DIGEST_BYTES = 8


def digest(data: bytes | memoryview) -> str:
    """By which one message is known among a few thousand."""
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).hexdigest()


@dataclass(frozen=True)
class Unheard:
    """Messages of one topic: those that the log received before a time, and those with these
    digests that it received until another.

    topic : without leading slash · before_ns : first time that counts · until_ns : last time at
    which those with digests came · digests · messages : how many there are.
    """

    topic: str
    before_ns: int = 0
    until_ns: int = 0
    digests: tuple[str, ...] = ()
    messages: int = 0

    def text(self) -> str:
        """As it stands in the log."""
        return json.dumps(asdict(self))

    def holds(self, t_ns: int, data: bytes | memoryview) -> bool:
        """Whether a message of the topic, received at a time, is one of them."""
        if t_ns < self.before_ns:
            return True
        return t_ns <= self.until_ns and bool(self.digests) and digest(data) in self.digests


def unheard_from_text(text: str) -> Unheard | None:
    """What a line of the log names; None for one that is none."""
    try:
        values = json.loads(text)
        digests = tuple(str(d) for d in values["digests"])
        numbers = (int(values[k]) for k in ("before_ns", "until_ns", "messages"))
        before_ns, until_ns, messages = numbers
        return Unheard(str(values["topic"]), before_ns, until_ns, digests, messages)
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


class UnheardMessages:
    """All that a log names."""

    def __init__(self, named: Iterable[Unheard]) -> None:
        self._topics: dict[str, list[Unheard]] = {}
        for one in named:
            self._topics.setdefault(one.topic, []).append(one)

    def __bool__(self) -> bool:
        return bool(self._topics)

    def counts(self) -> Mapping[str, int]:
        """How many messages, by topic."""
        return {t: sum(one.messages for one in named) for t, named in self._topics.items()}

    def hold(self, topic: str, t_ns: int, data: bytes) -> bool:
        """Whether a message is one of them."""
        return any(one.holds(t_ns, data) for one in self._topics.get(topic, ()))


#: A recording that names none.
NONE = UnheardMessages(())
