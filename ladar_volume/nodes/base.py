"""What every node is: a lifecycle node with declared parameters, one worker thread, a counted queue and diagnostics."""

from __future__ import annotations

import contextlib
import math
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ladar_volume.io.config import read_config
from ladar_volume.model.errors import ConfigurationError, LadarVolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameter import ParameterSpec, specs
from ladar_volume.model.parameters import SECTIONS, Parameters
from ladar_volume.warm import warm_up

#: Maps, datum and volumes: whoever comes late still gets the last one.
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
#: Between this package's nodes: nothing may be lost.
STREAM = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2000, reliability=ReliabilityPolicy.RELIABLE)
#: Items a worker's queue holds; beyond, the newest is dropped and counted.
QUEUE = 5000


def sensor_qos(parameters: Parameters) -> QoSProfile:
    """Sensor data QoS (REP-2003), reliability and depth as the parameters say."""
    reliable = parameters.node.input_reliability == "reliable"
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=parameters.node.input_depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )  # fmt: skip


def _descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    unit = f" [{spec.unit}]" if spec.unit else ""
    d = ParameterDescriptor(description=f"{spec.help}{unit}", additional_constraints=spec.range_text)
    # an empty list has no element type, and NaN fails every range check: these are checked by this package alone
    d.dynamic_typing = spec.vector == 0
    finite = not (isinstance(spec.default, float) and not math.isfinite(spec.default))
    if spec.vector is None and finite and (spec.low is not None or spec.high is not None):
        if spec.kind is float:
            low, high = (-1e308 if spec.low is None else spec.low), (1e308 if spec.high is None else spec.high)
            d.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        elif spec.kind is int:
            low, high = (-(2**62) if spec.low is None else spec.low), (2**62 if spec.high is None else spec.high)
            d.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    return d


class StageNode(LifecycleNode):
    """Base of the nodes. A subclass names its sections, builds its stage in :meth:`build` and handles work items in
    :meth:`work`, which runs in the one worker thread; callbacks only queue."""

    sections: tuple[str, ...] = ("node",)
    #: Sections whose parameters may change while the node runs.
    runtime_sections: tuple[str, ...] = ()
    #: Whether the node's stage runs compiled kernels, which must be ready before data comes.
    kernels = True

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.losses = Losses()
        self.received: dict[str, int] = {}
        self._rate_state: dict[str, tuple[float, int]] = {}
        self._arrived: dict[str, float] = {}
        self._queue: queue.Queue[tuple[str, Any] | None] = queue.Queue(QUEUE)
        self._worker: threading.Thread | None = None
        self._group = MutuallyExclusiveCallbackGroup()
        self._active = False
        self._busy = False
        self.parameters = self._declare()
        self.add_on_set_parameters_callback(self._on_set)

    # parameters ---------------------------------------------------------------------------------------------------
    def _declare(self) -> Parameters:
        file = self.declare_parameter("config_file", "", ParameterDescriptor(description="Parameter file in the ROS layout.")).value
        start = read_config(file or None)
        outside = start.write()
        for section in self.sections:
            for spec in specs(SECTIONS[section]):
                value = outside[section][spec.key]
                self.declare_parameter(f"{section}.{spec.key}", value if value != [] else [0.0][:0], _descriptor(spec))
        values = {s: {k.key: self._outside(f"{s}.{k.key}") for k in specs(SECTIONS[s])} for s in self.sections}
        return Parameters.read(values, start)

    def _outside(self, name: str) -> Any:
        value = self.get_parameter(name).value
        return list(value) if value is not None and not isinstance(value, str | int | float | bool) else [] if value is None else value

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        values: dict[str, dict[str, Any]] = {}
        for change in changes:
            section, dot, key = change.name.partition(".")
            if not dot or section not in SECTIONS:
                continue
            if self._worker is not None and section not in self.runtime_sections:
                return SetParametersResult(successful=False, reason=f"{change.name} cannot change while the node is configured")
            value = change.value
            values.setdefault(section, {})[key] = value if isinstance(value, str | int | float | bool) else list(value or [])
        try:
            parameters = Parameters.read(values, self.parameters)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.parameters = parameters
        self.changed()
        return SetParametersResult(successful=True)

    def changed(self) -> None:
        """Take over run-time parameters; for subclasses."""

    # lifecycle ----------------------------------------------------------------------------------------------------
    def build(self) -> None:
        """Create stage, publishers, subscriptions and services."""
        raise NotImplementedError

    def work(self, kind: str, item: Any) -> None:
        """Handle one queued item in the worker thread."""
        raise NotImplementedError

    def idle(self) -> None:
        """Called by the worker after items and at least every 50 ms; for periodic work."""

    def status(self) -> dict[str, Any]:
        """The node's own lines in the diagnostics."""
        return {}

    def on_configure(self, state: Any) -> TransitionCallbackReturn:
        """Build everything, kernels included, and start the worker."""
        try:
            if self.kernels:
                warm_up()
            self.build()
        except LadarVolumeError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(self.parameters.node.diagnostics_period_s, self.publish_diagnostics, callback_group=self._group)
        self.create_service(Trigger, "~/reset", self._reset, callback_group=self._group)
        self._worker = threading.Thread(target=self._run, name=self.get_name(), daemon=True)
        self._worker.start()
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Begin to take in data."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Take in no more; what is queued is still worked off."""
        self._active = False
        return super().on_deactivate(state)

    def on_shutdown(self, state: Any) -> TransitionCallbackReturn:
        """Finish the work in the queue."""
        self.stop()
        return TransitionCallbackReturn.SUCCESS

    def stop(self) -> None:
        """Work off the queue, then end the worker."""
        self._active = False
        if self._worker is not None and self._worker.is_alive():
            self._queue.put(None)
            self._worker.join(timeout=30.0)

    def _reset(self, request: Any, response: Any) -> Any:
        self.offer("reset", None)
        response.success, response.message = True, "reset"
        return response

    # worker -------------------------------------------------------------------------------------------------------
    def offer(self, kind: str, item: Any) -> None:
        """Queue an item for the worker; a full queue drops it and counts it."""
        self.received[kind] = self.received.get(kind, 0) + 1
        self._arrived[kind] = time.monotonic()
        try:
            self._queue.put_nowait((kind, item))
        except queue.Full:
            self.losses.add(f"message_queue_full_{kind}")

    def listen(self, kind: str, message_type: Any, topic: str, qos: QoSProfile) -> None:
        """Subscribe: messages go to the worker as ``kind``; what the middleware lost is counted."""

        def lost(event: Any) -> None:
            self.losses.add(f"message_lost_{kind}", max(int(event.total_count_change), 0))

        self.create_subscription(
            message_type, topic, lambda m: self.offer(kind, m) if self._active else None, qos,
            callback_group=self._group, event_callbacks=SubscriptionEventCallbacks(message_lost=lost),
        )  # fmt: skip

    def _run(self) -> None:
        while True:
            try:
                item = self._queue.get(timeout=0.05)
            except queue.Empty:
                self._busy = True
                self._guarded(self.idle)
                self._busy = False
                continue
            if item is None:
                break
            kind, payload = item
            self._busy = True
            self._guarded(lambda kind=kind, payload=payload: self.work(kind, payload))  # type: ignore[misc]
            self._guarded(self.idle)
            self._busy = False

    def _guarded(self, action: Callable[[], None]) -> None:
        """No input may end a node: a refusal is counted by its reason, a defect is logged and counted."""
        try:
            action()
        except LadarVolumeError as error:
            self.losses.add(error.reason)
        except Exception as error:
            self.losses.add("message_internal_error")
            self.get_logger().error(f"{type(error).__name__}: {error}")

    # diagnostics --------------------------------------------------------------------------------------------------
    def publish_diagnostics(self) -> None:
        """One DiagnosticStatus with rates, ages, queue length, losses by reason, and the stage's own lines."""
        values: dict[str, Any] = {"queue": self._queue.qsize() + int(self._busy)}
        now = time.monotonic()
        for kind, count in list(self.received.items()):
            before, old = self._rate_state.get(kind, (now, count))
            values[f"received_{kind}"] = count
            values[f"rate_{kind}_hz"] = f"{(count - old) / (now - before):.1f}" if now > before else "0.0"
            values[f"age_{kind}_s"] = f"{now - self._arrived[kind]:.2f}"
            self._rate_state[kind] = (now, count)
        with contextlib.suppress(RuntimeError):  # a dictionary of the worker's changed size under our eyes: next period
            values |= self.status()
        lost = self.all_losses()
        values |= {f"lost_{reason}": count for reason, count in lost.items()}
        level, message = (DiagnosticStatus.WARN, "data was lost") if lost else (DiagnosticStatus.OK, "good")
        status = DiagnosticStatus(level=level, name=self.get_name(), message=message, hardware_id="ladar_volume")
        status.values = [KeyValue(key=k, value=str(v)) for k, v in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def all_losses(self) -> Losses:
        """The node's and its stage's losses."""
        total = Losses(self.losses.as_dict())
        stage = getattr(self, "stage", None)
        if stage is not None:
            total.merge(stage.losses)
        return total

    def autostart(self) -> None:
        """Configure and activate where the parameters say so."""
        if self.parameters.node.autostart:
            self.trigger_configure()
            self.trigger_activate()


class Spinner:
    """One executor and one thread per node: callbacks only queue, and a service that computes delays no other node."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._spin, name=f"spin {node.get_name()}", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def close(self) -> None:
        """Let the node finish its work, then end the thread and the node."""
        if isinstance(self.node, StageNode):
            self.node.stop()
        self._executor.shutdown(timeout_sec=2.0)
        self._thread.join(timeout=2.0)
        self.node.destroy_node()


def spin(factory: Callable[[], StageNode], argv: Sequence[str] | None = None) -> int:
    """Run one node in this process until SIGINT or SIGTERM, then let it finish its work. Returns an exit code."""
    rclpy.init(args=list(argv) if argv is not None else None, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        node = factory()
        node.autostart()
        spinner = Spinner(node)
        while not stop.wait(0.2):
            continue
        spinner.close()
    except ConfigurationError as error:
        print(f"ladar_volume: {error}", file=sys.stderr)  # noqa: T201 - before any node exists there is no logger
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
