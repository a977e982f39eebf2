"""Ground surfaces and what stands on them.

Public:

- ``robust_ground.fit_ground``: plane or polynomial by random sampling with a gravity prior, then
  least squares on the inliers.
- ``surfaces``: several ground surfaces of one scene, and heights above them.
- ``polynomial``: surfaces ``z = x(dx, dy) @ beta`` of degree 0 to 3.
- ``heights``: of many points above such a surface.
- ``objects``, ``clusters``, ``regions``: objects above the ground, and how they are chosen.
- ``ground_adjoint``: the gradient of a result by the ground's own points.
- ``ground_presets``: published settings (seed 002 section 9.3).
"""
