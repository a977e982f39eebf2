"""filter_node puts off what changes least while data comes, and hands on all of it when asked: the
surface is then that of every point.
"""

from own_process import result_of

SCRIPT = """
import json, queue, time
import numpy as np, rclpy
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from mapped_sheet import mapped, platform, sheet
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.io.tables import decode
from ladar_volume.io.message_tables import (
    filter_update,
    filtered_columns,
    filtered_points,
    mapped_columns,
    no_filtered_points,
    patch_columns,
)
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import select
from ladar_volume.nodes import filter_node
from ladar_volume.nodes.convert import platform_messages, table_message
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.uncertainty.patch_table import PatchStore

filter_node.FIRST_RATE, filter_node.LEAST_MEASURED, filter_node.MOST = (
    1.0,
    10**9,
    200,
)  # one tile at a time, few by a flush
rclpy.init(args=[])
settings = {"filter.radius_m": 0.5, "filter.cap_per_voxel": 12, "node.update_period_s": 0.1}
node = filter_node.FilterNode(
    parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()]
)
node.autostart()
tester, got = rclpy.create_node("tester"), {"points": {}, "patches": {}, "repeated": 0}


def listen(kind):
    def take(m):
        stamp = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
        got["repeated"] += stamp in got[kind]
        got[kind][stamp] = m

    return take


tester.create_subscription(PointCloud2, "points_filtered", listen("points"), STREAM)
tester.create_subscription(PointCloud2, "patches", listen("patches"), STREAM)
clouds = tester.create_publisher(PointCloud2, "points_mapped", STREAM)
path = tester.create_publisher(Odometry, "platform", STREAM)
flush = tester.create_client(Trigger, "filter_node/flush")
spinners = [Spinner(n) for n in (node, tester)]


def until(done):
    for _ in range(2400):
        if done():
            return
        time.sleep(0.05)
    raise SystemExit(f"waited in vain: {node.status()}")


r = np.column_stack([sheet(6000, half=6.0), 0.02 * np.random.default_rng(3).normal(size=6000)])
points, states = mapped(r), platform(step_ns=100_000_000)
until(
    lambda: (
        clouds.get_subscription_count()
        and path.get_subscription_count()
        and flush.service_is_ready()
    )
)
until(
    lambda: (
        tester.count_publishers("patches")
        and node.count_subscribers("patches")
        and node.count_subscribers("points_filtered")
    )
)


def asked():
    future = flush.call_async(Trigger.Request())
    until(future.done)
    told = int(future.result().message.split()[0])
    until(lambda: told == 0 or (told in got["points"] and told in got["patches"]))
    return told


for m in platform_messages(states, None, ("map", "base_link")):
    path.publish(m)
nothing, put_off, equal, sent = asked(), [], [], []
store = PatchStore()
for part in np.array_split(np.argsort(points.t_ns, kind="stable"), 3):
    before = node.counts["points"]
    for some in np.array_split(part, 6):
        stamp, columns = mapped_columns(select(points, some))
        clouds.publish(table_message(columns, stamp, "map"))
        time.sleep(0.03)
    until(lambda: node.counts["points"] == before + len(part))
    put_off.append(node.stage.stats["points_deferred"])
    updates = node.counts["updates"]
    asked()
    sent.append(node.counts["updates"] - updates)
    parts = [(got["points"].pop(k), got["patches"].pop(k)) for k in sorted(got["points"])]
    for p, a in parts:
        store.replace(
            filter_update(
                filtered_points(decode(p)) if p.width else no_filtered_points(), decode(a)
            )
        )
    offline = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 12}}))
    offline.add_platform(states)
    offline.add(select(points, points.t_ns <= points.t_ns[part].max()))
    whole = offline.finish()
    whole = filter_update(filtered_points(filtered_columns(whole.points)), patch_columns(whole))
    same = [
        np.array_equal(getattr(store.patches, n), getattr(whole.patches, n))
        for n in ("key", "used", "t_ns", "sigma", "cross_key", "nav_bin")
    ]
    close = np.allclose(store.patches.beta, whole.patches.beta, atol=1e-6) and np.allclose(
        store.points.variance.sum(), whole.points.variance.sum()
    )
    equal.append(all(same) and bool(close) and len(store.points) == len(whole.points))
losses = dict(node.all_losses().as_dict())


def full(item):
    raise queue.Full


def answer():
    future = flush.call_async(Trigger.Request())
    until(future.done)
    return [future.result().success, future.result().message]


node.queue.put_nowait = full
refused = [*answer(), node.all_losses().as_dict().get("message_queue_full_flush")]
del node.queue.put_nowait
afterwards = answer()
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(
    json.dumps(
        {
            "nothing": nothing,
            "put_off": put_off,
            "sent": sent,
            "equal": equal,
            "repeated": got["repeated"],
            "losses": losses,
            "parts": node.counts["parts"],
            "refused": refused,
            "afterwards": afterwards,
        }
    )
)
"""


def test_a_flush_hands_on_all_points_that_came():
    found = result_of(SCRIPT, timeout_s=300)
    assert found["nothing"] == 0  # nothing sent yet, and nothing to wait for
    assert found["equal"] == [True, True, True]  # the offline surface of the same prefix
    assert (
        max(found["put_off"]) > 500 and max(found["sent"]) > 1
    )  # what a whole site put off comes in several updates
    assert (
        found["repeated"] == 0 and found["parts"] > 6
    )  # several updates without new data in between do not share a stamp
    assert not {k for k in found["losses"] if k.startswith("message_")}
    assert found["refused"] == [
        False,
        "too much waits already",
        1,
    ]  # an answer all the same: the next one must not wait for it
    assert found["afterwards"][0] and int(found["afterwards"][1].split()[0]) > 0
