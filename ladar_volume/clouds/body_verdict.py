"""What speaks against the bodies of a cloud: points above the ground that are in none, bodies that
could not be made, bodies at the edge of the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from ladar_volume.clouds.body_points import BodyPoints, LeftOut
from ladar_volume.clouds.body_volume import Body
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.ground.clusters import clusters
from ladar_volume.ground.objects import ObjectParameters, Objects, rising
from ladar_volume.mesh.linear_mesh import GROUND
from ladar_volume.mesh.local_mesh import REACH, SPACING, LocalMesh
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.errors import ObjectError
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.model.verdict import Doubt, Verdict

#: Share of the points above the ground that may be in no body: more is doubtful, and refused.
MISSED, TOO_MANY = 0.01, 0.05
#: Share of them that the filter may leave out, stray points in the air among them, before what is
#: left is no longer the bodies.
MOST_LEFT_OUT = 0.5
#: Share of what a body is closed on, away from its rim, under which the ground may be seen; width
#: of that rim, in spacings of its points.
UNDERCUT, RIM = 0.05, 2.0
#: Least step between points of one object, in the spacing where the points are sparsest.
SPARSE, SPARSEST = 2.0, 90.0


def step_between(points: F64) -> float:
    """Longest step between points (n, 3) m of one object: the longest edge of a mesh through them,
    and twice the spacing where it is large. Spacing: distance of the 6th neighbour. 0 without two
    points at different places.
    """
    if len(points) < 2:
        return 0.0
    k = min(SPACING, len(points) - 1)
    away = np.asarray(cKDTree(points).query(points, [k])[0])
    return float(max(REACH * np.median(away), SPARSE * np.percentile(away, SPARSEST)))


@dataclass(frozen=True)
class Missed:
    """above : points above the ground · missed : those in no object · small : how many clusters
    they make
    """

    above: int
    missed: int
    small: int

    @property
    def share(self) -> float:
        """Share of the points above the ground that are in no object."""
        return self.missed / self.above if self.above else 0.0


def missed_points(points: F64, ground: Plane, found: Objects, p: ObjectParameters) -> Missed:
    """Points (n, 3) m above the ground that are in none of the objects found with ``p``."""
    above = rising(points, [ground], p)[1]
    lost = above & (found.label < 0)
    small = clusters(points, p.distance_m, 1, lost).max(initial=-1) + 1
    return Missed(int(np.count_nonzero(above)), int(np.count_nonzero(lost)), int(small))


def check_missed(missed: Missed) -> None:
    """Raises :class:`ObjectError` (object_missed; value: share) where too many points above the
    ground are in no object.
    """
    if missed.above and missed.share == 1.0:
        raise ObjectError(
            f"no body: all of the {missed.above:,} points above the ground are in {missed.small:,} "
            "clusters too small to be one: raise --distance or lower --min-points",
            reason="object_missed",
            value=missed.share,
        )
    if missed.share > TOO_MANY:
        raise ObjectError(
            f"{100 * missed.share:.1f} % of the {missed.above:,} points above the ground are in no "
            f"body but in {missed.small:,} clusters too small to be one: raise --distance, lower "
            "--min-points, or choose bodies by --pick, --box or --polygon",
            reason="object_missed",
            value=missed.share,
        )


def filter_doubts(lost: LeftOut) -> tuple[Doubt, ...]:
    """Doubt where the filter left out many of the good points that stand above the ground: bodies
    then lack them. Raises :class:`ObjectError` (object_left_out; value: share) where it left out
    most of them.
    """
    if lost.share <= TOO_MANY:
        return ()
    words = f"the filter left out {100 * lost.share:.0f} % of the {lost.above:,} points"
    if lost.share > MOST_LEFT_OUT:
        raise ObjectError(
            f"{words} of what rises: too few are left to be the bodies; scan more densely, or take "
            "the points as they are with --no-filter",
            reason="object_left_out",
            value=lost.share,
        )
    advice = "of what rises, so bodies may lack volume: scan more densely, or --no-filter"
    return (Doubt("points_left_out", f"{words} {advice}", lost.share),)


def at_the_edge(points: F64, own: F64, step_m: float) -> bool:
    """Whether some of the points (n, 3) m lie within a step of the convex outline of all."""
    try:
        hull = ConvexHull(points[:, :2])
    except (QhullError, ValueError):
        return False
    inward = own[:, :2] @ hull.equations[:, :2].T + hull.equations[:, 2]
    return bool(inward.max() > -step_m)


def bodies_verdict(made: CloudBodies, points: F64, missed: Missed | None) -> Verdict:
    """Doubts about the bodies of filtered points (n, 3) m."""
    doubts = []
    if missed is not None and missed.share >= MISSED:
        doubts.append(
            Doubt(
                "points_in_no_body",
                f"{100 * missed.share:.1f} % of the points above the ground are in no body "
                f"({missed.small:,} clusters too small to be one): raise --distance or lower "
                "--min-points",
                missed.share,
            )
        )
    for f in made.failed:
        x, y, z = f.middle_m
        doubts.append(
            Doubt(
                "body_failed",
                f"object {f.number + 1} of {f.points:,} points at {x:.7g}, {y:.7g}, {z:.7g} is not "
                f"in the sum: {f.reason}",
                float(f.points),
            )
        )
    for k, (body, mesh) in enumerate(zip(made.bodies, made.meshes, strict=True), 1):
        if "method_published" in mesh.report:
            doubts.append(_published(k, body, mesh))
        elif made.ground is not None and len(made.ground.support):
            step_m = float(mesh.report["spacing_m"])
            if at_the_edge(points, points[made.sources[k - 1]], step_m):
                doubts.append(_cut(k, step_m))
    return Verdict(tuple(doubts))


def _published(k: int, body: Body, mesh: LocalMesh) -> Doubt:
    """Body k is a mesh that is not closed."""
    spread = body.closed.pole_spread_m3
    edges = int(mesh.report["open_edges"]) + int(mesh.report["over_full"])
    return Doubt(
        "mesh_published",
        f"body {k} is a mesh as published with {edges:,} edges that have not two triangles: its "
        f"volume changes by up to {spread:.2g} m³ with the pole, which sigma does not hold; leave "
        "--repair out for a closed body",
        spread,
    )


def _cut(k: int, step_m: float) -> Doubt:
    """Body k may go on beyond the data."""
    return Doubt(
        "body_cut",
        f"body {k} comes within {step_m:.3g} m of the edge of the data and may be cut off there: "
        "scan beyond it",
        step_m,
    )


def foot_doubts(made: CloudBodies, points: BodyPoints) -> tuple[Doubt, ...]:
    """Doubt about bodies under which the ground is seen: what they stand on is less than what they
    are closed on.
    """
    if made.ground is None or not len(made.ground.support):
        return ()
    doubts = []
    floor = points.r[made.ground.support]
    for k, (body, mesh) in enumerate(zip(made.bodies, made.meshes, strict=True), 1):
        share = seen_under(body, floor, float(mesh.report["spacing_m"]))
        if share > UNDERCUT:
            doubts.append(
                Doubt(
                    "body_undercut",
                    f"the ground is seen under {100 * share:.0f} % of what body {k} is closed on: "
                    "it is hollow there, and its volume too large; scan its underside",
                    share,
                )
            )
    return tuple(doubts)


def seen_under(body: Body, floor: F64, spacing_m: float) -> float:
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
    seen = np.zeros(count, bool)
    seen[tuple(cell.T)] = True
    x, y = (low[i] + wide * (np.arange(count[i]) + 0.5) for i in (0, 1))
    middle = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    deep = inside_edges(middle, a, b, wide).reshape(seen.shape)
    return float(np.count_nonzero(seen & deep) / max(np.count_nonzero(deep), 1))


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
