"""Messages that wait behind the one taken come in the same round, in order, none twice."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

SCRIPT = """
import json, time
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64
from ladar_volume.nodes.base import STREAM
from ladar_volume.nodes.taking import AT_ONCE, waiting

rclpy.init(args=[])
node = rclpy.create_node("taker")
out = node.create_publisher(Float64, "number", STREAM)
got, rounds = [], []

def take(message):
    rounds.append(1)
    got.extend(m.data for m in (message, *(m for m, _ in waiting(subscription))))

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
print(json.dumps({"got": got, "rounds": len(rounds), "of_none": len(list(waiting(subscription))), "number": number}))
executor.shutdown()
node.destroy_node()
rclpy.shutdown()
"""


def test_a_burst_is_taken_in_few_rounds():
    environment = os.environ | {"ROS_DOMAIN_ID": str(os.getpid() % 90 + 10), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    run = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=True)
    out = json.loads(run.stdout)
    assert out["got"] == [float(k) for k in range(out["number"])]
    assert out["rounds"] < 10 and out["of_none"] == 0
