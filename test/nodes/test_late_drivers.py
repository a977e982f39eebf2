"""Drivers that start after the nodes, or were there before: what a replay of the log reads is what
georeference_node used, message for message, and all that the log heard is in it.
"""

import json
import random
from pathlib import Path

import pytest
from own_process import result_of

from ladar_volume.io.bags import BagReader
from ladar_volume.io.logs.unheard import Unheard, UnheardMessages, unheard_from_text
from ladar_volume.nodes.inputs.heard_inputs import WAIT_S, WINDOW_BYTES, WINDOW_S, HeardInputs
from ladar_volume.nodes.inputs.input_copies import InputCopy, copy_from_message
from ladar_volume.nodes.inputs.logged_inputs import MEMORY_S, LoggedInputs
from ladar_volume.nodes.inputs.logged_inputs import WAIT_S as LATE_S
from ladar_volume.nodes.inputs.publisher_streams import PublisherStreams

NANO = 1_000_000_000
KIND = "sensor_msgs/msg/Imu"


class Publisher:
    """One that sends so many messages, and when each listener finds it (s)."""

    def __init__(self, name, begins_s, count, rate_hz, node_s, log_s):
        self.name, self.count = name.encode(), count
        self.times = [begins_s + k / rate_hz for k in range(count)]
        self.found = {"node": begins_s + node_s, "log": begins_s + log_s}

    def events(self, rng, node_from_s, log_from_s):
        """(time, who hears, number, when it was sent); to one listener in order."""
        for who, start in (("node", node_from_s), ("log", log_from_s)):
            at = 0.0
            for k, sent in enumerate(self.times):
                at = max(at, sent + rng.uniform(1e-4, 0.02))
                if sent >= max(self.found[who], start):
                    yield at, who, self, k + 1, sent


class Played:
    """What becomes of publishers' messages: used by the node, written to the log, named there."""

    def __init__(self, publishers, seed, node_from_s=0.0, log_from_s=0.0, topic="/imu/data"):
        rng = random.Random(seed)
        self.topic, self.publishers = topic, publishers
        self.used, self.log, self.heard, self.named = [], [], set(), []
        self.now = 0.0
        self._node = HeardInputs(lambda topic: self._there("node"))
        self._logged = LoggedInputs(lambda topic: self._there("log"))
        events = [e for p in publishers for e in p.events(rng, node_from_s, log_from_s)]
        ticks = [(0.2 * k, "tick", None, 0, 0.0) for k in range(300)]
        copies = []
        for at, who, publisher, number, sent in sorted([*events, *ticks], key=lambda e: e[0]):
            self.now = at
            while copies and copies[0][0] <= at:
                self._logged.heard(copies.pop(0)[1], self.now)
            if who == "node":
                self._use(publisher, number, sent)
            elif who == "log":
                self._hear(publisher, number, sent)
            else:
                self._settle()
            listened = at >= log_from_s
            delay = rng.uniform(1e-4, 0.1)
            copies += [(at + delay, copy) for copy in self._node.due(listened, at)]
            copies.sort(key=lambda c: c[0])
        for _, copy in copies:
            self._logged.heard(copy, self.now)
        self._settle(ended=True)

    def _there(self, who):
        alive = [p for p in self.publishers if p.found[who] <= self.now <= p.times[-1] + 0.5]
        return [p.name for p in alive]

    @staticmethod
    def _data(publisher, number):
        return publisher.name + number.to_bytes(4, "little")

    def _use(self, publisher, number, sent):
        data = self._data(publisher, number)
        self.used.append(data)
        info = {"publication_sequence_number": number, "source_timestamp": self._ns(sent)}
        self._node.take(self.topic, KIND, data, info, self._ns(self.now), self.now)

    def _hear(self, publisher, number, sent):
        data, t_ns = self._data(publisher, number), self._ns(self.now)
        self.heard.add(data)
        if self._logged.logged(self.topic, data, t_ns, self._ns(sent), number):
            self.log.append((t_ns, data))

    def _settle(self, ended=False):
        self.log += [(t, c.data) for c, t in self._logged.lacking(self.now, ended)]
        named = [u.text() for u in self._logged.unheard(self.now, ended)]
        self.named += [unheard_from_text(text) for text in named]

    @staticmethod
    def _ns(seconds):
        return NANO + round(seconds * NANO)

    def replayed(self):
        """What a replay of the log reads, in its order."""
        left_out = UnheardMessages(self.named)
        name = self.topic.lstrip("/")
        return [d for t, d in sorted(self.log) if not left_out.hold(name, t, d)]

    def check(self):
        """The replay is the live survey, and the log lost nothing that it heard."""
        assert sorted(self.replayed()) == sorted(self.used)
        written = [data for _, data in self.log]
        assert len(set(written)) == len(written) and self.heard <= set(written)
        assert sum(u.messages for u in self.named) == len(written) - len(self.used)
        for p in self.publishers:
            mine = [d for d in self.replayed() if d.startswith(p.name)]
            assert mine == sorted(mine, key=lambda d: int.from_bytes(d[-4:], "little"))


@pytest.mark.parametrize("seed", range(12))
def test_a_late_driver_that_the_listeners_find_one_after_the_other(seed):
    rng = random.Random(seed)
    late = Publisher("a", rng.uniform(0, 5), 300, 50.0, rng.uniform(0, 1.5), rng.uniform(0, 1.5))
    played = Played([late], seed)
    assert played.used and played.heard != set(played.used)
    played.check()


@pytest.mark.parametrize("seed", range(12))
def test_a_driver_that_was_there_before_and_restarts_in_the_survey(seed):
    rng = random.Random(100 + seed)
    runs = [
        Publisher(f"r{k}", 14.0 * k, 500, 50.0, rng.uniform(0, 1), rng.uniform(0, 1))
        for k in range(3)
    ]
    played = Played(runs, seed, node_from_s=rng.uniform(0, 4), log_from_s=rng.uniform(0, 3))
    played.check()


@pytest.mark.parametrize("seed", range(12))
def test_two_drivers_on_one_topic(seed):
    rng = random.Random(200 + seed)
    both = [
        Publisher("a", 0.0, 1500, 50.0, rng.uniform(0, 1), rng.uniform(0, 1)),
        Publisher("b", rng.uniform(15, 20), 300, 20.0, rng.uniform(0, 1), rng.uniform(0, 1)),
    ]
    Played(both, seed).check()


def test_a_node_that_comes_long_after_the_log_and_the_driver():
    driver = Publisher("a", 0.0, 3000, 100.0, 0.0, 0.3)
    played = Played([driver], 1, node_from_s=25.0)
    played.check()
    (named,) = played.named
    assert named.before_ns and named.messages > 2000 and not named.digests


def test_a_node_that_starts_anew_says_nothing_of_what_another_one_had_heard():
    logged, node = LoggedInputs(lambda topic: [b"a"]), HeardInputs(lambda topic: [b"a"])
    for k in range(1, 60):
        t = NANO + k * NANO // 10
        if k == 31:
            node = HeardInputs(lambda topic: [b"a"])
        info = {"publication_sequence_number": k, "source_timestamp": t}
        assert logged.logged("/imu/data", bytes([k]), t, t, k)
        node.take("/imu/data", KIND, bytes([k]), info, t, k / 10)
        for copy in node.due(True, k / 10):
            logged.heard(copy, k / 10)
        assert not list(logged.lacking(k / 10)) and not list(logged.unheard(k / 10))


def test_copies_that_nobody_takes_are_let_go():
    node = HeardInputs(lambda topic: [b"a"])
    info = {"publication_sequence_number": 7, "source_timestamp": NANO}
    node.take("/velodyne_points", KIND, bytes(1000), info, NANO, 0.0)
    assert not list(node.due(False, 1.0)) and node.waits
    assert not list(node.due(False, WAIT_S + 0.1)) and not node.waits
    for k in range(40):
        info = {"publication_sequence_number": 8 + k, "source_timestamp": NANO + k}
        node.take("/velodyne_points", KIND, bytes(1_000_000), info, NANO, 1.0)
        assert not list(node.due(False, 1.0))
    assert sum(len(copy.data) for copy in node.due(True, 1.0)) <= 33_000_000
    node.take("/velodyne_points", KIND, b"x", info | {"source_timestamp": 0}, NANO, 1.0)
    assert not node.waits  # the middleware does not say which message it is


def test_the_log_keeps_a_bounded_number_of_copies():
    logged = LoggedInputs(lambda topic: [])
    for k in range(1, 100):
        logged.heard(InputCopy("/p", KIND, bytes(1_000_000), NANO + k, k, NANO), 0.0)
    assert logged.dropped == 99 - 64
    assert len(list(logged.lacking(10.0))) == 64 and not list(logged.lacking(20.0))


def test_numbers_tell_publishers_apart():
    streams, there = PublisherStreams(), [b"a"]
    begun = [streams.begins(k, lambda: there) for k in (5, 6, 9, 10)]
    assert begun == [True, False, False, False]  # 7 and 8 were lost
    there = [b"b"]
    assert streams.begins(12, lambda: there)  # a successor that sent eleven before it was found
    assert streams.begins(3, lambda: there) and not streams.begins(13, lambda: there)
    assert not streams.begins(4, lambda: there) and not streams.begins(0, lambda: there)


def test_a_copy_is_what_was_sent_and_damaged_ones_are_none():
    copy = InputCopy("/imu/data", KIND, b"abc", 5, 7, 9, "topic")
    message = copy.message()
    assert copy_from_message(message) == copy
    for label in ("{}", "[", "[]", message.layout.dim[0].label.replace("topic", "x")):
        message.layout.dim[0].label = label
        assert copy_from_message(message) is None
    message.layout.dim = []
    assert copy_from_message(message) is None


def test_what_a_log_names_is_read_as_it_was_written():
    one = Unheard("imu/data", 5, 9, ("ab", "cd"), 4)
    assert unheard_from_text(one.text()) == one
    for text in ("", "[]", "{}", '{"topic": 1}', "[" * 100_000):
        assert unheard_from_text(text) is None


#: A driver that one node hears from its message n on, the log from another one on. Fed by hand, in
#: place of what DDS may do.
SCRIPT = """
import hashlib, json, random, sys, time
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2, PointField
from std_msgs.msg import UInt8MultiArray
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.inputs.input_copies import InputCopy
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.qos import HANDED_ON, STREAM
from ladar_volume.nodes.running import Spinner

seed, log, stranger = int(sys.argv[1]), sys.argv[2], sys.argv[3] == "stranger"
rng = random.Random(seed)
node_from = {k: rng.randint(0, 12) for k in ("cloud", "fix", "imu")}
log_from = {k: rng.randint(0, 12) for k in ("cloud", "fix", "imu")}
usual = {"velodyne_points": "cloud", "gnss/fix": "fix", "imu/data": "imu"}
space = "/rover"
rclpy.init(args=["--ros-args", "-r", f"__ns:={space}"])
used = {k: [] for k in node_from}

class Node(GeoreferenceNode):
    kernels = None
    count = dict.fromkeys(node_from, 0)
    def receive(self, kind, message_type, data):
        self.count[kind] += 1
        if self.count[kind] <= node_from[kind]:
            return False
        used[kind].append(hashlib.sha256(data).hexdigest())
        return super().receive(kind, message_type, data)
    def work(self, kind, item):
        pass

class Log(LoggerNode):
    count = dict.fromkeys(node_from, 0)
    def _take(self, name, known, data, info):
        kind = usual.get(name.removeprefix("rover/"))
        if kind is not None:
            self.count[kind] += 1
            if self.count[kind] <= log_from[kind]:
                return
        super()._take(name, known, data, info)

sure = [Parameter("node.input_reliability", value="reliable")]
given = {"logger.path": log, "logger.disk_reserve_bytes": 0, "node.diagnostics_period_s": 0.2}
nodes = [
    Log(parameter_overrides=[*sure, *(Parameter(k, value=v) for k, v in given.items())]),
    Node(parameter_overrides=[*sure, Parameter("node.diagnostics_period_s", value=0.2)]),
]
for n in nodes:
    assert n.autostart()
spinners = [Spinner(n) for n in nodes]
time.sleep(1.0)
driver = rclpy.create_node("driver")
if stranger:
    lies = driver.create_publisher(UInt8MultiArray, "georeference_node/inputs_heard", HANDED_ON)
    false = InputCopy(f"{space}/imu/data", "sensor_msgs/msg/Imu", b"false" * 9, 5, 7, 9, "topic")
    time.sleep(0.5)
    lies.publish(false.message())
out = {
    "cloud": driver.create_publisher(PointCloud2, "velodyne_points", STREAM),
    "fix": driver.create_publisher(NavSatFix, "gnss/fix", STREAM),
    "imu": driver.create_publisher(Imu, "imu/data", STREAM),
}
until = lambda done, s=60.0: [time.sleep(0.02) for _ in range(int(s / 0.02)) if not done()]
until(lambda: all(p.get_subscription_count() >= 2 for p in out.values()))
def stamped(message, k):
    message.header.stamp.sec, message.header.stamp.nanosec = 1000, k
    return message
for k in range(30):
    out["cloud"].publish(stamped(PointCloud2(), k))
    out["fix"].publish(stamped(NavSatFix(), k))
    for j in range(5):
        out["imu"].publish(stamped(Imu(), 5 * k + j))
    time.sleep(0.02)
until(lambda: [len(used[k]) + node_from[k] for k in ("cloud", "fix", "imu")] == [30, 30, 150])
time.sleep(0.5)
lost = nodes[0].all_losses().as_dict()
for spinner in reversed(spinners):
    spinner.close()
rclpy.try_shutdown()
print(json.dumps({"used": used, "node": node_from, "log": log_from, "lost": lost}))
"""


def hashes(path, all_messages=False):
    """Digests of a log's messages of each sensor, in its order."""
    import hashlib

    topics = {"rover/velodyne_points": "cloud", "rover/gnss/fix": "fix", "rover/imu/data": "imu"}
    found = {role: [] for role in topics.values()}
    with BagReader(path, all_messages) as bag:
        counts = {topics[t]: n for t, (_, n) in bag.topics().items() if t in topics}
        for raw in bag.raw(set(topics)):
            found[topics[raw.topic]].append(hashlib.sha256(raw.data).hexdigest())
    assert all_messages or counts == {role: len(each) for role, each in found.items()}
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_nodes_replay_what_was_used(tmp_path, seed):
    log = tmp_path / "log.mcap"
    seen = result_of(SCRIPT, seed, log, "alone", timeout_s=200)
    assert hashes(log) == seen["used"] and not seen["lost"]
    whole = hashes(log, all_messages=True)
    for role, count in {"cloud": 30, "fix": 30, "imu": 150}.items():
        assert len(whole[role]) == count - min(seen["node"][role], seen["log"][role])


def test_copies_of_a_stranger_do_not_get_into_the_log(tmp_path):
    log = tmp_path / "log.mcap"
    seen = result_of(SCRIPT, 4, log, "stranger", timeout_s=200)
    assert seen["lost"]["message_copy_stranger"] >= 1
    import hashlib

    false = hashlib.sha256(b"false" * 9).hexdigest()
    assert false not in hashes(log, all_messages=True)["imu"]
    assert json.dumps(false) not in Path(log).read_bytes().decode("latin1")


def heard(node, k, now_s, size=1, topic="/imu/data"):
    """Have a node use message k."""
    info = {"publication_sequence_number": k, "source_timestamp": NANO + k}
    node.take(topic, KIND, bytes(size), info, NANO, now_s)


def test_copies_are_made_for_a_while_after_a_publisher_begins_and_up_to_a_size():
    there = [b"a"]
    node = HeardInputs(lambda topic: there)
    for k, now_s in ((1, 0.0), (2, WINDOW_S), (3, WINDOW_S + 0.01)):
        heard(node, k, now_s)
    assert [(c.sequence, c.begins) for c in node.due(True, 5.0)] == [(1, "topic"), (2, "")]
    there = [b"b"]
    heard(node, 1, 9.0)
    heard(node, 2, 9.0 + WINDOW_S)
    heard(node, 1, 9.0, topic="/gnss/fix")
    begun = [(c.topic, c.sequence, c.begins) for c in node.due(True, 9.0)]
    assert begun == [("/imu/data", 1, "publisher"), ("/imu/data", 2, ""), ("/gnss/fix", 1, "topic")]
    there = [b"c"]
    for k in range(1, 5):
        heard(node, k, 20.0, WINDOW_BYTES // 2)
    assert [c.sequence for c in node.due(True, 20.0)] == [1, 2, 3]


def test_a_copy_waits_for_the_logs_own_message_and_stands_before_what_came_later():
    logged = LoggedInputs(lambda topic: [b"a"])
    copy = InputCopy("/p", KIND, b"1", NANO, 1, 7 * NANO)
    logged.heard(copy, 0.0)
    assert not list(logged.lacking(LATE_S))  # its own message may still come
    assert logged.logged("/p", b"2", 5 * NANO, NANO + 9, 2)
    assert list(logged.lacking(0.1)) == [(copy, 5 * NANO - 1)]
    assert not logged.logged("/p", b"1", 6 * NANO, NANO, 1)  # it came after all: once is enough
    last = InputCopy("/p", KIND, b"3", NANO + 20, 3, 8 * NANO)
    logged.heard(last, 1.0)
    assert not list(logged.lacking(1.0 + LATE_S))
    assert list(logged.lacking(1.01 + LATE_S)) == [(last, 8 * NANO)]


def test_what_is_old_is_forgotten():
    logged = LoggedInputs(lambda topic: [b"a"])
    first, second = NANO, NANO + round((MEMORY_S + 1.0) * NANO)
    assert logged.logged("/p", b"1", first, first, 1)
    assert logged.logged("/p", b"2", second, second, 2)
    assert logged.logged("/p", b"1", second, first, 1)  # not known any more
    assert not logged.logged("/p", b"2", second, second, 2)
