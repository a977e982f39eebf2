"""What waits for a node's worker: so many items, and so many bytes of clouds among them."""

from __future__ import annotations

import queue
from typing import Any

#: Items, and bytes of clouds.
QUEUE, QUEUE_BYTES = 5000, 64_000_000


def cloud_bytes(work: tuple[str, Any] | None) -> int:
    """Bytes of a cloud, 0 for what has none."""
    return len(work[1].data) if work is not None and hasattr(work[1], "point_step") else 0


class WorkQueue(queue.Queue[tuple[str, Any] | None]):
    """A queue of kinds with their items; None ends the work. What is beyond the bounds is refused
    with ``queue.Full``, but a cloud that would be alone, however large.
    """

    def __init__(self) -> None:
        super().__init__(QUEUE)
        self.bytes = 0

    def put_nowait(self, item: tuple[str, Any] | None) -> None:
        """Put in what there is room for."""
        if self.bytes and 0 < cloud_bytes(item) > QUEUE_BYTES - self.bytes:
            raise queue.Full
        super().put_nowait(item)

    def _put(self, item: tuple[str, Any] | None) -> None:
        super()._put(item)
        self.bytes += cloud_bytes(item)

    def _get(self) -> tuple[str, Any] | None:
        item = super()._get()
        self.bytes -= cloud_bytes(item)
        return item
