"""An answer waits until what came before the call is in the surface: clouds that georeference_node
has just heard count in ``~/compute`` at once.
"""

from own_process import result_of

SCRIPT = """
import json, sys, threading, time
import rclpy
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from ladar_volume.io.bags import BagReader, BagWriter
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.player import Player
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.services import catch_up
from ladar_volume.nodes.volume_node import VolumeNode

rclpy.init(args=[])
catch_up.CATCH_UP_S = 200.0  # on a machine that is busy
settings = {"config_file": "bags/box/config.yaml", "node.update_period_s": 2.0}
settings |= {"georeference.max_pending_s": 60.0}  # played fast, topics run apart
settings |= {"node.input_reliability": "reliable", "node.input_depth": 2000}
given = [Parameter(k, value=v) for k, v in settings.items()]
nodes = [kind(parameter_overrides=given) for kind in (GeoreferenceNode, FilterNode, VolumeNode)]
mapped, filter_node, volume = nodes
for node in nodes:
    assert node.autostart(), node.failure
with BagReader("bags/box") as whole, BagWriter(sys.argv[1]) as some:
    for raw in whole.raw():
        if 14.0 < (raw.t_ns - whole.start_ns) * 1e-9 < 16.5:
            some.write_raw(raw.topic, raw.kind, raw.data, raw.t_ns)
bag = BagReader(sys.argv[1])
player = Player(bag, bag.roles(), 8.0)
compute = player.create_client(Trigger, "volume_node/compute")
spinners = [Spinner(n) for n in (*nodes, player)]


def until(done, what):
    for _ in range(1200):
        if done():
            return
        time.sleep(0.05)
    raise SystemExit(f"waited in vain for {what}")


def asked():
    future = compute.call_async(Trigger.Request())
    until(future.done, "an answer")
    return json.loads(future.result().message)


until(
    lambda: player.ready() and compute.service_is_ready() and volume.status()["joined"],
    "the nodes",
)
# what arrives is held until the call stands: at it all points are on their way
put, held, lock = mapped.queue.put_nowait, [], threading.Lock()


def hold(item):
    with lock:
        (put if held is None else held.append)(item)


def release():
    global held
    with lock:
        for item in held:
            put(item)
        held = None


mapped.queue.put_nowait = hold
player.run()
threading.Timer(1.0, release).start()
late = filter_node.count_publishers("points_mapped") and filter_node.counts["points"]
first = asked()
count = filter_node.counts["points"]
seen = mapped.received_counts().get("cloud", 0), player.sent["cloud"]
time.sleep(1.0)
until(lambda: not filter_node._fresh, "the surface")
second = asked()
catch_up.CATCH_UP_S = 1.0
mapped.queue.put_nowait = lambda item: None
third = asked()
print(
    json.dumps(
        {
            "clouds": seen,
            "points": [late, count, mapped.sent["points"]],
            "volumes": [first.get("volume_m3"), second.get("volume_m3")],
            "verdicts": [[d["name"] for d in a["verdict"]["reasons"]] for a in (first, third)],
            "waiting": first.get("returns_waiting_for_poses"),
        }
    )
)
del mapped.queue.put_nowait
for s in spinners:
    s.close()
rclpy.try_shutdown()
"""


def test_an_answer_has_all_that_came_before_the_call(tmp_path):
    found = result_of(SCRIPT, tmp_path / "bag", timeout_s=300)
    assert found["clouds"][0] == found["clouds"][1]
    late, count, sent = found["points"]
    assert late < count == sent
    first, second = found["volumes"]
    assert first and first == second and found["waiting"] >= 0
    assert "not_caught_up" not in found["verdicts"][0] and "not_caught_up" in found["verdicts"][1]
