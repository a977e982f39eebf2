"""The volume of a body: edges completed, closed, by signed tetrahedra, corrected for curvature; and
what its uncertainty is made of.

The correction for edges and that for curvature are printed apart, and the volume of the mesh as it
is beside. The gradient goes through all that was made out of measured points: completed edges, feet
on the ground, fills. The sources of variance (UNCERTAINTY steps 1 to 3):

- ``noise``: of the points. Filtered points share raw ones; the sum is over the raw points, each
  with all it moves, in this body and in
  the ground under it.
- ``ground``: the part of it, or of the ground's own covariance, by which the plane moves.
- ``closing``: what the volume changes where the closing surface is drawn the other plausible way
  (:mod:`~ladar_volume.mesh.closing`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import identity

from ladar_volume.clouds.filter.filter_adjoint import influence
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.ground.ground_adjoint import ground_gradient
from ladar_volume.mesh.bottom_closing import Closure
from ladar_volume.mesh.chord_curvature import bulge_volumes
from ladar_volume.mesh.closing import close
from ladar_volume.mesh.crossed_space import Crossing, crossing_doubts, crossing_of
from ladar_volume.mesh.edge_completion import sharpen
from ladar_volume.mesh.linear_mesh import LinearMesh, linear_mesh
from ladar_volume.mesh.local_mesh import LocalMesh
from ladar_volume.mesh.tetrahedra import (
    ClosedVolume,
    closed_variance,
    closed_volume,
    other_poles,
    signed_tetrahedra,
    surface_area,
    tetrahedra_gradient,
)
from ladar_volume.mesh.topology import OrientedMesh, edge_table
from ladar_volume.model.body_parameters import SHARP_RAD
from ladar_volume.model.records import F64, I32, I64, Bool, Plane
from ladar_volume.model.verdict import Doubt


@dataclass(frozen=True)
class Body:
    """A closed body.

    volume_m3 : corrected · uncorrected_m3 : of the closed mesh as it is, its edges cut off and its
    curves chords · edge_m3, curvature_m3 : the corrections · closed_m3 : between the rims, spanned
    from their middles, and what closes them · centroid_map : (3,) m · skin : the closed mesh ·
    closed : its volume without curvature, gradient, parts, independence of the pole · closures :
    what was closed · edge_vertices : how many vertices complete edges · gradient : (k, 3) m², by
    the measured vertices · by_ground : (3,), by the ground's height and slopes · fit_m3 : the part
    of the volume by which the filter's surfaces are off their points
    (:mod:`~ladar_volume.clouds.body_checks`)
    """

    volume_m3: float
    uncorrected_m3: float
    edge_m3: float
    curvature_m3: float
    closed_m3: float
    centroid_map: F64
    skin: LinearMesh
    closed: ClosedVolume
    closures: tuple[Closure, ...]
    edge_vertices: int
    gradient: F64
    by_ground: F64
    fit_m3: float = 0.0

    @cached_property
    def crossed_space(self) -> Crossing:
        """Triangles that cross, and how much space that counts wrongly."""
        found = self.closed.crossing
        return found or crossing_of(self.skin.vertices, self.closed.mesh.triangles)

    @property
    def crossing_pairs(self) -> int:
        """Pairs of triangles that cross."""
        return len(self.crossed_space.pairs)

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What makes the volume doubtful."""
        return crossing_doubts(self.crossed_space, self.volume_m3)

    @property
    def area_m2(self) -> float:
        """Area of the closed mesh."""
        return self.closed.area_m2


def body_of(
    vertices: F64,
    triangles: I32,
    normals: F64 | None = None,
    curved: Bool | None = None,
    close_m: float = 0.0,
    ground: Plane | None = None,
    sharp_rad: float | None = SHARP_RAD,
    pole_map: F64 | None = None,
    allow_crossings: bool = False,
) -> Body:
    """The body within a mesh (n, 3), (m, 3), open or closed.

    normals : (n, 3) of the surface at the vertices, of either sign; without them nothing is
    corrected · curved : (n,) whether it is curved there · close_m, ground : see
    :func:`~ladar_volume.mesh.closing.close` · sharp_rad : faces whose normals enclose more meet
    in an edge; None: no edge is completed. Raises :class:`SurfaceError` as
    :func:`~ladar_volume.mesh.closing.close` and
    :func:`~ladar_volume.mesh.tetrahedra.closed_volume`.
    """
    start = linear_mesh(vertices, triangles, normals, curved)
    blunt, skin, closures, added = _close_skin(start, close_m, ground, sharp_rad)
    closed = closed_volume(skin.vertices, skin.triangles, pole_map, allow_crossings)
    cut_off = _volume_within(blunt, pole_map) if added else closed.volume_m3
    # a cavity is turned round: what its surface bulges is lost to the body
    side = np.where(closed.flipped, -1.0, 1.0)
    curvature = float(bulge_volumes(skin, SHARP_RAD if sharp_rad is None else sharp_rad) @ side)
    by_measured = np.asarray(closed.gradient.ravel() @ skin.by_measured).reshape(-1, 3)
    volumes = closed.volume_m3 + curvature, cut_off, closed.volume_m3 - cut_off, curvature
    return Body(
        *volumes,
        sum(c.closed_m3 for c in closures),
        solid_centroid(skin.vertices, closed),
        skin,
        closed,
        tuple(closures),
        added,
        by_measured,
        closed.gradient.ravel() @ skin.by_ground,
    )


def _volume_within(skin: LinearMesh, pole_map: F64 | None) -> float:
    """Volume, m³, of a closed skin whose triangles may cross."""
    return closed_volume(skin.vertices, skin.triangles, pole_map, True).volume_m3


class ClosedSkins(NamedTuple):
    """blunt : the closed skin without, skin : with the edges completed · closures : of the latter ·
    added_vertices : vertices on the edges
    """

    blunt: LinearMesh
    skin: LinearMesh
    closures: list[Closure]
    added_vertices: int


def _close_skin(
    start: LinearMesh, close_m: float, ground: Plane | None, sharp_rad: float | None
) -> ClosedSkins:
    """The skin closed, as it is and with its sharp edges completed."""
    blunt, closures = close(start, close_m, ground)
    sharp, added = sharpen(start, sharp_rad) if sharp_rad is not None else (start, 0)
    if not added:
        return ClosedSkins(blunt, blunt, closures, 0)
    skin, closures = close(sharp, close_m, ground)
    return ClosedSkins(blunt, skin, closures, added)


def published_body(mesh: LocalMesh, pole_map: F64 | None = None) -> Body:
    """The sum of signed tetrahedra of a mesh as published (seed 002 section 7.2), closed or not,
    about the middle of its points: nothing is completed, closed or corrected.

    Where the mesh is open the volume depends on the pole, and ``closed.pole_spread_m3`` says by
    how much.
    """
    v, t = mesh.vertices, mesh.triangles
    pole = v.mean(axis=0) if pole_map is None else np.asarray(pole_map, dtype=np.float64)
    volume = float(signed_tetrahedra(v, t, pole).sum())
    spread = max(abs(float(signed_tetrahedra(v, t, q).sum()) - volume) for q in other_poles(v))
    ends = np.array([rim for rim in mesh.rims], np.int32).reshape(-1, 2)
    turned, part = np.zeros(len(t), bool), np.zeros(len(t), np.int32)
    edges = len(edge_table(t)[1]) - 1
    used = OrientedMesh(t, turned, part, ends, edges, len(np.unique(t)))
    gradient = tetrahedra_gradient(v, t, pole)
    closed = ClosedVolume(
        volume, np.array([volume]), gradient, surface_area(v, t), pole, spread, used, turned
    )
    kind, face = np.zeros(len(v), np.int32), np.zeros(len(t), np.int32)
    unknown = np.full((len(t), 3, 3), np.nan)
    still, by_ground = np.zeros(len(v), bool), np.zeros((3 * len(v), 3))
    direct = identity(3 * len(v), format="csr")
    skin = LinearMesh(v, t, unknown, kind, still, face, direct, by_ground)
    none = np.zeros(3)
    centre = solid_centroid(v, closed)
    return Body(volume, volume, 0.0, 0.0, 0.0, centre, skin, closed, (), 0, gradient, none)


def solid_centroid(vertices: F64, closed: ClosedVolume) -> F64:
    """Centroid (3,) m of a closed body, that of its tetrahedra weighted by their volumes."""
    pole = vertices[closed.mesh.triangles[0, 0]]
    share = signed_tetrahedra(vertices, closed.mesh.triangles, pole)
    out: F64 = pole + share @ (vertices[closed.mesh.triangles] - pole).sum(axis=1) / (
        4.0 * share.sum()
    )
    return out


@dataclass(frozen=True)
class Uncertain:
    """C_m6 : (b, b) m⁶, covariance of the bodies' volumes · budget_m6 : variances of each body by
    source, which add up to the diagonal
    """

    C_m6: F64
    budget_m6: tuple[dict[str, float], ...]

    @property
    def sigma_m3(self) -> F64:
        """Standard deviations (b,) m³."""
        return np.sqrt(np.diagonal(self.C_m6))


def closing_m6(body: Body) -> float:
    """Variance of a body from how it was closed, m⁶."""
    return sum(c.doubt_m3**2 for c in body.closures)


def cloud_uncertainty(
    bodies: Sequence[Body],
    sources: Sequence[I64],
    r: F64,
    filtered: CloudResult,
    ground: Plane | None,
) -> Uncertain:
    """Of bodies whose measured vertices are the filtered points ``sources`` (k,) each.

    r : (n, 3) m, the raw points · ground : with a support, that of filtered points, which it moves
    with; without, a plane with a covariance of its own.
    """
    b = len(bodies)
    weight = _weights(bodies, sources, filtered, ground)
    own = np.zeros((b, b))
    if ground is not None and not len(ground.support):
        J = np.stack([body.by_ground[: len(ground.beta)] for body in bodies])
        own = J @ ground.C_beta @ J.T
    told = filtered.independent_noise
    noise = np.ones(1) if told is None else told
    s = influence(r, filtered, weight) * noise[:, None]
    joint = s.T @ s
    by_ground = joint[b:, b:] + own
    both = joint[:b, :b] + joint[:b, b:] + joint[b:, :b] + joint[b:, b:]
    closing = np.array([closing_m6(body) for body in bodies])
    budget = tuple(
        {
            "noise": float(both[k, k] - joint[b + k, b + k]),
            "ground": float(by_ground[k, k]),
            "closing": float(closing[k]),
        }
        for k in range(b)
    )
    return Uncertain(both + own + np.diag(closing), budget)


def _weights(
    bodies: Sequence[Body], sources: Sequence[I64], filtered: CloudResult, ground: Plane | None
) -> F64:
    """Derivative (k, 2b) m² of the b volumes by the height of each filtered point along its normal:
    as a point of the body, and as a point of the ground's support.
    """
    b = len(bodies)
    weight = np.zeros((len(filtered.r), 2 * b))
    for k, (body, source) in enumerate(zip(bodies, sources, strict=True)):
        along = np.einsum("ni,ni->n", body.gradient, filtered.normal[source])
        np.add.at(weight[:, k], source, along)
        if ground is not None and len(ground.support):
            by_beta = body.by_ground[: len(ground.beta), None]
            by_point = ground_gradient(filtered.r, ground, by_beta)[:, 0]
            along = np.einsum("ni,ni->n", by_point, filtered.normal[ground.support])
            np.add.at(weight[:, b + k], ground.support, along)
    return weight


def mesh_uncertainty(
    bodies: Sequence[Body], sigma_m: float | Sequence[F64], ground: Plane | None = None
) -> Uncertain:
    """Of bodies whose measured vertices err independently and in every direction: by ``sigma_m``,
    one for all or (k,) for each body.

    The second-order part is that of the closed mesh with the mean variance.
    """
    C = np.zeros((len(bodies), len(bodies)))
    if ground is not None:
        J = np.stack([body.by_ground[: len(ground.beta)] for body in bodies])
        C = J @ ground.C_beta @ J.T
    budget = []
    for k, body in enumerate(bodies):
        sigma = np.broadcast_to(
            sigma_m[k] if isinstance(sigma_m, Sequence) else sigma_m, len(body.gradient)
        )
        first = float((body.gradient**2).sum(axis=1) @ sigma**2)
        second = closed_variance(
            body.skin.vertices, body.closed, float(np.sqrt(np.mean(sigma**2)))
        ).second_m6
        budget.append(
            {"noise": first + second, "ground": float(C[k, k]), "closing": closing_m6(body)}
        )
        C[k, k] = sum(budget[-1].values())
    return Uncertain(C, tuple(budget))
