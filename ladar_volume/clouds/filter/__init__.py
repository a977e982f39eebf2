"""The filter for point cloud files: each cell finds one quadric or several planes.

``self_tuning`` chooses noise and radii from the cloud. ``cell_cover`` lays the grid of cells.
``cell_surface`` finds the surface of one cell: a plane or quadric (``single_surface``,
``orthogonal_quadric``) or several planes (``sharp_planes``, ``plane_em``,
``plane_set_selection``, ``plane_agreement``). ``point_reduction`` thins points before and after.
``filter_adjoint`` tells what one input point moves. The door is ``clouds.filter_cloud``.
"""
