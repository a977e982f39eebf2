"""How far a sender is ahead of its listener: what is on its way takes room in both and between
them.
"""

from __future__ import annotations

import threading
import time
from collections import deque

#: Bytes on their way from which on a sender waits, and how long without news, s: a listener may be
#: gone, or busy for that long.
AHEAD_BYTES, NEWS_S = 16 << 20, 5.0


class Ahead:
    """Bytes sent, by stamp, that the listener has not taken yet. News come in another thread than
    what is sent.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, int]] = deque()
        self._news = threading.Condition()
        self._newest = time.monotonic()

    @property
    def bytes(self) -> int:
        """On their way."""
        with self._news:
            return self._total()

    def _total(self) -> int:
        return sum(size for _, size in self._sent)

    def sent(self, t_ns: int, size: int) -> None:
        """So many bytes with this stamp went out; stamps rise."""
        with self._news:
            self._sent.append((t_ns, size))

    def taken(self, t_ns: int) -> None:
        """The listener has taken all up to this stamp."""
        with self._news:
            while self._sent and self._sent[0][0] <= t_ns:
                self._sent.popleft()
            self._newest = time.monotonic()
            self._news.notify_all()

    def forget(self) -> None:
        """Nobody is going to take what was sent."""
        with self._news:
            self._sent.clear()
            self._news.notify_all()

    def may_send(self, wait: bool = False) -> bool:
        """Whether there is room for more, or no news for so long that one more is sent all the
        same; with ``wait``, as soon as so.
        """
        with self._news:
            while self._total() > AHEAD_BYTES:
                left = self._newest + NEWS_S - time.monotonic()
                if left <= 0.0:
                    self._newest = time.monotonic()
                    return True
                if not wait:
                    return False
                self._news.wait(left)
            return True
