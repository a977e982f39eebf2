"""A node that is closed while its callbacks run: its thread ends first, without an exception. One
that runs keeps nothing of its rounds, and hears on after a callback that raised.
"""

from own_process import result_of

SCRIPT = """
import json, threading, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
raised, rounds = [], []
take = SingleThreadedExecutor._take_timer
SingleThreadedExecutor._take_timer = lambda *a: (
    time.sleep(0.005) or take(*a)
)  # so that the end comes between waiting and taking
threading.excepthook = lambda what: raised.append(repr(what.exc_value))
for turn in range(10):
    node = rclpy.create_node(f"busy_{turn}")
    for _ in range(8):
        node.create_timer(1e-5, lambda: rounds.append(turn))
    spinner = Spinner(node)
    until = time.monotonic() + 30.0
    while turn not in rounds[-1:] and time.monotonic() < until:
        time.sleep(0.002)
    spinner.close()
    raised += ["still runs"] * spinner._thread.is_alive()
print(json.dumps([len(set(rounds)), raised]))
rclpy.try_shutdown()
"""


ROUNDS = """
import gc, json, time
import rclpy
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
rounds = []
node = rclpy.create_node("round")
node.create_timer(1e-4, lambda: rounds.append(None))
spinner = Spinner(node)
held = []
for enough in (50, 2050):
    until = time.monotonic() + 60.0
    while len(rounds) < enough and time.monotonic() < until:
        time.sleep(0.002)
    gc.collect()
    held.append(len(gc.get_objects()))
done = len(rounds)
spinner.close()
print(json.dumps([done, held[1] - held[0]]))
rclpy.try_shutdown()
"""

DEFECT = """
import json, time
import rclpy
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
node = FilterNode()
node.kernels = None
node.autostart()
rounds = []


def tick():
    rounds.append(None)
    if len(rounds) in (3, 5):
        raise KeyError("of this callback")


node.create_timer(1e-3, tick)
spinner = Spinner(node)
until = time.monotonic() + 60.0
while len(rounds) < 20 and time.monotonic() < until:
    time.sleep(0.002)
spinner.close()
print(
    json.dumps(
        [len(rounds) >= 20, node.losses["message_internal_error"], spinner._thread.is_alive()]
    )
)
rclpy.try_shutdown()
"""

LAST = """
import json, sys, time
import rclpy
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
nodes = [
    FilterNode(),
    LoggerNode(parameter_overrides=[Parameter("logger.path", value=sys.argv[1])]),
]
nodes[0].kernels = None
for node in nodes:
    node.autostart()
spinners = [Spinner(node) for node in nodes]
sender = rclpy.create_node("sender")
out = sender.create_publisher(Odometry, "platform", STREAM)
until = time.monotonic() + 60.0
while out.get_subscription_count() < 2 and time.monotonic() < until:
    time.sleep(0.02)
busy = [node.create_timer(1e-3, lambda: time.sleep(1.5)) for node in nodes]  # what comes now waits
time.sleep(0.1)
for k in range(450):
    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = 1000, 1_000_000 * k
    out.publish(message)
came = out.wait_for_all_acked(Duration(seconds=30))
for spinner in spinners:
    spinner.close()
print(
    json.dumps(
        [
            came,
            nodes[0].health.lines(0.0, 0).get("received_platform"),
            nodes[1]._recorder.accounts["platform"].written,
        ]
    )
)
rclpy.try_shutdown()
"""


def test_closing_a_busy_node():
    assert result_of(SCRIPT) == [10, []]


def test_a_round_leaves_nothing_behind():
    rounds, more = result_of(ROUNDS)
    assert rounds >= 2050 and more < 200, more


def test_a_callback_that_raises_is_counted_and_the_node_hears_on():
    assert result_of(DEFECT) == [True, 2, False]


def test_what_came_before_the_end_is_taken_in(tmp_path):
    assert result_of(LAST, str(tmp_path / "log.mcap")) == [True, 450, 450]
