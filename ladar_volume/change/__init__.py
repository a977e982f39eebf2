"""Two surveys of one place: what changed, and whether it is more than noise.

Public:

- ``epoch_change.epoch_difference``: two surveys with their shared errors.
- ``cut_and_fill``, ``unchanged_ground``: cut and fill with standard deviations of their own.
- ``change_detection``: the map of change with its level of detection.
- ``excavation``, ``two_surfaces``, ``sight_ring``: a pit between two scans by tetrahedra to a
  free pole (seed 003 section 3).
- ``spherical_tin``: triangulation about the scanner.
- ``density``, ``resolution``: density from mass and volume; volume against resolution (seed 003
  section 4).
"""
