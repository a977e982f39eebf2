"""Messages that wait behind the one taken come in the same round, in order, none twice; bytes that
are no message are counted.
"""

from own_process import result_of

SCRIPT = """
import json, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.executor_rounds import AT_ONCE, take_waiting

rclpy.init(args=[])
node = rclpy.create_node("taker")
out = node.create_publisher(Float64, "number", STREAM)
got, rounds = [], []


def take(message):
    rounds.append(1)
    got.append(message.data)
    take_waiting(subscription, lambda m, _: got.append(m.data))


subscription = node.create_subscription(Float64, "number", take, STREAM)
executor = SingleThreadedExecutor()
executor.add_node(node)
until = time.monotonic() + 30.0
while not out.get_subscription_count() and time.monotonic() < until:
    executor.spin_once(timeout_sec=0.05)
number = 2 * AT_ONCE + 50
for k in range(number):
    out.publish(Float64(data=float(k)))
time.sleep(0.5)
while len(got) < number and time.monotonic() < until:
    executor.spin_once(timeout_sec=0.05)
node.destroy_subscription(subscription)
executor.spin_once(timeout_sec=0.05)
print(
    json.dumps(
        {
            "got": got,
            "rounds": len(rounds),
            "of_none": take_waiting(subscription, None),
            "number": number,
        }
    )
)
executor.shutdown()
node.destroy_node()
rclpy.shutdown()
"""

UNREADABLE = """
import json, time
import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
node = GeoreferenceNode(parameter_overrides=[Parameter("node.input_reliability", value="reliable")])
node.autostart()
sender = rclpy.create_node("sender")
out = sender.create_publisher(Imu, "imu/data", STREAM)
spinner = Spinner(node)
until = time.monotonic() + 60.0
while not out.get_subscription_count() and time.monotonic() < until:
    time.sleep(0.02)
good = Imu()
good.orientation.w = 1.0
for axis in (0, 4, 8):
    good.orientation_covariance[axis] = 1e-6
sent = []
for k in range(60):
    good.header.stamp.sec, good.header.stamp.nanosec = 1000, 10_000_000 * k
    data = serialize_message(good)
    sent.append([data, data[: 5 * k], b"", b"\\xff" * k][k % 4])
    out.publish(sent[-1])

def received():
    return node.health.lines(0.0, 0).get("received_imu", 0)

def lost():
    return sum(node.losses.as_dict().values())

while lost() + received() < len(sent) and time.monotonic() < until:
    time.sleep(0.02)
print(json.dumps({"lost": node.losses.as_dict(), "received": received()}))
spinner.close()
sender.destroy_node()
rclpy.try_shutdown()
"""


def test_a_burst_is_taken_in_few_rounds():
    out = result_of(SCRIPT)
    assert out["got"] == [float(k) for k in range(out["number"])]
    assert out["rounds"] < 10 and out["of_none"] == 0


def test_bytes_that_are_no_message_are_counted_and_the_others_come():
    out = result_of(UNREADABLE)
    assert out == {"lost": {"message_unreadable_imu": 45}, "received": 15}
