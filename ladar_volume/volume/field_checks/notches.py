"""Notches: narrow and deep bays of a survey's edge, in which nothing was measured. Where everything
counts, a hole is bridged, but a notch is taken for the outside.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.boundary import border, part_numbers
from ladar_volume.tin.full_tin import footprint_areas

#: Depth over mean width above which a bay of the outline is a notch: a corner that is missing has
#: 1, half a circle 0.64.
DEEP = 1.25
#: What a notch may hold: in standard deviations, and in shares of the volume.
SIGMAS, SHARE = 3.0, 0.01
#: Bays that are looked at, the largest first, and border points of each.
MOST, POINTS = 20, 500


def notch_doubts(tin: Tin, base: Plane, size_m3: float, sigma_m3: float) -> list[Doubt]:
    """Each notch that may hold more than three sigma and 1 % of a volume above a base. Its surface
    is drawn straight from rim to rim.
    """
    outside = ~tin.relevant
    if not outside.any():
        return []
    part = part_numbers(tin.neighbours, outside)
    area = footprint_areas(tin.vertices, tin.triangles)
    held = area * height_above(tin.vertices, base)[tin.triangles].mean(axis=1)
    volumes = np.bincount(part[outside], held[outside]).astype(np.float64)
    found = []
    for k in large_bays(volumes, sigma_m3, size_m3):
        ends, _, hull = border(tin, part == k)
        corners = tin.vertices[tin.triangles[part == k], :2]
        found += notch_doubt(corners, tin.vertices[ends, :2], hull, float(volumes[k]))
    return found


def large_bays(volumes: F64, sigma_m3: float, size_m3: float) -> list[int]:
    """Which of bays with volumes (k,) m³ may hold enough, the largest first."""
    least = max(SIGMAS * sigma_m3, SHARE * abs(size_m3))
    order = np.argsort(-np.abs(volumes), kind="stable")[:MOST].tolist()
    return [k for k in order if abs(volumes[k]) > least]


def notch_doubt(corners: F64, ends: F64, hull: Bool, held_m3: float) -> list[Doubt]:
    """A bay, where it is a notch. corners : (t, 3, 2) m of its triangles · ends : (e, 2, 2) m of
    its sides · hull : (e,) which of these lie on the hull of the survey
    """
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    total, depth = float(area.sum()), depth_of(ends, hull)
    if not depth > DEEP * total / max(depth, 1e-300):
        return []
    return [words_of(area @ corners.mean(axis=1) / total, total, depth, held_m3)]


def depth_of(ends: F64, hull: Bool) -> float:
    """How far, m, a bay reaches in from the hull: the greatest distance of its rim from its sides
    on the hull, as :func:`notch_doubt` has them.
    """
    if not hull.any() or hull.all():
        return 0.0
    rim = np.unique(ends[~hull].reshape(-1, 2), axis=0)
    rim = rim[:: math.ceil(len(rim) / POINTS)]
    return float(segment_distances(rim, ends[hull, 0], ends[hull, 1]).min(axis=1).max())


def segment_distances(p: F64, a: F64, b: F64) -> F64:
    """Distances (n, k) m of points (n, 2) from segments from a to b (k, 2)."""
    d = b - a
    along = np.einsum("nkj,kj->nk", p[:, None] - a, d) / np.maximum((d**2).sum(axis=1), 1e-300)
    foot = a + np.clip(along, 0.0, 1.0)[..., None] * d
    out: F64 = np.linalg.norm(p[:, None] - foot, axis=2)
    return out


def words_of(at: F64, area_m2: float, depth_m: float, held_m3: float) -> Doubt:
    """What to do about a notch."""
    x, y = np.round(at, 6).tolist()  # on a lattice a middle may lie between two tenths
    words = (
        f"nothing was measured on {area_m2:.3g} m² about ({x:.1f}, {y:.1f}) m, a notch "
        f"{depth_m:.3g} m deep from the edge of the survey: some {held_m3:.3g} m³ may lie in it "
        "and are not counted; survey it, or draw the outline that counts"
    )
    return Doubt("notch", words, held_m3)
