"""A cone of 4 m radius and 2 m height on gently waved ground, as filtered patches, and its
estimate.
"""

import math

import numpy as np

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilterUpdate, select
from ladar_volume.volume.estimator import VolumeEstimator
from test.scenes.volume_surfaces import platform, surface_update, take_patches

TRUE_M3 = math.pi * 4.0**2 * 2.0 / 3.0


def pile(x, y, at=(0.0, 0.0), radius=4.0, top=2.0):
    ground = 0.004 * np.sin(4.1 * x + 0.3) * np.cos(3.3 * y)
    return ground + np.maximum(0.0, top * (1.0 - np.hypot(x - at[0], y - at[1]) / radius))


def update_of(height=pile, seen=None, half=10.0):
    """The surface where ``seen(x, y)``."""
    update = surface_update(height, half=half, spacing=0.25, noise=0.004, perturb=0.002)
    if seen is None:
        return update
    keep = seen(update.patches.centre[:, 0], update.patches.centre[:, 1])
    points = select(update.points, np.isin(update.points.patch, update.patches.key[keep]))
    patches = take_patches(update.patches, np.flatnonzero(keep))
    return FilterUpdate(update.t_ns, update.removed, points, patches)


def estimator_of(height=pile, seen=None, half=10.0, region=(), **volume):
    """The estimator with what lies where ``seen(x, y)``."""
    given = {"volume": {"max_edge_m": 1.5, "ground_ring_m": 4.0, **volume}}
    given["filter"] = {"nav_bin_s": 1.0}
    p = Parameters.read(given | {"georeference": {"region_m": list(region)}})
    estimator = VolumeEstimator(p)
    estimator.add_platform(platform())
    estimator.add(update_of(height, seen, half))
    return estimator


def estimated(*given, **options):
    """The estimate of :func:`estimator_of`."""
    return estimator_of(*given, **options).estimate()


def names(estimate):
    """What the volume is doubted for."""
    return {doubt.name for doubt in estimate.volume.verdict.doubts}
