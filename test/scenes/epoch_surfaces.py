"""Synthetic epochs of one place: sloping ground, and a pit of known volume in it."""

from __future__ import annotations

import dataclasses
import math

from volume_surfaces import cone, platform

from ladar_volume.model.parameters import Parameters
from ladar_volume.volume.estimator import VolumeEstimator

PIT = -math.pi * 16.0


def epoch(update, navigation=True, **sections):
    """A synthetic surface as an epoch."""
    e = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}, **sections}))
    e.add_platform(platform() if navigation else platform(position=0.0, attitude=0.0))
    e.add(update)
    return e.epoch()


def flat(x, y):
    return 3.0 + 0.02 * x


def pit(x, y):
    return flat(x, y) - cone(x, y)


def moved(update, shift):
    """The same survey with its points displaced along their normals by shift (n,) m."""
    r = update.points.r_map + shift[:, None] * update.points.normal
    return dataclasses.replace(update, points=dataclasses.replace(update.points, r_map=r))
