"""What stands on the surface of all tiles: the points thinned to one a cell (``thinned_tiles``),
the search among them (``tiled_objects``), whether there are steps at all (``tiled_steps``), and
which objects are of an outline (``objects_inside``).
"""
