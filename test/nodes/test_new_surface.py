"""volume_node has filter_node begin anew when it finds it, once: poses that come after the surface
they belong to are waited for, and a surface that lacks what filter_node had taken before says so.
"""

import pytest
from own_process import result_of

from ladar_volume.nodes.services.new_surface import ANSWER_S, NewSurface

SCRIPT = """
import json, sys, time
import numpy as np, rclpy
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from volume_surfaces import cone, piece, platform, surface_update
from ladar_volume.io.message_tables import filtered_columns, patch_columns, update_parts
from ladar_volume.nodes.convert import platform_messages, table_message
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.volume_node import VolumeNode

taken, order = int(sys.argv[1]), sys.argv[2]
rclpy.init(args=[])
settings = {"filter.nav_bin_s": 1.0, "volume.base": "level", "volume.outline": "all"}
node = VolumeNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
node.autostart()
tester, said, asked = rclpy.create_node("tester"), [], []
tester.create_subscription(Log, "/rosout", lambda m: said.append(m.msg), 50)
points = tester.create_publisher(PointCloud2, "points_filtered", STREAM)
patches = tester.create_publisher(PointCloud2, "patches", STREAM)
path = tester.create_publisher(Odometry, "platform", STREAM)
update = surface_update(lambda x, y: 3.0 + 0.02 * x - cone(x, y))
states = platform_messages(platform(20, 2), None, ("map", "base_link"))


def until(done, seconds=60.0):
    for _ in range(int(seconds / 0.05)):
        if done():
            return
        time.sleep(0.05)
    raise SystemExit(f"waited in vain: {node.status()} {said}")


def send(update, late):
    for k, part in enumerate(update_parts(update)):
        t = update.t_ns + late + k
        points.publish(table_message(filtered_columns(part.points), t, "map"))
        patches.publish(table_message(patch_columns(part), t, "map"))
    return t


def begin_anew(request, response):
    # what it had sent of the surface before is on its way yet; none of it counts
    asked.append(taken)
    last = 0
    if taken:
        last = send(piece(update, np.arange(len(update.patches) // 2)), -1000)
        until(lambda: node.queue.empty() and node.counts["parts"])
    response.success, response.message = True, f"{last} {taken}"
    return response


spinners = [Spinner(node), Spinner(tester)]
until(
    lambda: (
        all(p.get_subscription_count() for p in (points, patches, path))
        and node.count_subscribers("/rosout")
    )
)
first = states if order == "poses" else states[: len(states) // 2]
for m in first if order != "none" else []:
    path.publish(m)
until(lambda: order == "none" or node.health.counts().get("platform", 0) == len(first))
tester.create_service(Trigger, "filter_node/reset", begin_anew)
until(lambda: node.status()["joined"])
parts = len(node.stage.store.patches or [])
send(update, 0)
until(lambda: node.health.counts().get("patches") and node.queue.empty())
time.sleep(0.3)
before = node.counts["estimates"]
for m in states if order == "none" else states[len(first) :]:
    path.publish(m)
    time.sleep(0.002)
until(lambda: node.counts["estimates"] and node.queue.empty())
verdict = [d.name for d in node._new_surface.verdict().doubts]
patches_held = len(node.stage.store.patches)
for p in (points, patches, path):
    tester.destroy_publisher(p)
until(lambda: not node.count_publishers("points_filtered"))
spinners[0].close()
until(lambda: any("volume" in words for words in said))
spinners[1].close()
rclpy.try_shutdown()
print(
    json.dumps(
        {
            "asked": len(asked),
            "estimates": before,
            "held": [parts, patches_held, len(update.patches)],
            "lost": node.all_losses().as_dict(),
            "doubts": verdict,
            "said": said,
        }
    )
)
"""


@pytest.mark.parametrize("order", ["poses", "half", "none"])
def test_poses_that_come_after_their_surface_are_waited_for(order):
    found = result_of(SCRIPT, "0", order)
    assert found["asked"] == 1 and not found["lost"], found
    assert found["estimates"] == (order == "poses")
    assert "volume at the end" in found["said"][-1] and not found["doubts"]


def test_a_surface_that_lacks_what_the_filter_had_taken_says_so():
    found = result_of(SCRIPT, "12", "poses")
    assert found["asked"] == 1 and found["doubts"] == ["surface_began_anew"]
    # nothing of the surface before is in the new one
    assert found["held"][0] == 0 and found["held"][1] == found["held"][2], found["held"]
    words = found["said"][-1]
    assert words.startswith("incomplete volume: ") and "12 messages of returns and poses" in words


class Asked:
    """A service that answers when it is told to."""

    def __init__(self, ready=True):
        self.ready, self.calls, self.callback = ready, 0, None

    def create_client(self, kind, name):
        assert name == "filter_node/reset"
        return self

    def service_is_ready(self):
        return self.ready

    def call_async(self, request):
        self.calls += 1
        return self

    def add_done_callback(self, callback):
        self.callback = callback

    def result(self):
        return self

    success, message = True, "100 7"


def test_what_came_until_the_answer_is_sorted_by_it():
    node, told = Asked(), []
    surface = NewSurface(node, told.append)
    assert surface.due() and not surface.waits
    surface.ask()
    assert surface.waits and not surface.due()
    for key in (99, 100, 101):
        surface.hold(key, [])
    assert "has not said" in surface.words()
    node.callback(node)
    assert told == [(100, 7)]
    assert surface.begin(told[0]) == [(101, [])] and surface.joined and not surface.due()
    assert surface.lacking == 7 and "7 messages" in surface.verdict().doubts[0].text
    surface.again(wanted=False)  # it adds up
    assert surface.due()
    surface.ask()
    surface.begin((200, 5))
    assert surface.lacking == 12
    surface.again(wanted=True)  # a person's own wish
    surface.ask()
    surface.begin((300, 5))
    assert surface.lacking == 0 and surface.words() == "" and not surface.verdict().doubts


def test_an_answer_that_does_not_come_is_asked_for_again(monkeypatch):
    node = Asked(ready=False)
    surface, now = NewSurface(node, print), [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    assert not surface.due()
    node.ready = True
    surface.ask()
    now[0] = ANSWER_S + 1.0
    assert surface.due()
