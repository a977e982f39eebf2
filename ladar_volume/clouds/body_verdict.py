"""What speaks against the bodies of a cloud: points above the ground that are in none, bodies that
could not be made, bodies at the edge of the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ladar_volume.clouds.body_points import ExcludedPoints
from ladar_volume.clouds.body_volume import Body
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.ground.clusters import clusters
from ladar_volume.ground.objects import Objects, heights_above_ground
from ladar_volume.mesh.local_mesh import LocalMesh
from ladar_volume.model.body_parameters import ObjectParameters
from ladar_volume.model.errors import ObjectError
from ladar_volume.model.records import F64, Plane
from ladar_volume.model.verdict import Doubt, Verdict

#: Share of the points above the ground that may be in no body: more is doubtful, and refused.
MISSED, TOO_MANY = 0.01, 0.05
#: Share of them that the filter may leave out, stray points in the air among them, before what is
#: left is no longer the bodies.
MOST_LEFT_OUT = 0.5


@dataclass(frozen=True)
class MissedPoints:
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


def missed_points(points: F64, ground: Plane, found: Objects, p: ObjectParameters) -> MissedPoints:
    """Points (n, 3) m above the ground that are in none of the objects found with ``p``."""
    above = heights_above_ground(points, [ground], p)[1]
    lost = above & (found.label < 0)
    small = clusters(points, p.distance_m, 1, lost).max(initial=-1) + 1
    return MissedPoints(int(np.count_nonzero(above)), int(np.count_nonzero(lost)), int(small))


def check_missed(missed: MissedPoints) -> None:
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


def filter_doubts(lost: ExcludedPoints) -> tuple[Doubt, ...]:
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


def touches_outline(points: F64, own: F64, step_m: float) -> bool:
    """Whether some of the points (n, 3) m lie within a step of the convex outline of all."""
    try:
        hull = ConvexHull(points[:, :2])
    except (QhullError, ValueError):
        return False
    inward = own[:, :2] @ hull.equations[:, :2].T + hull.equations[:, 2]
    return bool(inward.max() > -step_m)


def bodies_verdict(made: CloudBodies, points: F64, missed: MissedPoints | None) -> Verdict:
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
            doubts.append(_published_mesh_doubt(k, body, mesh))
        elif made.ground is not None and len(made.ground.support):
            step_m = float(mesh.report["spacing_m"])
            if touches_outline(points, points[made.sources[k - 1]], step_m):
                doubts.append(_cut_doubt(k, step_m))
    return Verdict(tuple(doubts))


def _published_mesh_doubt(k: int, body: Body, mesh: LocalMesh) -> Doubt:
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


def _cut_doubt(k: int, step_m: float) -> Doubt:
    """Body k may go on beyond the data."""
    return Doubt(
        "body_cut",
        f"body {k} comes within {step_m:.3g} m of the edge of the data and may be cut off there: "
        "scan beyond it",
        step_m,
    )
