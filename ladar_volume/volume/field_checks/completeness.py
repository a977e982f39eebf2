"""Whether a body is whole: cut at the edge of the data or of the region, bounded by a wall, seen
with ground on one side only, or one of several.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64, I64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.volume.field_checks.cut_bodies import BodyCut, body_cut, cut_doubts
from ladar_volume.volume.field_checks.steep_faces import faces_to_base
from ladar_volume.volume.outline import labelled_bodies

#: Directions around a body that are told apart, and the widest gap in them without ground.
DIRECTIONS, WIDEST_DEG = 36, 60.0
#: Upward component of the normal of a steep face (60°), points of a direction that make one, and
#: the shares of the directions between which walls bound a part of the body.
STEEP, FEW, WALLED = 0.5, 3, (1.0 / 36.0, 0.75)


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
    return one_sided_doubts(np.bincount(at, minlength=DIRECTIONS))


def one_sided_doubts(count: I64) -> list[Doubt]:
    """The same from how many points of the ground lie in each direction (DIRECTIONS,)."""
    run, middle = longest_run(count < FEW)
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


def stands_on_faces(tin: Tin, base: Plane, inside: Bool, least_m: float) -> bool:
    """Whether steep faces bound a body nearly all round, as those of a box, seen or not."""
    centre = tin.vertices[vertex_mask(tin, inside), :2].mean(axis=0)
    at = directions(faces_to_base(tin, base, inside, least_m), centre)
    return len(np.unique(at)) > WALLED[1] * DIRECTIONS


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


def bodies_beside(
    tin: Tin, base: Plane, inside: Bool, p: VolumeParameters
) -> list[tuple[float, float, float]]:
    """Volumes, m³, and middles, m, of other bodies that stand beside those that count."""
    if p.outline != "auto" or p.bodies == 0:
        return []
    height = height_above(tin.vertices, base)
    area, found = footprint_areas(tin.vertices, tin.triangles), []
    label, kept = labelled_bodies(tin, base, p.object_height_m, 0, p.min_body_m3)
    for body in kept:
        rows = np.flatnonzero((label == body) & ~inside)
        own = float(area[rows] @ height[tin.triangles[rows]].mean(axis=1))
        if len(rows) and own >= p.min_body_m3:
            found.append((own, *tin.vertices[tin.triangles[rows], :2].mean(axis=(0, 1)).tolist()))
    return found


def further_doubts(found: list[tuple[float, float, float]], rise_m: float) -> list[Doubt]:
    """Other bodies stand beside those that count: their volumes, m³, and middles, m."""
    if not found:
        return []
    size, x, y = max(found)
    words = (
        f"{len(found)} further {'body rises' if len(found) == 1 else 'bodies rise'} more than "
        f"{rise_m:g} m above the base and {'is' if len(found) == 1 else 'are'} not in "
        f"the volume, the largest of {size:.4g} m³ at ({x:.1f}, {y:.1f}) m; set volume.bodies "
        "to 0 for all, or draw volume.polygon_m"
    )
    return [Doubt("further_bodies", words, sum(item[0] for item in found))]


class Surroundings(NamedTuple):
    """What lies along the outline of all bodies. cut : where the surface does not come down to the
    base · walls, ground : doubts whatever the volume · beside : :func:`bodies_beside`
    """

    cut: BodyCut | None
    walls: tuple[Doubt, ...]
    beside: list[tuple[float, float, float]]
    ground: tuple[Doubt, ...]

    def doubts(self, sigma_m3: float, parameters: Parameters) -> list[Doubt]:
        """What they let doubt of a volume with this sigma."""
        more = [body for body in self.beside if not body[0] < sigma_m3]
        return [
            *cut_doubts(self.cut, sigma_m3, parameters),
            *self.walls,
            *further_doubts(more, parameters.volume.object_height_m),
            *self.ground,
        ]


def surroundings_of(
    tin: Tin, base: Plane, inside_m2: F64, on_face: Bool, parameters: Parameters
) -> Surroundings:
    """For the outline of all bodies: inside_m2 (m,) m² of each triangle · on_face : (n,) vertices
    on steep faces.
    """
    inside, p, walls = inside_m2 > 0.0, parameters.volume, list[Doubt]()
    if p.outline == "auto" and not stands_on_faces(tin, base, inside, p.object_height_m):
        walls = wall_doubts(tin, base, inside, on_face, p.object_height_m)
    ground = ground_doubts(tin, base, inside) if p.outline != "all" else []
    return Surroundings(
        body_cut(tin, base, inside, p),
        tuple(walls),
        bodies_beside(tin, base, inside, p),
        tuple(ground),
    )
