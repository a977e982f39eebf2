"""Volumes of surfaces above a base, with their corrections, and the live estimator.

Public:

- ``estimator.VolumeEstimator``: the stage. Filtered points and patches in; volume, TIN and ground
  out.
- ``prismoids``, ``cutfill``, ``polygon``: cut, fill and net by exact prismoids.
- ``base``, ``outline``: what a volume stands on and where it counts.
- ``overlay``: two triangulated surfaces over their common footprint.
- ``near_base``, ``folded_normal``: cut and fill where the surface runs along its base.
- ``floors``, ``published_methods``: levels and methods of seed 000.
- ``more_data``: where flying again would help.
"""
