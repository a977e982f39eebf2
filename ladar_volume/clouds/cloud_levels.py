"""Floors of a cloud's surface from its cut volumes over many levels, with their standard
deviations, and the volume above the floor.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, corrected_volume, solid_above
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.volume.base import area_inside
from ladar_volume.volume.cutfill import Sequence, cut_sequence
from ladar_volume.volume.floors import MAX_LEVELS, Event, Floors, event_gradient, spikes
from ladar_volume.volume.near_base import near_levels


def level_list(start_m: float, stop_m: float, step_m: float) -> F64:
    """Levels (m,) m from start to stop, both included where the step divides their distance. Raises
    :class:`VolumeError` for a span that is empty, a step that is not positive, or more than a
    million levels.
    """
    span = np.array([start_m, stop_m, step_m], dtype=np.float64)
    if (
        not np.isfinite(span).all()
        or not step_m > 0
        or stop_m < start_m
        or (stop_m - start_m) / step_m > MAX_LEVELS
    ):
        words = f"levels from {start_m} to {stop_m} m by {step_m} m make no sequence"
        raise VolumeError(words, reason="volume_levels", value=span.tolist())
    count = int(np.floor((stop_m - start_m) / step_m + 1e-9)) + 1
    return np.asarray(start_m + step_m * np.arange(count), dtype=np.float64)


def sequence(surface: CloudSurface, levels_m: F64, base: Plane | None = None) -> Sequence:
    """Cut and fill of the relevant triangles at levels (m,), m; with a base they count from it. Not
    corrected near the levels: noise widens the spikes of second differences and leaves their
    centroids, so events and offsets are read off this.
    """
    return cut_sequence(surface.representation.tin, levels_m, base)


def folded_levels(surface: CloudSurface, found: Sequence, base: Plane | None = None) -> F64:
    """What noise adds to cut and to fill alike at each level (m,), m³, of a sequence ("folded
    normal"): no more than either; NaN where the noise is not known.
    """
    if surface.sigma_m is None:
        return np.full(len(found.level_m), np.nan)
    if not surface.sigma_m.any():
        return np.zeros(len(found.level_m))
    correction = near_levels(
        surface.representation.tin,
        found.level_m,
        surface.representation.covariance(surface.sigma_m),
        base,
    )
    return np.minimum(correction, np.minimum(found.cut_m3, found.fill_m3))


def events(
    surface: CloudSurface, found: Sequence, base: Plane | None = None
) -> tuple[tuple[Event, ...], F64]:
    """Flat parts of the surface as the sequence shows them, upwards, and the standard deviations
    (k,) m of their levels, NaN where the noise is not known. None for fewer than five levels.
    """
    if len(found.level_m) < 5:
        return (), np.zeros(0)
    seen = spikes(found.level_m, found.cut_m3)
    if not seen:
        return (), np.zeros(0)
    floors = _floors(found, seen)
    gradient = np.stack(
        [event_gradient(surface.representation.tin, floors, e, base) for e in seen], axis=1
    )
    return seen, np.sqrt(surface.variance(gradient))


def _floors(found: Sequence, seen: tuple[Event, ...]) -> Floors:
    return Floors(
        seen[0],
        seen[-1],
        seen,
        found.level_m,
        found.cut_m3,
        np.diff(found.cut_m3),
        np.diff(found.cut_m3, 2),
    )


def above_floor(
    surface: CloudSurface, found: Sequence, parameters: Parameters, correct: bool = True
) -> tuple[CloudVolume, Parameters]:
    """The volume above the lowest event of a sequence, whose level moves with the points that make
    it; and the parameters with that level.

    Raises :class:`VolumeError` where no level stands out.
    """
    seen = spikes(found.level_m, found.cut_m3)
    if not seen:
        raise VolumeError(
            "no level stands out: the surface has no flat part among these levels",
            reason="volume_no_floor",
        )
    floor, tin = seen[0], surface.representation.tin
    volume = dataclasses.replace(parameters.volume, base="level", level_m=floor.level_m)
    p = dataclasses.replace(parameters, volume=volume)
    base = design_surface([floor.level_m])
    solid = solid_above(
        surface, base, area_inside(tin, base, volume), p, np.zeros(len(tin.vertices)), correct
    )
    moves = event_gradient(tin, _floors(found, seen), floor)
    (_, gradient), *_ = solid.gradients
    # a level that rises by dz takes its area times dz from the net volume, and the area above it
    # from the cut
    moved = gradient - moves[:, None] * gradient.sum(axis=0)
    return corrected_volume(
        dataclasses.replace(solid, gradients=((surface, moved),)),
        f"floor of the same cloud at {floor.level_m:.4f} m",
        True,
    ), p
