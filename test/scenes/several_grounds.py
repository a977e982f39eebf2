"""All ground surfaces of a scene, the main one first."""

from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.ground.surfaces import further_grounds


def find_grounds(points, variance, parameters):
    """Up to ``parameters.surfaces`` surfaces of points (n, 3) with variances (n,) m²."""
    main = fit_ground(points, variance, parameters)
    return main, *further_grounds(points, variance, main, parameters)
