"""What the shape of a body says against its volume: ground that is seen under it, and curved walls
so thin that the filter's reach takes in both sides.

A fit that reaches over two sheets is of planes, since one quadric holds only one of them: coarse
facets where the curvature is strong. And of a face narrower than its reach, as the end of a pipe,
it has too few points to tell it from its neighbours, which round the edges there by about the
noise. Both are lines of the budget: ``facets`` and ``undercut``.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.body_volume import Body, closing_m6
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.mesh.linear_mesh import GROUND, vertex_normals
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.model.verdict import Doubt

#: Share of what a body is closed on, away from its rim, under which the ground may be seen; width
#: of that rim, in spacings of its points.
UNDERCUT, RIM = 0.05, 2.0
#: Share of a body that its closing may put in doubt.
UNSEEN = 0.05
#: A wall thinner than this share of the filter's reach is thin; share of the surface that may have
#: one behind it; points asked, and the cosine from which on two of them face away from each other.
THIN, MAY_BE_THIN, ASKED, AWAY = 2.0 / 3.0, 0.1, 2000, -0.7
#: A triangle off the faces of one of its corners by less than this cosine cuts an edge off.
CUT_OFF = 0.7
#: Share of what the facets of a curved surface were off their points that may be left.
FACETS_LEFT = 0.2
#: Share of the mesh's edges between planes that meet at angles from the first to the second that
#: makes a surface curved.
CURVED, SHALLOW_RAD, STEEP_RAD = 0.05, float(np.radians(10.0)), float(np.radians(60.0))


def undercuts(made: CloudBodies, points: BodyPoints) -> list[float]:
    """Of each body the share of what it is closed on under which the ground is seen; 0 where it is
    less than :data:`UNDERCUT`.
    """
    if made.ground is None or not len(made.ground.support):
        return [0.0] * len(made.bodies)
    floor = points.r[made.ground.support]
    shares = (
        share_of_ground_under(body, floor, float(mesh.report["spacing_m"]))
        for body, mesh in zip(made.bodies, made.meshes, strict=True)
    )
    return [share if share > UNDERCUT else 0.0 for share in shares]


def foot_doubts(made: CloudBodies, points: BodyPoints) -> tuple[Doubt, ...]:
    """Doubt about bodies under which the ground is seen: what they stand on is less than what they
    are closed on.
    """
    return tuple(
        Doubt(
            "body_undercut",
            f"the ground is seen under {100 * share:.0f} % of what body {k} is closed on: "
            "it is hollow there, and its volume too large; scan its underside",
            share,
        )
        for k, share in enumerate(undercuts(made, points), 1)
        if share
    )


def closing_doubts(made: CloudBodies) -> tuple[Doubt, ...]:
    """Doubt about bodies whose closing is much of their volume."""
    doubts = []
    for k, body in enumerate(made.bodies, 1):
        share = float(np.sqrt(closing_m6(body))) / max(abs(body.volume_m3), 1e-300)
        if share > UNSEEN:
            doubts.append(
                Doubt(
                    "body_unseen",
                    f"{100 * share:.2g} % of body {k} depends on how the part that was not seen is "
                    "closed: scan its foot and its underside",
                    share,
                )
            )
    return tuple(doubts)


def share_of_ground_under(body: Body, floor: F64, spacing_m: float) -> float:
    """Share of the area a body is closed on, away from its rim, on which points (n, 3) m of the
    ground lie; as dense as the ground around it they would be all of it.
    """
    skin = body.skin
    flat = (skin.face == GROUND) & (skin.kind[skin.triangles] == GROUND).all(axis=1)
    t = skin.triangles[flat]
    if not len(t):
        return 0.0
    order, start, _ = edge_table(t)
    half = order[start[:-1]][np.diff(start) == 1]
    a = skin.vertices[t.ravel()[half], :2]
    b = skin.vertices[t[:, [1, 2, 0]].ravel()[half], :2]
    wide = RIM * spacing_m
    low, high = a.min(axis=0) - wide, a.max(axis=0) + wide
    near = floor[((floor[:, :2] >= low) & (floor[:, :2] <= high)).all(axis=1), :2]
    cell = np.floor((near - low) / wide).astype(np.int64)
    count = np.floor((high - low) / wide).astype(np.int64) + 1
    seen = np.zeros((int(count[0]), int(count[1])), np.bool_)
    seen[cell[:, 0], cell[:, 1]] = True
    x, y = (low[i] + wide * (np.arange(count[i]) + 0.5) for i in (0, 1))
    middle = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    deep = inside_edges(middle, a, b, wide).reshape(seen.shape)
    return int(np.count_nonzero(seen & deep)) / max(int(np.count_nonzero(deep)), 1)


def inside_edges(p: F64, a: F64, b: F64, away_m: float) -> Bool:
    """Points (n, 2) within the outlines that edges (e, 2) to (e, 2) make, by the even-odd rule, and
    farther than ``away_m`` from all of them.
    """
    inside, far = np.zeros(len(p), bool), np.ones(len(p), bool)
    for (ax, ay), (bx, by) in zip(a, b, strict=True):
        across = (ay > p[:, 1]) != (by > p[:, 1])
        inside[across] ^= p[across, 0] < ax + (p[across, 1] - ay) / (by - ay) * (bx - ax)
        d = np.array([bx - ax, by - ay])
        s = np.clip((p - (ax, ay)) @ d / max(float(d @ d), 1e-300), 0.0, 1.0)
        far &= ((p - (ax, ay) - s[:, None] * d) ** 2).sum(axis=1) > away_m**2
    return inside & far


def thin_walls(made: CloudBodies, points: BodyPoints) -> list[tuple[float, float]]:
    """Of each body the share of its surface that has a thin wall behind it, 0 where it is not
    curved or less than :data:`MAY_BE_THIN`; and what counts as thin, m.
    """
    f, out = points.filtered, []
    for body, rows in zip(made.bodies, made.sources, strict=True):
        share = thin_m = 0.0
        if f is not None and f.reach is not None and curved_by_planes(body, f.normal[rows]):
            thin_m = THIN * float(np.median(f.reach[rows]))
            share = thin_share(body, thin_m)
        out.append((share if share > MAY_BE_THIN else 0.0, thin_m))
    return out


def wall_doubts(made: CloudBodies, points: BodyPoints) -> tuple[Doubt, ...]:
    """Doubt about bodies with curved walls thinner than two thirds of the filter's reach."""
    return tuple(
        Doubt(
            "body_thin_wall",
            f"{100 * share:.0f} % of the surface of body {k} has a wall behind it thinner "
            f"than {thin_m:.3g} m, two thirds of the filter's reach, so its edges are "
            "hardly known: scan it more densely",
            share,
        )
        for k, (share, thin_m) in enumerate(thin_walls(made, points), 1)
        if share
    )


def shape_lines(made: CloudBodies, points: BodyPoints) -> list[dict[str, float]]:
    """Of each body the variances, m⁶, of what its shape leaves open.

    facets : planes stand in for a curved surface. What they were off their points was put back but
    for a fifth at most, and edges stay cut off: by a quarter of the spacing on the mean over the
    triangles that leave the face of one of their corners · undercut : it is hollow below, so that
    all that closed it on the ground may be too much.
    """
    out: list[dict[str, float]] = []
    for k, (body, share) in enumerate(zip(made.bodies, undercuts(made, points), strict=True)):
        lines, f = {}, points.filtered
        normal = None if f is None else f.normal[made.sources[k]]
        if normal is not None and curved_by_planes(body, normal):
            spacing_m = float(made.meshes[k].report["spacing_m"])
            cut_m3 = 0.25 * spacing_m * cut_off_m2(body, normal)
            lines["facets"] = cut_m3**2 + (FACETS_LEFT * body.fit_m3) ** 2
        if share:
            low_m3 = sum(c.closed_m3 for c in body.closures if c.kind == GROUND)
            lines["undercut"] = low_m3**2 / 3.0
        out.append(lines)
    return out


def cut_off_m2(body: Body, normal: F64) -> float:
    """Area of the triangles between measured vertices with normals (k, 3) that leave the face of
    one of them.
    """
    t = body.skin.triangles
    t = t[(t < len(normal)).all(axis=1)]
    a, b, c = (body.skin.vertices[corner] for corner in t.T)
    across = np.cross(b - a, c - a)
    twice = np.linalg.norm(across, axis=1)
    along = np.abs(np.einsum("ti,tki->tk", across, normal[t]))
    return 0.5 * float(twice[(along < CUT_OFF * twice[:, None]).any(axis=1)].sum())


def curved_by_planes(body: Body, normal: F64) -> bool:
    """Whether planes with normals (k, 3) at the measured vertices stand in for a curved surface."""
    t = body.skin.triangles
    ends = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    ends = ends[(ends < len(normal)).all(axis=1)]
    lean = np.abs(np.einsum("ni,ni->n", normal[ends[:, 0]], normal[ends[:, 1]]))
    shallow = (lean < np.cos(SHALLOW_RAD)) & (lean > np.cos(STEEP_RAD))
    return bool(np.count_nonzero(shallow) > CURVED * max(len(ends), 1))


def thin_share(body: Body, thin_m: float) -> float:
    """Share of the measured vertices that have others within ``thin_m`` behind them that face
    away.
    """
    skin = body.skin
    normal = vertex_normals(skin.vertices, skin.triangles)[: skin.measured_count]
    used: I64 = np.unique(skin.triangles).astype(np.int64)
    used = used[used < skin.measured_count]
    asked = used[:: max(1, len(used) // ASKED)]
    near = cKDTree(skin.vertices[used]).query_ball_point(skin.vertices[asked], thin_m)
    thin = 0
    for v, found in zip(asked, near, strict=True):
        rows = used[np.asarray(found, np.int64)]
        d = skin.vertices[rows] - skin.vertices[v]
        depth = -(d @ normal[v])
        straight = 2.0 * depth**2 > (d**2).sum(axis=1)
        thin += bool(((depth > 0.0) & straight & (normal[rows] @ normal[v] < AWAY)).any())
    return thin / max(len(asked), 1)
