"""The graph on a machine with a normal Jazzy install: ``ros2 launch ladar_volume online.launch.py
config:=FILE log:=FILE mavlink:=URL namespace:=rover1 cloud:=/ouster/points``; ``--show-args`` lists
all arguments.
"""

from ament_index_python.packages import get_package_share_path
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import LifecycleNode

from launch import LaunchContext, LaunchDescription

#: Inputs by argument: the topic that the nodes know, and its usual name.
TOPICS = {
    "cloud": "velodyne_points",
    "fix": "gnss/fix",
    "imu": "imu/data",
    "odometry": "odometry",
}
#: Arguments that are parameters of the nodes.
PARAMETERS = {
    "lidar_frame": ("node.lidar_frame", "frame the clouds must come in; empty for any"),
    "imu_frame": ("node.imu_frame", "frame the attitudes must come in; empty for any"),
    "gnss_frame": ("node.gnss_frame", "frame the fixes must come in; empty for any"),
    "map_frame": ("node.map_frame", "frame of the map, another one for each vehicle"),
    "odom_frame": ("node.odom_frame", "frame between map and base on /tf"),
    "base_frame": ("node.base_frame", "frame of the platform"),
    "publish_tf": ("node.publish_tf", "what goes to /tf: pose, correction or off"),
    "hardware_id": ("node.hardware_id", "name of the vehicle in /diagnostics"),
}


def declared() -> list[DeclareLaunchArgument]:
    """All arguments with their defaults."""
    default = str(get_package_share_path("ladar_volume") / "config" / "default.yaml")
    words = {
        "config": (default, "parameter file in the ROS layout"),
        "log": ("ladar_volume.mcap", "MCAP file to write"),
        "log_all": ("false", "log also what the nodes derive on the way"),
        "mavlink": ("", "autopilot to take poses from (mavlink.url); empty for none"),
        "namespace": ("", "namespace of all nodes, one for each vehicle"),
        "use_sim_time": ("false", "take the time from /clock"),
        **{name: (topic, f"topic of {name}") for name, topic in TOPICS.items()},
        **{name: ("", text) for name, (_, text) in PARAMETERS.items()},
    }
    return [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in words.items()
    ]


def nodes(context: LaunchContext) -> list[LifecycleNode]:
    """Four lifecycle nodes, and a fifth for an autopilot. What is not given stays as the parameter
    file has it.
    """
    given = context.launch_configurations
    common = {
        "config_file": given["config"],
        "use_sim_time": given["use_sim_time"].lower() == "true",
        **{key: given[name] for name, (key, _) in PARAMETERS.items() if given[name]},
    }
    own = {"georeference_node": {}, "filter_node": {}, "volume_node": {}}
    own["logger_node"] = {"logger.path": given["log"]}
    if given["log_all"].lower() == "true":
        own["logger_node"]["logger.all"] = True
    if given["mavlink"]:
        own["mavlink_node"] = {"mavlink.url": given["mavlink"]}
    return [
        LifecycleNode(
            package="ladar_volume",
            executable=name,
            name=name,
            namespace=given["namespace"],
            parameters=[common | more],
            remappings=[(topic, given[argument]) for argument, topic in TOPICS.items()],
            output="screen",
            # each node lets those before it end, and finishes its work (stop_s and ending_s of
            # nodes/base.py)
            sigterm_timeout="120",
            sigkill_timeout="30",
        )
        for name, more in own.items()
    ]


def generate_launch_description() -> LaunchDescription:
    """The nodes configure and activate themselves unless node.autostart is false."""
    return LaunchDescription([*declared(), OpaqueFunction(function=nodes)])
