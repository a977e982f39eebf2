"""Two point clouds of one place, surveyed at two times.

Public:

- ``cloud_change.cloud_change``: the change with its verdict, its map and the level of detection.
- ``cloud_registration.lay_on``: the later cloud laid on the earlier one by what did not change.
"""
