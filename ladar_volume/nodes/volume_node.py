"""volume_node: filtered points and patches in; TIN, mesh, ground and volumes out. It never holds a
raw point.
"""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock
from rclpy.event_handler import SubscriptionEventCallbacks
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import Empty, Float64
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from ladar_volume.io import cdr, results
from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.meshfiles.body_mesh import join_bodies, write_bodies
from ladar_volume.io.message_tables import (
    filter_update,
    filtered_points,
    ground_columns,
    more_data_columns,
    no_filtered_points,
    volume_columns,
)
from ladar_volume.io.output_set import output_set
from ladar_volume.io.tables import decode
from ladar_volume.model.errors import LadarVolumeError, VolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import Estimate, FilterUpdate, Volume
from ladar_volume.model.verdict import Verdict
from ladar_volume.nodes.base import STEADY, WATCH_S, StageNode
from ladar_volume.nodes.convert import (
    datum_of,
    platform_state,
    table_message,
    time_message,
)
from ladar_volume.nodes.executor_rounds import deserialize
from ladar_volume.nodes.inputs.first_listeners import JOINED
from ladar_volume.nodes.previous_epoch import SinceEpoch
from ladar_volume.nodes.qos import LATCHED, REPORTS, STREAM
from ladar_volume.nodes.running import spin
from ladar_volume.nodes.services.catch_up import CatchUp
from ladar_volume.nodes.services.closed_bodies import ClosedBodies
from ladar_volume.nodes.services.new_surface import NewSurface
from ladar_volume.nodes.stream_passes import StreamPasses
from ladar_volume.nodes.watch.fix_step_lines import doubts_from_lines
from ladar_volume.nodes.watch.upstream_nodes import UpstreamNodes
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.more_data import MoreData

#: Newer data that wait for longer make a volume old, s.
OLD_S = 5.0
#: Why a volume is incomplete whose last update is not.
TORN = "the last update of filter_node did not come whole"
#: The nodes whose losses are those of the volume.
UPSTREAM = ("georeference_node", "filter_node")


class VolumeNode(StageNode):
    """Wraps one VolumeEstimator; estimates after every complete update of the surface."""

    sections = ("budget", "georeference", "filter", "ground", "tin", "volume", "node")
    kernels = "volume"
    upstream = (("points_mapped", "georeference_node"), ("points_filtered", "filter_node"))
    ending_s = 90.0
    runtime_sections = ("node", "ground", "tin", "volume")

    def __init__(self, **options: Any) -> None:
        super().__init__("volume_node", **options)

    def build(self) -> None:
        """Stage, topics, services."""
        self.stage = VolumeEstimator(self.parameters)
        self._lock = threading.Lock()
        self._map = self.parameters.node.map_frame
        self._half: dict[int, dict[str, Any]] = {}
        self._parts: list[FilterUpdate] = []
        self._states: list[Odometry] = []
        self._passes = StreamPasses("platform", "points", "patches")
        self._segment = 0
        self._due = False
        self._mapped = self._checked = float("-inf")
        self._last: Volume | None = (
            None  # no more of the last estimate: its surface would be held beside the new one
        )
        self._why_not = "no surface yet"
        self._epoch = 0
        self._since = SinceEpoch()
        self._more: MoreData | None = None
        self.counts = {"parts": 0, "estimates": 0}
        self._last_estimate_s, self._estimate_began = 0.0, float("-inf")
        self._newest_part, self._late = 0, Verdict()
        self._begun: Any = None
        self._others = UpstreamNodes(self.get_namespace(), UPSTREAM)
        self._make_publishers()
        self.listen("points", PointCloud2, "points_filtered", STREAM)
        self.listen("patches", PointCloud2, "patches", STREAM)
        self.listen("platform", Odometry, "platform", STREAM)
        self.hear_datum()
        self._hear_others()
        self._filter_reset = self.create_client(Trigger, "filter_node/reset")
        self._new_surface = NewSurface(self, lambda answer: self.offer("joined", answer))
        self._make_bodies()
        self._make_services()

    def _hear_others(self) -> None:
        """Their last words count, too, where all end at once."""

        def take(data: bytes, info: Mapping[str, Any]) -> None:
            array = deserialize(data, DiagnosticArray)
            if array is not None:
                self._others.take(array)

        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        self.subscribe("/diagnostics", DiagnosticArray, REPORTS, take, quiet)
        self.create_timer(WATCH_S, self._watch_others, self._group, Clock(clock_type=STEADY))

    def _watch_others(self) -> None:
        others_end = self.ending or self.count_publishers("filter_node/ending") > 0
        self._others.watch(time.monotonic(), others_end)

    def _make_bodies(self) -> None:
        """What ``volume.kind: bodies`` needs beside the surface."""
        self._closed: ClosedBodies | None = None
        self._unsure: list[PointCloud2] = []
        if self.parameters.volume.kind == "bodies":
            self._closed = closed = ClosedBodies(self.parameters, self.offer)
            self.listen("mapped", PointCloud2, "points_mapped", STREAM)
            self._catch_up = CatchUp(self, self._newest_whole, lambda: closed.last_ns)
        else:
            self._catch_up = CatchUp(self, self._newest_whole)

    def _make_publishers(self) -> None:
        self._tin = self.create_publisher(Marker, "tin", LATCHED)
        self._mesh = self.create_publisher(Mesh, "mesh", LATCHED)
        self._ground = self.create_publisher(PoseWithCovarianceStamped, "ground_plane", LATCHED)
        self._grounds = self.create_publisher(PointCloud2, "grounds", LATCHED)
        self._volumes = self.create_publisher(PointCloud2, "volumes", LATCHED)
        self._more_data = self.create_publisher(PointCloud2, "more_data", LATCHED)
        self._volume = self.create_publisher(Float64, "volume", 10)
        self._sigma = self.create_publisher(Float64, "volume_sigma", 10)
        self._taken = self.create_publisher(Time, "taken", STREAM)

    def _make_services(self) -> None:
        answers = (
            MutuallyExclusiveCallbackGroup()
        )  # they wait for messages, which have to come in meanwhile
        for name, action in (
            ("compute", self._answer),
            ("set_base", self._answer),
            ("save", self._save),
            ("start_epoch", self._start_epoch),
        ):
            self.create_service(Trigger, f"~/{name}", self._service(action), callback_group=answers)

    def all_losses(self) -> Losses:
        """Those of the node and its stage, and what median screen and filter changed at last."""
        total = super().all_losses()
        total.merge(self.stage.screen_losses)
        return total

    def _newest_whole(self) -> int:
        """Stamp (ns) of the last part of the surface, 0 while poses for it are on their way."""
        return 0 if self.stage.awaits_path else self._newest_part

    def _start_over(self, stage: VolumeEstimator | None = None, keep_returns: bool = False) -> None:
        self.losses.merge(self.stage.losses)
        if not keep_returns:
            self._new_surface.forget()
            if self._closed is not None:
                self._closed.clear()
        self.stage, self._half, self._parts = (
            VolumeEstimator(self.parameters) if stage is None else stage,
            {},
            [],
        )
        self._states, self._due, self._why_not, self._last, self._more = (
            [],
            False,
            "no surface yet",
            None,
            None,
        )

    def apply_live_parameters(self) -> None:
        """New base, outline or ground: the next estimate uses it."""
        if hasattr(self, "stage"):
            self.offer("parameters", self.parameters)

    def work(self, kind: str, item: Any) -> None:
        """Pair the two tables of an update by their stamp, and hand updates and states to the
        stage.
        """
        with self._lock:
            self._work(kind, item)

    def _work(self, kind: str, item: Any) -> None:
        if kind == "reset":
            self._since = SinceEpoch()
            self._new_surface.again(wanted=True)
            return self._start_over()
        if kind == "joined":
            return self._begin(item)
        if kind == "parameters":
            self._due = True
            return None
        if kind == "datum":
            if self.take_datum(datum_of(item)):
                self._since = SinceEpoch()
                self._start_over()
            return None
        if kind == "bodies":
            return self._take_bodies()
        verdict = self._passes.take(kind, stamp_ns(item))
        if verdict == "old":
            return self.losses.add("message_before_restart")
        if verdict == "wait":
            return self._unsure.append(item)
        if verdict == "new":
            self._newest_part = 0
            self._start_over()
        unsure, self._unsure = self._unsure, []
        for message in (*unsure, *([item] if kind == "mapped" else [])):
            self._take_mapped(message)
        if kind == "mapped":
            return None
        if kind == "platform":
            self._states.append(item)
            if self.stage.awaits_path:
                self._hand_over()
                self.wake()
            return None
        return self._pair(kind, item)

    def _take_mapped(self, message: PointCloud2) -> None:
        if self._closed is not None:
            self._closed.take(message)
            if self._catch_up.waits:
                self.wake()

    def _take_bodies(self) -> None:
        """Closed bodies that the thread has made: publish them."""
        if self._closed is None:
            return
        try:
            found = self._closed.done(lambda: self.stage.epoch().sources, self.parameters)
            if found is not None:
                self._publish_volumes(self._rows())
                self._mesh.publish(cdr.mesh_of(*join_bodies([b.body for b in found.bodies])))
        finally:
            self.wake()

    def _rows(self) -> list[Volume]:
        """The closed bodies as rows of ``volumes``."""
        if self._closed is None or self._closed.found is None:
            return []
        from ladar_volume.clouds.survey.survey_bodies import volume_rows

        return volume_rows(self._closed.found, self._closed.found_ns, self.parameters)

    def _pair(self, kind: str, item: PointCloud2) -> None:
        key = stamp_ns(item)
        pair = self._half.setdefault(key, {})
        pair[kind] = item
        if len(pair) < 2:
            while len(self._half) > 1000:  # a half whose other half was lost
                self._half.pop(next(iter(self._half)))
                self.losses.add("message_unpaired_update")
            return
        del self._half[key]
        points = (
            filtered_points(decode(pair["points"]))
            if pair["points"].width
            else no_filtered_points()
        )
        update = filter_update(points, decode(pair["patches"]))
        self.counts["parts"] += 1
        self._parts.append(update)
        if update.complete:  # half an update would lack the cross covariances with its other half
            parts, self._parts = self._parts, []
            self._taken.publish(time_message(key))
            if self._new_surface.waits:
                self._new_surface.hold(key, parts)
            else:
                self._take_update(key, parts)

    def _take_update(self, key: int, parts: list[FilterUpdate]) -> None:
        self._hand_over()
        for part in parts:
            self.stage.add(part)
        self._due, self._newest_part = True, key
        if self._catch_up.waits:
            self.wake()

    def _hand_over(self) -> None:
        if self._states:
            states, self._segment = platform_state(self._states, self._segment)
            self._states = []
            self.stage.add_platform(states)

    def idle(self) -> None:
        """Estimate when an update is complete: at once when nothing more waits, else at most half
        of the time, so that a late estimator skips updates but does not fall behind.
        """
        if self._new_surface.due():
            self._join()
        waited = time.monotonic() - self._estimate_began
        if self._due and (self.queue.empty() or waited > 2.0 * self._last_estimate_s):
            if self.stage.awaits_path:  # topics keep no order among each other
                return
            with self._lock:
                self._compute()

    def _join(self) -> None:
        """Have the filter begin anew. The path so far stays: returns that the filter had not yet
        read when it began anew refer to it.
        """
        with self._lock:
            self._hand_over()
            self._start_over(self.stage.with_same_path(), keep_returns=True)
            self._new_surface.ask()

    def _begin(self, answer: tuple[int, int]) -> None:
        """The filter has begun for this node: from now on georeference_node sends."""
        for key, parts in self._new_surface.begin(answer):
            self._take_update(key, parts)
        if self._begun is None:
            self._begun = self.create_publisher(Empty, JOINED, LATCHED)

    def finish(self) -> None:
        """The last estimate, if anything is new, said once more in the log."""
        try:
            with self._lock:
                checked = self._checked >= self._estimate_began
                if self._due or (self._last and (self._states or not checked)):
                    self._compute(ask_all=True)  # the last poses count in sigma
                if self._closed is not None and self._closed.ended():
                    self._take_bodies()
        finally:
            self._log_last_words()

    def _log_last_words(self) -> None:
        """The volume at the end; that it lacks data, or why there is none."""
        v, log = self._last, self.get_logger()
        if self._closed is not None:
            log.info(self._closed.last_words())
        found = (
            f"none, {self._why_not}"
            if v is None
            else f"{v.volume_m3:.4f} m3, sigma {v.sigma_m3:.4f} m3"
        )
        half = self._half or self._parts or self.stage.awaits_path
        torn = TORN if half or self._others.sent_ns() > self._newest_part else ""
        waiting = self._others.waiting_text() if self.cut_off else ""
        untaken = self._others.untaken_text()
        lacking = "; ".join(filter(None, (waiting or torn, self._new_surface.words(), untaken)))
        if lacking:
            log.warning(f"incomplete volume: {found}; {lacking}: replay the log")
        elif v is None:
            log.info(f"no volume at the end: {self._why_not}")
        else:
            log.info(f"volume at the end: {found}")

    def _compute(self, naive: bool = False, ask_all: bool = False) -> Estimate:
        self._hand_over()
        if self.stage.parameters is not self.parameters:
            self.stage.set_parameters(self.parameters)
        self._due = False
        self._estimate_began = now = time.monotonic()
        ask_all = ask_all or now - self._checked >= self.parameters.node.check_period_s
        try:
            self._since.compare(self.stage)
            estimate = self.stage.estimate(naive, ask_all)
        except LadarVolumeError as error:
            self._why_not, self._last = str(error), None  # an older volume is none of these data
            if error.reason == "volume_no_navigation" and not self.stage.awaits_path:
                # the filter held returns from before this node listened: once more
                self._new_surface.again(wanted=False)
            self._publish_volumes([])  # a pit is no body above its ground, and yet a change
            raise
        finally:
            self._last_estimate_s = time.monotonic() - self._estimate_began
        self._checked = now if ask_all else self._checked
        self.counts["estimates"] += 1
        self._last = estimate.volume
        self._publish(estimate)
        return estimate

    def _publish_volumes(self, bodies: list[Volume]) -> None:
        rows = [*bodies, *self._since.rows()]
        if rows:
            self._volumes.publish(table_message(volume_columns(rows), rows[0].t_ns, self._map))

    def _publish(self, estimate: Estimate) -> None:
        v = estimate.volume
        if self._closed is None:
            self._publish_volumes(list(estimate.bodies))
        else:
            self._closed.begin(estimate, self.parameters)
        if estimate.grounds:
            grounds = ground_columns(estimate.grounds)
            self._grounds.publish(table_message(grounds, v.t_ns, self._map))
        self._volume.publish(Float64(data=v.volume_m3))
        self._sigma.publish(Float64(data=v.sigma_m3))
        self._ground.publish(cdr.ground_plane(estimate, self._map))
        # maps are megabytes: they follow at their own pace
        if time.monotonic() - self._mapped >= self.parameters.node.map_period_s:
            self._mapped = time.monotonic()
            self._more = self.stage.more_data()
            self._more_data.publish(table_message(more_data_columns(self._more), v.t_ns, self._map))
            # latched: who looks later sees the last one, without asking for a volume
            by_sigma = self.parameters.node.tin_colour == "sigma"
            height = (
                self.stage.epoch().sigma_z(estimate.tin)
                if by_sigma
                else estimate.tin.vertices[:, 2]
            )
            self._tin.publish(cdr.tin_marker(estimate, height, self._map))
            if self._closed is None:
                self._mesh.publish(cdr.mesh(estimate))

    def _result(self) -> tuple[Estimate, dict[str, Any]]:
        estimate = self._compute(naive=True, ask_all=True)
        verdict = estimate.volume.verdict
        step = doubts_from_lines(self._others.lines("georeference_node"), verdict)
        verdict = verdict + self._others.verdict() + self._late + step
        verdict = verdict + self._new_surface.verdict()
        volume = dataclasses.replace(estimate.volume, verdict=verdict)
        estimate = dataclasses.replace(estimate, volume=volume)
        self._more = self.stage.more_data()
        result = results.result_dict(
            estimate, self.parameters, self.all_losses(), self._datum, {}, {"node": self.get_name()}
        )
        change = None if self._since.change is None else results.change_dict(self._since.change)
        if self._closed is not None:
            found = self._closed.present()
            result["closed_bodies"] = results.closed_bodies_dict(found)
            result["closed_bodies_time_ns"] = self._closed.found_ns
            result["verdict"] = results.with_doubts(result["verdict"], found.verdict)
        return estimate, result | {
            "losses_upstream": self._others.losses(),
            "returns_waiting_for_poses": self._catch_up.returns_waiting,
            "where_more_data_helps": results.more_data_dict(self._more),
            "epoch": change,
        }

    def _service(self, action: Callable[[], dict[str, Any]]) -> Any:
        async def call(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            self._late = await self._catch_up()
            if not self._late.sound:
                self.losses.add("message_filter_late")
            try:
                if self._closed is not None:
                    await self._closed.wait_for_all(self._begin_bodies)
                with self._lock:
                    response.message = json.dumps(results.finite(action()))
                response.success = True
            except LadarVolumeError as error:
                response.success, response.message = (
                    False,
                    json.dumps({"error": str(error), "reason": error.reason}),
                )
            except Exception as error:  # who asked is told, too
                self.defect(error)
                answer = {
                    "error": f"{type(error).__name__}: {error}",
                    "reason": "message_internal_error",
                }
                response.success, response.message = False, json.dumps(answer)
            return response

        return call

    def _begin_bodies(self) -> None:
        with self._lock:
            estimate = self._compute(ask_all=True)
            if self._closed is not None:
                self._closed.begin(estimate, self.parameters, immediately=True)

    def _answer(self) -> dict[str, Any]:
        return self._result()[1]

    def _save(self) -> dict[str, Any]:
        estimate, result = self._result()
        folder = Path(self.parameters.node.output_folder)
        self._write(folder, estimate, result)
        return {
            "folder": str(folder),
            "volume_m3": result["volume_m3"],
            "sigma_m3": result["sigma_m3"],
        }

    def _write(self, folder: Path, estimate: Estimate, result: dict[str, Any]) -> None:
        from ladar_volume.io.surveys import (
            FILE,
            write_survey,
        )  # what bags need is loaded where one is written

        epoch = self.stage.epoch()
        with output_set(folder, results.SURVEY_FILES) as part:
            results.write_text(part / "result.json", results.json_text(result))
            results.write_ply(part / "mesh.ply", estimate.tin, epoch.sigma_z(estimate.tin))
            write_survey(part / FILE, estimate, epoch, result)
            if self._closed is not None:
                write_bodies(part / "bodies.ply", [b.body for b in self._closed.present().bodies])

    def _start_epoch(self) -> dict[str, Any]:
        if self._last is None:
            raise VolumeError(
                f"nothing to keep as an epoch: {self._why_not}", reason="volume_no_estimate"
            )
        folder = Path(f"{self.parameters.node.output_folder}/epoch_{self._epoch}")
        estimate, result = self._result()
        self._write(folder, estimate, result)
        self._epoch += 1
        self._since.keep(self.stage.epoch())
        if self._filter_reset.service_is_ready():
            self._filter_reset.call_async(Trigger.Request())
        self._start_over(self.stage.with_same_path())
        return {"kept": str(folder), "epoch": self._epoch, "volume_m3": result["volume_m3"]}

    def warnings(self) -> list[str]:
        """No volume while there is a surface, or one that is old."""
        if not self.counts["parts"]:
            return []
        if self._last is None:
            return [f"no volume: {self._why_not}"]
        age = time.monotonic() - self._estimate_began
        if self._due and age > OLD_S + 3.0 * self._last_estimate_s:
            return [f"the volume is {age:.0f} s old and newer data wait"]
        return []

    def status(self) -> dict[str, Any]:
        """The present estimate against the wanted tolerance."""
        lines: dict[str, Any] = {f"count_{k}": v for k, v in self.counts.items()} | {
            "joined": int(self._new_surface.joined),
            "pending_estimate": int(self._due),
            "last_estimate_s": f"{self._last_estimate_s:.2f}",
            "restarts": self._passes.begun,
            **self._since.lines(),
            **({} if self._closed is None else self._closed.lines()),
        }
        for number, place in enumerate(
            [] if self._more is None else self._more.best_cells(), start=1
        ):
            lines[f"more_data_{number}"] = (
                f"{place['x_m']:.2f} {place['y_m']:.2f} {place['gain_m3']:.4f} {place['why']}"
            )
        if self._last is None:
            return lines | {"estimate": self._why_not}
        v = self._last
        share = v.sigma_m3 / abs(v.volume_m3) if v.volume_m3 else float("inf")
        return lines | {
            "volume_m3": f"{v.volume_m3:.4f}",
            "sigma_m3": f"{v.sigma_m3:.4f}",
            "sigma_share": f"{share:.4f}",
            "tolerance": self.parameters.volume.tolerance,
            "within_tolerance": v.verdict.sound and share <= self.parameters.volume.tolerance,
            "verdict": v.verdict.status,
            **{f"doubt_{doubt.name}": doubt.text for doubt in v.verdict.doubts},
            "seen_share": f"{v.seen_share:.4f}",
            "coverage_m2": f"{v.area_m2:.1f}",
            "data_time_ns": v.t_ns,
        }


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(VolumeNode, argv)
