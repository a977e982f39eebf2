"""The graph on a machine with a normal Jazzy install: ``ros2 launch ladar_volume online.launch.py
config:=FILE log:=FILE mavlink:=URL``.
"""

from ament_index_python.packages import get_package_share_path
from launch.actions import DeclareLaunchArgument
from launch.conditions import LaunchConfigurationNotEquals
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Four lifecycle nodes, and a fifth for an autopilot; they configure and activate themselves
    unless node.autostart is false.
    """
    default = str(get_package_share_path("ladar_volume") / "config" / "default.yaml")
    config = LaunchConfiguration("config")
    arguments = [
        DeclareLaunchArgument(
            "config", default_value=default, description="parameter file in the ROS layout"
        ),
        DeclareLaunchArgument(
            "log", default_value="ladar_volume.mcap", description="MCAP file to write"
        ),
        DeclareLaunchArgument(
            "mavlink",
            default_value="",
            description="autopilot to take poses from (mavlink.url); empty for none",
        ),
    ]
    # each node lets those before it end, and finishes its work (STOP_S of nodes/base.py)
    ends = {"sigterm_timeout": "45", "sigkill_timeout": "10"}
    nodes = [
        LifecycleNode(
            package="ladar_volume",
            executable=name,
            name=name,
            namespace="",
            parameters=[
                {"config_file": config},
                *([{"logger.path": LaunchConfiguration("log")}] if name == "logger_node" else []),
            ],
            output="screen",
            **ends,
        )
        for name in ("georeference_node", "filter_node", "volume_node", "logger_node")
    ]
    autopilot = LifecycleNode(
        package="ladar_volume",
        executable="mavlink_node",
        name="mavlink_node",
        namespace="",
        parameters=[{"config_file": config, "mavlink.url": LaunchConfiguration("mavlink")}],
        condition=LaunchConfigurationNotEquals("mavlink", ""),
        output="screen",
        **ends,
    )
    return LaunchDescription([*arguments, *nodes, autopilot])
