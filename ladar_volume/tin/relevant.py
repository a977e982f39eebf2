"""Which triangles count (seed 000 section 3.1): shadows and artificial corners do not."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ladar_volume.math.kernels import kernel, leaf_kernel, run_in_ranges
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.full_tin import area_of

#: How relevant triangles are told from others.
OPTIONS = ("all", "corners", "edge", "circumcircle")
#: Squares below, m², round to nothing or nearly so; a square root alone takes a third of the time.
TINY = 1e-290
#: A limit holds for what exceeds it by rounding alone: by this share of it, or by so many steps of
#: the coordinates. Sides of a lattice that is turned are not all as long as they were.
LIMIT_SHARE, STEPS = 1e-9, 16.0


@leaf_kernel
def side_length(vertices: F64, triangles: I32, t: int, k: int) -> float:
    """Horizontal length, m, of the edge opposite corner k of triangle t."""
    a, b = vertices[triangles[t, (k + 1) % 3]], vertices[triangles[t, (k + 2) % 3]]
    square = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
    length: float = math.sqrt(square) if square > TINY else np.hypot(b[0] - a[0], b[1] - a[1])
    return length


@kernel
def length_kernel(vertices: F64, triangles: I32) -> F64:
    """See :func:`edge_lengths`."""
    out = np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        for k in range(3):
            out[t, k] = side_length(vertices, triangles, t, k)
    return out


@kernel
def edge_kernel(vertices: F64, triangles: I32, limit: float, mask: Bool) -> None:
    """Take those out of the triangles in ``mask`` (m,) that have an edge longer than a limit, m."""
    for t in range(len(triangles)):
        for k in range(3):
            mask[t] &= side_length(vertices, triangles, t, k) <= limit


def edge_lengths(tin: Tin, mask: Bool | None = None) -> F64:
    """Horizontal lengths (k, 3) of the edges opposite each vertex, m, of the triangles in ``mask``
    (m,), by default of all.
    """
    t = tin.triangles if mask is None else tin.triangles[mask]
    return np.asarray(length_kernel(tin.vertices, t))


@leaf_kernel
def longest_side(a: F64, b: F64, c: F64) -> float:
    """Horizontal length, m, of the longest side between corners (3,)."""
    square = max(
        (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2,
        max((c[0] - b[0]) ** 2 + (c[1] - b[1]) ** 2, (a[0] - c[0]) ** 2 + (a[1] - c[1]) ** 2),
    )
    if square > TINY:
        return math.sqrt(square)
    out: float = max(
        np.hypot(b[0] - a[0], b[1] - a[1]),
        max(np.hypot(c[0] - b[0], c[1] - b[1]), np.hypot(a[0] - c[0], a[1] - c[1])),
    )
    return out


@kernel
def longest_sides(vertices: F64, triangles: I32, rows: I64) -> F64:
    """Horizontal lengths (k,) m of the longest sides of the triangles ``rows`` (k,)."""
    out = np.empty(len(rows))
    for k in range(len(rows)):
        t = rows[k]
        out[k] = longest_side(
            vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        )
    return out


@kernel
def size_kernel(vertices: F64, triangles: I32, mask: Bool) -> tuple[float, float]:
    """Sums over the triangles in ``mask`` (m,) of their horizontal areas, m², and of their longest
    edges, m.
    """
    area, longest = 0.0, 0.0
    for t in range(len(triangles)):
        if mask[t]:
            a, b, c = (
                vertices[triangles[t, 0]],
                vertices[triangles[t, 1]],
                vertices[triangles[t, 2]],
            )
            area += 0.5 * abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
            longest += longest_side(a, b, c)
    return area, longest


@leaf_kernel
def circumdiameter_of(vertices: F64, triangles: I32, t: int) -> float:
    """Diameter of the horizontal circumcircle of triangle t, m; infinite where its area is 0."""
    area = area_of(vertices, triangles, t)
    if area == 0.0:
        return np.inf
    a, b, c = (
        side_length(vertices, triangles, t, 0),
        side_length(vertices, triangles, t, 1),
        side_length(vertices, triangles, t, 2),
    )
    out: float = a * b * c / (2.0 * abs(area))
    return out


@kernel
def circle_kernel(first: int, end: int, vertices: F64, triangles: I32, out: F64) -> None:
    """See :func:`circumdiameters`; some triangles."""
    for t in range(first, end):
        out[t] = circumdiameter_of(vertices, triangles, t)


def circumdiameters(vertices: F64, triangles: I32) -> F64:
    """Diameters (m,) of the horizontal circumcircles of triangles (m, 3) over vertices (n, 3), m:
    product of the edges over twice the area; infinite for a triangle so flat that its area rounds
    to zero.
    """
    out = large_zeros((len(triangles),))
    run_in_ranges(circle_kernel, len(out), vertices, triangles, out)
    return out


def step_of(tin: Tin) -> float:
    """What lengths between vertices may be off by, m, since coordinates are rounded."""
    xy = tin.vertices[:, :2]
    return STEPS * float(np.spacing(max(xy.max(), -xy.min()))) if len(xy) else 0.0


def widened(tin: Tin, limit_m: float) -> float:
    """A limit of lengths, m, with what is rounding alone."""
    return limit_m * (1.0 + LIMIT_SHARE) + step_of(tin)


def artificial_vertices(tin: Tin) -> I64:
    """Vertices (k,) that are no data points (map corners): their source is -1."""
    return np.flatnonzero(tin.source < 0)


def check_option(option: str, limit: float) -> None:
    """Raise :class:`SurfaceError` for an unknown option or a limit, m, that is not above 0."""
    if option not in OPTIONS:
        raise SurfaceError(
            f"unknown choice of relevant triangles {option!r}",
            reason="surface_relevant",
            value=option,
        )
    if not limit > 0.0:
        raise SurfaceError(
            f"the limit of option {option!r} is {limit} m; it must be above 0",
            reason="surface_limit",
            value=limit,
        )


def relevant_triangles(
    tin: Tin,
    option: str,
    max_edge_m: float = np.inf,
    max_circumdiameter_m: float = np.inf,
    artificial: I64 | None = None,
) -> Bool:
    """Mask (m,) by one of the four options of seed 000 section 3.1.

    ``all``: every triangle · ``corners``: those that meet no artificial vertex (indices
    ``artificial``, by default those without a source) · ``edge``: of these, those without an edge
    longer than ``max_edge_m`` · ``circumcircle``: of these, those whose circumcircle is no wider
    than ``max_circumdiameter_m`` (the α-shape of the data points with α half of it). Horizontal
    measures.

    Raises :class:`SurfaceError` for an unknown option or a limit that is not a number > 0.
    """
    limits = {"edge": max_edge_m, "circumcircle": max_circumdiameter_m}
    check_option(option, limits.get(option, 1.0))
    mask = np.ones(len(tin.triangles), bool)
    if option == "all":
        return mask
    artificial = artificial_vertices(tin) if artificial is None else artificial
    if len(artificial):
        mask &= ~np.isin(tin.triangles, artificial).any(axis=1)
    if option == "edge":
        edge_kernel(tin.vertices, tin.triangles, widened(tin, max_edge_m), mask)
    elif option == "circumcircle":
        mask &= circumdiameters(tin.vertices, tin.triangles) <= widened(tin, max_circumdiameter_m)
    return mask


def with_relevant(
    tin: Tin,
    option: str,
    max_edge_m: float,
    max_circumdiameter_m: float,
    artificial: I64 | None = None,
) -> Tin:
    """The same TIN with its relevant triangles marked; raises :class:`SurfaceError` where none is
    left.
    """
    return mark_relevant(
        tin,
        relevant_triangles(tin, option, max_edge_m, max_circumdiameter_m, artificial),
        f"option {option!r}",
    )


def mark_relevant(tin: Tin, mask: Bool, by: str) -> Tin:
    """The same TIN with the triangles in ``mask`` (m,) relevant; the others stay in it. Raises
    :class:`SurfaceError` where none is left that has an area: slivers between points in one line,
    whose area is rounding, are none.
    """
    area, longest = size_kernel(tin.vertices, tin.triangles, mask)
    if not area > longest * step_of(tin):
        raise SurfaceError(
            f"no relevant triangle is left of {len(mask)} ({by})",
            reason="surface_no_relevant",
            value=by,
        )
    return dataclasses.replace(tin, relevant=mask)
