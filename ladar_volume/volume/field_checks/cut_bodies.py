"""Where a body is cut by the region or by the edge of what was seen, and what may lie beyond."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import base_height
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.boundary import boundary_sides, side_ends
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.tin.relevant import edge_lengths

#: Least volume that a cut is likely to hide, in standard deviations of the volume.
HIDDEN = 0.5
#: A boundary within so many metres of a side of the region is the region's.
AT_REGION_M = 1.5
#: A sliver's long side, in usual edges; its width is below one. Layers of slivers that are peeled.
LONG, PEELED = 3.0, 20
#: Slopes (tangents) across a cut: towards it the surface rises from the first on, and falls off no
#: more gently than the second. How often what was seen may be missing where it rises.
RISING, FLAT, RISES = 0.1, 0.1, 2.0
#: The slope is told over so many usual lengths of a side, and so many metres, or this part of a
#: small body's width, at least; from the mean of so many points.
INWARD, INWARD_M, PART, NEAREST = 4.0, 0.5, 0.05, 4


@dataclass(frozen=True)
class BodyCut:
    """Where a body is cut. hidden_m3 : volume beyond that is likely, if the surface falls off at
    45° · length_m : of the cut · high_m : its mean height · x_m, y_m : its middle
    """

    hidden_m3: float
    length_m: float
    high_m: float
    x_m: float
    y_m: float


def without_slivers(tin: Tin, inside: Bool) -> Bool:
    """The triangles (m,) inside without the slivers along a straight boundary: where the edge of
    the data cuts a body, one long side can pass below it from ground to ground.
    """
    if not inside.any():
        return inside
    usual = float(np.median(edge_lengths(tin, inside)))
    left = inside.copy()
    for _ in range(PEELED):
        t, k = boundary_sides(tin, left)
        d = np.diff(tin.vertices[side_ends(tin, t, k), :2], axis=1)[:, 0]
        length, area = np.hypot(d[:, 0], d[:, 1]), footprint_areas(tin.vertices, tin.triangles[t])
        gone = t[(length > LONG * usual) & (2.0 * area < usual * length)]
        if not len(gone):
            break
        left[gone] = False
    return left


class CutSides(NamedTuple):
    """Sides on which a body is cut. triangle : (k,) inside · ends : (k, 2) vertices · height : (k,
    2) m of these off the base · length_m : (k,)
    """

    triangle: I64
    ends: I32
    height: F64
    length_m: F64

    @property
    def section_m3(self) -> F64:
        """Integral (k,) of the squared height along each side."""
        one, two = self.height.T
        out: F64 = self.length_m * (one**2 + one * two + two**2) / 3.0
        return out


def cut_sides(tin: Tin, base: Plane, inside: Bool, least_m: float) -> CutSides:
    """Sides on the boundary of the triangles ``inside`` (m,) with an end more than ``least_m`` off
    the base.
    """
    t, k = boundary_sides(tin, without_slivers(tin, inside))
    ends = side_ends(tin, t, k)
    r = tin.vertices[ends]
    height = np.abs(r[:, :, 2] - base_height(base, r[:, :, :2].reshape(-1, 2)).reshape(-1, 2))
    high = (height > least_m).any(axis=1)
    length = np.hypot(*(r[high, 1, :2] - r[high, 0, :2]).T)
    return CutSides(t[high], ends[high], height[high], length)


def slopes_across(tin: Tin, base: Plane, inside: Bool, sides: CutSides) -> F64:
    """Slopes (k,) at which the surface rises outwards across each side on which it is cut, from
    some sides' lengths within to the side: of the triangles at a ragged edge many are slivers.
    """
    ends = tin.vertices[sides.ends]
    along = (ends[:, 1, :2] - ends[:, 0, :2]) / np.maximum(sides.length_m, 1e-9)[:, None]
    across = np.column_stack([along[:, 1], -along[:, 0]])
    within = tin.vertices[tin.triangles[sides.triangle], :2].mean(axis=1) - ends[:, 0, :2]
    across *= np.where((across * within).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    own = tin.vertices[vertex_mask(tin, inside)]
    height = np.abs(height_above(own, base))
    middle = ends[:, :, :2].mean(axis=1)
    wide = math.sqrt(float(footprint_areas(tin.vertices, tin.triangles[inside]).sum()))
    far = max(INWARD * float(np.median(sides.length_m)), min(INWARD_M, PART * wide))
    count = min(NEAREST, len(own))
    near = cKDTree(own[:, :2]).query(middle - far * across, k=count)[1].reshape(-1, count)
    inward = ((middle[:, None] - own[near, :2]) * across[:, None]).sum(axis=2).mean(axis=1)
    rise = sides.height.mean(axis=1) - height[near].mean(axis=1)
    slopes: F64 = rise / np.maximum(inward, 0.5 * far)
    return slopes


def missing_at_most(tin: Tin, base: Plane, inside: Bool, sides: CutSides, body_m3: float) -> float:
    """The most that a body of so many m³ is likely to have beyond the sides on which it is cut, m³.

    Where the surface falls off across the cut it goes on falling as steeply, down to the base: a
    heap falls off more steeply further out. What was seen of the body is the most that is allowed:
    its summit was seen. Twice that where the surface rises towards the cut. inside : (m,) triangles
    of the body
    """
    section, slopes = sides.section_m3, slopes_across(tin, base, inside, sides)
    order = np.argsort(slopes)
    middle = int(np.searchsorted(np.cumsum(section[order]), 0.5 * float(section.sum())))
    slope = float(slopes[order[min(middle, len(order) - 1)]])
    if slope > RISING:
        return RISES * body_m3
    return min(body_m3, 0.5 * float(section.sum()) / max(-slope, FLAT))


def missing_m6(tin: Tin, base: Plane, inside: Bool, sides: CutSides, volume_m3: float) -> float:
    """Variance of a body, the triangles ``inside`` (m,), for what is beyond the sides on which it
    is cut: anything from nothing to :func:`missing_at_most` is as likely (GUM 4.3.7, about what was
    seen).
    """
    if not len(sides.ends):
        return 0.0
    return missing_at_most(tin, base, inside, sides, abs(volume_m3)) ** 2 / 3.0


def cut_m6(tin: Tin, base: Plane, part: F64, volume_m3: float, parameters: Parameters) -> float:
    """:func:`missing_m6` of a body, part (m,) m² of each triangle. None for an outline that is
    given: it says what is meant.
    """
    p = parameters.volume
    if p.outline != "auto":
        return 0.0
    inside = part > 0.0
    sides = cut_sides(tin, base, inside, 0.5 * p.object_height_m)
    return missing_m6(tin, base, inside, sides, volume_m3)


def cut_at_boundary(tin: Tin, base: Plane, inside: Bool, least_m: float) -> BodyCut | None:
    """Where the surface stands higher above the base, or lies deeper, than ``least_m`` on the
    boundary of the triangles ``inside`` (m,).
    """
    sides = cut_sides(tin, base, inside, least_m)
    if not len(sides.ends):
        return None
    r = tin.vertices[sides.ends]
    length, total = sides.length_m, float(sides.length_m.sum())
    weight = length * sides.height.mean(axis=1)
    x, y = (weight @ r[:, :, :2].mean(axis=1) / weight.sum()).tolist()
    hidden = 0.5 * float(sides.section_m3.sum())
    return BodyCut(hidden, total, float(weight.sum()) / total, x, y)


def body_cut(tin: Tin, base: Plane, inside: Bool, p: VolumeParameters) -> BodyCut | None:
    """Where the outline, the boundary of the triangles ``inside`` (m,), cuts bodies that do not end
    there by themselves; None where it does not, or says itself what is meant.
    """
    if p.outline == "all" or (p.outline == "polygon" and p.base != "ground"):
        return None
    return cut_at_boundary(tin, base, inside, 0.5 * p.object_height_m)


def cut_doubts(found: BodyCut | None, sigma_m3: float, parameters: Parameters) -> list[Doubt]:
    """The surface does not come down to the base at the outline. sigma_m3 : of the volume."""
    if found is None or found.hidden_m3 < HIDDEN * sigma_m3:
        return []
    what, todo = cause_of(found, parameters)
    words = (
        f"{what}: the surface stands {found.high_m:.2g} m off the base along {found.length_m:.3g} m"
        f" of the outline about ({found.x_m:.1f}, {found.y_m:.1f}) m, so that some "
        f"{found.hidden_m3:.2g} m³ or more are not counted; {todo}"
    )
    return [Doubt("cut", words, found.hidden_m3)]


def cause_of(cut: BodyCut, parameters: Parameters) -> tuple[str, str]:
    """What cuts a body, and what to do."""
    region = parameters.georeference.region_m
    if parameters.volume.outline == "polygon":
        return "the outline cuts the body", "draw volume.polygon_m around its toe"
    if len(region) == 6:
        x0, y0, _, x1, y1, _ = region
        apart = min(abs(cut.x_m - x0), abs(cut.x_m - x1), abs(cut.y_m - y0), abs(cut.y_m - y1))
        if apart < AT_REGION_M:
            return "the region cuts the body", "widen georeference.region_m"
    return "the edge of what was seen cuts the body", "survey that place"
