"""Which part of the surface of all tiles was sampled, to what
:mod:`ladar_volume.tin.sampled_area` tells of one: what a tile knows (``tile_area``), the points
without those that stand alone beyond (``without_alone``), and both together (``tiled_area``).
"""
