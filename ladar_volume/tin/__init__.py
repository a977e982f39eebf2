"""Triangulated surfaces over a plane: the TIN kernel of TINvolume (seed 000).

Public:

- ``delaunay``: exact Delaunay triangulations and the proof that one is valid.
- ``full_tin``, ``adaptive``, ``greedy``: every point, or the few that represent them.
- ``elevation_adjustment``, ``asd_adjustment``, ``diagonal_exchange``: a better fit.
- ``represent``: from a cloud to the surface that represents it, all options together.
- ``relevant``, ``boundary``: which triangles count.
- ``median_screen``: outliers deleted or levelled (TINscreen, TINfilter).
- ``locate``: where a point lies in a triangulated surface.
- ``adjustment_adjoint``: how an adjusted surface follows its raw points.
- ``predicates``: exact signs, which everything above rests on.
"""
