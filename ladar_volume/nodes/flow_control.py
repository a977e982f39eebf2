"""Flow control between a publisher and one subscriber: bytes in flight occupy memory in both
processes and between them.
"""

from __future__ import annotations

import threading
import time
from collections import deque

#: Most bytes in flight; a sender with more waits for an acknowledgement at most so long, s: the
#: listener may be gone, or busy for that long.
MAX_IN_FLIGHT_BYTES, ACKNOWLEDGEMENT_TIMEOUT_S = 16 << 20, 5.0


class UnacknowledgedBytes:
    """Bytes in flight by stamp: sent, not yet acknowledged. Messages are sent in one thread and
    acknowledged in another.
    """

    def __init__(self) -> None:
        self._sent: deque[tuple[int, int]] = deque()
        self._changed = threading.Condition()
        self._acknowledged_s = time.monotonic()

    @property
    def bytes(self) -> int:
        """Bytes in flight."""
        with self._changed:
            return self._total()

    def _total(self) -> int:
        return sum(size for _, size in self._sent)

    def record_sent(self, t_ns: int, size: int) -> None:
        """Add a message of ``size`` bytes; stamps rise."""
        with self._changed:
            self._sent.append((t_ns, size))

    def acknowledge(self, t_ns: int) -> None:
        """The listener has processed everything up to this stamp."""
        with self._changed:
            while self._sent and self._sent[0][0] <= t_ns:
                self._sent.popleft()
            self._acknowledged_s = time.monotonic()
            self._changed.notify_all()

    def forget(self) -> None:
        """Forget all bytes in flight: the listener is gone."""
        with self._changed:
            self._sent.clear()
            self._changed.notify_all()

    def all_taken(self, timeout_s: float) -> bool:
        """Wait until nothing is in flight. False where that takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._sent, timeout_s)

    def may_send(self, wait: bool = False) -> bool:
        """Whether one more message may be sent: there is room, or no acknowledgement came within
        the timeout. With ``wait``, return as soon as either holds.
        """
        with self._changed:
            while self._total() > MAX_IN_FLIGHT_BYTES:
                left = self._acknowledged_s + ACKNOWLEDGEMENT_TIMEOUT_S - time.monotonic()
                if left <= 0.0:
                    self._acknowledged_s = time.monotonic()
                    return True
                if not wait:
                    return False
                self._changed.wait(left)
            return True
