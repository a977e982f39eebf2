"""Clouds larger than the memory: points at rest in square tiles, and the volume from their sums.

Public:

- ``tile_store``: a LAS, LAZ or COPC file dealt out into tiles on disk, part by part.
- ``tile_stars``: the triangles round a tile's points, as they are in the whole triangulation.
- ``tiled_volume``: the volume of all tiles above a level, a plane, or their ground.
- ``tile_work``: the work of all tiles, in this process or on Dask.
"""
