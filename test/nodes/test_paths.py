"""Paths and the graph: which files a node touches is set at launch; a node that cannot be
configured is not activated.
"""

from dataclasses import fields

from own_process import result_of

from ladar_volume.model.parameters import Parameters
from ladar_volume.nodes.declared_parameters import launch_refusal

SCRIPT = """
import json, sys, time
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.running import Spinner

rclpy.init(args=[])


def values(**given):
    return [Parameter(k.replace("__", "."), value=v) for k, v in given.items()]


# delete_oldest without splitting is refused by configure
bad = LoggerNode(
    parameter_overrides=values(
        logger__path=sys.argv[1] + "/bad.mcap",
        logger__disk_full="delete_oldest",
        logger__split_bytes=0,
        logger__split_s=0.0,
    )
)
bad.autostart()
out = {"bad": bad._active}
bad.destroy_node()
node = LoggerNode(parameter_overrides=values(logger__path=sys.argv[1] + "/log.mcap"))
stranger = rclpy.create_node("stranger")
spinners = [Spinner(n) for n in (node, stranger)]
client = stranger.create_client(SetParameters, "logger_node/set_parameters")
client.wait_for_service(timeout_sec=60.0)
asked = values(
    logger__path=sys.argv[1] + "/precious.txt",
    logger__disk_full="delete_oldest",
    node__output_folder=sys.argv[1],
)
future = client.call_async(SetParameters.Request(parameters=[p.to_parameter_msg() for p in asked]))
for _ in range(3000):
    if future.done():
        break
    time.sleep(0.02)
out["answers"] = [[r.successful, r.reason] for r in future.result().results]
out["path"] = node.parameters.logger.path
for s in spinners:
    s.close()
rclpy.try_shutdown()
print(json.dumps(out))
"""


def test_every_parameter_that_names_a_file_a_device_or_an_address_is_fixed_at_launch():
    kinds = ("path", "file", "folder", "url")
    names = [
        f"{section}.{field.name}"
        for section, stage in vars(Parameters()).items()
        for field in fields(stage)
        if field.type == "str" and field.name.split("_")[-1] in kinds
    ]
    assert len(names) >= 4
    assert [name for name in names if launch_refusal(name) is None] == []


def test_a_stranger_sets_no_path_and_a_failed_configure_activates_nothing(tmp_path):
    out = result_of(SCRIPT, tmp_path, timeout_s=60)
    assert out["bad"] is False and out["path"] == f"{tmp_path}/log.mcap"
    for successful, reason in out["answers"]:
        assert not successful and "set at launch" in reason
