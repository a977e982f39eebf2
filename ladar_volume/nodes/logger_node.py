"""logger_node: any topics as raw CDR into one MCAP, without decoding."""

from __future__ import annotations

import fnmatch
import importlib
import sys
from collections.abc import Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ladar_volume.io.log import McapLog
from ladar_volume.io.results import json_text
from ladar_volume.nodes.base import StageNode, spin


def message_class(kind: str) -> Any:
    """The Python class of ``package/msg/Name``; None where the package is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        return None


class LoggerNode(StageNode):
    """Looks for topics once a second and subscribes to those wanted, with the publisher's own durability and reliability."""

    kernels = False
    sections = ("logger", "node")

    def __init__(self, **options: Any) -> None:
        super().__init__("logger_node", **options)

    def build(self) -> None:
        """Open the log, begin to look for topics."""
        self._log = McapLog(self.parameters.logger)
        self._log.metadata("ladar_volume", {"parameters": json_text(self.parameters.write())})
        self._known: set[str] = set()
        self.create_timer(1.0, self._discover, callback_group=self._group)
        self.create_service(Trigger, "~/split", self._split, callback_group=self._group)
        self._discover()

    def _discover(self) -> None:
        for topic, kinds in self.get_topic_names_and_types():
            name = topic.lstrip("/")
            if topic in self._known or not any(fnmatch.fnmatch(name, pattern.lstrip("/")) for pattern in self.parameters.logger.topics):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            self._known.add(topic)
            kind = message_class(kinds[0])
            if kind is None:
                self.losses.add("message_unknown_type")
                self.get_logger().warning(f"{topic}: no Python support for {kinds[0]}, not logged")
                continue
            # asking for more than a publisher offers would get nothing: take the weakest of what they offer
            reliable = all(p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers)
            latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
            qos = QoSProfile(
                history=HistoryPolicy.KEEP_LAST, depth=1000,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )  # fmt: skip
            self.create_subscription(
                kind, topic, lambda data, name=name, kind=kinds[0]: self._take(name, kind, data), qos, raw=True, callback_group=self._group
            )

    def _take(self, name: str, kind: str, data: bytes) -> None:
        if self._active:
            self.offer("message", (name, kind, data, self.get_clock().now().nanoseconds))

    def work(self, kind: str, item: Any) -> None:
        """Write one message, or split."""
        if kind == "split":
            self._log.split()
        elif kind == "message":
            self._log.write(*item)

    def _split(self, request: Any, response: Any) -> Any:
        self.offer("split", None)
        response.success, response.message = True, json_text({"finishing": str(self._log.path)})
        return response

    def stop(self) -> None:
        """Write what is queued, then finish the file with its index."""
        super().stop()
        if hasattr(self, "_log"):
            self._log.close()

    def status(self) -> dict[str, Any]:
        """What is written where."""
        return {"file": self._log.path, "messages_written": self._log.messages, "topics": len(self._known)}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(LoggerNode, argv)


if __name__ == "__main__":
    sys.exit(main())
