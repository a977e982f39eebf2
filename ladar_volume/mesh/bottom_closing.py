"""The unseen bottom of a body: rims that look down, drawn on to the ground and joined there (seed
002 section 7.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design
from ladar_volume.mesh.ground_clipping import steepness
from ladar_volume.mesh.hole_filling import ears, inside_loop, loop_area
from ladar_volume.mesh.linear_mesh import (
    GROUND,
    KINDS,
    Faces,
    LinearMesh,
    blocks,
    extend_mesh,
    vertex_normals,
)
from ladar_volume.mesh.rims import Rim, place_text
from ladar_volume.mesh.unseen_foot import extrapolation_reach, unseen_bend, wall_directions
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool, Plane

#: Sine of the slope from which on a surface is drawn on along itself; and from which on where its
#: foot is then no further out than so many sides of the rim: the toe of a pile, not an eave.
STEEP, SLOPING, SIDES_OUT = 0.5, 0.1, 4.0
#: Eigenvalue, of trace 1, of the normals around a vertex below which a direction is in all their
#: planes.
IN_PLANE = 0.05
#: Straight down.
DOWN = np.array([0.0, 0.0, -1.0])
#: Rim vertices nearer to the ground than this share of the rim are on it.
ON_GROUND = 1e-9


@dataclass(frozen=True)
class Closure:
    """One closed rim. kind : GAP or GROUND · vertices : of the rim · size_m : width of a gap,
    diameter of a foot · closed_m3, doubt_m3 : see :mod:`~ladar_volume.mesh.closing` · overlaps :
    triangles that overlap because the foot of the rim crosses itself
    """

    kind: int
    vertices: int
    size_m: float
    closed_m3: float
    doubt_m3: float
    overlaps: int = 0

    @property
    def name(self) -> str:
        """What it was closed on."""
        return KINDS[self.kind]


def tetrahedra(v: F64, triangles: I64, pole: F64) -> float:
    """Signed volume, m³, between triangles and a pole (3,)."""
    a, b, c = (v[triangles[:, k]] - pole for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0


def downward(skin: LinearMesh, vertices: I64, normals: F64, least: F64) -> F64:
    """Directions (k, 3) in which the surface with corner normals (m, 3, 3) goes down at vertices
    (k,); straight where not known, or flatter than the sines ``least`` (k,).
    """
    M, wanted = np.zeros((len(skin.vertices), 3, 3)), np.zeros(len(skin.vertices), bool)
    wanted[vertices] = True
    corner = np.flatnonzero(wanted[skin.triangles.ravel()])
    n = normals.reshape(-1, 3)[corner]
    np.add.at(M, skin.triangles.ravel()[corner], np.einsum("ni,nj->nij", n, n))
    M = M[vertices]
    known = np.isfinite(M).all(axis=(1, 2)) & (np.trace(M, axis1=1, axis2=2) > 0.0)
    M[~known] = np.eye(3)
    value, vector = np.linalg.eigh(M / np.trace(M, axis1=1, axis2=2)[:, None, None])
    along = np.einsum(
        "kia,ka,kja,j->ki", vector, (value < IN_PLANE).astype(np.float64), vector, DOWN
    )
    length = np.linalg.norm(along, axis=1)
    steep = known & (length > least)
    return np.where(steep[:, None], along / np.where(steep, length, 1.0)[:, None], DOWN)


def least_sine(skin: LinearMesh, rims: list[Rim], ground: Plane) -> F64:
    """Sines (k,) of the slope from which on the surface is drawn on along itself at the vertices of
    all rims: less than ``STEEP`` where they are so near to the ground that their feet are, too.
    """
    out = []
    for rim in rims:
        p = skin.vertices[rim.vertices]
        side = float(np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1).mean())
        up = np.abs(height_above(p, ground))
        out.append(np.clip(up / np.hypot(up, SIDES_OUT * side), SLOPING, STEEP))
    return np.concatenate(out)


def ground_feet(p: F64, along: F64, ground: Plane) -> tuple[F64, F64, F64]:
    """Where lines from points (k, 3) meet the ground; derivative by the points (k, 3, 3) and by the
    ground's height and slopes (k, 3, 3).
    """
    w = steepness(ground)
    rate = along @ w
    q = p - along * (height_above(p, ground) / rate)[:, None]
    by_point = np.eye(3) - along[:, :, None] * w / rate[:, None, None]
    by_ground = (
        along[:, :, None] * design(q[:, :2], ground.origin_xy, 1)[:, None, :] / rate[:, None, None]
    )
    return q, by_point, by_ground


def nearer_feet(q: F64, other: F64, along: F64) -> F64:
    """The other feet (k, 3) of rims, nearer to theirs q (k, 3) where a surface flatter than
    ``STEEP`` goes on to the ground along directions (k, 3): it ends anywhere between the two, and
    the root mean square of that about its end is its length over √3.
    """
    flat = np.linalg.norm(along[:, :2], axis=1) > np.sqrt(1.0 - STEEP * STEEP)
    return np.where(flat[:, None], q + (other - q) / np.sqrt(3.0), other)


def by_direction(p: F64, along: F64, ground: Plane) -> csr_matrix:
    """Derivative (3k, 3k) of where lines from points (k, 3) meet the ground, by their directions
    (k, 3).
    """
    w = steepness(ground)
    rate = along @ w
    drop = -height_above(p, ground) / rate
    values = drop[:, None, None] * (np.eye(3) - along[:, :, None] * w / rate[:, None, None])
    k = np.arange(len(p))
    return blocks(k, k, values, (len(p), len(p)))


def loops_of(rims: list[Rim]) -> list[I64]:
    """Which of the vertices of all rims, one rim after the other, are each rim's."""
    ends = np.cumsum([len(r.vertices) for r in rims])
    return np.split(np.arange(ends[-1]), ends[:-1])


def join_to_ground(
    skin: LinearMesh, rims: list[Rim], ground: Plane, up: F64
) -> tuple[LinearMesh, list[Closure]]:
    """All rims that look down joined to the ground, and their feet to each other."""
    n, all_of = len(skin.vertices), np.concatenate([r.vertices for r in rims])
    own = np.broadcast_to(
        vertex_normals(skin.vertices, skin.triangles)[skin.triangles], skin.normals.shape
    )
    corner = np.where(np.isnan(skin.normals), own, skin.normals)
    tangent = downward(skin, all_of, corner, least_sine(skin, rims, ground))
    known = has_known_normals(skin, all_of)
    straight = np.broadcast_to(DOWN, tangent.shape)
    p = skin.vertices[all_of]
    along = np.where(known[:, None], tangent, straight)
    along, by_lean = _wall_directions(skin, rims, ground, along)
    q, by_point, by_ground = ground_feet(p, along, ground)
    other, _, _ = ground_feet(p, np.where(known[:, None], straight, tangent), ground)
    other = nearer_feet(q, other, along)
    size = max(r.size_m for r in rims)
    there = np.abs(height_above(p, ground)) <= ON_GROUND * size
    q[there] = other[there] = p[there]
    foot = np.where(there, all_of, n + np.arange(len(all_of)))
    new, made = _close_to_ground(skin, rims, _Feet(q, other, foot, along, in_plane(q, up)))
    skin = extend_mesh(
        skin,
        q,
        GROUND,
        blocks(np.arange(len(q)), all_of, by_point, (len(q), n))
        + by_direction(p, along, ground) @ by_lean,
        by_ground.reshape(-1, 3),
        Faces(
            np.concatenate([skin.triangles, new.astype(np.int32)]),
            np.concatenate([skin.normals, np.full((len(new), 3, 3), np.nan)]),
            np.concatenate([skin.face, np.full(len(new), GROUND, np.int32)]),
        ),
    )
    return skin, made


def _wall_directions(
    skin: LinearMesh, rims: list[Rim], ground: Plane, along: F64
) -> tuple[F64, csr_matrix]:
    """Directions (k, 3) from the vertices of all rims to the ground, of plane walls by the part
    that was seen, and their derivative (3k, 3n) by the vertices.
    """
    all_of = np.concatenate([r.vertices for r in rims])
    p = skin.vertices[all_of]
    drawn = np.linalg.norm(ground_feet(p, along, ground)[0] - p, axis=1)
    reach = np.concatenate([extrapolation_reach(skin, all_of[i], drawn[i]) for i in loops_of(rims)])
    return wall_directions(skin, all_of, along, (along != DOWN).any(axis=1), reach, drawn)


class _Feet(NamedTuple):
    """Feet of the vertices of all rims (n,), one rim after the other. q : (n, 3) m · other : (n, 3)
    m where they might be as well · foot : (n,) their numbers as vertices · along : (n, 3)
    directions to them · plane : (n, 2) m in the plane of the ground
    """

    q: F64
    other: F64
    foot: I64
    along: F64
    plane: F64


def _close_to_ground(
    skin: LinearMesh, rims: list[Rim], feet_of: _Feet
) -> tuple[I64, list[Closure]]:
    """Triangles (k, 3) between rims and their feet and among the feet, and what they close: each
    rim with those that lie within it.
    """
    q, other, foot, along, plane = feet_of
    all_of = np.concatenate([r.vertices for r in rims])
    drawn = np.linalg.norm(q - skin.vertices[all_of], axis=1)
    loops = loops_of(rims)
    strips = [strip(all_of[i], foot[i]) for i in loops]
    at = np.concatenate([skin.vertices, q])
    made: list[Closure] = []
    triangles: list[I64] = []
    alternative = np.concatenate([skin.vertices, other])
    for outer, holes in group_loops(plane, loops, rims):
        inner, forced = ears(plane, loops[outer], [loops[h] for h in holes])
        here = np.concatenate([foot[inner], *(strips[k] for k in (outer, *holes))])
        triangles.append(here)
        closed = tetrahedra(at, here, rims[outer].middle)
        doubt = closed - tetrahedra(alternative, here, rims[outer].middle)
        bend = sum(
            unseen_bend(skin, all_of[i], along[i], drawn[i])
            for i in (loops[k] for k in (outer, *holes))
        )
        count = sum(len(rims[k].vertices) for k in (outer, *holes))
        made.append(
            Closure(GROUND, count, rims[outer].size_m, closed, math.hypot(doubt, bend), forced)
        )
    return np.concatenate(triangles), made


def has_known_normals(skin: LinearMesh, vertices: I64) -> Bool:
    """Whether (k,) the normals at all corners of vertices are known."""
    unknown = np.bincount(
        skin.triangles.ravel(), np.isnan(skin.normals[..., 0]).ravel(), len(skin.vertices)
    )
    out: Bool = unknown[vertices] == 0
    return out


def strip(rim: I64, foot: I64) -> I64:
    """Triangles (≤ 2 k, 3) between a rim (k,) and its feet (k,); none where both are one vertex."""
    a, b, c, d = rim, np.roll(rim, -1), np.roll(foot, -1), foot
    t: I64 = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    out: I64 = t[(t[:, 0] != t[:, 1]) & (t[:, 1] != t[:, 2]) & (t[:, 2] != t[:, 0])]
    return out


def in_plane(q: F64, up: F64) -> F64:
    """Coordinates (k, 2) m in the plane across ``up``, as seen from below."""
    e = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    e /= np.linalg.norm(e)
    local = q - q.mean(axis=0)
    return np.stack([local @ e, -(local @ np.cross(up, e))], axis=1)


def group_loops(plane: F64, loops: list[I64], rims: list[Rim]) -> list[tuple[int, list[int]]]:
    """Outer loops with the holes in them. Raises :class:`SurfaceError` (closing_inside_out) for a
    hole in nothing.
    """
    area = [loop_area(plane[i]) for i in loops]
    outers = [k for k in range(len(loops)) if area[k] > 0]
    holes: dict[int, list[int]] = {k: [] for k in outers}
    for k in (k for k in range(len(loops)) if area[k] <= 0):
        around = [o for o in outers if inside_loop(plane[loops[o]], plane[loops[k][0]])]
        if not around:
            raise SurfaceError(
                f"the rim at {place_text(rims[k].middle)} encloses a hollow, not a body: "
                "compare a pit with another epoch (diff), or measure "
                "it below a base (volume)",
                reason="closing_inside_out",
                value=rims[k].middle,
            )
        holes[min(around, key=lambda o: area[o])].append(k)
    return list(holes.items())
