"""Closing a body (seed 002 section 7.3): its unseen bottom on the ground plane, small gaps by the
least area.

A rim that looks down, as the lower end of a wall does, is drawn on to the ground: each of its
vertices along the surface's own tangent plane (along the line where two faces meet), or straight
down where normals are not known or the surface is flatter than 30 degrees. A strip joins the rim
and its foot, and the area between the feet of outer rims and those of holes is triangulated. Every
other rim is a gap: it is filled with the least area, without new vertices, or from its middle where
that would use an edge of the mesh twice.

How much depends on it is said of each rim: ``closed_m3`` is the volume between the closing surface
and the rim spanned from its middle; ``doubt_m3`` is what the volume changes when the closing
surface is drawn the other plausible way: straight down instead of along the tangent, or bulging as
the surface around a gap does instead of flat. The latter counts as one standard deviation.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import degree_of
from ladar_volume.mesh.bottom_closing import (
    IN_PLANE,
    Closure,
    in_plane,
    join_to_ground,
    loops_of,
    tetrahedra,
)
from ladar_volume.mesh.chord_curvature import bulge_volumes
from ladar_volume.mesh.ground_clipping import clip_to_ground, steepness
from ladar_volume.mesh.hole_filling import inside_loop, least_area, loop_area
from ladar_volume.mesh.linear_mesh import (
    GAP,
    Faces,
    LinearMesh,
    blocks,
    extend_mesh,
    vertex_normals,
)
from ladar_volume.mesh.rims import LEAVES, Rim, mean_descent, place_text, rims_of, split_fans
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool, Plane

#: Longest rim filled with the least area; its search takes the cube of this.
LONGEST = 200
#: Share of what is closed below which a hole is one of the mesh, about two spacings of its points.
SCRAP = 0.25
#: A rim that looks down by less than this may be a hole with ragged triangles.
RAGGED = 0.5


def close(
    skin: LinearMesh, close_m: float, ground: Plane | None = None
) -> tuple[LinearMesh, list[Closure]]:
    """A mesh without boundary, and what was closed.

    close_m : gaps up to this width are filled, rims up to this far from the ground drawn on to it.
    Raises :class:`SurfaceError` as :func:`~ladar_volume.mesh.topology.orient`, closing_gap
    (value: width m), closing_height (value: m), closing_inside_out, closing_ground (a ground that
    is not a plane).
    """
    up = np.array([0.0, 0.0, 1.0]) if ground is None else plane_normal(ground)
    skin, bottoms, gaps = sorted_rims(split_fans(skin), ground, up, close_m)
    if ground is not None:
        for rim in bottoms:
            check_height(skin, rim, ground, close_m)
        if any(height_above(skin.vertices[r.vertices], ground).min() < 0.0 for r in bottoms):
            skin = split_fans(clip_to_ground(skin, ground))
            skin, bottoms, gaps = sorted_rims(skin, ground, up, close_m)
    bottoms, hollows = small_hollows(skin, bottoms, up, close_m)
    gaps += hollows
    hint = "" if ground is not None else ", or give the ground it stands on"
    made: list[Closure] = []
    for rim in gaps:
        skin, closure = fill_gap(skin, rim, close_m, hint)
        made.append(closure)
    if bottoms and ground is not None:
        skin, closures = join_to_ground(skin, bottoms, ground, up)
        made += closures
    return skin, made


def sorted_rims(
    skin: LinearMesh, ground: Plane | None, up: F64, close_m: float
) -> tuple[LinearMesh, list[Rim], list[Rim]]:
    """The skin, its rims that look down to the ground, and its gaps: among these holes beside a
    wider bottom, up to ``close_m`` wide or higher than that above the ground, whose ragged
    triangles happen to lean down.
    """
    rims = rims_of(skin)
    if ground is None or not rims:
        return skin, [], rims
    descent, size = mean_descent(skin, rims, up), np.array([r.size_m for r in rims])
    down = descent > LEAVES
    low = np.array([height_above(skin.vertices[r.vertices], ground).min() for r in rims])
    hole = (size <= close_m) | (low > close_m)
    down &= (descent > RAGGED) | ~hole | (size == size[down].max(initial=0.0))
    return (
        skin,
        [r for r, d in zip(rims, down, strict=True) if d],
        [r for r, d in zip(rims, down, strict=True) if not d],
    )


def small_hollows(
    skin: LinearMesh, bottoms: list[Rim], up: F64, close_m: float
) -> tuple[list[Rim], list[Rim]]:
    """The rims that look down, and those among them that enclose a hollow beside the body, no wider
    than ``close_m``: where the noise folds the surface along the ground, a scrap of it is left. One
    below :data:`SCRAP` of that is no hole through the body either.
    """
    if len(bottoms) < 2:
        return bottoms, []
    plane = in_plane(np.concatenate([skin.vertices[r.vertices] for r in bottoms]), up)
    loops = loops_of(bottoms)
    outers = [i for i in loops if loop_area(plane[i]) > 0.0]
    small = [
        bool(outers)
        and loop_area(plane[i]) <= 0.0
        and rim.size_m <= close_m
        and (rim.size_m <= SCRAP * close_m or not _within(plane, outers, i))
        for rim, i in zip(bottoms, loops, strict=True)
    ]
    return (
        [r for r, s in zip(bottoms, small, strict=True) if not s],
        [r for r, s in zip(bottoms, small, strict=True) if s],
    )


def _within(plane: F64, outers: list[I64], loop: I64) -> bool:
    """Whether a loop of points (n, 2) lies within one of others."""
    return any(inside_loop(plane[o], plane[loop[0]]) for o in outers)


def plane_normal(ground: Plane) -> F64:
    """Unit normal (3,) of a ground, upwards. Raises :class:`SurfaceError` (closing_ground) for one
    that is curved.
    """
    if degree_of(ground) > 1:
        raise SurfaceError(
            "a body is closed on a level or a plane; fit a ground of degree 0 or 1",
            reason="closing_ground",
        )
    normal = steepness(ground)
    out: F64 = normal / np.linalg.norm(normal)
    return out


def check_height(skin: LinearMesh, rim: Rim, ground: Plane, close_m: float) -> None:
    """Refuse a rim that ends far from the ground."""
    h = height_above(skin.vertices[rim.vertices], ground)
    worst = int(np.argmax(np.abs(h)))
    if abs(h[worst]) > close_m:
        side, at = (
            ("above" if h[worst] > 0 else "below"),
            place_text(skin.vertices[rim.vertices[worst]]),
        )
        raise SurfaceError(
            f"the surface ends at {at}, {abs(h[worst]):.3g} m {side} the ground, more "
            f"than {close_m:.3g} m: close more (--close), "
            "check the ground, or scan the foot of the body",
            reason="closing_height",
            value=float(h[worst]),
        )


def gap_width(p: F64, triangles: I64) -> float:
    """Width of a gap, m: four areas of its fill (k, 3) over the length of its rim (n, 3). The
    diameter of a circle, twice the width of a slit, however long.
    """
    a, b, c = (p[triangles[:, k]] for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    return 4.0 * area / max(float(np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1).sum()), 1e-300)


def fill_gap(skin: LinearMesh, rim: Rim, close_m: float, hint: str) -> tuple[LinearMesh, Closure]:
    """The least area within a rim, or a fan from its middle. Refuses a gap that is too wide."""
    loop, n, k = rim.vertices, len(skin.vertices), len(rim.vertices)
    inner = (
        least_area(skin.vertices[loop], existing_chords(skin, loop))
        if k <= LONGEST
        else np.zeros((0, 3), np.int64)
    )
    fan = len(inner) == 0
    width = rim.size_m if fan else gap_width(skin.vertices[loop], inner)
    if width > close_m:
        what = f"an open rim of {k:,} vertices, {width:.3g} m across," if fan else ""
        raise too_wide(what or f"a gap {width:.3g} m wide", rim, width, close_m, hint)
    new = np.zeros((0, 3))
    if fan:
        inner = np.stack([np.arange(k), (np.arange(k) + 1) % k, np.full(k, k)], axis=1)
        new = rim.middle[None]
        loop = np.append(loop, n)
    rows, share = (
        np.zeros(k if fan else 0, np.int64),
        np.tile(np.eye(3) / k, (k if fan else 0, 1, 1)),
    )
    known = np.concatenate([rim_normals(skin, rim.vertices), np.full((1, 3), np.nan)])
    before = len(skin.triangles)
    skin = extend_mesh(
        skin,
        new,
        GAP,
        blocks(rows, rim.vertices[: len(rows)], share, (len(new), n)),
        np.zeros((3 * len(new), 3)),
        Faces(
            np.concatenate([skin.triangles, loop[inner].astype(np.int32)]),
            np.concatenate([skin.normals, known[inner]]),
            np.concatenate([skin.face, np.full(len(inner), GAP, np.int32)]),
        ),
    )
    return skin, Closure(
        GAP, k, width, tetrahedra(skin.vertices, loop[inner], rim.middle), bulge_of(skin, before)
    )


def too_wide(what: str, rim: Rim, width_m: float, close_m: float, hint: str) -> SurfaceError:
    """The refusal of a gap."""
    return SurfaceError(
        f"{what} at {place_text(rim.middle)}, more than {close_m:.3g} m: "
        f"close more (--close), scan that side{hint}",
        reason="closing_gap",
        value=width_m,
    )


def bulge_of(skin: LinearMesh, start: int) -> float:
    """Magnitude, m³, of the bulge over the triangles from ``start`` on, by the normals of the mesh
    itself where none are known.
    """
    t = skin.triangles[start:]
    normals = skin.normals[start:]
    own = vertex_normals(skin.vertices, skin.triangles[:start])[t]
    rounded = np.ones(len(skin.vertices), bool)
    part = LinearMesh(
        skin.vertices,
        t,
        np.where(np.isnan(normals), own, normals),
        skin.kind,
        rounded,
        skin.face[start:],
        skin.by_measured,
        skin.by_ground,
    )
    return abs(float(bulge_volumes(part).sum()))


def existing_chords(skin: LinearMesh, loop: I64) -> Bool:
    """Pairs (k, k) of loop vertices that an edge of the mesh joins already."""
    order, start, key = edge_table(skin.triangles)
    a, b = np.meshgrid(loop, loop, indexing="ij")
    out: Bool = np.isin(np.minimum(a, b) << 32 | np.maximum(a, b), key[order[start[:-1]]])
    return out


def rim_normals(skin: LinearMesh, vertices: I64) -> F64:
    """One normal (k, 3) per vertex: the mean of those at its corners, NaN where not known or where
    two faces meet.
    """
    total = np.zeros((len(skin.vertices), 3))
    np.add.at(total, skin.triangles.ravel(), skin.normals.reshape(-1, 3))
    count = np.bincount(skin.triangles.ravel(), minlength=len(skin.vertices))[vertices]
    length = np.linalg.norm(total[vertices], axis=1)
    one_face = length > (1.0 - IN_PLANE) * count
    return np.asarray(total[vertices] / np.where(one_face, length, np.nan)[:, None])
