"""Which triangles count (seed 000 section 3.1): shadows and artificial corners do not."""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.surface.tin import footprint_areas


def edge_lengths(tin: Tin) -> F64:
    """Horizontal lengths (m, 3) of the edges opposite each vertex, m."""
    p = tin.vertices[tin.triangles, :2]
    out: F64 = np.linalg.norm(p[:, [2, 0, 1]] - p[:, [1, 2, 0]], axis=2)
    return out


def circumdiameters(tin: Tin) -> F64:
    """Diameters (m,) of the horizontal circumcircles, m: product of the edges over twice the area."""
    out: F64 = edge_lengths(tin).prod(axis=1) / (2.0 * np.abs(footprint_areas(tin.vertices, tin.triangles)))
    return out


def relevant_triangles(
    tin: Tin, option: str, max_edge_m: float = np.inf, max_circumdiameter_m: float = np.inf, artificial: I64 | None = None
) -> Bool:
    """Mask (m,) by one of the four options of seed 000 section 3.1.

    ``all``: every triangle · ``corners``: those that meet no artificial vertex (indices ``artificial``) · ``edge``: of these,
    those without an edge longer than ``max_edge_m`` · ``circumcircle``: of these, those whose circumcircle is no wider than
    ``max_circumdiameter_m``. Horizontal measures.
    """
    if option not in ("all", "corners", "edge", "circumcircle"):
        raise SurfaceError(f"unknown choice of relevant triangles {option!r}", reason="surface_relevant", value=option)
    mask = np.ones(len(tin.triangles), bool)
    if option == "all":
        return mask
    if artificial is not None and len(artificial):
        mask &= ~np.isin(tin.triangles, artificial).any(axis=1)
    if option == "edge":
        mask &= (edge_lengths(tin) <= max_edge_m).all(axis=1)
    elif option == "circumcircle":
        mask &= circumdiameters(tin) <= max_circumdiameter_m
    return mask


def with_relevant(tin: Tin, option: str, max_edge_m: float, max_circumdiameter_m: float, artificial: I64 | None = None) -> Tin:
    """The same TIN with its relevant triangles marked; raises :class:`SurfaceError` where none is left."""
    mask = relevant_triangles(tin, option, max_edge_m, max_circumdiameter_m, artificial)
    if not mask.any():
        raise SurfaceError(f"no relevant triangle is left of {len(mask)} (option {option!r})", reason="surface_no_relevant", value=option)
    return dataclasses.replace(tin, relevant=mask)
