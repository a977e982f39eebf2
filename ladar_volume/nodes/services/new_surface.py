"""What volume_node asks of filter_node when it finds it: to begin anew, for of a surface from
before this node was there, patches and times of flight would be missing here.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from ladar_volume.model.records import FilterUpdate
from ladar_volume.model.verdict import Doubt, Verdict

#: An answer that does not come within this time is asked for again, s.
ANSWER_S = 20.0


class NewSurface:
    """Asks, and holds what comes until the answer tells what of it is of the new surface."""

    def __init__(self, node: Node, answered: Callable[[tuple[int, int]], object]) -> None:
        """answered : told, in the executor's thread, the stamp (ns) of the last part of the surface
        before, and how many messages filter_node had taken for it.
        """
        self._client = node.create_client(Trigger, "filter_node/reset")
        self._answered = answered
        self._asked_s: float | None = None
        self._counts = True
        self._held: list[tuple[int, list[FilterUpdate]]] = []
        self.joined = False
        #: Messages of returns and poses that the surface lacks, though nobody asked for that.
        self.lacking = 0

    @property
    def waits(self) -> bool:
        """Whether an answer is awaited."""
        return self._asked_s is not None

    def due(self) -> bool:
        """Whether to ask."""
        if self.joined or not self._client.service_is_ready():
            return False
        return self._asked_s is None or time.monotonic() - self._asked_s > ANSWER_S

    def ask(self) -> None:
        """Have the filter begin anew."""
        self._held, self._asked_s = [], time.monotonic()
        self._client.call_async(Trigger.Request()).add_done_callback(self._take_answer)

    def _take_answer(self, future: Future) -> None:
        first, _, second = str(future.result().message).partition(" ")
        if future.result().success and first.isdecimal() and second.isdecimal():
            self._answered((int(first), int(second)))

    def hold(self, key: int, parts: list[FilterUpdate]) -> None:
        """Keep a complete update, with the stamp (ns) of its last part, until the answer."""
        self._held.append((key, parts))

    def begin(self, answer: tuple[int, int]) -> list[tuple[int, list[FilterUpdate]]]:
        """The held updates that are of the new surface."""
        sent_ns, taken = answer
        self.lacking += taken if self._counts else 0
        held, self._held = self._held, []
        self._asked_s, self._counts, self.joined = None, True, True
        return [(key, parts) for key, parts in held if key > sent_ns]

    def again(self, wanted: bool) -> None:
        """Ask once more. wanted : a person asked for a surface of what comes from now on, which
        lacks nothing then.
        """
        self.joined = False
        if wanted:
            self.lacking, self._counts = 0, False

    def forget(self) -> None:
        """Another survey begins: of this one nothing is lacking, and nothing held."""
        self._held, self.lacking = [], 0

    def words(self) -> str:
        """What the surface lacks; empty for nothing."""
        if self._held:
            return "filter_node has not said of what it sent whether it is of a new surface"
        if not self.lacking:
            return ""
        return (
            f"filter_node began anew for volume_node, {self.lacking} messages of returns and poses "
            "that it had taken before are not in the surface"
        )

    def verdict(self) -> Verdict:
        """The same as a doubt of a result."""
        words = self.words()
        doubt = Doubt("surface_began_anew", f"{words}: replay the log", float(self.lacking))
        return Verdict((doubt,) if words else ())
