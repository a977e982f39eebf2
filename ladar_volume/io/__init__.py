"""Files and messages: bags, MCAP, MAVLink, point clouds, meshes, tables, configuration.

Public:

- ``bags``, ``mcap_log``, ``recorder``, ``mcap_recovery``: recordings in and out.
- ``cloud_messages``, ``sensor_messages``, ``message_tables``, ``tables``, ``cdr``: ROS messages
  to records and back.
- ``mavlink``: an autopilot's messages and logs.
- ``pointfiles``, ``meshfiles``: point clouds and meshes by the ending of their name.
- ``config``: strict YAML, and the pages generated from the parameters.
- ``results``, ``surveys``: results and kept surveys as files.
- ``transforms``, ``measurements``, ``epoch_registration``: what verbs hand to one another.
- ``atomic_write``, ``output_set``: files that are there whole or not at all, alone and as a set.
"""
