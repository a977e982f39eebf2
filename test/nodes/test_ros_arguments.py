"""What is wrong on the command line is one line, never a traceback of the client library."""

import pytest
from own_process import result_of
from rclpy.parameter import Parameter

from ladar_volume.cli.replay import topics_by_role
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.nodes.declared_parameters import check_given

SCRIPT = """
import json, rclpy
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.nodes.logger_node import LoggerNode
from ladar_volume.nodes.running import begin_ros, made

said, file = {}, "--params-file nothere.yaml"
for words in ("-r", "-r __ns:=rover1", file, "--other", "-p use_sim_time:=x"):
    try:
        begin_ros(["--ros-args", *words.split()])
        made(LoggerNode)
    except ConfigurationError as error:
        said[words] = str(error)
    rclpy.try_shutdown()
print(json.dumps(said))
"""


def test_arguments_that_ros_cannot_read_are_named():
    said = result_of(SCRIPT)
    named = {
        "-r": "trailing -r flag",
        "-r __ns:=rover1": "'-r __ns:=rover1'",
        "--params-file nothere.yaml": "nothere.yaml",
        "--other": "['--other'] are none of ROS",
        "-p use_sim_time:=x": "'use_sim_time' to 'x'",
    }
    assert said.keys() == named.keys()
    for words, text in named.items():
        assert said[words].startswith("--ros-args: ") and text in said[words], said[words]
        assert "/src/" not in said[words] and "\n" not in said[words]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("node.nothing", 3, "node.nothing"),
        ("georeference.beams", 99_999, "out of range"),
        ("georeference.beams", "abc", "not a int"),
        ("filter.radius", 1.0, "filter.radius"),
    ],
)
def test_a_parameter_that_is_none_of_this_package_s_is_refused(name, value, words):
    with pytest.raises(ConfigurationError, match=words):
        check_given({name: Parameter(name, value=value)}, Parameters())


def test_parameters_of_others_are_left_to_them():
    names = {"use_sim_time": True, "qos_overrides./clock.depth": 3, "config_file": "x"}
    check_given({n: Parameter(n, value=v) for n, v in names.items()}, Parameters())
    check_given({"node.map_frame": Parameter("node.map_frame")}, Parameters())


@pytest.mark.parametrize("word", ["cloud", "cloud=", "=/points"])
def test_a_topic_without_its_role_is_refused(word):
    assert topics_by_role(["cloud=/points", "imu=/a=b"]) == {"cloud": "/points", "imu": "/a=b"}
    with pytest.raises(ConfigurationError, match="give role=topic"):
        topics_by_role(["fix=/fix", word])
