"""From sensor samples to points in the map: the LiDAR equation with its Jacobians.

Public:

- ``georeferencer.Georeferencer``: the stage. Fixes, attitudes and returns in; mapped points and
  platform states out.
- ``lidar_equation``, ``mapping``: one return, and a whole cloud in one compiled pass.
- ``trajectory``, ``knot_table``: the platform's path, interpolated at each return's own time.
- ``error_budget``, ``point_jacobian``: the error sources and how a point moves with each.
- ``sample_admission``, ``clock_check``, ``clock_restart``: which samples are let in, and why not.
- ``geodesy``: WGS 84 to the local tangent plane.

Source: seed 004 sections 4.1 and 4.2; Glennie 2007.
"""
