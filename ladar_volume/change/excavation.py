"""The volume dug out between two scans, step by step as seed 003 section 3 does it, with its error
budget.

Region of scan A by a polygon and a margin, region of scan B by the box of A's, triangulation in
spherical projection about each scanner, one common boundary ring, tetrahedra to a pole. Both scans
are registered before (section 3, steps 1 and 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from ladar_volume.change.resolution import ResolutionSeries, resolution_series, thin
from ladar_volume.change.sight_ring import Ring, densify, ring_over, ring_through
from ladar_volume.change.spherical_tin import (
    build_spherical,
    short_edges,
    stereographic,
    unit_directions,
)
from ladar_volume.change.two_surfaces import (
    TwoSurfaces,
    near_polygon,
    published_difference,
    select_regions,
    two_surface_budget,
    two_surfaces,
)
from ladar_volume.mesh.tetrahedra import signed_tetrahedra, surface_area
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.registration.transform import Transform
from ladar_volume.volume.polygon import check_polygon, signed_area

#: The margin where none is given, as a share of the region's smaller side, and the spacing of the
#: ring in spacings of the points.
MARGIN_SHARE, RING_SPACINGS = 0.1, 2.0
#: Points so near to a side of the region, as a share of its size, are on it.
ON_SIDE = 1e-8
#: The ring lies on planes through the points within so many sigma: where noise folds the surface,
#: its triangles would tear the ring.
RING_SIGMAS = 8.0
#: Where the ring tears, the points within so many of its spacings serve.
TORN_SPACINGS = 1.5


@dataclass(frozen=True)
class Scan:
    """A registered scan.

    points : (n, 3) m, map frame · scanner : (3,) m, map frame · noise : of its points, a sigma,
    sigmas (n,), m, or covariances (n, 3, 3) m² in the map frame · transform : that brought it here,
    with covariance; None for none
    """

    points: F64
    scanner: F64
    noise: float | F64
    transform: Transform | None = None

    def part(self, chosen: Bool | I64) -> Scan:
        """The points of a mask (n,) or of indices (k,)."""
        noise = self.noise if np.ndim(self.noise) == 0 else np.asarray(self.noise)[chosen]
        return replace(self, points=self.points[chosen], noise=noise)

    def sigma(self) -> float:
        """A typical standard deviation of a point, m; 0 where it is not known."""
        noise = np.asarray(self.noise)
        typical = (
            float(np.median(noise))
            if noise.ndim < 3
            else float(np.sqrt(np.median(np.trace(noise, axis1=1, axis2=2))))
        )
        return typical if np.isfinite(typical) else 0.0

    def source(self) -> F64 | None:
        """The points (n, 3), m, as they were before registration."""
        return None if self.transform is None else self.transform.apply_inverse(self.points)


@dataclass(frozen=True)
class Region:
    """corners : (c, 2) m of a polygon in plan, or (c, 3) of one in space, seen from scanner A ·
    margin_m · spacing_m : of the ring
    """

    corners: F64
    margin_m: float
    spacing_m: float


@dataclass(frozen=True)
class Excavation:
    """removed_m3 : taken away from A to B · sigma_m3, budget_m6 : its noise and registration,
    NaN where unknown · closed_m3 : what depends on the ring's wall and on triangles beyond the
    limit, as their tetrahedra to the body's middle, without sign · published_m3 : each surface
    over its own boundary, about the same pole · between : the body and its derivatives · in_a,
    in_b : masks of the regions · area_m2 : of the whole body
    """

    removed_m3: float
    sigma_m3: float
    budget_m6: dict[str, float]
    closed_m3: float
    published_m3: float
    between: TwoSurfaces
    in_a: Bool
    in_b: Bool
    area_m2: float


def beam_noise(points: F64, scanner: F64, sigma_m: float | F64) -> F64:
    """Covariances (n, 3, 3) m² of points (n, 3) whose noise ``sigma_m`` lies along the beam from
    the scanner (3,).
    """
    u, _ = unit_directions(points, scanner)
    s = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(u),))
    out: F64 = (s**2)[:, None, None] * u[:, :, None] * u[:, None, :]
    return out


def hull_polygon(points: F64, inward_m: float = 0.0) -> F64:
    """Convex hull (c, 2) of points (n, 2 or more) in plan, counter-clockwise, its sides moved
    inward.

    Raises :class:`VolumeError` (region_hull) for points in one line, and where nothing is left.
    """
    plan = np.asarray(points, dtype=np.float64)[:, :2]
    middle = plan.mean(axis=0) if len(plan) else np.zeros(2)
    try:
        hull = ConvexHull(plan - middle)
        if inward_m == 0.0:
            return np.asarray(plan[hull.vertices])
        sides = hull.equations.copy()
        sides[:, 2] += inward_m
        corners = HalfspaceIntersection(sides, np.zeros(2)).intersections
    except (QhullError, ValueError, IndexError) as error:
        raise VolumeError(
            (
                f"no region {inward_m:g} m within the outline of {len(plan)} points: give a "
                "polygon or a smaller margin"
            ),
            reason="region_hull",
            value=inward_m,
        ) from error
    centre = corners.mean(axis=0)
    order = np.argsort(np.arctan2(*(corners - centre).T[::-1]))
    out: F64 = corners[order] + middle
    return out


def narrowest(xy: F64) -> float:
    """Width, m, of the narrowest strip that holds places (n, 2), or places (n, 3) as they lie on
    the plane through them; 0 for places in one line.
    """
    if len(xy) < 3:
        return 0.0
    at = xy - xy.mean(axis=0)
    if at.shape[1] == 3:
        at = at @ np.linalg.svd(at, full_matrices=False)[2][:2].T
    try:
        corner = at[ConvexHull(at).vertices]
    except QhullError:
        return 0.0
    side = np.roll(corner, -1, axis=0) - corner
    normal = np.column_stack([-side[:, 1], side[:, 0]]) / np.linalg.norm(side, axis=1)[:, None]
    return float(np.ptp(corner @ normal.T, axis=0).min())


def region_of(
    points_a: F64,
    corners: F64 | None = None,
    margin_m: float | None = None,
    spacing_m: float | None = None,
) -> Region:
    """A region with what is not given filled in: the hull of A's points in plan less the margin, a
    margin of a tenth of the region's width, a ring at twice the spacing of A's points.

    Raises :class:`VolumeError` for corners that make no polygon.
    """
    a = np.asarray(points_a, dtype=np.float64)
    outline = np.asarray(a[:, :2] if corners is None else corners, dtype=np.float64)
    if corners is not None and (
        outline.ndim != 2
        or len(outline) < 3
        or outline.shape[1] not in (2, 3)
        or not np.isfinite(outline).all()
    ):
        raise VolumeError(
            "a region is a polygon of at least three finite corners, x, y or x, y, z",
            reason="region_polygon",
        )
    margin = MARGIN_SHARE * narrowest(outline) if margin_m is None else float(margin_m)
    if not 0.0 <= margin < np.inf:
        raise VolumeError(
            f"a margin of {margin:g} m; it must be 0 or more", reason="region_margin", value=margin
        )
    if corners is None:
        outline = hull_polygon(a, margin)
        # the points on the sides that the outline came from are within it, wherever the cloud lies
        wide = float(np.ptp(a[:, :2], axis=0).max())
        margin += ON_SIDE * wide + 4.0 * float(np.spacing(np.abs(a).max()))
    if outline.shape[1] == 2:
        outline = check_polygon(outline)
    if spacing_m is None:
        spacing_m = RING_SPACINGS * spacing_within(a, outline)
    return Region(outline, margin, float(spacing_m))


def spacing_within(points: F64, corners: F64) -> float:
    """Spacing, m, of points (n, 3) within a polygon in plan (c, 2), or within the box of one in
    space (c, 3).
    """
    if corners.shape[1] == 2:
        area = abs(signed_area(corners - corners[0]))
        near = near_polygon(points[:, :2], corners, 0.0)
    else:
        area = float(np.sort(np.ptp(corners, axis=0))[-2:].prod())
        near = ((points >= corners.min(axis=0)) & (points <= corners.max(axis=0))).all(axis=1)
    return float(np.sqrt(area / max(int(near.sum()), 16)))


def select(a: Scan, b: Scan, region: Region, margin_m: float | None = None) -> tuple[Bool, Bool]:
    """Masks of both scans: A within the polygon and its margin, B within the box of these; of a
    polygon in space, as seen from scanner A.

    Raises :class:`VolumeError` (region_polygon, region_empty).
    """
    margin = region.margin_m if margin_m is None else margin_m
    if region.corners.shape[1] == 2:
        return select_regions(a.points, b.points, region.corners, margin)
    outline = densify(
        region.corners, region.spacing_m
    )  # straight lines in space are arcs in the projection
    direction, distance = unit_directions(outline, a.scanner)
    axis = direction.mean(axis=0)
    gap = -axis / np.linalg.norm(axis)
    one, two, corners = (
        stereographic(d, gap)
        for d in (*(unit_directions(s.points, a.scanner)[0] for s in (a, b)), direction)
    )
    # near its middle the projection halves angles
    return select_regions(one, two, corners, 0.5 * margin / float(np.median(distance)))


def ring_of(region: Region, a: Scan, b: Scan) -> Ring:
    """Straight down over a polygon in plan; along sight lines of scanner A through one in space."""
    if region.corners.shape[1] == 3:
        return ring_through(region.corners, a.scanner, region.spacing_m)
    top = max(float(a.points[:, 2].max()), float(b.points[:, 2].max()))
    return ring_over(region.corners, top + max(region.spacing_m, 1.0), region.spacing_m)


def excavate(
    a: Scan, b: Scan, region: Region, *, pole_map: F64 | None = None, max_edge_m: float = np.inf
) -> Excavation:
    """The volume between scans A and B within a region; ``pole_map`` (3,) m, default scanner B,
    changes nothing but the published value.

    Raises :class:`VolumeError` and :class:`SurfaceError` as :func:`two_surfaces` and :func:`select`
    do.
    """
    in_a, in_b = select(a, b, region)
    one, two = a.part(in_a), b.part(in_b)
    pole = b.scanner if pole_map is None else np.asarray(pole_map, dtype=np.float64)
    if pole.shape != (3,) or not np.isfinite(pole).all():
        raise VolumeError("a pole is three finite numbers", reason="volume_pole", value=pole_map)
    between = between_scans(one, two, region, pole, max_edge_m)
    budget = two_surface_budget(
        between,
        one.noise,
        two.noise,
        two.transform,
        two.source(),
        transform_a=one.transform,
        source_a=one.source(),
    )
    whole_a, whole_b = (
        build_spherical(s.points, s.scanner, max_edge_m=max_edge_m) for s in (one, two)
    )
    published = published_difference(whole_a, whole_b, pole)
    return Excavation(
        between.removed_m3,
        float(np.sqrt(sum(budget.values()))),
        budget,
        closed_volume_share(between, max_edge_m),
        published,
        between,
        in_a,
        in_b,
        surface_area(between.vertices, between.triangles),
    )


def between_scans(
    one: Scan, two: Scan, region: Region, pole: F64, max_edge_m: float = np.inf
) -> TwoSurfaces:
    """What lies between the points of two scans, all within their regions. Where single points
    tear the ring it is laid on planes through more of the points around.
    """
    radius, ring = RING_SIGMAS * max(one.sigma(), two.sigma()), ring_of(region, one, two)
    for wider in (radius, max(2.0 * radius, TORN_SPACINGS * region.spacing_m)):
        try:
            return two_surfaces(
                one.points,
                two.points,
                ring,
                one.scanner,
                two.scanner,
                max_edge_m=max_edge_m,
                pole_map=pole,
                ring_radius_m=wider,
            )
        except VolumeError as error:
            if error.reason not in ("ring_lost", "ring_touches"):
                raise
            torn = error
    raise torn


def closed_volume_share(d: TwoSurfaces, max_edge_m: float = np.inf) -> float:
    """What depends on triangles that no scan saw: the ring's wall and those with too long an edge,
    m³, see :class:`Excavation`.
    """
    closing = ~short_edges(d.vertices, d.triangles, max_edge_m, angle=False)
    closing[-2 * len(d.gap_m) :] = True  # the wall comes last
    middle = 0.5 * (d.vertices.min(axis=0) + d.vertices.max(axis=0))
    return float(np.abs(signed_tetrahedra(d.vertices, d.triangles[closing], middle)).sum())


def by_resolution(
    a: Scan, b: Scan, region: Region, cells_m: list[float], max_edge_m: float = np.inf
) -> ResolutionSeries:
    """Volume and surface of B over a series of thinned scans, finest first (seed 003 section 4)."""
    in_a, in_b = select(a, b, region)
    one, two = a.part(in_a), b.part(in_b)
    cells, radius = iter(sorted(cells_m)), RING_SIGMAS * max(one.sigma(), two.sigma())

    def evaluate(points: F64) -> tuple[float, float]:
        cell = next(cells)
        before = one.points[thin(one.points, cell)]
        coarse = replace(region, spacing_m=max(region.spacing_m, cell))
        d = two_surfaces(
            before,
            points,
            ring_of(coarse, one, two),
            one.scanner,
            two.scanner,
            max_edge_m=max_edge_m,
            ring_radius_m=radius,
        )
        return d.removed_m3, d.area_b_m2

    return resolution_series(two.points, cells_m, evaluate)
