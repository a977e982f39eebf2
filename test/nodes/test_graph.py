"""The real nodes over real DDS on loopback: the same volume as offline; no input ends a node."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from own_process import own_graph, result_of

from ladar_volume.cli.main import main
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import SUITED
from ladar_volume.simulation.survey import Survey

ROOT = Path(__file__).parents[2]
#: What ``replay --no-figure`` leaves out.
FIGURES = {"figure.png", "report.html", "report.json"}


@pytest.fixture
def environment():
    """A graph of its own on the loopback."""
    with own_graph() as variables:
        yield variables


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Seven seconds over a stockpile, thinned."""
    path = tmp_path_factory.mktemp("flight") / "bag"
    scene = make_scene("stockpile", 5)
    survey = Survey(
        scene,
        make_platform("uav", scene.extent_m, 7.0),
        BudgetParameters(),
        SurveyParameters(7.0, 20, seed=5),
    )
    suited = {s: dict(v) for s, v in SUITED["pile"].items()}
    write_bag(survey, path, suited, lambda share: None)
    return path


def test_four_processes_give_the_offline_volume_and_a_log(flight, tmp_path, environment, capsys):
    assert (
        main(["replay", str(flight), "--json", "--no-figure", "-o", str(tmp_path / "offline")]) == 0
    )
    offline = json.loads(capsys.readouterr().out)
    log = tmp_path / "log.mcap"
    words = [
        "up",
        "--play",
        str(flight),
        "--separate",
        "--rate",
        "2",
        "--set",
        "node.update_period_s=1",  # the volume at the end is asked for, not those on the way
        "--json",
        "--log",
        str(log),
        "-o",
        str(tmp_path / "online"),
    ]
    done = subprocess.run(
        [sys.executable, "-m", "ladar_volume.cli.main", *words],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    online = json.loads(done.stdout)
    assert online["volume_m3"] == pytest.approx(offline["volume_m3"], rel=1e-6)
    assert online["sigma_m3"] == pytest.approx(offline["sigma_m3"], rel=1e-5)
    for reason in ("point_outlier", "point_few_neighbours", "point_region"):
        assert online["losses"].get(reason, 0) == offline["losses"].get(reason, 0)
    files = {p.name for p in (tmp_path / "online").iterdir()}
    assert files == {f.name for f in (tmp_path / "offline").iterdir()} | FIGURES
    assert json.loads((tmp_path / "online" / "result.json").read_text()) == online
    from mcap.reader import make_reader

    with log.open("rb") as stream:
        topics = _counts(make_reader(stream))
    assert (
        topics["/velodyne_points"] > 50
        and topics["/volumes"] >= 1
        and topics["/grounds"] >= 1
        and "/diagnostics" in topics
    )
    words = [
        "replay",
        str(log),
        "--config",
        str(flight / "config.yaml"),
        "--json",
        "--no-figure",
        "-o",
        str(tmp_path / "again"),
    ]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["volume_m3"] == pytest.approx(
        offline["volume_m3"], rel=1e-6
    )


def _counts(reader):
    summary = reader.get_summary()
    return {
        summary.channels[k].topic: n for k, n in summary.statistics.channel_message_counts.items()
    }


BAD_INPUT = """
import array, json, sys, time
import numpy as np, rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_srvs.srv import Trigger
from ladar_volume.nodes.convert import header, table_message
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.nodes.qos import STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.volume_node import VolumeNode

rclpy.init(args=[])
node = GeoreferenceNode(
    parameter_overrides=[
        Parameter("node.input_reliability", value="reliable"),
        Parameter("node.diagnostics_period_s", value=0.2),
    ]
)
volume = VolumeNode()
for n in (node, volume):
    n.autostart()
tester = rclpy.create_node("tester")
lines, mapped = {}, []
tester.create_subscription(
    DiagnosticArray,
    "/diagnostics",
    lambda m: lines.update({s.name: {v.key: v.value for v in s.values} for s in m.status}),
    50,
)
tester.create_subscription(PointCloud2, "points_mapped", lambda m: mapped.append(m.width), STREAM)
clouds = tester.create_publisher(PointCloud2, "velodyne_points", STREAM)
fixes = tester.create_publisher(NavSatFix, "gnss/fix", STREAM)
imus = tester.create_publisher(Imu, "imu/data", STREAM)
compute = tester.create_client(Trigger, "volume_node/compute")
spinners = [Spinner(n) for n in (node, volume, tester)]
until = lambda done: [time.sleep(0.05) for _ in range(2400) if not done()]
until(
    lambda: (
        clouds.get_subscription_count()
        and fixes.get_subscription_count()
        and imus.get_subscription_count()
    )
)
S = 1_000_000_000


def cloud(t, **changes):
    n = 50
    columns = {a: np.full(n, v, np.float32) for a, v in zip("xyz", (3.0, 1.0, -2.0))}
    columns |= {
        "intensity": np.ones(n, np.float32),
        "ring": np.zeros(n, np.uint16),
        "time": np.linspace(0, 0.05, n).astype(np.float32),
    }
    columns |= {k: v for k, v in changes.items() if isinstance(v, np.ndarray)}
    m = table_message(
        {k: v for k, v in columns.items() if changes.get(k, 1) is not None}, t, "velodyne"
    )
    for k, v in changes.items():
        if k in ("row_step", "point_step", "width"):
            setattr(m, k, v)
    return m


def fix(t, **changes):
    m = NavSatFix(
        header=header(t, ""), latitude=50.0, longitude=14.0, altitude=200.0
    )
    m.position_covariance_type = 2
    m.position_covariance = np.diag([1e-4] * 3).ravel()
    m.status.status = 2
    for k, v in changes.items():
        m.status.status = v if k == "status" else m.status.status
        if k != "status":
            setattr(m, k, v)
    return m


def imu(t, q=(0.0, 0.0, 0.0, 1.0), c0=1e-6):
    m = Imu(header=header(t, ""))
    m.orientation.x, m.orientation.y, m.orientation.z, m.orientation.w = q
    m.orientation_covariance = np.diag([c0, 1e-6, 1e-6]).ravel()
    return m


T = 1000 * S
nan = np.full(50, np.nan, np.float32)
for bad in (
    cloud(T, x=None),
    cloud(T, row_step=7),
    cloud(T, point_step=9),
    cloud(T, width=0),
    cloud(T, x=nan),
    cloud(T, time=None),
    cloud(T, width=10**8, row_step=26 * 10**8),
):
    clouds.publish(bad)
for bad in (fix(T, status=-1), fix(T, latitude=float("nan")), fix(T, position_covariance_type=0)):
    fixes.publish(bad)
for bad in (imu(T, c0=-1.0), imu(T, q=(0.0, 0.0, 0.0, 3.0))):
    imus.publish(bad)
for k in range(8):
    fixes.publish(fix(T + k * S // 10))
for k in range(71):
    imus.publish(imu(T + k * S // 100))
clouds.publish(cloud(T + S // 4))
until(lambda: mapped and int(lines.get("georeference_node", {}).get("received_cloud", 0)) == 8)
time.sleep(0.6)
refused = node.set_parameters([Parameter("georeference.range_min_m", value=2.0)])[0]
accepted = volume.set_parameters([Parameter("volume.level_m", value=3.0)])[0]
outside = volume.set_parameters([Parameter("volume.confidence", value=7.0)])[0]
compute.wait_for_service(timeout_sec=60.0)
future = compute.call_async(Trigger.Request())
until(future.done)
answer = future.result()
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(
    json.dumps(
        {
            "lost": {
                k[5:]: int(v)
                for k, v in lines["georeference_node"].items()
                if k.startswith("lost_")
            },
            "mapped": mapped,
            "refused": [refused.successful, refused.reason],
            "accepted": accepted.successful,
            "level": volume.parameters.volume.level_m,
            "outside": outside.successful,
            "compute": [answer.success, json.loads(answer.message)],
        }
    )
)
"""


def test_no_input_ends_a_node_and_every_refusal_is_named():
    seen = result_of(BAD_INPUT, timeout_s=300)
    for reason in (
        "cloud_no_xyz",
        "cloud_row_step",
        "cloud_point_step",
        "cloud_empty",
        "cloud_all_nan",
        "cloud_no_time",
        "cloud_short",
        "fix_no_fix",
        "fix_nan",
        "fix_unknown_covariance",
        "imu_no_orientation",
        "imu_not_unit",
    ):
        assert seen["lost"].get(reason) == 1, (reason, seen["lost"])
    assert sum(seen["mapped"]) == 50  # the good cloud among them, in parts as poses come
    assert seen["refused"][0] is False and "georeference.range_min_m" in seen["refused"][1]
    assert seen["accepted"] is True and seen["level"] == 3.0 and seen["outside"] is False
    assert seen["compute"][0] is False and "no surface yet" in seen["compute"][1]["error"]


def test_a_node_ends_cleanly_on_sigterm_and_on_a_bad_configuration(tmp_path, environment):
    bad = tmp_path / "bad.yaml"
    bad.write_text("/**:\n  ros__parameters:\n    filter: {radus_m: 1.0}\n")
    command = [
        sys.executable,
        "-m",
        "ladar_volume.nodes.programs",
        "filter_node",
        "--ros-args",
        "-p",
        f"config_file:={bad}",
    ]
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert (
        done.returncode == 2
        and "did you mean 'radius_m'" in done.stderr
        and "Traceback" not in done.stderr
    )
    log = tmp_path / "log.mcap"
    command = [
        sys.executable,
        "-m",
        "ladar_volume.nodes.programs",
        "logger_node",
        "--ros-args",
        "-p",
        f"logger.path:={log}",
    ]
    node = subprocess.Popen(command, env=environment, cwd=ROOT)
    try:
        for _ in range(600):
            if log.exists():
                break
            with pytest.raises(subprocess.TimeoutExpired):
                node.wait(0.1)
        with pytest.raises(subprocess.TimeoutExpired):
            node.wait(1.5)
        node.terminate()
        assert node.wait(30) == 0
    finally:
        node.kill()
    assert log.read_bytes()[-8:] == b"\x89MCAP0\r\n"  # closed with its index
