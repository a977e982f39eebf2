"""logger_node: any topics as raw CDR into one MCAP, without decoding."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_msgs.msg import String, UInt8MultiArray
from std_srvs.srv import Trigger

from ladar_volume.io.bags import BY_NAME, INSTEAD, ROLES
from ladar_volume.io.config import dump_config
from ladar_volume.io.logs import unheard
from ladar_volume.io.logs.heard_live import NODE
from ladar_volume.io.mcap_log import usual_definition
from ladar_volume.io.mcap_recovery import Recovery
from ladar_volume.io.recorder import Recorder
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import OutputError
from ladar_volume.model.losses import Losses
from ladar_volume.nodes.base import StageNode
from ladar_volume.nodes.executor_rounds import deserialize
from ladar_volume.nodes.inputs.heard_inputs import TOPIC as TOPIC_OF_COPIES
from ladar_volume.nodes.inputs.input_copies import copy_from_message
from ladar_volume.nodes.inputs.logged_inputs import LoggedInputs
from ladar_volume.nodes.message_classes import message_class
from ladar_volume.nodes.qos import HANDED_ON
from ladar_volume.nodes.running import spin
from ladar_volume.nodes.stream_passes import OnePublisher
from ladar_volume.nodes.watch.missed_inputs import MissedInputs
from ladar_volume.nodes.watch.wanted_topics import WantedTopics
from ladar_volume.version import version

#: How often new topics are looked for.
DISCOVERY_S = 0.2
#: Types of the sensors' messages.
INPUTS = frozenset(kind for roles in (ROLES, INSTEAD, BY_NAME) for kind, _ in roles.values())
_FOREVER = "{sec: 9223372036, nsec: 854775807}"


def installed_definition(kind: str) -> str:
    """ros2msg text of any installed message type, its parts behind it; of the common interfaces
    from the type store.
    """
    text = usual_definition(kind)
    if text:
        return text
    parts, todo = [], [kind]
    seen = set(todo)
    while todo:
        kind = todo.pop(0)
        cls = message_class(kind)
        if cls is None:
            return ""
        fields = cls.get_fields_and_field_types()
        inner = [m for m in (re.search(r"(\w+)/(\w+)", t) for t in fields.values()) if m]
        parts.append((kind, "".join(f"{_ros2msg(t)} {name}\n" for name, t in fields.items())))
        fresh = dict.fromkeys(f"{m[1]}/msg/{m[2]}" for m in inner)
        todo += [k for k in fresh if k not in seen]
        seen |= set(fresh)
    rule = "=" * 80
    return parts[0][1] + "".join(
        f"{rule}\nMSG: {k.replace('/msg/', '/')}\n{text}" for k, text in parts[1:]
    )


def _ros2msg(kind: str) -> str:
    """A field type as rclpy names it, as .msg files write it."""
    kind = kind.replace("boolean", "bool").replace("double", "float64").replace("octet", "byte")
    kind = re.sub(r"\bfloat\b", "float32", kind)
    bounded = re.fullmatch(r"sequence<(.+), (\d+)>", kind)
    if bounded:
        return f"{_ros2msg(bounded[1])}[<={bounded[2]}]"
    endless = re.fullmatch(r"sequence<(.+)>", kind)
    return f"{_ros2msg(endless[1])}[]" if endless else re.sub(r"string<(\d+)>", r"string<=\1", kind)


@dataclass
class TopicSubscription:
    """A topic that is logged, as it was subscribed to."""

    kind: str
    reliable: bool
    latched: bool
    subscription: Any = None
    #: The only publisher so far, and whether there were several at once.
    publisher: bytes = b""
    shared: bool = False
    sequence: int = 0
    events: int = 0
    gaps: int = 0

    def see_publishers(self, there: Sequence[bytes]) -> None:
        """Who publishes. Numbers of several publishers cannot be told apart, also when only one of
        them is left; those of a successor begin anew.
        """
        if len(there) > 1:
            self.shared = True
        elif there and there[0] != self.publisher:
            self.sequence = -1 if self.publisher else self.sequence
            self.publisher = there[0]

    def missing_before(self, sequence: int, publishers: Callable[[], Sequence[bytes]]) -> int:
        """How many messages are missing between the last one and that of a number. publishers :
        who is there now, asked where some seem to be missing.
        """
        if self.sequence > 0 and sequence > self.sequence + 1 and not self.shared:
            self.see_publishers(publishers())
        alone = self.sequence > 0 and not self.shared
        missing = max(sequence - self.sequence - 1, 0) if alone else 0
        self.sequence = sequence
        return missing

    @property
    def qos_text(self) -> str:
        """The publisher's QoS as rosbag2 stores it, so that a replay offers the same."""
        return (
            "- history: keep_last\n  depth: 1\n  reliability: "
            f"{'reliable' if self.reliable else 'best_effort'}\n"
            f"  durability: {'transient_local' if self.latched else 'volatile'}\n  "
            f"deadline: {_FOREVER}\n  lifespan: {_FOREVER}\n"
            f"  liveliness: automatic\n  liveliness_lease_duration: {_FOREVER}\n  "
            "avoid_ros_namespace_conventions: false"
        )


def _ids(publishers: Sequence[Any]) -> list[bytes]:
    return [bytes(p.endpoint_gid) for p in publishers]


class LoggerNode(StageNode):
    """Looks for topics and subscribes to those wanted, with the publisher's own durability and
    reliability.
    """

    sections = ("logger", "node")
    #: The log ends last.
    upstream = (
        ("points_mapped", "georeference_node"),
        ("points_filtered", "filter_node"),
        ("volumes", "volume_node"),
    )
    ending_s = 130.0

    def __init__(self, **options: Any) -> None:
        super().__init__("logger_node", **options)

    def build(self) -> None:
        """Open the log, begin to look for topics, make whole what a killed run left behind."""
        self._recorder = Recorder(self.parameters.logger, installed_definition)
        parameters = self.parameters
        self._recorder.metadata(
            "ladar_volume", {"version": version(), "parameters": json_text(parameters.write())}
        )
        self._recorder.attach(
            "parameters.yaml", "application/yaml", dump_config(parameters).encode(), self._now()
        )
        self._known: dict[str, TopicSubscription | None] = {}
        self._wanted = WantedTopics(self.get_namespace(), parameters.logger)
        self._reported = ""
        self._offered, self._taken = 0, 0  # bytes; each counted by one thread alone
        self._rates: dict[str, tuple[float, int]] = {}
        self._repairs: list[Recovery | OutputError] = []
        threading.Thread(target=self._repair, name="repair", daemon=True).start()
        self.create_timer(DISCOVERY_S, self._discover, callback_group=self._group)
        self.create_service(Trigger, "~/split", self._on_split_request, callback_group=self._group)
        inputs = {
            role: self.resolve_topic_name(usual) for role, (_, usual) in self._roles().items()
        }
        logged = {r: t.lstrip("/") for r, t in inputs.items() if self._wanted.matches(t)}
        self._missed = MissedInputs(self.get_namespace(), logged)
        self.create_subscription(
            DiagnosticArray, "/diagnostics", self._missed.take, 50, callback_group=self._group
        )
        self._compare_inputs()
        self._subscribe_inputs()
        self._discover()

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _repair(self) -> None:
        for done in self._recorder.repair_older():
            if isinstance(done, OutputError):
                self.get_logger().error(str(done))
            else:
                self.get_logger().warning(
                    f"{done.path} was not finished: repaired with {done.messages} "
                    f"messages; {done.lost_bytes} bytes at its end were torn"
                )
            self._repairs.append(done)

    # what georeference_node used
    # ----------------------------------------------------------------------------------------------
    def _compare_inputs(self) -> None:
        """Hear which first messages of the sensors georeference_node used."""
        self._inputs = LoggedInputs(self.publishers_of)
        self._copies_from = OnePublisher()
        self._copies_topic = self.resolve_topic_name(TOPIC_OF_COPIES.replace("~", NODE))
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        self.subscribe(self._copies_topic, UInt8MultiArray, HANDED_ON, self._take_copy, quiet)
        self.create_timer(DISCOVERY_S, self._settle_inputs, callback_group=self._group)

    def _take_copy(self, data: bytes, info: Mapping[str, Any]) -> None:
        """A copy of a message that georeference_node used; nobody else's is believed."""
        if not self._active:
            return
        now = time.monotonic()
        self._copies_from.update_publishers(self.publishers_of(self._copies_topic), now)
        if not self._copies_from.accepts_change(now):
            if not self.losses["message_copy_stranger"]:
                self.get_logger().warning(
                    f"somebody else than {NODE} publishes on {self._copies_topic}: left out"
                )
            self.losses.add("message_copy_stranger")
            return
        message = deserialize(data, UInt8MultiArray)
        copy = None if message is None else copy_from_message(message)
        if copy is None or copy.kind not in INPUTS:
            self.losses.add("message_copy_unreadable")
            return
        known = self._known.get(copy.topic)
        if self._wanted.matches(copy.topic) and (known is None or known.kind == copy.kind):
            self._inputs.heard(copy, now)

    def _settle_inputs(self, ended: bool = False) -> None:
        """Write what the log lacks of what georeference_node used, and name what it has more."""
        now = time.monotonic()
        for copy, t_ns in self._inputs.lacking(now, ended):
            name = copy.topic.lstrip("/")
            known = self._known.get(copy.topic) or TopicSubscription(copy.kind, False, False)
            if self._enqueue(name, known, copy.data, t_ns, *copy.key):
                self._recorder.account(name).copied += 1
        for found in self._inputs.unheard(now, ended):
            name = f"{self.get_namespace().strip('/')}/{unheard.TOPIC}".lstrip("/")
            text = TopicSubscription(unheard.KIND, reliable=True, latched=False)
            data = serialize_message(String(data=found.text()))
            self._enqueue(name, text, data, self._now(), None, 0)

    # topics
    # ----------------------------------------------------------------------------------------------
    def _subscribe_inputs(self) -> None:
        """The sensors' topics, whose types are known: a driver that starts later loses nothing
        while it is looked for.
        """
        reliable = self.parameters.node.input_reliability == "reliable"
        for kind, usual in self._roles().values():
            topic = self.resolve_topic_name(usual)
            if self._wanted.matches(topic):
                self._subscribe(
                    topic, topic.lstrip("/"), TopicSubscription(kind, reliable, latched=False)
                )

    def _roles(self) -> dict[str, tuple[str, str]]:
        """Type and usual topic of each role."""
        packets = self.parameters.node.cloud_message == "VelodyneScan"
        return ROLES | (INSTEAD if packets else {})

    def _discover(self) -> None:
        self._wanted.look(self.get_node_names_and_namespaces())
        for topic, kinds in self.get_topic_names_and_types():
            name = topic.lstrip("/")
            if not self._wanted.matches(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers or (topic in self._known and self._known[topic] is None):
                continue
            # asking for more than a publisher offers would get nothing: take the weakest of what
            # they offer
            reliable = all(
                p.qos_profile.reliability == ReliabilityPolicy.RELIABLE for p in publishers
            )
            latched = all(
                p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers
            )
            known = self._known.get(topic)
            if known is not None:
                known.see_publishers(_ids(publishers))
                if known.reliable <= reliable and known.latched <= latched:
                    continue
                self.destroy_subscription(
                    known.subscription
                )  # a newcomer offers less than was asked for
            known = TopicSubscription(kinds[0], reliable, latched)
            known.see_publishers(_ids(publishers))
            self._subscribe(topic, name, known)

    def _subscribe(self, topic: str, name: str, known: TopicSubscription) -> None:
        message_type = message_class(known.kind)
        if message_type is None:
            self._known[topic] = None
            self.losses.add("message_unknown_type")
            self.get_logger().warning(f"{topic}: no Python support for {known.kind}, not logged")
            return
        self._known[topic] = known
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=1000,
            reliability=ReliabilityPolicy.RELIABLE
            if known.reliable
            else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if known.latched
            else DurabilityPolicy.VOLATILE,
        )

        def lost(event: Any) -> None:
            known.events += max(int(event.total_count_change), 0)
            self._recorder.account(name).middleware = max(known.events, known.gaps)

        # warnings of a QoS that does not match are not asked for: it is the publishers' own, and
        # each costs at every message
        events = SubscriptionEventCallbacks(message_lost=lost, use_default_callbacks=False)
        known.subscription = self.subscribe(
            topic, message_type, qos, lambda data, info: self._take(name, known, data, info), events
        )

    def _take(
        self, name: str, known: TopicSubscription, data: bytes, info: Mapping[str, Any]
    ) -> None:
        if not self._active:
            return
        account = self._recorder.account(name)
        sequence = int(info.get("publication_sequence_number") or 0)
        if known.sequence == 0 and not known.shared:
            account.before = max(sequence - 1, 0)
        missing = known.missing_before(sequence, lambda: self._publisher_ids(name))
        if missing:
            known.gaps += missing
            account.middleware = max(known.events, known.gaps)
        t_ns, published_ns = self._now(), int(info.get("source_timestamp") or 0)
        if known.kind in INPUTS and not self._inputs.logged(
            f"/{name}", data, t_ns, published_ns, sequence
        ):
            return
        self._enqueue(name, known, data, t_ns, published_ns or None, sequence)

    def _enqueue(
        self,
        name: str,
        known: TopicSubscription,
        data: bytes,
        t_ns: int,
        published_ns: int | None,
        sequence: int,
    ) -> bool:
        """Have a message written; one that finds no room is lost. Returns whether it found room."""
        waiting = self._offered - self._taken + len(data)
        if self.queue.full() or waiting > self.parameters.logger.queue_bytes:
            self._recorder.account(name).queue += 1
            return False
        self._offered += len(data)
        return self.offer("message", (name, known, data, t_ns, published_ns, sequence))

    def _publisher_ids(self, name: str) -> list[bytes]:
        return self.publishers_of(f"/{name}")

    # the writing thread
    # -------------------------------------------------------------------------------------------
    def work(self, kind: str, item: Any) -> None:
        """Write one message, or split."""
        if kind == "split":
            self._recorder.split(self._now())
        elif kind == "message":
            name, known, data, t_ns, published_ns, sequence = item
            self._taken += len(data)
            self._recorder.write(
                name, known.kind, data, t_ns, published_ns, sequence, known.qos_text, known.latched
            )

    def idle(self) -> None:
        """Write a chunk that is old enough even when nothing comes."""
        self._recorder.tick(self._now())

    def _on_split_request(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self.offer("split", None)
        response.success, response.message = (
            True,
            json_text({"finishing": str(self._recorder.path)}),
        )
        return response

    def stop(self) -> None:
        """Write what is queued, then finish the file with its index."""
        if self._worker is not None and self._worker.is_alive():
            self._settle_inputs(ended=True)
        super().stop()
        if not hasattr(self, "_recorder"):
            return
        self._recorder.close()
        if words := self._missed.words(self._recorder.accounts, ended=True):
            self.get_logger().warning(words)

    def warnings(self) -> list[str]:
        """What the log lacks of what the survey is made of."""
        words = self._missed.words(self._recorder.accounts)
        return [words] if words and self.queue.empty() else []

    def all_losses(self) -> Losses:
        """Messages that are not in the log, by reason and topic."""
        total = Losses(self.losses.as_dict())
        total.merge(self._recorder.losses())
        total.add("message_copy_no_room", self._inputs.dropped)
        total.add("message_unrepaired_file", sum(isinstance(r, OutputError) for r in self._repairs))
        return total

    def errors(self) -> list[str]:
        """Why nothing is written, said on the console as well when it begins."""
        problem = self._recorder.problem
        if problem and problem != self._reported:
            self.get_logger().error(problem)
        self._reported = problem
        return [f"nothing is logged: {problem}"] if problem else []

    def status(self) -> dict[str, Any]:
        """What is written where, and the account of every topic."""
        recorder, now = self._recorder, time.monotonic()
        accounts = dict(sorted(recorder.accounts.items()))
        lines: dict[str, Any] = {
            "file": recorder.path,
            "messages_written": sum(a.written for a in accounts.values()),
            "topics": len(accounts),
            "waiting_bytes": self._offered - self._taken,
            "disk": recorder.problem or "good",
            "disk_free_bytes": recorder.free(),
            "deleted_files": len(recorder.deleted),
            "repaired_files": ", ".join(
                f"{Path(r.path).name}: {r.lost_bytes} B torn"
                for r in self._repairs
                if isinstance(r, Recovery)
            ),
        }
        for topic, a in accounts.items():
            before, old = self._rates.get(topic, (now, a.written))
            self._rates[topic] = (now, a.written)
            rate = (a.written - old) / (now - before) if now > before else 0.0
            lines |= {f"written_{topic}": a.written, f"written_rate_{topic}_hz": f"{rate:.1f}"}
            if a.before:
                lines[f"before_{topic}"] = a.before
            if a.copied:
                lines[f"copied_{topic}"] = a.copied
        return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node alone."""
    return spin(LoggerNode, argv)
