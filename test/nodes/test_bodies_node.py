"""volume_node with ``volume.kind: bodies`` over DDS: what it answers and publishes is what offline
replay makes of the same points, whatever their order.
"""

import pytest
from own_process import result_of

SCRIPT = """
import json, sys, time
from pathlib import Path
import numpy as np, rclpy
from rclpy.parameter import Parameter
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_srvs.srv import Trigger
from surveyed_box import parameters, states, survey_of_a_box
from ladar_volume.clouds.survey.survey_bodies import returns_around, bodies_of_survey
from ladar_volume.io.message_tables import (
    filtered_columns, mapped_columns, patch_columns, update_parts,
)
from ladar_volume.io.meshfiles.mesh_files import read_mesh
from ladar_volume.io.results import closed_bodies_dict
from ladar_volume.io.tables import decode
from ladar_volume.model.records import select
from ladar_volume.nodes.convert import platform_messages, table_message
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.nodes.volume_node import VolumeNode
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.estimator import VolumeEstimator

mapped, path = survey_of_a_box(), states()
surface, estimator = SurfaceFilter(parameters()), VolumeEstimator(parameters())
surface.add_platform(path)
estimator.add_platform(path)
surface.add(mapped)
update = surface.finish()
estimator.add(update)
near = returns_around(estimator.estimate(), mapped.r_map, parameters())
near = near[np.lexsort(near.T)]
offline = bodies_of_survey(near, estimator.epoch().sources, parameters())

rclpy.init(args=[])
settings = {"volume.kind": "bodies", "node.output_folder": sys.argv[1]}
settings |= {"filter.radius_m": parameters().filter.radius_m, "node.map_period_s": 0.1}
node = VolumeNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
node.autostart()
tester = rclpy.create_node("tester")
tables, meshes = [], []
tester.create_subscription(PointCloud2, "volumes", lambda m: tables.append(decode(m)), LATCHED)
tester.create_subscription(Mesh, "mesh", meshes.append, LATCHED)
returns = tester.create_publisher(PointCloud2, "points_mapped", STREAM)
points = tester.create_publisher(PointCloud2, "points_filtered", STREAM)
patches = tester.create_publisher(PointCloud2, "patches", STREAM)
platform = tester.create_publisher(Odometry, "platform", STREAM)
clients = {n: tester.create_client(Trigger, f"volume_node/{n}") for n in ("compute", "save")}
spinners = [Spinner(n) for n in (node, tester)]


def until(done):
    for _ in range(6000):
        if done():
            return
        time.sleep(0.05)
    raise SystemExit("waited in vain")


def call(name):
    clients[name].wait_for_service(timeout_sec=60.0)
    future = clients[name].call_async(Trigger.Request())
    until(future.done)
    return json.loads(future.result().message)


until(lambda: all(p.get_subscription_count() for p in (returns, points, patches, platform)))
none_yet = call("compute")
for m in platform_messages(path, None, ("map", "base_link")):
    platform.publish(m)
for rows in np.array_split(np.random.default_rng(1).permutation(len(mapped)), 9):
    stamp, columns = mapped_columns(select(mapped, np.sort(rows)))
    returns.publish(table_message(columns, stamp, "map"))
until(lambda: node.health.counts().get("mapped") == 9)
for k, part in enumerate(update_parts(update)):
    points.publish(table_message(filtered_columns(part.points), update.t_ns + k, "map"))
    patches.publish(table_message(patch_columns(part), update.t_ns + k, "map"))
until(lambda: tables and meshes)  # of itself, while nobody asks
answer, saved = call("compute"), call("save")
for s in spinners:
    s.close()
rclpy.try_shutdown()
mesh = meshes[-1]
faces = np.array([t.vertex_indices for t in mesh.triangles], np.int64)
corners = np.array([[v.x, v.y, v.z] for v in mesh.vertices])
edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
a, b, c = corners[faces].swapaxes(0, 1)
print(
    json.dumps(
        {
            "none_yet": none_yet,
            "offline": closed_bodies_dict(offline),
            "answer": answer["closed_bodies"],
            "row": {k: v.tolist() for k, v in tables[-1].items()},
            "edges": np.unique(np.unique(edges, axis=0, return_counts=True)[1]).tolist(),
            "tetrahedra": float((a * np.cross(b, c)).sum() / 6.0),
            "files": sorted(p.name for p in Path(saved["folder"]).iterdir()),
            "faces": [len(faces), len(read_mesh(Path(saved["folder"]) / "bodies.ply").triangles)],
        }
    )
)
"""


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")
    return result_of(SCRIPT, folder / "out", timeout_s=600)


def test_the_bodies_are_those_of_replay(seen):
    (live,), (offline,) = seen["answer"], seen["offline"]
    assert live["volume_m3"] == offline["volume_m3"]  # to the bit
    assert live["volume_m3"] == pytest.approx(3.6, rel=0.003)
    # covariances travel in single precision
    assert live["sigma_m3"] == pytest.approx(offline["sigma_m3"], rel=1e-5)
    for line in ("noise", "ground", "closing", "fit", "between"):
        assert live["budget_m6"][line] == offline["budget_m6"][line]
    assert abs(live["volume_m3"] - 3.6) < 3.0 * live["sigma_m3"]


def test_a_row_of_volumes_and_a_closed_mesh_are_published(seen):
    (body,), row = seen["answer"], seen["row"]
    assert row["volume"] == [body["volume_m3"]] and row["base"] == [0]
    assert row["variance"] == pytest.approx([body["sigma_m3"] ** 2], rel=1e-6)
    for source, variance in body["budget_m6"].items():
        assert row[f"var_{source}"] == pytest.approx([variance], rel=1e-6)
    assert row["area"] == pytest.approx([2.0 * 1.5], rel=0.01) and row["cut"] == row["volume"]
    assert seen["edges"] == [2]  # every edge has two triangles
    assert seen["tetrahedra"] == pytest.approx(body["volume_m3"], rel=0.005)
    assert seen["faces"][0] == seen["faces"][1] == body["faces"]


def test_before_there_is_anything_the_answer_says_so(seen):
    assert "no surface yet" in seen["none_yet"]["error"]
    assert seen["files"] == ["bodies.ply", "mesh.ply", "result.json", "result.mcap"]
