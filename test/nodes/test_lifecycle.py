"""Lifecycle over real ROS: configured, cleaned up and configured again; parameters accepted or
refused with the reason; a simulated clock; a looping recording; the last estimate before the end.
"""

from own_process import result_of

SCRIPT = """
import json, time
import numpy as np, rclpy
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from benchmarks.fuzz import good
from ladar_volume.nodes.filter_node import FilterNode
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.volume_node import VolumeNode

rclpy.init(args=[])
S = 1_000_000_000
out = {}
geo = GeoreferenceNode(
    parameter_overrides=[
        Parameter("node.input_reliability", value="reliable"),
        Parameter("use_sim_time", value=True),
    ]
)
before = {t for t, _ in geo.get_publisher_names_and_types_by_node(geo.get_name(), "/")}
counts = []
for _ in range(3):
    counts.append(
        [
            str(geo.trigger_configure()),
            len(list(geo.publishers)),
            len(list(geo.subscriptions)),
            len(list(geo.timers)),
        ]
    )
    geo.trigger_activate()
    geo.trigger_deactivate()
    geo.trigger_cleanup()
    counts.append([len(list(geo.publishers)), geo._worker is None])
out["counts"] = counts
free = geo.set_parameters([Parameter("georeference.range_min_m", value=0.7)])[0]
out["unconfigured"] = [free.successful, geo.parameters.georeference.range_min_m]
filter_ = FilterNode(parameter_overrides=[Parameter("filter.radius_m", value=3.0)])
volume = VolumeNode()
for n in (geo, filter_, volume):
    n.autostart()
tester = rclpy.create_node("tester")
pubs = {
    "cloud": tester.create_publisher(PointCloud2, "velodyne_points", STREAM),
    "fix": tester.create_publisher(NavSatFix, "gnss/fix", STREAM),
    "imu": tester.create_publisher(Imu, "imu/data", STREAM),
}
spinners = [Spinner(n) for n in (geo, filter_, volume, tester)]
until = lambda done: [time.sleep(0.05) for _ in range(2400) if not done()]
until(lambda: all(p.get_subscription_count() for p in pubs.values()) and volume.status()["joined"])
time.sleep(0.5)
tried = {}
for node, name, value in (
    (geo, "georeference.range_min_m", 2.0),
    (geo, "node.input_depth", 7),
    (geo, "node.diagnostics_period_s", 0.25),
    (geo, "config_file", "x"),
    (filter_, "node.update_period_s", 0.1),
    (filter_, "filter.radius_m", 1.0),
    (volume, "volume.level_m", 1.5),
    (volume, "volume.bodies", -1),
    (volume, "node.autostart", False),
):
    try:
        r = node.set_parameters([Parameter(name, value=value)])[0]
        tried[name] = [r.successful, r.reason]
    except Exception as error:
        tried[name] = [False, type(error).__name__]
out["tried"] = tried
out["timer_s"] = geo._timer.timer_period_ns * 1e-9


def fly():
    rng = np.random.default_rng(1)
    for k in range(60):
        t = 1000 * S + k * S // 20
        for kind in ("fix", "imu", "cloud"):
            if kind != "cloud" or k % 2:
                pubs[kind].publish(good(kind, t, rng))
        time.sleep(0.005)
    until(
        lambda: (
            geo.queue.empty()
            and filter_.queue.empty()
            and not filter_._fresh
            and volume.queue.empty()
            and not volume._due
        )
    )


fly()
first = [filter_.stage.stats["points_offered"], geo.stage.restarts]
fly()
until(
    lambda: filter_._passes.begun and volume._passes.begun
)  # volume_node may still be at its estimate of the first pass
out["passes"] = [
    first,
    [filter_.stage.stats["points_offered"], geo.stage.restarts],
    filter_._passes.begun,
    volume._passes.begun,
]
out["delay"] = {
    k: v for k, v in geo.health.lines(time.monotonic(), 0).items() if k.startswith("rate")
}
for s in spinners:
    s.close()
out["states"] = [geo.sent["states"], filter_.counts["states"]]
out["ended"] = [not n._worker.is_alive() for n in (geo, filter_, volume)] + [
    filter_._fresh,
    volume._due,
]
out["lost"] = {k: v for n in (geo, filter_, volume) for k, v in n.all_losses().items()}
rclpy.try_shutdown()
print(json.dumps(out))
"""


def test_lifecycle_parameters_and_a_looping_recording():
    seen = result_of(SCRIPT, timeout_s=300)
    configured, cleaned = seen["counts"][::2], seen["counts"][1::2]
    assert all("SUCCESS" in c[0] for c in configured) and all(
        c[1:] == configured[0][1:] for c in configured
    )
    assert all(
        c == [configured[0][1] - 5, True] for c in cleaned
    )  # points, platform, datum, copies for the log and diagnostics are gone
    assert seen["unconfigured"] == [True, 0.7]
    tried = seen["tried"]
    accepted = {name for name, (ok, _) in tried.items() if ok}
    assert accepted == {"node.diagnostics_period_s", "node.update_period_s", "volume.level_m"}
    assert (
        "data taken in so far" in tried["georeference.range_min_m"][1]
        and "data taken in so far" in tried["filter.radius_m"][1]
    )
    assert "when the node is configured" in tried["node.input_depth"][1]
    assert seen["timer_s"] == 0.25
    first, second, filter_passes, volume_passes = seen["passes"]
    assert first[1] == 0 and second[1] == 1 and filter_passes == 1 and volume_passes == 1
    assert abs(second[0] - first[0]) < 0.2 * first[0]  # a new surface, not twice the points
    assert (
        seen["ended"] == [True, True, True, False, False]
        and "message_internal_error" not in seen["lost"]
    )
    # states that wait for their block when a new pass begins are not lost uncounted
    assert seen["states"][0] == seen["states"][1] > 0
