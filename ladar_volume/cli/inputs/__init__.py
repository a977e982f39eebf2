"""What the verbs read: options of a command line as settings, files as records.

- ``reading``: point clouds with their coordinates, units and classes.
- ``mesh_source``: mesh files as surfaces.
- ``filter_settings``: parameters of the filter for point cloud files.
- ``rows``: small tables of numbers that options name.

The options themselves are declared in ``cli.arguments``.
"""
