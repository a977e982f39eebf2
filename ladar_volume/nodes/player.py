"""player: a recording onto the topics of the graph, raw, at a chosen rate; /clock beside it."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from ladar_volume.io.bags import BY_NAME, INSTEAD, ROLES, BagReader, Recording
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.nodes.message_classes import needed_class

RELIABLE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE
)


#: Listeners are all there when their numbers have not changed for so long, s: a log listens, too,
#: and may be found before the node that georeferences.
SETTLED_S = 1.0
#: How long listeners may take to have what was sent at last, s.
TAKEN_S = 5.0


class Player(Node):
    """Plays the topics a volume needs under their usual names."""

    def __init__(self, bag: Recording, topics: dict[str, str], rate: float, **options: Any) -> None:
        super().__init__("player", **options)
        self._bag, self._topics, self._rate = bag, topics, rate
        self._clock_out = self.create_publisher(Clock, "/clock", RELIABLE)
        recorded, self._out = bag.topics(), {}
        for role, topic in topics.items():
            kind = recorded[topic][0]
            usual = dict([ROLES[role], *([s[role] for s in (INSTEAD, BY_NAME) if role in s])])[kind]
            self._out[topic] = self.create_publisher(needed_class(kind), usual, RELIABLE)
        self.sent: dict[str, int] = dict.fromkeys(topics, 0)
        self._listeners: tuple[int, ...] = ()
        self._changed = time.monotonic()
        self.share = 0.0
        self.done = threading.Event()
        self.stop = threading.Event()

    def ready(self, wanted: int = 1) -> bool:
        """Whether so many listen to every topic that is played, and nobody came since a while."""
        needed = [t for role, t in self._topics.items() if role in ("cloud", "fix", "imu")]
        listeners = tuple(self._out[t].get_subscription_count() for t in needed)
        if listeners != self._listeners:
            self._listeners, self._changed = listeners, time.monotonic()
        return min(listeners, default=0) >= wanted and time.monotonic() - self._changed > SETTLED_S

    def run(self) -> None:
        """Play to the end; for a thread of its own."""
        began, first = time.monotonic(), self._bag.start_ns
        roles = {topic: role for role, topic in self._topics.items()}
        try:
            for raw in self._bag.raw(set(self._out)):
                if self.stop.is_set():
                    break
                wait = (raw.t_ns - first) * 1e-9 / self._rate - (time.monotonic() - began)
                if wait > 0 and self.stop.wait(wait):
                    break
                self._out[raw.topic].publish(bytes(raw.data))
                self.sent[roles[raw.topic]] += 1
                if roles[raw.topic] == "cloud":
                    self._clock_out.publish(
                        Clock(
                            clock=Time(
                                sec=raw.t_ns // 1_000_000_000, nanosec=raw.t_ns % 1_000_000_000
                            )
                        )
                    )
                    self.share = (raw.t_ns - first) * 1e-9 / max(self._bag.duration_s, 1e-9)
        except LadarVolumeError as error:
            self.get_logger().error(str(error))
        self.done.set()

    def wait_taken(self) -> None:
        """Wait until all listeners have what was sent: what is on its way when a publisher goes is
        lost, to one listener or the other.
        """
        deadline = time.monotonic() + TAKEN_S
        for publisher in self._out.values():
            left = max(deadline - time.monotonic(), 0.1)
            publisher.wait_for_all_acked(Duration(nanoseconds=round(left * 1e9)))


def main(argv: Sequence[str] | None = None) -> int:
    """``player BAG [RATE [LISTENERS]]``: play a recording for nodes that already run, once so many
    listen to every topic, ten seconds later at the latest. A signal ends it in order.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0].startswith("-"):
        print("usage: player BAG [RATE [LISTENERS]]", file=sys.stderr)  # noqa: T201
        return 2
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        with BagReader(words[0]) as bag:
            player = Player(bag, bag.roles(), float(words[1]) if len(words) > 1 else 1.0)
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, lambda *_: player.stop.set())
            deadline = time.monotonic() + 10.0
            wanted = int(words[2]) if len(words) > 2 else 1
            while (
                not (player.stop.is_set() or player.ready(wanted)) and time.monotonic() < deadline
            ):
                rclpy.spin_once(player, timeout_sec=0.1)
            player.run()
            player.wait_taken()
            player.destroy_node()
    except LadarVolumeError as error:
        print(f"ladar_volume: {error}", file=sys.stderr)  # noqa: T201
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
