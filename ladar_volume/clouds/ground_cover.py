"""What stands on the ground or beside a body and is neither: plants, told from the scatter of the
points about local quadrics; walls, machines and trees, told from steep edges of the surface.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import binary_dilation

from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.clouds.cloud_noise import FEWEST, fit_residuals, neighbours, robust_sigma
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import vertex_mask

#: Points at which the scatter of the ground and of the body is looked at, each.
MOST = 4000
#: Directions about a body in which the ground is looked at one by one.
SECTORS = 8
#: Least scatter of the ground beyond the body's that is believed to be plants, m, and in the body's
#: scatter.
GRASS_M, GRASS = 0.009, 1.0
#: Slope of a steep edge (60°), and its least climb in standard deviations of a point.
STEEP, CLIMB = math.tan(math.radians(60.0)), 6.0
#: Ground is beside closed bodies beyond so many spacings of their points, and lies within this
#: share of their height about the base.
BESIDE, LOW = 4.0, 0.3


def steep_vertices(surface: CloudSurface, object_height_m: float, scatter_m: float) -> Bool:
    """Vertices (n,) at the upper end of an edge steeper than 60° that climbs twice what a body
    rises at least, and more than the scatter of the body's points can.
    """
    return steep_edges(surface.representation.tin, max(2.0 * object_height_m, CLIMB * scatter_m))


def steep_edges(tin: Tin, least_m: float) -> Bool:
    """Vertices (n,) at the upper end of an edge steeper than 60° that climbs more than least_m."""
    return np.asarray(steep_kernel(tin.vertices, tin.triangles, tin.relevant, least_m))


@kernel
def steep_kernel(r: F64, triangles: I32, relevant: Bool, least_m: float) -> Bool:
    """See :func:`steep_edges`."""
    out = np.zeros(len(r), np.bool_)
    for t in range(len(triangles)):
        if not relevant[t]:
            continue
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            climb = r[b, 2] - r[a, 2]
            if abs(climb) > least_m and abs(climb) > STEEP * np.hypot(
                r[b, 0] - r[a, 0], r[b, 1] - r[a, 1]
            ):
                out[b if climb > 0.0 else a] = True
    return out


def scatter(points: F64, rows: I64) -> F64:
    """What local quadrics miss the points (n, 3) of some rows (k,) by, m, 4,000 of them at most."""
    some = rows[:: max(1, math.ceil(len(rows) / MOST))]
    near = neighbours(points, np.arange(len(points)), some)
    out = fit_residuals(points, near, some)[0]
    return np.where(np.isfinite(out), out, 0.0)


def body_scatter(surface: CloudSurface, high: Bool) -> float:
    """Scatter, m, of the points at the vertices ``high`` (n,) of a body about local quadrics; NaN
    where they are too few.
    """
    source = surface.representation.tin.source[high]
    rows = source[source >= 0].astype(np.int64)
    if len(rows) < FEWEST:
        return math.nan
    return robust_sigma(scatter(surface.points, rows), 0.0)


def body_vertices(surface: CloudSurface, base: Plane, inside: Bool, object_height_m: float) -> Bool:
    """Vertices (n,) of the triangles (m,) inside an outline that rise above the base."""
    tin = surface.representation.tin
    return vertex_mask(tin, inside) & (height_above(tin.vertices, base) > object_height_m)


def growth_above_ground(surface: CloudSurface, base: Plane, high: Bool, body_m: float) -> float:
    """By how much, m, the points of the ground scatter more than those of the body, the vertices
    ``high`` (n,), which scatter by ``body_m``: 0 where they do not by as much as grass does.

    The ground is looked at by directions about the body, since plants may stand on one side only.
    """
    tin, points, body = surface.representation.tin, surface.points, body_m
    source = tin.source
    low = base.support[source[base.support] >= 0]
    if len(low) < FEWEST or math.isnan(body):
        return 0.0
    step = max(1, math.ceil(len(low) / MOST))
    centre = tin.vertices[high, :2].mean(axis=0)
    off = scatter(points, source[low[::step]].astype(np.int64))
    return growth_by_sectors(tin.vertices[low[::step], :2] - centre, off, body)


def growth_by_sectors(xy: F64, off: F64, body_m: float) -> float:
    """By how much, m, points xy (k, 2) m about a middle, off local quadrics by (k,) m, scatter more
    than a body that scatters by ``body_m``: 0 where they do not by as much as grass does.
    """
    angle = np.arctan2(xy[:, 1], xy[:, 0]) / (2.0 * math.pi)
    sector = np.floor(angle % 1.0 * SECTORS).astype(np.int64)
    own = [off[sector == k] for k in range(SECTORS)]
    sizes = [robust_sigma(some, 0.0) ** 2 - body_m**2 for some in own if len(some) >= FEWEST]
    found = math.sqrt(sum(max(0.0, s) for s in sizes) / len(sizes)) if sizes else 0.0
    return found if found > max(GRASS_M, GRASS * body_m) else 0.0


def bodies_scatter(raw: F64, points: BodyPoints, rows: I64) -> float:
    """Scatter, m, of the points of bodies, rows (k,): what the filter moved them by, or the noise
    of the cloud; NaN where neither is known.
    """
    f = points.filtered
    if f is None or f.count is not None:
        return points.noise_m or math.nan
    moved = raw[f.index[rows]] - f.r[rows]
    return robust_sigma(np.einsum("ni,ni->n", moved, f.normal[rows]), 0.0)


def growth_about_bodies(raw: F64, made: CloudBodies, points: BodyPoints) -> float:
    """As :func:`growth_above_ground`, for closed bodies: raw (n, 3) m, the points as they came,
    those of the ground beside the bodies against those of the bodies.
    """
    ground = made.ground
    if ground is None or not len(ground.support) or not made.bodies:
        return 0.0
    rows, r = np.concatenate(made.sources), points.r
    body = bodies_scatter(raw, points, rows)
    apart = BESIDE * max(float(mesh.report["spacing_m"]) for mesh in made.meshes)
    reach = LOW * float(np.ptp(r[rows, 2]))
    low = np.flatnonzero(np.abs(height_above(raw, ground)) < reach)
    ground_only = raw[low[away_from(raw[low, :2], r[rows, :2], apart)]]
    if len(ground_only) < FEWEST or math.isnan(body):
        return 0.0
    centre = r[rows, :2].mean(axis=0)
    some = np.arange(0, len(ground_only), max(1, math.ceil(len(ground_only) / MOST)))
    off = scatter(ground_only, some)
    return growth_by_sectors(ground_only[some, :2] - centre, off, body)


def away_from(xy: F64, others: F64, cell_m: float) -> Bool:
    """Which places (n, 2) m have none of the others (k, 2) m in their square cell or those beside
    it: they lie farther off than a cell is wide.
    """
    low = others.min(axis=0) - 2.0 * cell_m
    size = np.floor((others.max(axis=0) - low) / cell_m).astype(np.int64) + 3
    taken = np.zeros(size, np.bool_)
    taken[tuple(np.floor((others - low) / cell_m).astype(np.int64).T)] = True
    near = binary_dilation(taken, np.ones((3, 3), np.bool_))
    at = np.floor((xy - low) / cell_m).astype(np.int64)
    inside = ((at >= 0) & (at < size)).all(axis=1)
    out = np.ones(len(xy), np.bool_)
    out[inside] = ~near[tuple(at[inside].T)]
    return out


def doubts_about_growth(made: CloudBodies, growth_m: float) -> tuple[Doubt, ...]:
    """The ground beside closed bodies is overgrown, where it is."""
    if not growth_m:
        return ()
    base_m2 = abs(sum(float(body.by_ground[0]) for body in made.bodies))
    return tuple(growth_doubts(growth_m, growth_m * base_m2))


def growth_doubts(growth_m: float, sigma_m3: float) -> list[Doubt]:
    """The ground is overgrown: its scatter beyond the body's, m, and what that does to the volume,
    m³.
    """
    words = (
        f"the points of the ground scatter by {1e2 * growth_m:.2g} cm more than those of the body, "
        f"as grass and plants do: the base may lie above the soil, {sigma_m3:.3g} m³ of sigma; "
        "filter the ground by class (--classes 2,6), give --level or --plane, survey the empty "
        "site, or say with --set volume.ground_cover_m=[H,SIGMA] how high it is (0,0: bare)"
    )
    return [Doubt("vegetation", words, growth_m)]
