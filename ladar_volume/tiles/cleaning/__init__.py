"""The stray points of all tiles, to those of one process: the order of all points along one curve
(``curve_tiles``), which of them are strays (``tile_strays``), and a cloud without these
(``tiled_cleaning``).
"""
