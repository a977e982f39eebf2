"""Whether a body is whole: cut at the edge of the data or of the region, bounded by a wall, seen
with ground on one side only, or one of several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.ground.polynomial import base_height, height_above
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.boundary import boundary_sides, side_ends
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.tin.relevant import edge_lengths
from ladar_volume.volume.outline import bodies

#: Least volume that a cut is likely to hide, in standard deviations of the volume.
HIDDEN = 0.5
#: A boundary within so many metres of a side of the region is the region's.
AT_REGION_M = 1.5
#: Directions around a body that are told apart, and the widest gap in them without ground.
DIRECTIONS, WIDEST_DEG = 36, 60.0
#: Upward component of the normal of a steep face (60°), points of a direction that make one, and
#: the shares of the directions between which walls bound a part of the body.
STEEP, FEW, WALLED = 0.5, 3, (1.0 / 36.0, 0.75)
#: A sliver's long side, in usual edges; its width is below one. Layers of slivers that are peeled.
LONG, PEELED = 3.0, 20


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


def cut_at_boundary(tin: Tin, base: Plane, inside: Bool, least_m: float) -> BodyCut | None:
    """Where the surface stands higher above the base, or lies deeper, than ``least_m`` on the
    boundary of the triangles ``inside`` (m,).
    """
    t, k = boundary_sides(tin, without_slivers(tin, inside))
    r = tin.vertices[side_ends(tin, t, k)]
    height = np.abs(r[:, :, 2] - base_height(base, r[:, :, :2].reshape(-1, 2)).reshape(-1, 2))
    high = (height > least_m).any(axis=1)
    if not high.any():
        return None
    (one, two), length = height[high].T, np.hypot(*(r[high, 1, :2] - r[high, 0, :2]).T)
    weight = length * 0.5 * (one + two)
    x, y = (weight @ r[high, :, :2].mean(axis=1) / weight.sum()).tolist()
    total = float(length.sum())
    hidden = float(length @ (one**2 + one * two + two**2)) / 6.0
    return BodyCut(hidden, total, float(weight.sum()) / total, x, y)


def cut_doubts(
    tin: Tin, base: Plane, inside: Bool, sigma_m3: float, parameters: Parameters
) -> list[Doubt]:
    """The surface does not come down to the base at the outline. sigma_m3 : of the volume."""
    p = parameters.volume
    if p.outline == "all" or (p.outline == "polygon" and p.base != "ground"):
        return []
    found = cut_at_boundary(tin, base, inside, 0.5 * p.object_height_m)
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


def directions(xy: F64, centre: F64) -> I64:
    """Number (n,) of the direction from a centre (2,) in which points (n, 2) lie."""
    angle = np.arctan2(xy[:, 1] - centre[1], xy[:, 0] - centre[0]) % (2.0 * math.pi)
    out: I64 = np.minimum((angle * (DIRECTIONS / (2.0 * math.pi))).astype(np.int64), DIRECTIONS - 1)
    return out


def longest_run(missing: Bool) -> tuple[int, float]:
    """Length of the longest run of a ring (k,) of flags, and its middle."""
    if missing.all():
        return len(missing), 0.0
    best, middle, run = 0, 0.0, 0
    for at, gone in enumerate(np.concatenate([missing, missing])):
        run = run + 1 if gone else 0
        if run > best:
            best, middle = run, at - 0.5 * (run - 1)
    return best, middle % len(missing)


def ground_doubts(tin: Tin, base: Plane, inside: Bool) -> list[Doubt]:
    """The ground of the same survey lies on one side only."""
    if not len(base.support):
        return []
    centre = tin.vertices[vertex_mask(tin, inside), :2].mean(axis=0)
    at = directions(tin.vertices[base.support, :2], centre)
    run, middle = longest_run(np.bincount(at, minlength=DIRECTIONS) < FEW)
    wide = 360.0 * run / DIRECTIONS
    if wide < WIDEST_DEG:
        return []
    toward = 360.0 * (middle + 0.5) / DIRECTIONS
    words = (
        f"no ground was found beside the body over {wide:.0f}° about the direction {toward:.0f}° "
        "(counter-clockwise from east), so that the base is carried over from the other sides; "
        "survey the ground there, or give volume.base level or plane"
    )
    return [Doubt("ground_one_sided", words, wide)]


def steep(normal: F64) -> Bool:
    """Which of the vertices with these normals (n, 3) lie on steep faces."""
    out: Bool = np.abs(normal[:, 2]) < STEEP
    return out


def wall_doubts(tin: Tin, base: Plane, inside: Bool, on_face: Bool, least_m: float) -> list[Doubt]:
    """Steep faces bound a part of the body: a wall, a machine. on_face : (n,) vertices on them."""
    own = vertex_mask(tin, inside)
    r = tin.vertices
    height = height_above(r, base)
    high = own & on_face & (height > least_m)
    if not high.any():
        return []
    centre = r[own, :2].mean(axis=0)
    count = np.bincount(directions(r[high, :2], centre), minlength=DIRECTIONS)
    share = float(np.count_nonzero(count >= FEW)) / DIRECTIONS
    if not WALLED[0] <= share <= WALLED[1]:
        return []
    x, y = r[high, :2].mean(axis=0).tolist()
    words = (
        f"faces steeper than 60° and up to {float(height[high].max()):.2g} m high stand in "
        f"{360 * share:.0f}° of the directions around the body, about ({x:.1f}, {y:.1f}) m: a "
        "wall, a machine or a tree may be counted; look at it, or draw volume.polygon_m without it"
    )
    return [Doubt("wall", words, 360.0 * share)]


def body_doubts(
    tin: Tin, base: Plane, inside: Bool, sigma_m3: float, parameters: Parameters
) -> list[Doubt]:
    """Other bodies stand beside those that count. sigma_m3 : of the volume."""
    p = parameters.volume
    if p.outline != "auto" or p.bodies == 0:
        return []
    height = height_above(tin.vertices, base)
    area, found = footprint_areas(tin.vertices, tin.triangles), []
    for mask in bodies(tin, base, p.object_height_m, 0, p.min_body_m3):
        rows = np.flatnonzero(mask & ~inside)
        own = float(area[rows] @ height[tin.triangles[rows]].mean(axis=1))
        if len(rows) and own >= max(p.min_body_m3, sigma_m3):
            found.append((own, *tin.vertices[tin.triangles[rows], :2].mean(axis=(0, 1)).tolist()))
    if not found:
        return []
    size, x, y = max(found)
    words = (
        f"{len(found)} further {'body rises' if len(found) == 1 else 'bodies rise'} more than "
        f"{p.object_height_m:g} m above the base and {'is' if len(found) == 1 else 'are'} not in "
        f"the volume, the largest of {size:.4g} m³ at ({x:.1f}, {y:.1f}) m; set volume.bodies "
        "to 0 for all, or draw volume.polygon_m"
    )
    return [Doubt("further_bodies", words, sum(item[0] for item in found))]


def completeness_doubts(
    tin: Tin, base: Plane, inside_m2: F64, on_face: Bool, sigma_m3: float, parameters: Parameters
) -> list[Doubt]:
    """All of them, for the outline of all bodies: inside_m2 (m,) m² of each triangle · on_face :
    (n,) vertices on steep faces · sigma_m3 : of the volume.
    """
    inside = inside_m2 > 0.0
    out = cut_doubts(tin, base, inside, sigma_m3, parameters)
    if parameters.volume.outline == "auto":
        out += wall_doubts(tin, base, inside, on_face, parameters.volume.object_height_m)
    return [
        *out,
        *body_doubts(tin, base, inside, sigma_m3, parameters),
        *(ground_doubts(tin, base, inside) if parameters.volume.outline != "all" else []),
    ]
