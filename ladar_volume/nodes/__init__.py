"""The ROS graph: the only room that imports rclpy.

Public:

- ``georeference_node``, ``filter_node``, ``volume_node``: the steps of ``pipeline`` as nodes.
- ``logger_node``, ``mavlink_node``, ``player``: recording, autopilot, replay.
- ``graph.Graph``: all of them in one process or each in its own; ``programs`` has their entries.

Within: ``base`` (the lifecycle node with its worker and counted queue, ``work_queue``),
``declared_parameters``, ``qos``, ``convert`` (records and messages), ``flow_control`` (how far a
sender is ahead), ``stream_passes`` (a recording that starts again), ``previous_epoch``,
``executor_rounds``, ``running``. What a node says of its own state is in ``watch``.
"""
