"""What the JSON says of cut and fill: one volume, and its sequence over levels."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import numpy as np

from ladar_volume.clouds.cloud_levels import events, folded_levels, sequence
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.volume.cutfill import Sequence
from ladar_volume.volume.field_checks.base_readings import student_factor
from ladar_volume.volume.floors import surface_offset
from ladar_volume.volume.published_methods import method_one, method_two


def volume_facts(volume: CloudVolume, parameters: Parameters) -> dict[str, Any]:
    """What the JSON says of a volume."""
    confidence = parameters.volume.confidence
    share = volume.budget_m6.get("base_surface", 0.0) / max(volume.sigma_m3**2, 1e-300)
    normal = NormalDist().inv_cdf(0.5 + confidence / 2)
    k = student_factor(normal, confidence, share, volume.freedom)
    half = k * volume.sigma_m3
    return {
        "cut_m3": volume.cut_m3,
        "fill_m3": volume.fill_m3,
        "net_m3": volume.net_m3,
        "sigma_m3": volume.sigma_m3,
        "interval_m3": [volume.net_m3 - half, volume.net_m3 + half],
        "confidence": confidence,
        "coverage_factor": k,
        "sigma_cut_m3": volume.sigma_cut_m3,
        "sigma_fill_m3": volume.sigma_fill_m3,
        "area_m2": volume.area_m2,
        "base": volume.base,
        "base_same_survey": volume.base_same_survey,
        "correction": {
            "name": "folded normal" if abs(volume.folded_m3) > 0.0 else None,
            "m3": volume.folded_m3,
            "near_area_m2": volume.near_area_m2,
            "cut_raw_m3": volume.cut_raw_m3,
            "fill_raw_m3": volume.fill_raw_m3,
        },
        "cover_m3": volume.cover_m3,
        "budget_m6": volume.budget_m6,
        "sigma_holds": "noise of the points and what lies between them only",
        "centimetre_m3": 0.01 * volume.area_m2,
    }


def pair_facts(
    surfaces: list[CloudSurface], method: int, levels: F64, offset_m: float
) -> dict[str, Any]:
    """Volumes of a body by pairs of levels, one of each surface (seed 000 Table 5.7)."""
    compare = method_one if method == 1 else method_two
    found = compare(
        surfaces[0].representation.tin, surfaces[1].representation.tin, levels, offset_m
    )
    return {
        "method": method,
        "part": "fill" if method == 1 else "cut",
        "offset_m": offset_m,
        "level_with_m": found.level_with_m.tolist(),
        "level_without_m": found.level_without_m.tolist(),
        "with_m3": found.with_m3.tolist(),
        "without_m3": found.without_m3.tolist(),
        "volume_m3": found.volume_m3.tolist(),
        "slope_m2": None if np.isnan(found.slope_m2) else found.slope_m2,
        "areas_m2": list(found.areas_m2),
    }


def level_facts(
    surfaces: list[CloudSurface], levels: F64, base: Plane | None, correct: bool
) -> dict[str, Any]:
    """Sequences, events and, for two clouds, the offset between their sequences. Cut and fill are
    corrected near the levels where that is wanted and the noise is known.
    """
    found = [sequence(s, levels, base) for s in surfaces]
    facts: dict[str, Any] = {
        "sequences": [
            _sequence_facts(surface, each, base, correct)
            for surface, each in zip(surfaces, found, strict=True)
        ],
        "levels_from": "the base" if base is not None else "zero height of the frame",
    }
    if len(surfaces) == 2:
        facts["offset"] = _offset_facts(surfaces[0], surfaces[1], levels)
    return facts


def _sequence_facts(
    surface: CloudSurface, each: Sequence, base: Plane | None, correct: bool
) -> dict[str, Any]:
    """Cut and fill of one surface by level, and the events of the sequence."""
    seen, sigma = events(surface, each, base)
    folded = folded_levels(surface, each, base) if correct else np.zeros(len(each.level_m))
    known = np.nan_to_num(folded)
    return {
        "level_m": each.level_m.tolist(),
        "cut_m3": (each.cut_m3 - known).tolist(),
        "fill_m3": (each.fill_m3 - known).tolist(),
        "folded_m3": folded.tolist(),
        "above_m2": each.above_m2.tolist(),
        "first_m3": np.diff(each.cut_m3).tolist(),
        "second_m3": np.diff(each.cut_m3, 2).tolist(),
        "events": [
            {"level_m": e.level_m, "sigma_m": s, "area_m2": e.area_m2, "width_m": e.width_m}
            for e, s in zip(seen, sigma.tolist(), strict=True)
        ],
        "floor_m": seen[0].level_m if seen else None,
        "top_m": seen[-1].level_m if seen else None,
    }


def _offset_facts(first: CloudSurface, second: CloudSurface, levels: F64) -> dict[str, Any]:
    """The offset between the sequences of two surfaces, or why there is none."""
    try:
        offset = surface_offset(first.representation.tin, second.representation.tin, levels)
    except VolumeError as error:
        return {"offset_m": None, "why": str(error)}
    return {"offset_m": offset.offset_m, "sigma_m": offset.sigma_m, "levels": offset.levels}
