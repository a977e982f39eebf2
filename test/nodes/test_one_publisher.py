"""A stranger's datum: a change is believed only while its publisher is alone."""

from own_process import result_of

from ladar_volume.nodes.stream_passes import MEMORY_S, OnePublisher

A, B = b"a", b"b"


def test_the_first_one_is_bound_and_others_are_not_believed():
    one = OnePublisher()
    assert not one.update_publishers([], 0.0) and not one.accepts_change(0.0)
    assert not one.update_publishers([A], 1.0) and one.accepts_change(1.0)
    assert not one.update_publishers([A, B], 2.0) and not one.accepts_change(2.0)
    one.update_publishers([A], 3.0)  # gone: what it sent may still come
    assert not one.accepts_change(3.0) and one.accepts_change(2.1 + MEMORY_S)
    assert one.bound == A


def test_a_successor_is_bound_when_it_is_alone():
    one = OnePublisher()
    one.update_publishers([A], 0.0)
    assert not one.update_publishers([A, B], 1.0)  # a killed one is still listed for a while
    assert one.update_publishers([B], 20.0) and one.bound == B and one.accepts_change(20.0)
    assert not one.update_publishers([B], 21.0)


SCRIPT = """
import json, time
import rclpy
from sensor_msgs.msg import NavSatFix
from rclpy.parameter import Parameter
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.volume_node import VolumeNode
from ladar_volume.nodes.qos import LATCHED
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])
nodes = [FilterNode(), VolumeNode()]
own, stranger = rclpy.create_node("georeference_node"), rclpy.create_node("stranger")
for node in nodes:
    node.autostart()
spinners = [Spinner(n) for n in (*nodes, own, stranger)]
def until(condition):
    end = time.monotonic() + 60.0
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
def datum(latitude):
    return NavSatFix(latitude=latitude, longitude=14.0, altitude=200.0)
def seen():
    return [n._datum and n._datum.latitude_deg for n in nodes]
def lost(reason):
    return [n.all_losses()[reason] for n in nodes]
first = own.create_publisher(NavSatFix, "datum", LATCHED)
first.publish(datum(50.0))
until(lambda: seen() == [50.0, 50.0])
out = {"first": seen()}
first.publish(datum(50.5))
until(lambda: seen() == [50.5, 50.5])
out["own"] = [seen(), lost("message_datum_changed")]
second = stranger.create_publisher(NavSatFix, "datum", LATCHED)
second.publish(datum(10.0))
until(lambda: min(lost("message_datum_stranger")) > 0)
out["stranger"] = [seen(), lost("message_datum_stranger"), lost("message_datum_changed")]
own.destroy_publisher(first)
stranger.destroy_publisher(second)
time.sleep(1.0)
third = own.create_publisher(NavSatFix, "datum", LATCHED)
third.publish(datum(51.0))
until(lambda: seen() == [51.0, 51.0])
out["successor"] = seen()
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(json.dumps(out))
"""


def test_a_strangers_datum_resets_no_surface():
    out = result_of(SCRIPT)
    assert out["first"] == [50.0, 50.0]
    assert out["own"] == [[50.5, 50.5], [1, 1]]  # its publisher alone may change it
    where, strangers, changed = out["stranger"]
    assert where == [50.5, 50.5] and min(strangers) >= 1 and changed == [1, 1]
    assert out["successor"] == [51.0, 51.0]
