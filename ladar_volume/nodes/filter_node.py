"""filter_node: mapped points and platform states in; filtered points and patches out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.message_tables import (
    filtered_columns,
    mapped_points,
    patch_columns,
    update_parts,
)
from ladar_volume.io.tables import decode
from ladar_volume.model.records import FilterUpdate
from ladar_volume.nodes.base import StageNode
from ladar_volume.nodes.convert import datum_of, platform_state, table_message, time_ns
from ladar_volume.nodes.flow_control import UnacknowledgedBytes
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import spin
from ladar_volume.nodes.stream_passes import StreamPasses
from ladar_volume.rmls.surface_filter import SurfaceFilter

#: Patches refitted per second of an update, before any has been measured; updates with fewer than
#: so many measure nothing.
FIRST_RATE, LEAST_MEASURED = 2000.0, 50
#: Time of an update as a share of the pause between two; how long no data must have come until an
#: update need not wait for more, and until there is no hurry.
SHARE, BETWEEN_S, QUIET_S = 1.0 / 3.0, 0.15, 0.3
#: How long a node that ends waits until volume_node has taken the last update, s.
TAKEN_S = 15.0
#: Patches refitted by one update of a flush, about: all of a large site at once would take as much
#: room as all of its patches, and small pieces are refitted again at their rims.
MOST = 2000


class FilterNode(StageNode):
    """Wraps one SurfaceFilter; brings its surface up to date, with a pause of
    ``node.update_period_s`` between.
    """

    sections = ("calibration", "georeference", "filter", "node")
    kernels = "filter"
    upstream = (("points_mapped", "georeference_node"),)
    stop_s = 60.0
    runtime_sections = ("node",)

    def __init__(self, **options: Any) -> None:
        super().__init__("filter_node", **options)

    def build(self) -> None:
        """Stage, topics."""
        self.stage = SurfaceFilter(self.parameters, deferring=True)
        self._patches_per_s = FIRST_RATE
        self._came, self._just_came = time.monotonic(), False
        self._passes = StreamPasses("platform")
        self._unsure: list[PointCloud2] = []
        self._segment = 0
        self._states: list[Odometry] = []
        self._fresh = False
        self._updated = time.monotonic()
        self.counts = {"updates": 0, "parts": 0, "points": 0, "states": 0}
        self._last_update_s = 0.0
        self._points = self.create_publisher(PointCloud2, "points_filtered", STREAM)
        self._patches = self.create_publisher(PointCloud2, "patches", STREAM)
        #: Stamps of the last part sent, and of the last mapped points that are in the surface.
        self._sent_ns = self._taken_ns = 0
        #: Messages of points and states for the present surface.
        self._since_begin = 0
        self._ahead = UnacknowledgedBytes()
        self.create_subscription(
            Time,
            "taken",
            lambda m: self._ahead.acknowledge(time_ns(m)),
            STREAM,
            callback_group=self._group,
        )
        self.create_service(
            Trigger, "~/flush", self.flush, callback_group=MutuallyExclusiveCallbackGroup()
        )
        self.listen("points", PointCloud2, "points_mapped", STREAM)
        self.listen("platform", Odometry, "platform", STREAM)
        self.hear_datum()

    def work(self, kind: str, item: Any) -> None:
        """Hand points and states to the stage. A flush sends all that was put off; its answer is
        the stamps (ns) of the last part sent and of the last mapped points taken. That of a reset
        is the stamp of the last part of the surface that ends, and how many messages were taken
        for it.
        """
        if kind == "reset":
            item.set_result(f"{self._sent_ns} {self._since_begin}")
            self.wake()
            return self._start_over()
        if kind == "flush":
            try:
                self._catch_up()
            finally:
                item.set_result(f"{self._sent_ns} {self._taken_ns}")
                self.wake()
            return None
        if kind == "datum":
            return self._start_over() if self.take_datum(datum_of(item)) else None
        verdict = self._passes.take(kind, stamp_ns(item))
        if verdict == "old":
            self.counts["points"] += item.width if kind == "points" else 0
            return self.losses.add("message_before_restart")
        if verdict == "wait":
            return self._unsure.append(item)
        if verdict == "new":
            self._sent_ns = self._taken_ns = 0
            self._start_over()
        self._since_begin += 1
        if kind == "points":
            return self._add(item)
        self._states.append(
            item
        )  # handed over in blocks: one small array operation per state would cost more
        if len(self._states) >= 10:
            self._hand_over()
        unsure, self._unsure = self._unsure, []
        for message in unsure:
            self._add(message)
        return None

    def _add(self, message: PointCloud2) -> None:
        self._hand_over()
        points = mapped_points(stamp_ns(message), decode(message))
        self.stage.add(points)
        self.counts["points"] += len(points)
        self._taken_ns = stamp_ns(message)
        self._fresh, self._just_came, self._came = True, True, time.monotonic()

    def _start_over(self) -> None:
        self.losses.merge(self.stage.losses)
        self.stage = SurfaceFilter(self.parameters, deferring=True)
        # taken, like those in the stage, though the surface they belong to has ended
        self.counts["states"] += len(self._states)
        self._states, self._fresh, self._since_begin = [], False, 0
        self._ahead.forget()

    def _hand_over(self) -> None:
        if self._states:
            states, self._segment = platform_state(self._states, self._segment)
            self.counts["states"] += len(self._states)
            self._states = []
            self.stage.add_platform(states)
            self._fresh = True

    def _catch_up(self) -> None:
        """Send all that was put off, no faster than it is taken."""
        self._hand_over()
        while self.stage.stats["points_deferred"]:
            self._ahead.may_send(wait=True)
            self._send(self.stage.update(MOST))
        self._fresh = False

    def idle(self) -> None:
        """Publish an update when its time has come and something is new. While data comes it begins
        with new points, takes about :data:`SHARE` of the pause between two, and leaves for the next
        what changes least; once none comes there is no pause until nothing is left. While messages
        wait, at most every third of the time goes into updates; while volume_node is behind, none.
        """
        now, period = time.monotonic(), self.parameters.node.update_period_s
        waited, late, just_came, self._just_came = (
            now - self._updated,
            not self.queue.empty(),
            self._just_came,
            False,
        )
        quiet = not late and now - self._came > QUIET_S
        # between two clouds an update would only be of older points than one with the next
        due = waited >= period and (just_came or now - self._came > BETWEEN_S)
        if (
            not self._fresh
            or not (due or quiet)
            or (late and waited < 2.0 * self._last_update_s)
            or not self._ahead.may_send()
        ):
            return
        self._hand_over()
        update = self.stage.update(
            max(round((1.0 if quiet else SHARE) * period * self._patches_per_s), 1)
        )
        self._fresh = self.stage.stats["points_deferred"] > 0
        self._send(update)
        # the pause counts from the end: a slow machine spends at most its share on updates, and the
        # estimate gets its turn
        self._updated = time.monotonic()
        self._last_update_s = self._updated - now
        if self.stage.refitted_count >= LEAST_MEASURED:
            self._patches_per_s += 0.3 * (
                self.stage.refitted_count / self._last_update_s - self._patches_per_s
            )

    def finish(self) -> None:
        """The last update; whoever takes it has it before this node goes, for what is still on its
        way then is lost.
        """
        self._catch_up()
        self._send(self.stage.finish())
        began = time.monotonic()
        while self.ending and self.count_publishers("taken") > 0:
            if self._ahead.all_taken(0.1) or time.monotonic() - began > TAKEN_S:
                return

    def _send(self, update: FilterUpdate | None) -> None:
        if update is not None:
            # the stamp pairs the two tables: a nanosecond more where that of the data would come
            # again
            frame = self.parameters.node.map_frame
            first, heard = max(update.t_ns, self._sent_ns + 1), self.count_publishers("taken") > 0
            if not heard:
                self._ahead.forget()
            for self._sent_ns, part in enumerate(update_parts(update), start=first):
                patches, points = patch_columns(part), filtered_columns(part.points)
                if heard:
                    self._ahead.record_sent(
                        self._sent_ns,
                        sum(
                            column.nbytes
                            for table in (patches, points)
                            for column in table.values()
                        ),
                    )
                self._patches.publish(table_message(patches, self._sent_ns, frame))
                self._points.publish(table_message(points, self._sent_ns, frame))
                self.counts["parts"] += 1
            self.counts["updates"] += 1

    def received_counts(self) -> dict[str, int]:
        """Messages by input, and points."""
        return super().received_counts() | {"point": self.counts["points"]}

    def status(self) -> dict[str, Any]:
        """Size of the surface, what was sent, and whether something waits for the next update."""
        return {
            **self.stage.stats,
            **{f"count_{k}": v for k, v in self.counts.items()},
            "pending_update": int(self._fresh or bool(self._states)),
            "last_update_s": f"{self._last_update_s:.2f}",
            "deferred_s": f"{self.stage.deferred_s:.2f}",
            "restarts": self._passes.begun,
            "sent_ns": self._sent_ns,
            "ahead_bytes": self._ahead.bytes,
        }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(FilterNode, argv)
