"""The part of a surface within the outline of a pile, and what lies between it and each base."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ladar_volume.change.surface_difference import difference
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import ZERO, Solid, has_selected_vertices, solid_above
from ladar_volume.ground.ground_adjoint import ground_gradient
from ladar_volume.ground.polynomial import (
    base_height,
    degree_of,
    design,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import Pile
from ladar_volume.model.records import F64, Plane, Tin
from ladar_volume.piles.toe_bases import ToeBase
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import height_at
from ladar_volume.uncertainty.ground_field import GroundField, Roughness
from ladar_volume.volume.near_base import near_base
from ladar_volume.volume.neighbourhood import SparseF64
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.polygon import check_polygon, clipped_prismoids, weights_of_rows
from ladar_volume.volume.volume_loads import at_once, ground_field, whole_triangles


@dataclass(frozen=True)
class PilePart:
    """surface : of the site · pile · inside_m2 : (m,) of each triangle within the outline ·
    by_height : (n,) m², derivatives of the volume below the surface by its heights
    """

    surface: CloudSurface
    pile: Pile
    inside_m2: F64
    by_height: F64

    @property
    def area_m2(self) -> float:
        """Footprint where the surface is."""
        return float(self.inside_m2.sum())

    @property
    def tin(self) -> Tin:
        """The surface of the site."""
        return self.surface.representation.tin


@dataclass(frozen=True)
class Net:
    """A net volume: its gradient (n,) m² by the heights of the surface and of a second one, and
    variances m⁶ beyond theirs, by source
    """

    net_m3: float
    gradient: F64
    second: F64 | None = None
    extra: Mapping[str, float] = field(default_factory=dict)


def pile_part(surface: CloudSurface, pile: Pile) -> PilePart:
    """The part of a surface within the outline. Raises :class:`VolumeError` (volume_no_triangle)
    where there is none.
    """
    tin = surface.representation.tin
    rows, weights = weights_of_rows(tin, check_polygon(pile.ring))
    inside = np.zeros(len(tin.triangles))
    inside[rows] = np.maximum(weights.sum(axis=1), 0.0)
    if not inside.any():
        raise VolumeError(
            "no part of the surface lies inside the outline", reason="volume_no_triangle"
        )
    by_height = np.bincount(tin.triangles[rows].ravel(), weights.ravel(), len(tin.vertices))
    return PilePart(surface, pile, inside, by_height.astype(np.float64))


def roughness_around(part: PilePart, ground: Plane) -> Roughness | None:
    """How the ground around a pile deviates from the polynomial fitted to it."""
    variance = part.surface.vertex_variance
    field = ground_field(part.tin, ground, -loads(part, ground), part.inside_m2, variance)
    return None if field is None else field.rough


def above_plane(part: PilePart, plane: Plane, rough: Roughness | None = None) -> Net:
    """Net volume above a polynomial, which may be fitted to vertices of the same surface. rough :
    how these deviate from it, where it is known
    """
    tin, g = part.tin, part.by_height
    used = np.flatnonzero(g)
    v = tin.vertices[used]
    net = float(g[used] @ (v[:, 2] - base_height(plane, v[:, :2])))
    if not len(plane.support):
        return Net(net, g)
    by_beta = -(design(v[:, :2], plane.origin_xy, degree_of(plane)).T @ g[used])
    out = g.copy()
    out[plane.support] += ground_gradient(tin.vertices, plane, by_beta[:, None])[:, 0, 2]
    variance, keep = part.surface.vertex_variance, at_once if rough is None else lambda tell: rough
    field = ground_field(tin, plane, by_beta, part.inside_m2, variance, keep=keep)
    return Net(net, out, None, {} if field is None else {"base_surface": field.variance_m6})


def above_toe(part: PilePart, base: ToeBase, rough: Roughness | None) -> Net:
    """Net volume above a base from the toe line. rough : of the ground, where it is known."""
    g, B = part.by_height, base.line.by_vertex
    extra = {}
    if base.level_variance_m2 > 0.0:
        extra["base_extreme"] = base.level_variance_m2 * part.area_m2**2
    if base.plane is not None:
        net, load = above_plane(part, base.plane), loads(part, base.plane)
        by_line = base.by_heights.T @ load
        extra |= line_errors(part, base, by_line, rough)
        return Net(net.net_m3, g - B.T @ by_line, None, extra)
    assert base.tin is not None
    t = base.tin.triangles[base.tin.relevant]
    third = footprint_areas(base.tin.vertices, t) / 3.0
    by_node = np.bincount(t.ravel(), np.repeat(third, 3), len(base.tin.vertices))
    net_m3 = float(g @ part.tin.vertices[:, 2] - by_node @ base.tin.vertices[:, 2])
    by_line = base.by_heights.T @ by_node
    extra |= line_errors(part, base, by_line, rough)
    return Net(net_m3, g - B.T @ by_line, None, extra)


def line_errors(
    part: PilePart, base: ToeBase, by_line: F64, rough: Roughness | None
) -> dict[str, float]:
    """Variances m⁶ of what lies below a base beyond the noise of its toe line, with derivatives
    by_line (t,) m² by its heights: where the line was drawn, and how the ground below the pile
    deviates from that along the line.
    """
    out = {"toe_place": float(by_line @ base.line.outward_m) ** 2}
    if rough is not None:
        tin, line = part.tin, base.line
        own = GroundField(tin.vertices, tin.triangles, part.inside_m2, line.xy, -by_line, rough)
        out["base_surface"] = own.variance_m6
    return out


def loads(part: PilePart, plane: Plane, by_height: F64 | None = None) -> F64:
    """Derivatives (p,) of what lies below a polynomial by its coefficients, with weights by_height
    (n,) of the vertices in its heights.
    """
    g = part.by_height if by_height is None else by_height
    used = np.flatnonzero(g)
    xy = part.tin.vertices[used, :2]
    out: F64 = design(xy, plane.origin_xy, degree_of(plane)).T @ g[used]
    return out


def above_second(part: PilePart, second: CloudSurface) -> Net:
    """Net volume above a second surface. Raises :class:`VolumeError` (pile_second) where that does
    not cover the pile.
    """
    other = pile_part(second, part.pile)
    apart = abs(other.area_m2 - part.area_m2)
    if apart > 0.01 * part.area_m2:
        raise VolumeError(
            f"the second surface covers {other.area_m2:.5g} m² of the outline, the first "
            f"{part.area_m2:.5g} m²: draw the outline within both",
            reason="pile_second",
            value=apart,
        )
    g, h = part.by_height, other.by_height * (part.area_m2 / other.area_m2)
    net = float(g @ part.tin.vertices[:, 2] - h @ other.tin.vertices[:, 2])
    return Net(net, g, -h)


def solid_above_plane(
    part: PilePart, plane: Plane, parameters: Parameters, correct: bool, C: SparseF64 | None
) -> Solid:
    """Cut and fill above a polynomial; ``parameters`` with the outline as polygon."""
    variance = part.surface.vertex_variance
    return solid_above(part.surface, plane, part.inside_m2, parameters, variance, correct, C)


def solid_above_toe(
    part: PilePart,
    base: ToeBase,
    rough: Roughness | None,
    parameters: Parameters,
    correct: bool,
    C: SparseF64 | None,
) -> Solid:
    """Cut and fill above a base from the toe line."""
    net = above_toe(part, base, rough)
    B, M = base.line.by_vertex, base.by_heights
    if base.plane is not None:
        made = solid_above_plane(part, base.plane, parameters, correct, C)
        cut = made.gradients[0][1][:, 1]
        cut = cut - B.T @ (M.T @ loads(part, base.plane, cut))
        gradients = ((part.surface, np.column_stack([net.gradient, cut])),)
        return dataclasses.replace(made, gradients=gradients, extra=dict(net.extra))
    assert base.tin is not None
    upper = dataclasses.replace(part.tin, relevant=part.inside_m2 > 0)
    found = volumes_between(upper, base.tin)
    cut = found.gradient_cut[:, 2] + B.T @ (M.T @ found.lower_cut[:, 2])
    relative = relative_to(part.tin, base.tin)
    near, curved = None, 0.0
    if correct and part.surface.sigma_m is not None and C is not None:
        mask = whole_triangles(part.tin, part.inside_m2)
        mask &= np.isfinite(relative.vertices[part.tin.triangles, 2]).all(axis=1)
        known = np.nan_to_num(relative.vertices)
        if mask.any():
            near = near_base(
                dataclasses.replace(relative, vertices=known),
                ZERO,
                C,
                mask,
                selected=has_selected_vertices(part.surface),
            )
            curved = near.variance_m6
    gradients = ((part.surface, np.column_stack([net.gradient, cut])),)
    lines = dict(net.extra)
    return Solid(found.cut_m3, found.fill_m3, found.area_m2, gradients, near, curved, lines)


def relative_to(tin: Tin, base: Tin) -> Tin:
    """The surface with its heights above another, NaN where that is not."""
    height = tin.vertices[:, 2] - height_at(base, tin.vertices[:, :2])
    return dataclasses.replace(tin, vertices=np.column_stack([tin.vertices[:, :2], height]))


def solid_above_second(part: PilePart, second: CloudSurface) -> Solid:
    """Cut and fill above a second surface within the outline: net exactly, cut and fill by their
    difference at the vertices of the finer one.
    """
    net = above_second(part, second)
    assert net.second is not None
    upper = dataclasses.replace(part.tin, relevant=part.inside_m2 > 0)
    apart = difference(upper, second.representation.tin)
    found = clipped_prismoids(apart.tin, ZERO, part.pile.ring)
    own = found.gradient_cut[:, 2]
    shape = (
        len(second.representation.tin.vertices) if apart.upper_carries else len(part.tin.vertices)
    )
    other = -np.bincount(apart.corner.ravel(), (apart.weight * own[:, None]).ravel(), shape)
    cuts = (own, other) if apart.upper_carries else (-other, -own)
    missing = 0.5 * (
        net.net_m3 - found.net_m3
    )  # along the outline and over the coarser one's edges
    gradients = tuple(
        (surface, np.column_stack([n, c]))
        for surface, n, c in zip(
            (part.surface, second), (net.gradient, net.second), cuts, strict=True
        )
    )
    return Solid(
        found.cut_m3 + missing, found.fill_m3 - missing, part.area_m2, gradients, None, 0.0
    )
