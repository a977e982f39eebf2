"""Which publisher of a topic is believed where there must be one: rclpy does not say who sent a
message, so a change is believed only while nobody else could have sent it.
"""

from __future__ import annotations

from collections.abc import Iterable

#: Another publisher may have sent what comes until so long after it was last seen, s.
MEMORY_S = 5.0


class OnePublisher:
    """Bound to the first publisher that is there alone; its successor, alone, may take its place.

    ``seen`` is to be told who publishes, several times a second and with each message.
    """

    def __init__(self) -> None:
        self.bound: bytes | None = None
        self._others_s = float("-inf")

    def seen(self, publishers: Iterable[bytes], now_s: float) -> bool:
        """Who publishes at a time (s, of a steady clock). True when a successor has taken the place
        of the bound one: what it said before is to be asked for again.
        """
        there, before = set(publishers), self.bound
        if len(there) == 1 and before not in there:
            (self.bound,) = there
            self._others_s = float("-inf")
        elif there - {before}:
            self._others_s = now_s
        return before not in (None, self.bound)

    def believed(self, now_s: float) -> bool:
        """Whether a message that differs from the last one is the bound publisher's."""
        return self.bound is not None and now_s - self._others_s > MEMORY_S
