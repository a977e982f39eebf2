"""Before an answer: what came to the nodes before the call is brought into the surface."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.lifecycle import LifecycleNode
from rclpy.task import Future
from std_srvs.srv import Trigger

from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.nodes.executor_rounds import NextRound

#: How long an answer waits for the nodes before, s.
CATCH_UP_S = 20.0


class CatchUp:
    """Asks georeference_node for the last part that it sent, filter_node for the last that it made
    of that, and waits until volume_node has it.
    """

    def __init__(
        self,
        node: LifecycleNode,
        newest_ns: Callable[[], int],
        newest_mapped_ns: Callable[[], int] | None = None,
    ) -> None:
        """newest_ns : stamp of the last part that volume_node took · newest_mapped_ns : of the last
        mapped points, where it takes them, too.
        """
        self._mapped = node.create_client(Trigger, "georeference_node/flush")
        self._filter = node.create_client(Trigger, "filter_node/flush")
        self._newest_ns, self._newest_mapped_ns = newest_ns, newest_mapped_ns
        self._deadline = 0.0
        #: Whether an answer waits now: parts that come are to wake it.
        self.waits = False
        #: Returns that wait for poses, as georeference_node last said.
        self.returns_waiting = 0

    async def __call__(self) -> Verdict:
        """Wait, :data:`CATCH_UP_S` at most; what is missing then is a doubt. Nodes that are not
        there are not waited for.
        """
        self.waits, self._deadline = True, time.monotonic() + CATCH_UP_S
        try:
            return await self._caught_up()
        finally:
            self.waits = False

    async def _caught_up(self) -> Verdict:
        wanted_ns = 0
        self.returns_waiting = 0
        if self._mapped.service_is_ready():
            said = await self._answer(self._mapped.call_async(Trigger.Request()))
            if said is None:
                return _late_verdict(
                    "georeference_node has not worked off the messages that came before"
                )
            wanted_ns, self.returns_waiting = said
            while self._newest_mapped_ns is not None and self._newest_mapped_ns() < wanted_ns:
                if time.monotonic() > self._deadline:
                    return _late_verdict("volume_node lacks the last of the mapped points")
                await NextRound()
        if not self._filter.service_is_ready():
            return Verdict()
        while True:
            said = await self._answer(self._filter.call_async(Trigger.Request()))
            if said is None:
                return _late_verdict("filter_node has not worked off the points that came before")
            sent_ns, taken_ns = said
            if taken_ns >= wanted_ns:
                break
            if time.monotonic() > self._deadline:
                return _late_verdict(
                    f"filter_node lacks the last {(wanted_ns - taken_ns) * 1e-9:.1f} s of mapped "
                    "points"
                )
        while self._newest_ns() < sent_ns:
            if time.monotonic() > self._deadline:
                missing = (sent_ns - self._newest_ns()) * 1e-9 if self._newest_ns() else 0.0
                return _late_verdict(
                    f"volume_node lacks the last {missing:.1f} s of the filter's surface"
                )
            await NextRound()
        return Verdict()

    async def _answer(self, asked: Future) -> tuple[int, int] | None:
        """The two numbers that a flush answers with; None where it failed or did not in time."""
        while not asked.done():
            if time.monotonic() > self._deadline:
                return None
            await NextRound()
        if not asked.result().success:
            return None
        first, _, second = str(asked.result().message).partition(" ")
        return int(first), int(second)


def _late_verdict(missing: str) -> Verdict:
    words = f"the answer is not of all data: after {CATCH_UP_S:g} s {missing}; ask again"
    return Verdict((Doubt("not_caught_up", words, CATCH_UP_S),))
