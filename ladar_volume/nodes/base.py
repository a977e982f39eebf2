"""What every node is: a lifecycle node with declared parameters, one worker thread, a counted queue
and diagnostics.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import itertools
import queue
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode, State, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from ladar_volume.io.cloud_messages import stamp_ns
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import ConfigurationError, LadarVolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameter import specs
from ladar_volume.model.parameters import SECTIONS, CalibrationParameters, Parameters
from ladar_volume.model.records import Datum
from ladar_volume.nodes.declared_parameters import (
    check_given,
    descriptor,
    launch_refusal,
    plain_value,
    runtime_refusal,
)
from ladar_volume.nodes.executor_rounds import AT_ONCE, deserialize, take_waiting, worked_off
from ladar_volume.nodes.frames.static_mounting import mounting_from_frames
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.stream_passes import OnePublisher
from ladar_volume.nodes.watch.defect_reports import Defects
from ladar_volume.nodes.watch.first_start import compilation_reports
from ladar_volume.nodes.watch.health import Health
from ladar_volume.nodes.watch.loss_shares import LossShares
from ladar_volume.nodes.work_queue import WorkQueue
from ladar_volume.process import memory
from ladar_volume.process.switch import is_own_process

#: How long a node that is to end waits for those before it, s.
UPSTREAM_S = 2.0
#: How long a node that ends waits for listeners to have what it sent, s.
ACKED_S = 10.0
#: How often a node looks who publishes, and who ends, s.
WATCH_S = 0.2
STEADY = ClockType.STEADY_TIME


def _stamp(item: Any) -> int | None:
    """The header stamp of a message (ns), None for what has none."""
    return stamp_ns(item) if hasattr(item, "header") else None


class StageNode(LifecycleNode, ABC):
    """Base of the nodes. A subclass names its sections, builds its stage in :meth:`build` and
    handles work items in :meth:`work`, which runs in the one worker thread; callbacks only queue.
    """

    sections: tuple[str, ...] = ("node",)
    #: Sections whose parameters may change while the node runs.
    runtime_sections: tuple[str, ...] = ()
    #: Topics that come from this package's nodes before this one, with those nodes, the first of
    #: all first.
    upstream: tuple[tuple[str, str], ...] = ()
    #: How long it waits at its end for those that have said that they end, s: they work off their
    #: queues, each after those before it.
    ending_s: float = 25.0
    #: How long it may take to finish its work, s.
    stop_s: float = 30.0
    #: The stage whose compiled kernels must be ready before data comes; without one, no compiler is
    #: loaded.
    kernels: str | None = None

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.losses = Losses()
        self.failure = ""
        self.cut_off = self.ending = self.finished = False
        self._defects = Defects()
        self.health = Health()
        self._shares = LossShares()
        self.queue = WorkQueue()
        self._worker: threading.Thread | None = None
        self._group = MutuallyExclusiveCallbackGroup()
        self._active = False
        self._busy = False
        self._before_build: set[int] = set()
        self._rests: dict[str, Callable[[], int]] = {}
        self._jumps_back = 0
        #: Where boresight and lever arms come from, in words; the calibration as it was given.
        self.mounting = ""
        self._configured: CalibrationParameters | None = None
        self.parameters = self._declare()
        self.add_on_set_parameters_callback(self._on_set)
        # a simulated clock that goes back is named here; what it means for the data, the data
        # itself tells
        back = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self.get_clock().create_jump_callback(back, post_callback=self._on_clock_jump)

    def _on_clock_jump(self, jump: TimeJump) -> None:
        self._jumps_back += 1

    # parameters
    # ----------------------------------------------------------------------------------------------
    def _declare(self) -> Parameters:
        read_once = ParameterDescriptor(
            description="Parameter file in the ROS layout, read at the start.", read_only=True
        )
        file = self.declare_parameter("config_file", "", read_once).value
        start = read_config(file or None)
        check_given(self._parameter_overrides, start)
        given = start.write()
        for section in self.sections:
            for spec in specs(SECTIONS[section]):
                value = given[section][spec.key]
                self.declare_parameter(
                    f"{section}.{spec.key}", value if value != [] else [0.0][:0], descriptor(spec)
                )
        values = {
            s: {
                k.key: plain_value(self.get_parameter(f"{s}.{k.key}").value)
                for k in specs(SECTIONS[s])
            }
            for s in self.sections
        }
        return Parameters.read(values, start).checked()

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        values: dict[str, dict[str, Any]] = {}
        for change in changes:
            section, dot, key = change.name.partition(".")
            if not dot or section not in SECTIONS:
                continue
            reason = launch_refusal(change.name)
            if reason is None and self._worker is not None:
                reason = runtime_refusal(change.name, self.runtime_sections)
            if reason is not None:
                return SetParametersResult(successful=False, reason=reason)
            values.setdefault(section, {})[key] = plain_value(change.value)
        if not values:
            return SetParametersResult(successful=True)
        try:
            parameters = Parameters.read(values, self.parameters).checked()
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.parameters = parameters
        if self._worker is not None:
            self._timer.timer_period_ns = round(parameters.node.diagnostics_period_s * 1e9)
            self.apply_live_parameters()
        return SetParametersResult(successful=True)

    def apply_live_parameters(self) -> None:
        """Take over run-time parameters; for subclasses."""

    # lifecycle
    # ----------------------------------------------------------------------------------------------
    @abstractmethod
    def build(self) -> None:
        """Create stage, publishers, subscriptions and services."""

    @abstractmethod
    def work(self, kind: str, item: Any) -> None:
        """Handle one queued item in the worker thread."""

    def idle(self) -> None:
        """Called by the worker after items and at least every 50 ms; for periodic work."""

    def finish(self) -> None:
        """The worker's last act: bring to an end what was taken in."""
        self.idle()

    def status(self) -> dict[str, Any]:
        """The node's own lines in the diagnostics."""
        return {}

    def warnings(self) -> list[str]:
        """What the node itself finds wrong, in words; for subclasses."""
        return []

    def errors(self) -> list[str]:
        """What makes the node's results wrong or keeps them away, in words; for subclasses."""
        return []

    def received_counts(self) -> dict[str, int]:
        """What came so far, by the unit that losses count: a cloud, a fix, a point."""
        return self.health.counts()

    def on_configure(self, state: State) -> TransitionCallbackReturn:
        """Build everything, kernels included, and start the worker."""
        self._before_build = {id(e) for _, e in self._entities()}
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        try:
            if self.kernels is not None:
                with compilation_reports(self._tell_first_start):
                    kernels = importlib.import_module("ladar_volume.compile_kernels")
                    kernels.load_kernels(self.kernels)
            if "calibration" in self.sections:
                self._mount()
            self.build()
        except LadarVolumeError as error:
            self.failure = str(error)
            self.get_logger().error(self.failure)
            self._take_down()
            return TransitionCallbackReturn.FAILURE
        # by a steady clock: a simulated one may stand still, and then one wants to see why
        self._timer = self.create_timer(
            self.parameters.node.diagnostics_period_s,
            self.publish_diagnostics,
            self._group,
            Clock(clock_type=STEADY),
        )
        answers = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "~/reset", self._reset, callback_group=answers)
        self.finished = False
        self._worker = threading.Thread(target=self._run, name=self.get_name(), daemon=True)
        self._worker.start()
        return TransitionCallbackReturn.SUCCESS

    def _tell_first_start(self, words: str) -> None:
        """How far the compiler is: the only diagnostics of a node that is not configured yet."""
        array = DiagnosticArray(status=[self._status_of([], [words])])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _mount(self) -> None:
        """Take the mounting from /tf_static where the configuration has none."""
        self._configured = self.parameters.calibration
        found = mounting_from_frames(self, self.parameters)
        self.parameters, self.mounting = found.parameters, "; ".join(found.words)

    def on_activate(self, state: State) -> TransitionCallbackReturn:
        """Begin to take in data."""
        self._active = True
        if self.kernels is not None and is_own_process():
            memory.tidy()
        return super().on_activate(state)

    def on_deactivate(self, state: State) -> TransitionCallbackReturn:
        """Take in no more; what is queued is still worked off."""
        self._active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: State) -> TransitionCallbackReturn:
        """Finish the work in the queue, then take down what :meth:`on_configure` built; the node
        can be configured again.
        """
        self.stop()
        self._take_down()
        self._worker = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: State) -> TransitionCallbackReturn:
        """Finish the work in the queue."""
        self.stop()
        return TransitionCallbackReturn.SUCCESS

    def _entities(self) -> list[tuple[Callable[[Any], Any], Any]]:
        kinds = (
            (self.destroy_subscription, self.subscriptions),
            (self.destroy_publisher, self.publishers),
            (self.destroy_timer, self.timers),
            (self.destroy_service, self.services),
            (self.destroy_client, self.clients),
        )
        return [(destroy, entity) for destroy, entities in kinds for entity in entities]

    def _take_down(self) -> None:
        for destroy, entity in self._entities():
            if id(entity) not in self._before_build:
                destroy(entity)
        self._rests.clear()
        if self._configured is not None:  # the frames are read anew
            self.parameters = dataclasses.replace(self.parameters, calibration=self._configured)

    def take_all(self) -> None:
        """Take in what the middleware holds for this node, before it stops: the sender was told
        that it came. In the executor's thread.
        """
        for _ in range(STREAM.depth // AT_ONCE):
            if not sum([rest() for rest in self._rests.values()]):
                break

    def await_upstream(self) -> None:
        """Let those whose data this node takes end first, and say on the wire that this one ends;
        what they finish is still taken in. One that does not end is waited for for
        :data:`UPSTREAM_S`, one that has said that it ends for :attr:`ending_s`. Where one outlives
        the next, or this node, data are missing: :attr:`cut_off`.
        """
        if self.context.ok() and self._worker is not None:
            self.create_publisher(Empty, "~/ending", LATCHED)
        self.ending, began = True, time.monotonic()
        while self.context.ok() and self.upstream:
            alive = [self.count_publishers(topic) > 0 for topic, _ in self.upstream]
            self.cut_off |= any(a and not b for a, b in itertools.pairwise(alive))
            if not any(alive) or self.cut_off:
                return
            ends = any(self.count_publishers(f"{node}/ending") > 0 for _, node in self.upstream)
            if time.monotonic() - began > (self.ending_s if ends else UPSTREAM_S):
                return
            time.sleep(0.05)

    def stop(self) -> None:
        """Work off the queue, finish, report for the last time, and wait until listeners have it;
        then the worker has ended.
        """
        self._active = False
        if self._worker is None or not self._worker.is_alive():
            return
        if self.context.ok():
            self.cut_off |= any(self.count_publishers(topic) > 0 for topic, _ in self.upstream)
        self.queue.put(None)
        self._worker.join(timeout=self.stop_s)
        if self._worker.is_alive():
            self.get_logger().error(f"work was not finished within {self.stop_s:g} s")
        if self.context.ok():
            self.publish_diagnostics()
            deadline = time.monotonic() + ACKED_S
            for publisher in self.publishers:
                left = max(deadline - time.monotonic(), 0.1)
                publisher.wait_for_all_acked(Duration(nanoseconds=round(left * 1e9)))

    async def flush(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """A service's answer once all that came before has been worked off: two numbers, which the
        worker sets on the future that it finds in its queue as ``flush``.
        """
        return await worked_off(self.offer, "flush", response)

    async def _reset(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Once the node has begun anew."""
        return await worked_off(self.offer, "reset", response)

    # worker
    # ----------------------------------------------------------------------------------------------
    def offer(self, kind: str, item: Any) -> bool:
        """Queue an item for the worker; a full queue drops it and counts it. Returns whether it was
        queued.
        """
        self.health.record_arrival(kind, time.monotonic(), _stamp(item))
        try:
            self.queue.put_nowait((kind, item))
        except queue.Full:
            self.losses.add(f"message_queue_full_{kind}")
            return False
        return True

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """A publisher without warnings of QoS that do not match: each costs at every message."""
        return super().create_publisher(
            *arguments,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
            **options,
        )

    def listen(
        self,
        kind: str,
        message_type: type[Any],
        topic: str,
        qos: QoSProfile,
        silent_s: float | None = None,
        used: Callable[[bytes, Any], None] = lambda data, info: None,
    ) -> Any:
        """Subscribe: messages go to the worker as ``kind``; what the middleware lost is counted, a
        silence beyond ``silent_s`` named. used : told of each that went to the worker.
        """
        if silent_s is not None:
            self.health.expect(kind, silent_s)

        def lost(event: Any) -> None:
            self.losses.add(f"message_lost_{kind}", max(int(event.total_count_change), 0))

        def take(data: bytes, info: Mapping[str, Any]) -> None:
            if self.receive(kind, message_type, data):
                used(data, info)

        events = SubscriptionEventCallbacks(message_lost=lost)
        return self.subscribe(topic, message_type, qos, take, events)

    def subscribe(
        self,
        topic: str,
        message_type: type[Any],
        qos: QoSProfile,
        receive: Callable[[bytes, Any], None],
        events: Any,
    ) -> Any:
        """Have every message of a topic handed to ``receive`` as bytes, with what the middleware
        says of it.
        """

        def take(data: bytes, info: Mapping[str, Any]) -> None:
            receive(data, info)
            take_waiting(heard, receive)

        self._rests[topic] = lambda: take_waiting(heard, receive)
        heard = self.create_subscription(
            message_type,
            topic,
            take,
            qos,
            raw=True,
            callback_group=self._group,
            event_callbacks=events,
        )
        return heard

    def receive(self, kind: str, message_type: type[Any], data: bytes) -> bool:
        """Queue the message that came as ``data``, where the node is active; bytes that are none of
        its type are dropped and counted. Returns whether it was queued.
        """
        if not self._active:
            return False
        if kind == "datum":
            self._see_datum()
        message = deserialize(data, message_type)
        if message is None:
            self.losses.add(f"message_unreadable_{kind}")
            return False
        return self.offer(kind, message)

    def publishers_of(self, topic: str) -> list[bytes]:
        """Who publishes on a topic, given by its full name, now."""
        return [bytes(p.endpoint_gid) for p in self.get_publishers_info_by_topic(topic)]

    def _run(self) -> None:
        given_back = time.monotonic()
        while True:
            if is_own_process() and time.monotonic() - given_back > memory.GIVE_BACK_S:
                memory.release_memory()
                given_back = time.monotonic()
            try:
                item = self.queue.get(timeout=0.05)
            except queue.Empty:
                self._busy, began = True, time.monotonic()
                self._run_guarded(self.idle)
                self.health.busy(time.monotonic() - began)
                self._busy = False
                continue
            if item is None:
                self._run_guarded(self.finish)
                self.finished = True
                break
            kind, payload = item
            self._busy, began = True, time.monotonic()
            self._run_guarded(partial(self.work, kind, payload))
            if isinstance(payload, Future) and not payload.done():  # whoever waits is told
                payload.set_result(kind)
                self.wake()
            self._run_guarded(self.idle)
            self.health.record_work(kind, time.monotonic() - began, _stamp(payload))
            self._busy = False

    def _run_guarded(self, action: Callable[[], None]) -> None:
        """No input may end a node: a refusal is counted by its reason, a defect is counted and
        logged.
        """
        try:
            action()
        except LadarVolumeError as error:
            self.losses.add(error.reason)
        except Exception as error:
            self.defect(error)

    def defect(self, error: Exception) -> None:
        """Count an exception nobody foresaw, and log it, of one place once a minute."""
        self.losses.add("message_internal_error")
        text = self._defects.report_text(error, time.monotonic())
        if text is not None:
            self.get_logger().error(text)

    def wake(self) -> None:
        """Have the executor look again at services that answer later."""
        if self.executor is not None:
            self.executor.wake()

    # diagnostics
    # ----------------------------------------------------------------------------------------------
    def publish_diagnostics(self) -> None:
        """One DiagnosticStatus with rates, ages, queue length, losses by reason, and the stage's
        own lines.
        """
        values: dict[str, Any] = {
            "queue": self.queue.qsize() + int(self._busy),
            "queue_bytes": self.queue.bytes,
        }
        now, clock = time.monotonic(), self.get_clock().now()
        values |= self.health.lines(now, int(clock.nanoseconds)) | {
            "clock_jumps_back": self._jumps_back,
            "finished": int(self.finished),
        }
        wrong, errors = self.health.silent(now) if self._active else ([], [])
        with contextlib.suppress(
            RuntimeError
        ):  # a dictionary of the worker's changed size under our eyes: next period
            values |= self.status()
            wrong += self.warnings()
            errors += self.errors()
        lost = self.all_losses()
        values |= {f"lost_{reason}": count for reason, count in lost.items()}
        many, most = self._shares.judge(lost.as_dict(), self.received_counts(), now)
        wrong += [*many, *self.health.newly_lost(lost.as_dict())]
        status = self._status_of([*errors, *most], wrong)
        status.values = [KeyValue(key=k, value=str(v)) for k, v in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = clock.to_msg()
        self._diagnostics.publish(array)

    def _status_of(self, errors: list[str], warnings: list[str]) -> DiagnosticStatus:
        """The state under the node's name with its namespace, that of the worst finding."""
        level = DiagnosticStatus.WARN if warnings else DiagnosticStatus.OK
        return DiagnosticStatus(
            level=DiagnosticStatus.ERROR if errors else level,
            name=self.get_fully_qualified_name().lstrip("/"),
            message="; ".join([*errors, *warnings]) or "good",
            hardware_id=self.parameters.node.hardware_id or socket.gethostname(),
        )

    def all_losses(self) -> Losses:
        """The node's and its stage's losses."""
        total = Losses(self.losses.as_dict())
        stage = getattr(self, "stage", None)
        if stage is not None:
            total.merge(stage.losses)
        return total

    def autostart(self, before_data: Callable[[], None] = lambda: None) -> bool:
        """Configure and activate where the parameters say so; False, with :attr:`failure`, where it
        cannot be. before_data : called before the node takes in anything.
        """
        if not self.parameters.node.autostart:
            before_data()
            return True
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            return False
        before_data()
        self.trigger_activate()
        return True

    # the datum
    # ----------------------------------------------------------------------------------------------
    def hear_datum(self) -> None:
        """Subscribe to the datum, and watch who publishes it."""
        self._datum: Datum | None = None
        self._datum_from = OnePublisher()
        self._datum_heard = self.listen("datum", NavSatFix, "datum", LATCHED)
        self.create_timer(WATCH_S, self._watch_datum, self._group, Clock(clock_type=STEADY))

    def _see_datum(self) -> bool:
        there = self.publishers_of(self.resolve_topic_name("datum"))
        return self._datum_from.update_publishers(there, time.monotonic())

    def _watch_datum(self) -> None:
        if self._see_datum():
            self.destroy_subscription(self._datum_heard)  # the successor's last word comes again
            self._datum_heard = self.listen("datum", NavSatFix, "datum", LATCHED)

    def take_datum(self, datum: Datum) -> bool:
        """Whether another datum is to be believed; the first one is. One that somebody else than
        its publisher may have sent is left out, counted and named.
        """
        if self._datum in (None, datum):
            self._datum = datum
            return False
        if not self._datum_from.accepts_change(time.monotonic()):
            self.losses.add("message_datum_stranger")
            self.get_logger().warning(
                "another datum while another node publishes there as well: left out; stop the "
                "other node, then reset georeference_node"
            )
            return False
        self.get_logger().warning(
            "another datum: coordinates so far mean nothing in it, a new surface begins"
        )
        self.losses.add("message_datum_changed")
        self._datum = datum
        return True
