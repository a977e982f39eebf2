"""The bodies that rise above the ground, as piles with an outline."""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import ground_and_outline
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import Pile
from ladar_volume.volume.base import body_of_each
from ladar_volume.volume.outline import boundary_loop


def found_piles(surface: CloudSurface, parameters: Parameters) -> list[Pile]:
    """All bodies of at least ``volume.min_body_m3``, the largest first, each within its outline
    with the margin. Raises GroundError where no ground is found, and VolumeError where nothing
    rises above it.
    """
    volume = dataclasses.replace(parameters.volume, base="ground", outline="auto", bodies=0)
    own = dataclasses.replace(parameters, volume=volume)
    tin = surface.representation.tin
    base, inside = ground_and_outline(tin, surface.vertex_variance, own)
    body, count = body_of_each(tin, base, inside, volume)
    masks = [inside > 0] if body is None else (body == number for number in range(count))
    rings = [np.ascontiguousarray(boundary_loop(tin, mask)) for mask in masks]
    rings = [ring for ring in rings if len(ring) >= 3]
    return [Pile(f"pile {number}", ring, is_found=True) for number, ring in enumerate(rings, 1)]
