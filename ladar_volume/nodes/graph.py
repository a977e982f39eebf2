"""The whole graph: nodes composed in one process or each in its own, watched until everything has
drained.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from ladar_volume.compile_kernels import STAGES, load_kernels
from ladar_volume.io.bags import Recording
from ladar_volume.model.errors import ConfigurationError, VolumeError
from ladar_volume.nodes.base import StageNode
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.mavlink_node import MavlinkNode
from ladar_volume.nodes.player import Player
from ladar_volume.nodes.running import TAKE_S, Spinner, before_ros, begin_ros, made
from ladar_volume.nodes.viewers.page_node import PageNode
from ladar_volume.nodes.volume_node import VolumeNode
from ladar_volume.nodes.watch.first_start import compilation_reports
from ladar_volume.nodes.watch.upstream_nodes import own_name
from ladar_volume.page.feed import Feed

if TYPE_CHECKING:
    from ladar_volume.page.foxglove_live import LiveTopics

FACTORIES: dict[str, Callable[..., StageNode]] = {
    "georeference_node": GeoreferenceNode,
    "filter_node": FilterNode,
    "volume_node": VolumeNode,
    "logger_node": LoggerNode,
    "mavlink_node": MavlinkNode,
}
#: Data flows from each to the next: in this order they end, so that each still hears what the one
#: before it finishes.
ENDING = ("mavlink_node", "georeference_node", "filter_node", "volume_node", "logger_node")
#: The graph has drained when its counters have agreed and stood still this long.
STILL_S = 1.5
#: How long a process of one node may take to end, s: those before it have ended.
END_S = TAKE_S + FilterNode.ending_s + FilterNode.stop_s + 5.0


class Watcher(Node):
    """Reads the diagnostics and asks volume_node for its answer."""

    def __init__(self) -> None:
        super().__init__("watcher")
        self.lines: dict[str, dict[str, str]] = {}
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take, 50)
        self._save = self.create_client(Trigger, "volume_node/save")

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = own_name(
                status.name, self.get_namespace()
            )  # other vehicles report there as well
            if name is None:
                continue
            self.lines[name] = {v.key: v.value for v in status.values}

    def number(self, node: str, key: str) -> int:
        """A counter of a node's last diagnostics, −1 where it is not there."""
        try:
            return int(self.lines.get(node, {}).get(key, "-1"))
        except ValueError:
            return -1

    def counters(self) -> tuple[int, ...]:
        """Everything that moves while data is on its way."""
        n = self.number
        return (
            n("georeference_node", "received_cloud"),
            n("georeference_node", "received_imu"),
            n("georeference_node", "queue"),
            n("georeference_node", "sent_points"),
            n("georeference_node", "sent_states"),
            n("filter_node", "count_points"),
            n("filter_node", "count_states"),
            n("filter_node", "pending_update"),
            n("filter_node", "queue"),
            n("filter_node", "count_parts"),
            n("volume_node", "count_parts"),
            n("volume_node", "pending_estimate"),
            n("volume_node", "queue"),
        )

    def is_drained(self) -> bool:
        """Whether every node has handed on all it got."""
        n = self.number
        idle = all(
            n(node, "queue") == 0 for node in ("georeference_node", "filter_node", "volume_node")
        )
        done = n("filter_node", "pending_update") == 0 and n("volume_node", "pending_estimate") == 0
        passed = n("filter_node", "count_points") == n("georeference_node", "sent_points")
        return (
            idle
            and done
            and passed
            and n("volume_node", "count_parts") == n("filter_node", "count_parts")
        )

    def saved(self, timeout_s: float = 60.0) -> Path:
        """The folder of volume_node's ``~/save``. Raises VolumeError where there is no volume or no
        answer.
        """
        if not self._save.wait_for_service(timeout_sec=10.0):
            raise VolumeError("volume_node does not answer", reason="volume_no_node")
        future = self._save.call_async(Trigger.Request())
        deadline = time.monotonic() + timeout_s
        while not future.done() and time.monotonic() < deadline:
            time.sleep(0.02)
        if not future.done():
            raise VolumeError("volume_node gave no answer in time", reason="volume_no_node")
        result: dict[str, Any] = json.loads(future.result().message)
        if not future.result().success:
            raise VolumeError(result["error"], reason=result["reason"])
        return Path(result["folder"])


class Graph:
    """Starts the nodes, plays a recording if asked, waits, answers, stops what it started."""

    def __init__(
        self,
        config: Path,
        separate: bool,
        log: Path | None,
        mavlink: bool = False,
        ros: Sequence[str] = (),
    ) -> None:
        """``ros``: what follows ``--ros-args``, for all nodes."""
        self._spinners: dict[str, Spinner] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        wanted = {"logger_node": log is not None, "mavlink_node": mavlink}
        names = [n for n in FACTORIES if wanted.get(n, True)]
        self._names = set(names)
        for stage in (
            STAGES
        ):  # once here, so that processes do not compile the same kernels beside each other
            with compilation_reports(lambda words: None):
                load_kernels(stage)
        before_ros()
        begin_ros(["--ros-args", *ros] if ros else [])
        try:
            self.watcher = Watcher()
            self._add(self.watcher)
            for name in names:
                self._start(name, config, log, separate, ros)
        except BaseException:
            self.close()  # threads of ROS that outlive the interpreter abort it
            raise

    def _start(
        self, name: str, config: Path, log: Path | None, separate: bool, ros: Sequence[str]
    ) -> None:
        settings = {"config_file": str(config)} | (
            {"logger.path": str(log)} if name == "logger_node" else {}
        )
        if separate:
            words = [w for key, value in settings.items() for w in ("-p", f"{key}:={value}")]
            command = [
                sys.executable,
                "-m",
                "ladar_volume.nodes.programs",
                name,
                "--ros-args",
                *words,
                *ros,
            ]
            self._processes[name] = subprocess.Popen(command, env=os.environ)
        else:
            given = [Parameter(k, value=v) for k, v in settings.items()]
            node = made(FACTORIES[name], parameter_overrides=given)
            started = node.autostart()
            self._add(node)
            if not started:
                raise ConfigurationError(f"{name}: {node.failure}")

    def show(self, feed: Feed | None, live: LiveTopics | None) -> None:
        """Keep the page in the field up to date, and hand the topics on to Foxglove."""
        if feed is not None:
            self._add(PageNode(feed))
        if live is not None:
            from ladar_volume.nodes.viewers.foxglove_node import FoxgloveNode  # an extra

            self._add(FoxgloveNode(live))

    def check(self) -> None:
        """Raises VolumeError where a process has ended that should not have."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise VolumeError(
                    f"{name} ended with {process.returncode}", reason="volume_no_node"
                )

    def _add(self, node: Node) -> None:
        self._spinners[node.get_name()] = Spinner(node)

    def wait_ready(self, timeout_s: float = 300.0) -> None:
        """Until every node reports. Raises VolumeError where one does not."""
        deadline = time.monotonic() + timeout_s
        wanted = self._names
        while (
            not wanted <= set(self.watcher.lines)
            or self.watcher.number("volume_node", "joined") != 1
        ):
            self.check()
            if time.monotonic() > deadline:
                missing = (
                    sorted(wanted - set(self.watcher.lines))
                    or "volume_node and filter_node do not find each other"
                )
                raise VolumeError(f"nodes did not start: {missing}", reason="volume_no_node")
            time.sleep(0.05)

    def play(
        self, bag: Recording, topics: dict[str, str], rate: float, progress: Callable[[float], None]
    ) -> Player:
        """Play to the end and wait until the graph has drained."""
        player = Player(bag, topics, rate)
        self._add(player)
        deadline = time.monotonic() + 30.0
        while not player.ready():
            if time.monotonic() > deadline:
                raise VolumeError(
                    "nobody listens to the recording's topics", reason="volume_no_node"
                )
            time.sleep(0.05)
        thread = threading.Thread(target=player.run, daemon=True)
        thread.start()
        try:
            while not player.done.wait(0.1):
                progress(player.share)
            self._wait_drained(player)
        finally:
            player.stop.set()
            thread.join(timeout=5.0)
        return player

    def _wait_drained(self, player: Player, timeout_s: float = 120.0) -> None:
        # losses make the counters disagree for good: then standing still for long enough must do
        seen, since, deadline = (
            self.watcher.counters(),
            time.monotonic(),
            time.monotonic() + timeout_s,
        )
        while time.monotonic() < deadline:
            time.sleep(0.1)
            now = self.watcher.counters()
            if now != seen:
                seen, since = now, time.monotonic()
            still = time.monotonic() - since
            arrived = self.watcher.number("georeference_node", "received_cloud") == player.sent.get(
                "cloud", 0
            )
            if (self.watcher.is_drained() and arrived and still > STILL_S) or still > 8 * STILL_S:
                return

    def close(self) -> None:
        """Stop the nodes and processes this graph started, each once those before it have handed on
        what they had; the log ends last.
        """
        for name in (*ENDING, *(n for n in self._spinners if n not in ENDING)):
            process = self._processes.get(name)
            if process is not None:
                process.terminate()
                try:
                    process.wait(timeout=END_S)
                except subprocess.TimeoutExpired:
                    process.kill()
            if name in self._spinners:
                self._spinners[name].close()
        rclpy.try_shutdown()

    def losses(self) -> dict[str, int]:
        """All losses of all nodes, as their diagnostics name them."""
        total: dict[str, int] = {}
        for lines in self.watcher.lines.values():
            for key, value in lines.items():
                if key.startswith("lost_"):
                    total[key[5:]] = total.get(key[5:], 0) + int(value)
        return dict(sorted(total.items()))
