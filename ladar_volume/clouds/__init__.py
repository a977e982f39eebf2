"""What starts from a point cloud file, without times or poses.

Public:

- ``filter_cloud.filter_cloud``: outliers out, noise down, edges kept (rooms ``filter`` and
  ``published``).
- ``cloud_surface``: a cloud as a surface with the noise of its points.
- ``cloud_volume``, ``cloud_levels``: cut and fill above a base, or between two clouds.
- ``cloud_bodies``, ``body_volume``: closed bodies on the ground or seen from all sides.
"""
