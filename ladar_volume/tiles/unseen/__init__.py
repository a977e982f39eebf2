"""What tiles tell of the surface they do not see: between their points (``tiled_between``), over
gaps (``tiled_gaps``), and in two layers of points (``tiled_layers``).
"""
