"""Which pass of the data a message belongs to, where the time of georeference_node's outputs begins
again (a looping recording).

Its outputs come on several topics, whose order among each other DDS does not keep. A *leader*'s
stamps rise within a pass, so that a step back begins a new one. A *follower* (points of clouds that
came late) may go back within a pass: whether it does is known with the next message of a leader. No
follower is ahead of the leaders by more than moments, so one far ahead of a pass just begun is of
the old one.

Who sent it: rclpy does not say. Where there must be one publisher, a change is believed only while
nobody else could have sent it (:class:`OnePublisher`).
"""

from __future__ import annotations

from collections.abc import Iterable

#: Stamps further back than this are no matter of rounding; georeference_node begins anew only for
#: steps of two seconds and more.
BACK_NS = 1_000_000_000
#: Another publisher may have sent what comes until so long after it was last seen, s.
MEMORY_S = 5.0


class StreamPasses:
    """One per node; ``take`` every message's topic and stamp."""

    def __init__(self, *leaders: str) -> None:
        self.begun = 0
        self._leaders = leaders
        self._newest: dict[str, int] = {}
        self._old: set[str] = set()

    def take(self, kind: str, t_ns: int) -> str:
        """``same`` pass, ``new`` pass (begin anew, then take the message), ``old`` (drop it), or
        ``wait`` (until the next leader).
        """
        if kind in self._old:
            if t_ns > max(self._newest.values()) + BACK_NS:
                return "old"
            self._old.discard(kind)
        elif t_ns < self._newest.get(kind, t_ns) - BACK_NS:
            if kind not in self._leaders:
                return "wait"
            self._old = set(self._newest) - {kind}
            self._newest = {kind: t_ns}
            self.begun += 1
            return "new"
        self._newest[kind] = max(self._newest.get(kind, t_ns), t_ns)
        return "same"


class OnePublisher:
    """Bound to the first publisher that is alone on a topic; a successor that is alone replaces it.

    Call ``update_publishers`` several times a second and with each message.
    """

    def __init__(self) -> None:
        self.bound: bytes | None = None
        self._others_s = float("-inf")

    def update_publishers(self, publishers: Iterable[bytes], now_s: float) -> bool:
        """Take the publishers at a time (s, of a steady clock). True when a successor has replaced
        the bound one: what that one sent must be requested again.
        """
        there, before = set(publishers), self.bound
        if len(there) == 1 and before not in there:
            (self.bound,) = there
            self._others_s = float("-inf")
        elif there - {before}:
            self._others_s = now_s
        return before not in (None, self.bound)

    def accepts_change(self, now_s: float) -> bool:
        """Whether a message that differs from the last one is the bound publisher's."""
        return self.bound is not None and now_s - self._others_s > MEMORY_S
