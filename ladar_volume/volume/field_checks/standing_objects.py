"""What stands on a body or beside it and is no part of it: machines, walls, people, plants, cables.

Loose material keeps slopes of less than some 45°. The surface is cut apart along every edge of the
triangulation that is steeper than 55° and higher than a step; what is left hangs together in parts.
A part that lies above nearly all of its steep edges stands on the surface: its vertices are taken
out, and the surface is made from the others. What it hid is then a gap, bridged and in sigma as
every other. (Slope-based filtering: Vosselman 2000, *International Archives of Photogrammetry and
Remote Sensing* 33-B3, 935; segments by their steps: Sithole and Vosselman 2005, *ISPRS WG III/3*.)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.parameters import VolumeParameters
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, StandingObject, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import build_tin, footprint_areas, vertex_mask
from ladar_volume.tin.locate import height_at
from ladar_volume.volume.outline import labelled_bodies

#: Steeper than any loose material, and higher than a step (m): such an edge parts the surface.
STEEP, STEP_M = math.tan(math.radians(55.0)), 0.25
#: A part that lies above so many of its steep edges stands on the surface.
ABOVE = 0.6
#: Objects hide at most so much of an outline, and have at most so much of the vertices: more is the
#: body itself.
MOST, LARGE = 0.4, 0.25
#: Rounds in which what stands on what was found is found.
ROUNDS = 20
#: Vertices nearer than so many of the filter's radii bend towards an object.
BENT = 0.5
#: Vertices nearer than this are of one object; the surface around it reaches so far, m.
APART_M, AROUND_M = 1.0, 4.0
#: Objects matter from so many standard deviations of the volume on.
MATTERS = 0.5


def parts(n: int, one: I64 | I32, two: I64 | I32) -> I64:
    """The part (n,) to which each of n things belongs that edges one (k,), two (k,) join."""
    graph = sparse.coo_array((np.ones(len(one), np.int8), (one, two)), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1]).astype(np.int64)


class Steps(NamedTuple):
    """Steps between parts of a surface. size : (p,) vertices of each part · low, high : (k,) parts
    below and above · times : (k,) how many steep edges lead from one to the other, those of two
    triangles twice
    """

    size: I64
    low: I64
    high: I64
    times: I64

    @property
    def ground(self) -> int:
        """The largest part."""
        return int(np.argmax(self.size))


@kernel
def any_step(triangles: I32, vertices: F64, step_m: float, steep: float) -> bool:
    """Whether an edge of triangles (m, 3) is higher than a step, m, and steeper than a slope."""
    for t in range(len(triangles)):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            rise = abs(vertices[b, 2] - vertices[a, 2])
            if rise > step_m:
                x, y = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
                if rise * rise > steep * steep * (x * x + y * y):
                    return True
    return False


class CutApart(NamedTuple):
    """label : (n,) part of each vertex · low, high : (k,) vertices of the steep edges of each
    triangle
    """

    label: I64
    low: I64
    high: I64


def cut_apart(tin: Tin, longest_m: float, step_m: float, counted: Bool | None = None) -> CutApart:
    """The parts of a surface, and the steep edges of its triangles, or of those ``counted`` (m,)
    alone. longest_m : of edges that join · step_m : least height of a step
    """
    t, r = tin.triangles, tin.vertices
    one = np.concatenate([t[:, 0], t[:, 1], t[:, 2]])
    two = np.concatenate([t[:, 1], t[:, 2], t[:, 0]])
    rise, d = r[two, 2] - r[one, 2], r[two, :2] - r[one, :2]
    length = np.hypot(d[:, 0], d[:, 1])
    steep = (np.abs(rise) > step_m) & (np.abs(rise) > STEEP * length)
    joins = ~steep & (length <= longest_m)
    label = parts(len(r), one[joins], two[joins])
    if counted is not None:
        steep &= np.tile(counted, 3)
    up = rise[steep] > 0.0
    a, b = one[steep], two[steep]
    return CutApart(label, np.where(up, a, b), np.where(up, b, a))


def between_parts(low: I64, high: I64, times: I64, size: I64) -> Steps:
    """Steps (k,) between parts (p,), those between the same two as one."""
    name, at = np.unique(low * len(size) + high, return_inverse=True)
    total = np.bincount(at.reshape(-1), times, len(name)).astype(np.int64)
    return Steps(size, name // len(size), name % len(size), total)


def standing_parts(steps: Steps, own: Bool) -> Bool:
    """Parts (p,) that stand on others, from the top down; ``own`` (p,) never do."""
    found = np.zeros(len(steps.size), np.bool_)
    may = ~own & (steps.size <= LARGE * steps.size.sum())
    for _ in range(ROUNDS):
        left = ~found[steps.low] & ~found[steps.high]
        above = np.bincount(steps.high[left], steps.times[left], len(found))
        below = np.bincount(steps.low[left], steps.times[left], len(found))
        more = may & ~found & (above > 0) & (above >= ABOVE * (above + below))
        if not more.any():
            break
        found |= more
    return found


def more_on_ground(steps: Steps, found: Bool) -> bool:
    """Whether more steps lie within the ground's own part than below the parts ``found`` (p,)."""
    on_ground = (steps.low == steps.ground) & (steps.high == steps.ground)
    return int(steps.times[on_ground].sum()) > int(steps.times[found[steps.high]].sum())


def standing_vertices(
    tin: Tin, base: Plane, inside: Bool, p: VolumeParameters, step_m: float = STEP_M
) -> Bool:
    """Vertices (n,) of what stands on the surface. inside : (m,) triangles that count · step_m :
    least height of a step

    None where the main body itself stands on steep faces, as a box does, where more steps lie
    within the ground's own part than below what would go, and where most of the outline would go.
    """
    none = np.zeros(len(tin.vertices), np.bool_)
    if not any_step(tin.triangles, tin.vertices, step_m, STEEP):
        return none
    cut = cut_apart(tin, p.max_edge_m, step_m)
    size, once = np.bincount(cut.label), np.ones(len(cut.low), np.int64)
    steps = between_parts(cut.label[cut.low], cut.label[cut.high], once, size)
    own = np.zeros(len(size), np.bool_)
    own[steps.ground] = True
    if p.outline == "auto":
        label, kept = labelled_bodies(tin, base, p.object_height_m, p.bodies, p.min_body_m3)
        for body in kept:
            count = np.bincount(cut.label[vertex_mask(tin, label == body)], minlength=len(own))
            own[int(np.argmax(count))] = True
            if body == kept[0] and int(np.argmax(count)) != steps.ground:
                return none
    standing = standing_parts(steps, own)
    if more_on_ground(steps, standing):
        return none
    out: Bool = np.asarray(standing[cut.label])
    area = footprint_areas(tin.vertices, tin.triangles)
    hidden = inside & out[tin.triangles].any(axis=1)
    if float(area[hidden].sum()) > MOST * float(area[inside].sum()):
        return none
    return out


def bent_vertices(tin: Tin, standing: Bool, radius_m: float) -> Bool:
    """``standing`` (n,) with the vertices that bend towards them. radius_m : of the filter."""
    tree = cKDTree(tin.vertices[standing, :2])
    near = np.asarray(tree.query(tin.vertices[:, :2], distance_upper_bound=BENT * radius_m)[0])
    out: Bool = standing | np.isfinite(near)
    return out


def clumps(xy: F64, apart_m: float) -> I64:
    """The part (n,) to which places xy (n, 2) m belong, nearer ones than a distance to the same."""
    pairs = cKDTree(xy).query_pairs(apart_m, output_type="ndarray")
    return parts(len(xy), pairs[:, 0], pairs[:, 1])


def objects_of(
    tin: Tin, standing: Bool, taken: Bool, counted: Bool, label: I64
) -> tuple[StandingObject, ...]:
    """What stood on the surface, the largest first: vertices ``standing`` (n,), k of them, above
    those that were not ``taken`` (n,). counted : (n,) vertices of triangles that counted · label :
    (k,) the object to which each belongs
    """
    r, rows = tin.vertices, np.flatnonzero(standing)
    area = footprint_areas(r, tin.triangles) / 3.0
    share = np.zeros(len(r))
    for k in range(3):
        share += np.bincount(tin.triangles[:, k], area, len(r))
    rise = rise_above(r[rows], r[~taken])
    own, found = counted[rows], []
    for number in np.unique(label):
        at = label == number
        x, y = r[rows[at], :2].mean(axis=0).tolist()
        wide = math.sqrt(float(share[rows[at]].sum()))  # few vertices stand for their surroundings
        size = max(float(np.ptp(r[rows[at], :2], axis=0).max()), wide)
        volume = float(share[rows[at]] @ np.maximum(rise[at], 0.0))
        high = float(rise[at].max())
        if volume > 0.0:
            found.append(StandingObject(x, y, size, high, volume, bool(own[at].any())))
    return tuple(sorted(found, key=lambda one: -one.volume_m3))


def rise_above(r: F64, left: F64) -> F64:
    """Heights (n,) m of points r (n, 3) above the surface through the points left (k, 3) around."""
    low, high = r[:, :2].min(axis=0) - AROUND_M, r[:, :2].max(axis=0) + AROUND_M
    near = left[((left[:, :2] > low) & (left[:, :2] < high)).all(axis=1)]
    try:
        z = height_at(build_tin(near), r[:, :2])
    except SurfaceError:
        return np.zeros(len(r))
    return np.nan_to_num(r[:, 2] - z)


def object_doubts(objects: tuple[StandingObject, ...], sigma_m3: float) -> list[Doubt]:
    """What was taken out of the outline matters. sigma_m3 : of the volume."""
    counted = [one for one in objects if one.inside]
    total = sum(one.volume_m3 for one in counted)
    if not counted or total < MATTERS * sigma_m3:
        return []
    one = counted[0]
    several = f"{len(counted)} things stand" if len(counted) > 1 else "something stands"
    words = (
        f"{several} on the body or at its toe and {'are' if len(counted) > 1 else 'is'} not "
        f"counted, {total:.3g} m³ above the surface below, which is bridged; the largest, "
        f"{one.size_m:.2g} m wide and {one.high_m:.2g} m high, at ({one.x_m:.1f}, {one.y_m:.1f}) m:"
        " survey the place without it, or set volume.objects to count where it is of the body"
    )
    return [Doubt("object", words, total)]
