"""Whether those who make a volume of what georeference_node maps are there yet: what it sends
before they listen is in no volume, while the log has it.
"""

from __future__ import annotations

from rclpy.node import Node

#: Nodes that take points and path; volume_node has the filter begin anew when it finds it.
FILTER, VOLUME = "filter_node", "volume_node"
#: A publisher of volume_node, without messages, from when the filter has begun for it.
JOINED = f"{VOLUME}/joined"
#: How long nodes that are not on the graph are waited for, and those that are, s.
ABSENT_S, PRESENT_S = 3.0, 30.0
#: Returns that wait at most, 0.15 GB.
MOST_RETURNS = 2_000_000


class FirstListeners:
    """Asked until they are there, or have been waited for; then :attr:`there` stays true."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._since_s: float | None = None
        self.there = False

    def all_there(self, returns: int, now_s: float) -> bool:
        """Whether to send. returns : how many wait to be sent · now_s : of a steady clock, from
        the first call on.
        """
        if self.there:
            return True
        self._since_s = now_s if self._since_s is None else self._since_s
        waited = now_s - self._since_s
        self.there = returns > MOST_RETURNS or waited > PRESENT_S or self._listen()
        if not self.there and waited > ABSENT_S:
            self.there = not self._on_graph()
        return self.there

    def _listen(self) -> bool:
        """Whether both listen to all that they take, and have found each other."""
        node = self._node
        if not node.count_publishers(JOINED):
            return False
        needed = {"points_mapped": {FILTER}, "platform": {FILTER, VOLUME}}
        for topic, names in needed.items():
            there = node.get_subscriptions_info_by_topic(node.resolve_topic_name(topic))
            if not names <= {s.node_name for s in there if s.node_namespace == _space(node)}:
                return False
        return True

    def _on_graph(self) -> bool:
        """Whether both are on the graph."""
        own = _space(self._node)
        there = {n for n, space in self._node.get_node_names_and_namespaces() if space == own}
        return {FILTER, VOLUME} <= there


def _space(node: Node) -> str:
    return str(node.get_namespace())
