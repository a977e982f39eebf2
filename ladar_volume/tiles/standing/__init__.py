"""What stands on the surface of all tiles: the points thinned to one a cell (``thinned_tiles``),
their steps (``tiled_steps``), the parts that these cut apart, in a tile and in all (``tile_parts``,
``tiled_parts``), the search among the points (``tiled_objects``), the surface without them
(``cleared_tiles``), and which objects are of an outline (``objects_inside``).
"""
