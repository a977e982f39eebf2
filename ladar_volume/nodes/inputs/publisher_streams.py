"""Where the messages of another publisher begin on a topic. rclpy does not say who sent a message;
each publisher numbers its own from 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

#: Publishers of one topic that are told apart.
MOST = 8


class PublisherStreams:
    """One per topic; ``begins`` for every message."""

    def __init__(self) -> None:
        #: The last number of each publisher, in the order in which they were found.
        self._last: list[int] = []
        self._known: set[bytes] = set()

    def begins(self, sequence: int, publishers: Callable[[], Iterable[bytes]]) -> bool:
        """Whether a message is the first that is heard of its publisher. sequence : its number, 0
        where the middleware gives none · publishers : who is there now, asked where numbers do not
        follow each other.
        """
        if sequence <= 0:
            return False
        below = [k for k, last in enumerate(self._last) if last < sequence]
        nearest = max(below, key=self._last.__getitem__, default=None)
        if nearest is not None and sequence == self._last[nearest] + 1:
            self._last[nearest] = sequence
            return False
        # a newcomer, or messages were lost
        there = set(publishers())
        newcomer, self._known = bool(there - self._known), there
        if nearest is not None and not newcomer:
            self._last[nearest] = sequence
            return False
        self._last = [*self._last, sequence][-MOST:]
        return True
