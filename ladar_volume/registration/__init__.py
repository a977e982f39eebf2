"""One scan's frame to another's, with covariance (seed 003).

Public:

- ``spheres``, ``sphere_start``: reference spheres from returns on them.
- ``stillness``: whether a sphere stood still.
- ``sphere_adjustment``: the transform from common centres.
- ``transform.Transform``: a transform with its covariance.
- ``icp``: refinement on common ground.
"""
