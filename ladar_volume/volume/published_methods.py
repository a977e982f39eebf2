"""A body's volume from a surface with it and one without (seed 000 section 5.4), in any frame.

*Method 1* takes levels just in front of the body, between it and the instrument: fill without it
    minus fill with it. *Method 2* takes
levels beyond everything scanned, where fill is zero: cut with it minus cut without. Both compare
    each surface over its own footprint,
and levels that differ by the offset between the two surfaces. Where the footprints differ, their
difference times the distance to the level enters; :func:`overlay.volumes_between` over the common
footprint does not know this error, nor needs a level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Tin
from ladar_volume.volume.cutfill import cut_sequence


@dataclass(frozen=True)
class Pairs:
    """Volumes by pairs of levels, as in Table 5.7: level_with_m, level_without_m : (m,) · with_m3,
    without_m3 : (m,) cut or fill volumes of each surface · volume_m3 : (m,) of the body · slope_m2
    : change of the volume by the level, from a line through all pairs (NaN for one) · areas_m2 :
    footprints with and without
    """

    level_with_m: F64
    level_without_m: F64
    with_m3: F64
    without_m3: F64
    volume_m3: F64
    slope_m2: float
    areas_m2: tuple[float, float]


def level_pairs(
    surface_with: Tin, surface_without: Tin, level_with_m: F64, offset_m: float, part: str
) -> Pairs:
    """Volumes of a body by ``part``: "fill" (Method 1) or "cut" (Method 2, and Experiments 1 to 3
    with offset 0) at levels (m,) of the surface with it; the other surface's levels are ``level −
    offset``, see :class:`floors.Offset`.
    """
    if part not in ("cut", "fill"):
        raise VolumeError(
            f"volumes are compared by cut or by fill, not {part!r}",
            reason="volume_part",
            value=part,
        )
    level = np.atleast_1d(np.asarray(level_with_m, dtype=np.float64))
    one, two = cut_sequence(surface_with, level), cut_sequence(surface_without, level - offset_m)
    a, b = (one.cut_m3, two.cut_m3) if part == "cut" else (one.fill_m3, two.fill_m3)
    volume = a - b if part == "cut" else b - a
    slope = (
        float(np.polyfit(level - level.mean(), volume, 1)[0])
        if len(np.unique(level)) > 1
        else float("nan")
    )
    return Pairs(level, level - offset_m, a, b, volume, slope, (one.area_m2, two.area_m2))


def method_one(
    surface_with: Tin, surface_without: Tin, level_with_m: F64, offset_m: float = 0.0
) -> Pairs:
    """Method 1: fill volumes at levels between the body and the instrument (see
    :func:`front_level`).
    """
    return level_pairs(surface_with, surface_without, level_with_m, offset_m, "fill")


def method_two(
    surface_with: Tin, surface_without: Tin, level_with_m: F64 | None = None, offset_m: float = 0.0
) -> Pairs:
    """Method 2: cut volumes at levels where the fill of both surfaces is zero; by default the
    highest such level.

    Raises :class:`VolumeError` where a level leaves fill.
    """
    level = (
        np.array([zero_fill_level(surface_with, surface_without, offset_m)])
        if level_with_m is None
        else np.atleast_1d(level_with_m)
    )
    if level.max() > zero_fill_level(surface_with, surface_without, offset_m):
        raise VolumeError(
            f"at level {level.max()} m there is fill",
            reason="volume_fill",
            value=float(level.max()),
        )
    return level_pairs(surface_with, surface_without, level, offset_m, "cut")


def zero_fill_level(surface_with: Tin, surface_without: Tin, offset_m: float = 0.0) -> float:
    """The highest level (m, of the surface with the body) below which neither surface has fill."""
    lows = []
    for tin in (surface_with, surface_without):
        if not tin.relevant.any():
            raise VolumeError(
                "there is no triangle to take a volume of", reason="volume_no_triangle"
            )
        lows.append(float(tin.vertices[tin.triangles[tin.relevant], 2].min()))
    return min(lows[0], lows[1] + offset_m)


def front_level(
    surface_with: Tin,
    surface_without: Tin,
    step_m: float,
    offset_m: float = 0.0,
    share: float = 0.001,
) -> float:
    """The level (m, of the surface with the body) that separates the body from the instrument: one
    step above the highest at which the two cut volumes differ by ``share`` of their greatest
    difference.
    """
    high = max(
        float(s.vertices[s.triangles[s.relevant], 2].max()) for s in (surface_with, surface_without)
    )
    low = zero_fill_level(surface_with, surface_without, offset_m)
    if not step_m > 0 or not (high - low) / step_m < 1e6:
        raise VolumeError(
            f"the step between levels is {step_m} m", reason="volume_levels", value=step_m
        )
    level = np.asarray(low + step_m * np.arange(int((high - low) / step_m) + 2), dtype=np.float64)
    difference = np.abs(
        cut_sequence(surface_with, level).cut_m3
        - cut_sequence(surface_without, level - offset_m).cut_m3
    )
    if difference.max() == 0.0:
        raise VolumeError(
            "the two surfaces are the same: there is no body", reason="volume_no_body"
        )
    return float(level[np.flatnonzero(difference >= share * difference.max())[-1]] + step_m)
