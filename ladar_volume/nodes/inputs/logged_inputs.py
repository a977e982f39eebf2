"""What the log has of the sensors, held against the copies of what georeference_node used: messages
that the log lacks are taken from the copies; those before a driver's first that the node heard are
named, for a replay to leave them out.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from ladar_volume.io.logs.unheard import Unheard, digest
from ladar_volume.nodes.inputs.input_copies import InputCopy, Key
from ladar_volume.nodes.inputs.publisher_streams import PublisherStreams

#: How long messages are remembered, s of their publishers' clock, and how many at most.
MEMORY_S, MEMORY = 15.0, 20_000
#: How long after a publisher's first message its messages are remembered with their digests, s. A
#: listener that finds it later than this was not there when it began.
BEGIN_S = 12.0
#: How long a copy waits for the log's own message, s; where a later one came, it does not come.
WAIT_S = 3.0
#: Bytes of copies that wait at most.
WAIT_BYTES = 64_000_000


@dataclass
class _Own:
    """A message that is in the log: when it was received (ns), its digest where it may matter;
    whether it comes from a copy.
    """

    t_ns: int
    digest: str = ""
    copied: bool = False


@dataclass
class _Begin:
    """A publisher's first message that the node heard, and when its copy came (s)."""

    copy: InputCopy
    came_s: float


@dataclass
class _Topic:
    streams: PublisherStreams = field(default_factory=PublisherStreams)
    #: When each publisher's first message to the log was sent, ns.
    began: list[int] = field(default_factory=list)
    own: OrderedDict[Key, _Own] = field(default_factory=OrderedDict)
    count: int = 0
    #: Messages that the node used, as far as copies said so.
    heard: OrderedDict[Key, None] = field(default_factory=OrderedDict)
    waiting: dict[Key, tuple[InputCopy, float]] = field(default_factory=dict)
    begins: list[_Begin] = field(default_factory=list)
    #: Whether a node has begun to hear the topic.
    known: bool = False

    def forget(self, newest_ns: int) -> None:
        """Drop what is older than the memory, or more than it holds."""
        oldest = newest_ns - round(MEMORY_S * 1e9)
        for keys in (self.own, self.heard):
            while keys and (len(keys) > MEMORY or next(iter(keys))[0] < oldest):
                keys.popitem(last=False)

    def later(self, key: Key) -> _Own | None:
        """The first message in the log that its publisher sent after one."""
        return next((o for k, o in self.own.items() if k[0] > key[0] and k[1] > key[1]), None)


class LoggedInputs:
    """Topics by full name. Times ``now_s`` are a steady clock's."""

    def __init__(self, publishers: Callable[[str], Iterable[bytes]]) -> None:
        """publishers : of a topic, now."""
        self._publishers = publishers
        self._topics: dict[str, _Topic] = {}
        self._bytes = 0
        #: Copies that found no room.
        self.dropped = 0

    def logged(self, topic: str, data: bytes, t_ns: int, published_ns: int, sequence: int) -> bool:
        """A message that the log hears. False where it is in the log already, from a copy."""
        one, key = self._topics.setdefault(topic, _Topic()), (published_ns, sequence)
        if published_ns <= 0 or sequence <= 0:  # the middleware does not tell messages apart
            return True
        begins = one.streams.begins(sequence, lambda: self._publishers(topic))
        if key in one.own:
            return False
        if begins:
            one.began = [*one.began, published_ns][-8:]
        recent = any(0 <= published_ns - b <= BEGIN_S * 1e9 for b in one.began)
        one.own[key] = _Own(t_ns, digest(data) if recent else "")
        one.count += 1
        one.forget(published_ns)
        return True

    def heard(self, copy: InputCopy, now_s: float) -> None:
        """A copy of a message that the node used."""
        one = self._topics.setdefault(copy.topic, _Topic())
        one.heard[copy.key] = None
        if copy.begins:
            one.begins.append(_Begin(copy, now_s))
        if copy.key in one.own:
            return
        if self._bytes + len(copy.data) > WAIT_BYTES:
            self.dropped += 1
            return
        one.waiting[copy.key] = copy, now_s
        self._bytes += len(copy.data)

    def lacking(self, now_s: float, ended: bool = False) -> Iterator[tuple[InputCopy, int]]:
        """Copies of messages that the log did not hear, with the time (ns) under which each belongs
        into it: before what their publisher sent later. ended : nothing comes any more.
        """
        for one in self._topics.values():
            for key, (copy, came_s) in list(one.waiting.items()):
                if key not in one.own:
                    later = one.later(key)
                    if later is None and not ended and now_s - came_s <= WAIT_S:
                        continue
                    t_ns = copy.received_ns
                    t_ns = t_ns if later is None else min(t_ns, later.t_ns - 1)
                    one.own[key] = _Own(t_ns, copied=True)
                    yield copy, t_ns
                del one.waiting[key]
                self._bytes -= len(copy.data)

    def unheard(self, now_s: float, ended: bool = False) -> Iterator[Unheard]:
        """What the log has before the first messages that the node heard of a publisher, once that
        is known; to be asked after :meth:`lacking`.
        """
        for topic, one in self._topics.items():
            for begin in list(one.begins):
                key = begin.copy.key
                settled = key in one.own and one.later(key) is not None
                if not (settled or ended or now_s - begin.came_s > WAIT_S):
                    continue
                one.begins.remove(begin)
                found = self._before(topic, one, begin.copy)
                one.known = True
                if found.messages:
                    yield found

    def _before(self, topic: str, one: _Topic, first: InputCopy) -> Unheard:
        """What a publisher sent before the node's first, and the log has; before a node's very
        first message of the topic all that the log has of it. A later node, which comes to a topic
        that another one has heard, says nothing of what came before.
        """
        before_ns, older, mine = 0, 0, []
        if first.begins == "topic" and not one.known:
            heard = [o.t_ns for key, o in one.own.items() if key in one.heard]
            before_ns = min(heard, default=0)
            older = one.count - sum(o.t_ns >= before_ns and not o.copied for o in one.own.values())
        if first.begins != "topic" or not one.known:
            begun = [b for b in one.began if first.published_ns - b <= BEGIN_S * 1e9]
            oldest = min(begun, default=first.published_ns)
            mine = [
                o
                for key, o in one.own.items()
                if key not in one.heard and o.digest and o.t_ns >= before_ns
                if oldest <= key[0] < first.published_ns and key[1] < first.sequence
            ]
        until_ns = max((o.t_ns for o in mine), default=0)
        digests = tuple(o.digest for o in mine)
        return Unheard(topic.lstrip("/"), before_ns, until_ns, digests, older + len(mine))
