"""A recording through the pipeline by tiles: georeferenced by pieces of time, filtered tile by
tile, on as many workers as there are, to what one process gives.

1. The poses of the recording go through the georeferencer: datum, navigation, what is lost.
2. Each piece of time is georeferenced with the poses around it (``time_pieces``), and its returns
   are written to tiles (``return_store``).
3. Each tile is filtered with a halo (``tiles.patch_tiles``): its patches are those of the whole.
4. The patches of all tiles are one update of the estimator (``tiled_survey``): base, outline,
   volume and budget are those of one process, to the bit.

Public: ``tiled_survey.TiledReplay``. Pieces and tiles are at rest, each whole or not there, below a
digest of the recording and of what it is replayed with: an interrupted run goes on with those that
are missing.
"""
