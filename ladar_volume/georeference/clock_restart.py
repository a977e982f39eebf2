"""When the time of a whole recording begins again: a looping bag, or a simulation started anew.

One topic whose time goes back is a clock that was set, or late messages; where two topics go back
by the same step, all that came before belongs to another pass.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

#: A sample older than its topic's newest by more than this is no longer merely late.
BACK_NS = 2_000_000_000
#: A step ahead longer than this is believed once the next sample follows it, so that one corrupt
#: stamp makes no later one look old.
AHEAD_NS = 10_000_000_000
#: Samples in order that confirm a step back, and how long they are held for another topic to agree.
CONFIRM, HOLD_NS = 2, 2_000_000_000


@dataclass
class _Topic:
    newest: int | None = None
    ahead: int | None = None  # a step ahead that awaits its confirmation
    waiting: list[tuple[int, int, Any]] = field(
        default_factory=list
    )  # time, number of arrival, sample
    old: bool = False  # others began again, this one has not been seen to

    def advance(self, t_ns: int) -> None:
        """Follow the topic's time."""
        if (
            self.newest is None
            or t_ns <= self.newest + AHEAD_NS
            or (self.ahead is not None and 0 < t_ns - self.ahead <= AHEAD_NS)
        ):
            self.newest, self.ahead = t_ns if self.newest is None else max(self.newest, t_ns), None
        else:
            self.ahead = t_ns

    @property
    def confirmed_step_ns(self) -> int | None:
        """How far a confirmed step went back."""
        return (
            self.newest - self.waiting[0][0]
            if self.newest is not None and len(self.waiting) >= CONFIRM
            else None
        )


class Restart:
    """Stands before the stage: passes samples on, holds those that go back until it is known what
    they are.

    A held sample is passed on in the end in any case: to the stage as it is where nothing began
    again (which refuses what is out of order), else to the stage begun anew, in the order of
    arrival.
    """

    def __init__(self) -> None:
        self.count = 0
        self._topics: dict[str, _Topic] = {}
        self._arrived = 0

    def push(
        self, kind: str, t_ns: int, sample: object
    ) -> tuple[bool, list[tuple[str, Any]], list[str]]:
        """One sample of topic ``kind`` at ``t_ns``. Returns whether time began again before the
        samples that follow, the samples to take now as (kind, sample), and the reasons of those
        that are dropped: stragglers of the pass before.
        """
        self._arrived += 1
        topic = self._topics.setdefault(kind, _Topic())
        if topic.old:
            newest = max(
                (t.newest for t in self._topics.values() if not t.old and t.newest is not None),
                default=t_ns,
            )
            if t_ns > newest + BACK_NS:
                return False, [], [f"{kind}_before_restart"]
            topic.old, topic.newest = False, t_ns
            return False, [(kind, sample)], []
        if topic.newest is None or t_ns > topic.newest - BACK_NS:
            strays, topic.waiting = topic.waiting, []
            topic.advance(t_ns)
            return False, [*((kind, s) for _, _, s in strays), (kind, sample)], []
        strays = []
        if topic.waiting and not (
            0 < t_ns - topic.waiting[-1][0] and t_ns - topic.waiting[0][0] <= HOLD_NS
        ):
            strays, topic.waiting = topic.waiting, []
        topic.waiting.append((t_ns, self._arrived, sample))
        if not strays and self._topics_agree():
            return True, self._begin(), []
        return False, [(kind, s) for _, _, s in strays], []

    def _topics_agree(self) -> bool:
        steps = sorted(
            t.confirmed_step_ns for t in self._topics.values() if t.confirmed_step_ns is not None
        )
        return any(b - a <= BACK_NS for a, b in itertools.pairwise(steps))

    def _begin(self) -> list[tuple[str, Any]]:
        self.count += 1
        held = [
            (number, kind, sample)
            for kind, topic in self._topics.items()
            for _, number, sample in topic.waiting
        ]
        for topic in self._topics.values():
            topic.old = not topic.waiting
            topic.newest = topic.waiting[-1][0] if topic.waiting else None
            topic.waiting, topic.ahead = [], None
        return [(kind, sample) for _, kind, sample in sorted(held, key=lambda h: h[0])]

    def finish(self) -> list[tuple[str, Any]]:
        """End of data: what is still held, as it came."""
        rest = [
            (number, kind, sample)
            for kind, topic in self._topics.items()
            for _, number, sample in topic.waiting
        ]
        for topic in self._topics.values():
            topic.waiting = []
        return [(kind, sample) for _, kind, sample in sorted(rest, key=lambda h: h[0])]
