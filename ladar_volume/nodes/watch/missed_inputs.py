"""What a log lacks of what georeference_node had: the messages of a driver that was there before
the log listened, for which DDS has no account.
"""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray

from ladar_volume.io.logs.heard_live import NODE, lacking_words
from ladar_volume.io.recorder import TopicAccount
from ladar_volume.nodes.watch.upstream_nodes import UpstreamNodes


class MissedInputs:
    """topics : of the sensors that are logged, by role, as the log names them."""

    def __init__(self, namespace: str, topics: Mapping[str, str]) -> None:
        self._node, self._topics = UpstreamNodes(namespace, (NODE,)), dict(topics)
        self._before: dict[str, int] = {}

    def take(self, message: DiagnosticArray) -> None:
        """A message of /diagnostics."""
        self._node.take(message)

    def words(self, accounts: Mapping[str, TopicAccount], ended: bool = False) -> str:
        """What is missing; empty for nothing. It is held against the report before the last one,
        for what came since may still be on its way; against the last one where all has come.
        """
        lines = self._node.lines(NODE)
        received = {role: lines.get(f"received_{role}", "") for role in self._topics}
        last = {role: int(n) for role, n in received.items() if n.isdecimal()}
        heard, self._before = last if ended else self._before, last
        counted = {}
        for role, count in heard.items():
            account = accounts.get(self._topics[role], TopicAccount())
            came = account.written + account.queue + account.disk + account.middleware
            counted[role] = (count, came)
        words = lacking_words(counted)
        return f"{words}: they came before the log listened, its replay is another survey" * bool(
            words
        )
