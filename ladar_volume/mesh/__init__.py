"""Meshes of any orientation: made, closed and measured (seed 002 chapters 5 to 8).

Public:

- ``local_mesh.mesh_cloud``: triangles through points with normals, without a height per place.
- ``edge_completion``: edges and corners where surfaces meet.
- ``closing``, ``bottom_closing``, ``ground_clipping``, ``hole_filling``, ``rims``: an open mesh
  closed on the ground or over its gaps.
- ``tetrahedra``: volume of a closed mesh with gradient and covariance.
- ``topology``, ``intersections``: what a mesh is, and whether it crosses itself.
- ``linear_mesh``: every vertex as a linear function of the measured points.
"""
