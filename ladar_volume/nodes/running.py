"""Nodes in threads and processes: an executor for each, and an orderly end on SIGINT or SIGTERM."""

from __future__ import annotations

import inspect
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from ladar_volume.model.errors import ConfigurationError
from ladar_volume.nodes.base import StageNode
from ladar_volume.process.memory import few_arenas, free_buffers, without_blas
from ladar_volume.process.switch import is_own_process

#: How long a thread that waits for the interpreter lets another go on, s. The usual 5 ms are a
#: tenth of an estimate for each message that comes in meanwhile, and for each of its two threads.
TURN_S = 0.0005
#: Pause after a round that raised, s: one that raises at every round takes no whole core.
AFTER_DEFECT_S = 0.02
#: How long a node that ends waits for a callback that runs, before what came is taken in, s.
TAKE_S = 5.0


class Spinner:
    """One executor and one thread per node: callbacks only queue, and a service that computes
    delays no other node.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self._executor, self._ended, self._taken = (
            SingleThreadedExecutor(),
            threading.Event(),
            threading.Event(),
        )
        self._executor.add_node(node)
        # rclpy asks where a line for the console comes from: the first time, inspect looks up the
        # file of every module that is loaded, which takes seconds while other threads work
        inspect.getframeinfo(inspect.stack(0)[0].frame)
        self._thread = threading.Thread(
            target=self._spin, name=f"spin {node.get_name()}", daemon=True
        )
        self._thread.start()

    def _spin(self) -> None:
        # not until a future is done: each round would leave a callback with it, 20 MB an hour for
        # every hundred messages a second
        while not self._ended.is_set():
            try:
                self._executor.spin_once()
            except ExternalShutdownException:
                return
            except Exception as error:  # a callback's: the node would hear nothing from then on
                if not isinstance(self.node, StageNode):
                    raise
                self.node.defect(error)
                self._ended.wait(AFTER_DEFECT_S)

    def _take_all(self) -> None:
        try:
            self.node.take_all()
        finally:
            self._taken.set()

    def close(self) -> None:
        """Let the node take in what came and finish its work, then end the thread and the node."""
        if isinstance(self.node, StageNode):
            self.node.await_upstream()
            self._executor.create_task(self._take_all)
            self._taken.wait(timeout=TAKE_S)
            self.node.stop()
        # the thread first: the executor does not wait for a callback that runs as it is shut down,
        # and takes away what that needs
        self._ended.set()
        self._executor.create_task(lambda: None)  # a round in which it is seen
        self._thread.join(timeout=2.0)
        self._executor.shutdown(timeout_sec=2.0)
        self.node.destroy_node()


def before_ros() -> None:
    """What a process of nodes asks of allocator, middleware and interpreter before ROS starts;
    nothing in a process of others.
    """
    if not is_own_process():
        return
    few_arenas()
    free_buffers()
    sys.setswitchinterval(TURN_S)


def begin_ros(arguments: Sequence[str] | None) -> None:
    """Start ROS with its arguments, without signal handlers of its own: these would end the context
    before the nodes have finished. Raises :class:`ConfigurationError` for what it cannot read.
    """
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=rclpy.signals.SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # the client library's RCLError and UnknownROSArgsError
        words = str(error).removeprefix("failed to initialize rcl: ").partition(", at /")[0]
        if type(error).__name__ == "UnknownROSArgsError":
            words = f"{words} are none of ROS: give other options before it"
        raise ConfigurationError(f"--ros-args: {words}") from None


def made(factory: Callable[..., StageNode], **options: Any) -> StageNode:
    """The node. Raises :class:`ConfigurationError` for names and parameters that ROS refuses."""
    try:
        return factory(**options)
    except (ParameterException, NameValidationException) as error:
        raise ConfigurationError(f"--ros-args: {error}") from None


def spin(factory: Callable[[], StageNode], argv: Sequence[str] | None = None) -> int:
    """Run one node in this process until SIGINT or SIGTERM, then let it finish its work. Returns an
    exit code.
    """
    before_ros()
    stop = threading.Event()

    def end_in_order() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop.set())

    try:
        begin_ros(argv)
        node = made(factory)
        if node.kernels is None:
            end_in_order()
        if node.kernels is not None and is_own_process():
            without_blas()
        # until then a signal just ends the process, also one that waits for its kernels
        if not node.autostart(end_in_order):
            # for who started it
            print(f"ladar_volume: {node.get_name()}: {node.failure}", file=sys.stderr)  # noqa: T201
            node.destroy_node()
            return 2
        spinner = Spinner(node)
        while not stop.wait(0.2):
            continue
        spinner.close()
    except ConfigurationError as error:
        # before any node exists there is no logger
        print(f"ladar_volume: {error}", file=sys.stderr)  # noqa: T201
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
