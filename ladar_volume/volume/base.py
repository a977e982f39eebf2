"""What a volume stands on and where it counts: base and outline, which define each other where the
ground is the survey's own.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.ground.robust_ground import fit_ground, refine
from ladar_volume.ground.surfaces import further_grounds
from ladar_volume.math.large_arrays import in_its_room
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64, I32, Bool, Plane, Tin
from ladar_volume.tin.full_tin import footprint_areas, vertex_mask
from ladar_volume.volume.outline import labelled_bodies, nearest_bodies, surroundings, widen_body
from ladar_volume.volume.polygon import areas_inside, check_polygon

#: Base and outline settle in two or three rounds; the first repetition ends it, with what the
#: triangles that come and go until then make of the volume. Where none repeats, that is told of the
#: last rounds, so many.
MAX_ROUNDS, LAST = 10, 3
#: Stands where no base is needed.
ZERO = design_surface([0.0])


def base_and_outline(tin: Tin, height_variance: F64, parameters: Parameters) -> tuple[Plane, F64]:
    """The base, and the area (m,) m² of each triangle inside the outline.

    height_variance : (n,) m², independent noise of the vertex heights. Raises :class:`GroundError`
    where no ground can be fitted and :class:`VolumeError` where nothing lies inside the outline.
    """
    p = parameters.volume
    if p.base == "level":
        base = design_surface([p.level_m])
    elif p.base == "plane":
        base = design_surface(p.plane)
    else:
        if p.outline == "polygon":  # what is inside, such as a pit, is no ground
            used = surroundings(tin, area_inside(tin, ZERO, p) > 0, 0.0)
        else:
            used = in_its_room(np.flatnonzero(vertex_mask(tin, tin.relevant)))
        base = fit_ground(
            tin.vertices, height_variance, parameters.ground, p.object_height_m / 2, select=used
        )
    if p.base == "ground" and p.outline == "auto":
        return settled_outline(tin, height_variance, base, parameters)
    inside = area_inside(tin, base, p)
    if p.base == "ground" and p.outline == "polygon":
        base = refined_base(tin, height_variance, base, inside > 0, parameters)
    return base, inside


def settled_outline(
    tin: Tin, height_variance: F64, base: Plane, parameters: Parameters
) -> tuple[Plane, F64]:
    """:func:`base_and_outline` of bodies on their ground, which define each other."""
    p, known = parameters.volume, dict[bytes, Bool]()
    mask = body_outline(tin, base, p, known)
    seen = [mask]
    for _ in range(MAX_ROUNDS):
        base = refined_base(tin, height_variance, base, mask, parameters)
        mask = body_outline(tin, base, p, known)
        again = [k for k, earlier in enumerate(seen) if np.array_equal(mask, earlier)]
        if again:
            seen = seen[again[0] + 1 :]
            break
        seen.append(mask)
    inside = footprint_areas(tin.vertices, tin.triangles)
    inside[~mask] = 0.0
    others = [other for other in seen[-LAST:] if other is not mask]
    moved = max((abs(volume_between(tin, base, other, mask)) for other in others), default=0.0)
    return dataclasses.replace(base, unsettled_m3=moved), inside


def refined_base(
    tin: Tin, height_variance: F64, base: Plane, mask: Bool, parameters: Parameters
) -> Plane:
    """The ground around the outline of triangles in ``mask`` (m,)."""
    p = parameters.volume
    ring = surroundings(tin, mask, p.ground_ring_m)
    found = refine(
        tin.vertices[ring], height_variance[ring], base, parameters.ground, p.object_height_m
    )
    return dataclasses.replace(found, support=ring[found.support])


def volume_between(tin: Tin, base: Plane, one: Bool, two: Bool) -> float:
    """Net volume above a base, m³, within the second of two outlines of triangles (m,) less that
    within the first.
    """
    rows = np.flatnonzero(one != two)
    corners = tin.triangles[rows]
    height = height_above(tin.vertices[corners].reshape(-1, 3), base).reshape(-1, 3).mean(axis=1)
    sign = np.where(two[rows], 1.0, -1.0)
    return float((sign * footprint_areas(tin.vertices, corners)) @ height)


def area_inside(tin: Tin, base: Plane, p: VolumeParameters) -> F64:
    """Area (m,) m² of each triangle inside the outline. Raises :class:`VolumeError` where there is
    none.
    """
    if p.outline == "polygon":
        inside = areas_inside(tin, polygon_of(p))
        if not inside.any():
            raise VolumeError(
                "no part of the surface lies inside the outline", reason="volume_no_triangle"
            )
        return inside
    mask = tin.relevant if p.outline == "all" else body_outline(tin, base, p, {})
    out = footprint_areas(tin.vertices, tin.triangles)
    out[~mask] = 0.0
    return out


def body_outline(tin: Tin, base: Plane, p: VolumeParameters, known: dict[bytes, Bool]) -> Bool:
    """The triangles (m,) within the outline of the bodies. known : by the bodies' triangles, what
    was found on this surface before; a base that differs little has the same bodies.
    """
    body = np.isin(*labelled_bodies(tin, base, p.object_height_m, p.bodies, p.min_body_m3))
    key = np.packbits(body).tobytes()
    if key not in known:
        known[key] = widen_body(tin, body, p.outline_margin_m)
    return known[key]


def body_of_each(tin: Tin, base: Plane, inside: F64, p: VolumeParameters) -> tuple[I32 | None, int]:
    """The number of the body that each triangle inside the outline (m,) goes to, the main one's 0,
    -1 outside, and how many bodies there are; None for one that has all.
    """
    if p.outline != "auto" or p.bodies == 1:
        return None, 1
    label, kept = labelled_bodies(tin, base, p.object_height_m, p.bodies, p.min_body_m3)
    if len(kept) == 1:
        return None, 1
    return in_its_room(nearest_bodies(tin, inside > 0, label, kept)), len(kept)


def all_grounds(
    tin: Tin, height_variance: F64, base: Plane, inside: F64, parameters: Parameters
) -> tuple[Plane, ...]:
    """The ground surfaces of the survey: the base, and up to ``ground.surfaces - 1`` others outside
    the outline. None above a design surface.
    """
    p = parameters.volume
    if p.base != "ground":
        return ()
    if parameters.ground.surfaces == 1:
        return (base,)
    outside = surroundings(tin, inside > 0, 0.0)
    return (
        base,
        *further_grounds(
            tin.vertices, height_variance, base, parameters.ground, p.object_height_m / 2, outside
        ),
    )


def polygon_of(p: VolumeParameters) -> F64:
    """The outline (k, 2) m of the parameters. Raises :class:`VolumeError` for one that is no simple
    polygon.
    """
    flat = np.asarray(p.polygon_m, dtype=np.float64)
    if len(flat) % 2:
        raise VolumeError(
            "polygon_m holds x, y pairs; its length is odd",
            reason="volume_polygon",
            value=len(flat),
        )
    return check_polygon(flat.reshape(-1, 2))
