"""Which part of the surface of all tiles was sampled, to what
:mod:`ladar_volume.tin.sampled_area` tells of one: what a tile knows (``tile_area``), and what all
know together (``tiled_area``).
"""
