"""What volume_node calls a volume at the end is of all data that were sent to it."""

from own_process import result_of

SCRIPT = """
import json, sys, time
import rclpy
from rcl_interfaces.msg import Log
from sensor_msgs.msg import PointCloud2
from ladar_volume.nodes.convert import header
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.volume_node import VolumeNode

rclpy.init(args=[])
tester, said = rclpy.create_node("tester"), []
tester.create_subscription(Log, "/rosout", lambda m: said.append(m.msg), 50)
patches = tester.create_publisher(PointCloud2, "patches", STREAM)
node = VolumeNode()
node.autostart()
listener, spinner = Spinner(tester), Spinner(node)
until = lambda done, s=60.0: [time.sleep(0.02) for _ in range(int(s / 0.02)) if not done()]
until(lambda: patches.get_subscription_count() and node.count_subscribers("/rosout"))
if sys.argv[1] == "half":  # its points do not come
    patches.publish(PointCloud2(header=header(5, "map")))
    until(lambda: node.health.counts().get("patches"))
spinner.close()
until(lambda: any("volume" in words for words in said))
listener.close()
rclpy.try_shutdown()
print(json.dumps(said))
"""


def test_half_an_update_makes_the_last_volume_incomplete():
    said = " ".join(result_of(SCRIPT, "half"))
    assert "incomplete volume: none" in said and "did not come whole" in said, said


def test_without_it_there_is_just_no_volume():
    said = " ".join(result_of(SCRIPT, "none"))
    assert "no volume at the end" in said and "incomplete" not in said, said
