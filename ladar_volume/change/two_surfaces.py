"""Volume between two surfaces by tetrahedra to a free pole (seed 003 section 3).

The published way: both surfaces are triangulated in spherical projection, each about its scanner;
the tetrahedra of a surface and a pole add up to a volume with a constant defect, and the difference
of both is free of it. That holds only where both end at the same boundary: where one lacks the
outermost ring of points, the difference is off by the cone over the ring, and depends on the pole.

Here the boundary is common by construction: a ring of sight lines is cut into both triangulations,
what lies within it is kept, and the two rims are joined by a wall. The result is a closed body,
whose volume no pole changes.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ladar_volume.change.sight_ring import Hits, Ring, Target, cast, pull, slide, target
from ladar_volume.change.spherical_tin import (
    SphericalTin,
    build_spherical,
    stereographic,
    unit_directions,
)
from ladar_volume.mesh.tetrahedra import (
    other_poles,
    signed_tetrahedra,
    surface_area,
    tetrahedra_gradient,
    vertex_covariances,
)
from ladar_volume.mesh.topology import check_closed, orient
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.registration.transform import Transform

#: Rounds of refinement of the ring until its edges are in both triangulations, and the size at
#: which that is given up.
MAX_ROUNDS, MAX_RING = 40, 50_000
#: A point this near to an edge of the ring, in lengths of that edge, lies on it.
ON_RING = 0.05


@dataclass(frozen=True)
class TwoSurfaces:
    """What lies between two surfaces.

    removed_m3 : positive where B lies beyond A as seen from the scanner: material taken away;
    negative: material added · gradient_a, gradient_b : (na, 3), (nb, 3) m², by the points of both
    scans · vertices, triangles : the closed body, outward where removed · pole_spread_m3 : largest
    change over nine other poles · gap_m : (k,) from A to B along each line of the ring; the ring
    lies on unchanged ground where it is within the noise · area_a_m2, area_b_m2 : surfaces within
    the ring · bridged_m2 : (of A, of B) where no triangle was within the limits · ring_direction :
    (k, 3) of its lines · ring_b : (k, 3) m, where they meet B · ring_slide : (k, 3), derivative of
    each gap by where B's surface is
    """

    removed_m3: float
    gradient_a: F64
    gradient_b: F64
    vertices: F64
    triangles: I32
    pole_map: F64
    pole_spread_m3: float
    gap_m: F64
    area_a_m2: float
    area_b_m2: float
    bridged_m2: tuple[float, float]
    ring_direction: F64
    ring_b: F64
    ring_slide: F64


@dataclass(frozen=True)
class RingedSurface:
    """A surface with the ring in it: tin of ring points and points · inside : (m,) triangles within
    the ring · missing_edges : (j,) ring edges that are no edges of the triangulation
    """

    tin: Tin
    inside: Bool
    missing_edges: I64


class RingCut(NamedTuple):
    """A ring with all its lines, where they meet A and B, and both surfaces cut by it."""

    ring: Ring
    hits: tuple[Hits, Hits]
    cuts: tuple[RingedSurface, RingedSurface]


def ring_turn(points: F64, s: SphericalTin) -> float:
    """Twice the signed area of a ring of points (k, 3) in a scanner's projection: positive
    counter-clockwise.
    """
    q = stereographic(unit_directions(points, s.scanner_map)[0], s.gap_map)
    q, after = q - q[0], np.roll(q - q[0], -1, axis=0)
    return float((q[:, 0] * after[:, 1] - q[:, 1] * after[:, 0]).sum())


def near_ring(hits: Hits, s: SphericalTin) -> I64:
    """Vertices that lie on the ring as seen from the scanner, within a twentieth of the length of
    its edge there.
    """
    q = stereographic(unit_directions(hits.point, s.scanner_map)[0], s.gap_map)
    e = np.roll(q, -1, axis=0) - q
    length = np.linalg.norm(e, axis=1)
    found = cKDTree(s.projected).query_ball_point(q + 0.5 * e, 0.6 * length)
    row = np.repeat(np.arange(len(q)), [len(f) for f in found])
    vertex = np.concatenate([np.asarray(f, np.int64) for f in found])
    d = s.projected[vertex] - q[row]
    share = np.clip((d * e[row]).sum(axis=1) / np.maximum(length[row] ** 2, 1e-300), 0.0, 1.0)
    on = np.linalg.norm(d - share[:, None] * e[row], axis=1) <= ON_RING * length[row]
    return np.unique(vertex[on])


def cut_surface(
    points: F64, drop: Bool, hits: Hits, s: SphericalTin, max_angle_rad: float, max_edge_m: float
) -> RingedSurface:
    """Triangulate points (n, 3) together with the ring's points on their surface and find what lies
    within the ring.

    Points on the ring itself are left out, which ``drop`` (n,) remembers from round to round: the
    ring's own points stand for them.
    """
    k = len(hits.point)
    drop[s.tin.source[near_ring(hits, s)]] = True
    left = np.flatnonzero(~drop)
    tin = build_spherical(
        np.concatenate([hits.point, points[left]]),
        s.scanner_map,
        max_angle_rad,
        max_edge_m,
        s.gap_map,
    ).tin
    tin = dataclasses.replace(tin, source=np.concatenate([np.arange(k), left + k])[tin.source])
    check_ring_points(tin, k)
    first, second = (
        tin.triangles[:, [1, 2, 0]],
        tin.triangles[:, [2, 0, 1]],
    )  # edge opposite each corner, directed
    forward = (first < k) & (second < k) & (second == (first + 1) % k)
    backward = (first < k) & (second < k) & (first == (second + 1) % k)
    missing = np.setdiff1d(np.arange(k), first[forward])
    if len(missing):
        return RingedSurface(tin, np.zeros(len(tin.triangles), bool), missing)
    return RingedSurface(tin, within_ring(tin, forward, backward), missing)


def within_ring(tin: Tin, forward: Bool, backward: Bool) -> Bool:
    """Triangles (m,) on the side of the ring where its edges run forward; forward, backward :
    (m, 3), edges that run along and against it. Raises :class:`VolumeError` (ring_touches).
    """
    t, corner = np.nonzero((tin.neighbours >= 0) & ~forward & ~backward)
    graph = coo_matrix(
        (np.ones(len(t), np.int8), (t, tin.neighbours[t, corner])), shape=(len(tin.triangles),) * 2
    )
    label = connected_components(graph, directed=False)[1]
    within, beyond = label[forward.any(axis=1)], label[backward.any(axis=1)]
    if np.isin(within, beyond).any() or len(np.unique(within)) != 1:
        raise VolumeError("the ring crosses itself as seen from the scanner", reason="ring_touches")
    return np.asarray(label == within[0])


def check_ring_points(tin: Tin, k: int) -> None:
    """Raises :class:`VolumeError` (ring_touches) where a point of the ring of k is no vertex."""
    if len(tin.source) < k or not np.array_equal(tin.source[:k], np.arange(k)):
        raise VolumeError(
            "two lines of the ring meet in one direction of the scanner: the ring touches itself",
            reason="ring_touches",
        )


def two_surfaces(
    points_a: F64,
    points_b: F64,
    ring: Ring,
    scanner_a: F64,
    scanner_b: F64,
    *,
    max_edge_m: float = np.inf,
    pole_map: F64 | None = None,
    ring_radius_m: float = 0.0,
) -> TwoSurfaces:
    """Volume between surfaces A (before) and B (after) within a ring.

    points_a, points_b : (n, 3) m, both in the map frame (register first), reaching a margin beyond
    the ring · scanner_a, scanner_b : (3,) m · max_edge_m : limit of a triangle; wider
    ones still close the surface, and are counted in ``bridged_m2`` · pole_map : (3,) m,
    default scanner B · ring_radius_m : the ring lies on planes through the points so near to it; 0:
    on the triangles, which serves exact points.

    Raises :class:`SurfaceError` for points that cannot be triangulated and :class:`VolumeError`:
    ring_off_surface, ring_touches, ring_sides (the scanners see the ring from opposite sides),
    ring_lost (points too near the ring).
    """
    a, b = (np.asarray(p, dtype=np.float64) for p in (points_a, points_b))
    limits = (np.inf, max_edge_m)
    s_a, s_b = build_spherical(a, scanner_a, *limits), build_spherical(b, scanner_b, *limits)
    cut = cut_by_ring((a, b), (s_a, s_b), ring, limits, ring_radius_m)
    pole = np.asarray(scanner_b if pole_map is None else pole_map, dtype=np.float64)
    return body_between(cut, (s_a, s_b), (len(a), len(b)), pole)


def body_between(
    cut: RingCut, scans: tuple[SphericalTin, SphericalTin], counts: tuple[int, int], pole: F64
) -> TwoSurfaces:
    """The closed body between both cut surfaces, measured by tetrahedra to a pole; counts : points
    of A and of B.
    """
    ring, hits, cuts = cut
    vertices, triangles = join(*cuts, len(ring))
    total, spread = around_poles(vertices, triangles, pole)
    first = other_poles(vertices)[0]
    gradients = gradients_by_points((vertices, triangles), first, cut, scans, counts)
    area, bridged = areas_within(cuts)
    return TwoSurfaces(
        total,
        gradients[0],
        gradients[1],
        vertices,
        triangles,
        pole,
        spread,
        hits[1].distance - hits[0].distance,
        area[0],
        area[1],
        (bridged[0], bridged[1]),
        ring.direction,
        hits[1].point,
        slide(ring, hits[1]),
    )


def areas_within(cuts: tuple[RingedSurface, RingedSurface]) -> tuple[list[float], list[float]]:
    """Areas, m², of A and B within the ring, and of what no triangle within the limits covers."""
    area = [surface_area(c.tin.vertices, c.tin.triangles[c.inside]) for c in cuts]
    bridged = [
        surface_area(c.tin.vertices, c.tin.triangles[c.inside & ~c.tin.relevant]) for c in cuts
    ]
    return area, bridged


def around_poles(vertices: F64, triangles: I32, pole: F64) -> tuple[float, float]:
    """Volume, m³, of a closed body by tetrahedra to a pole, and its largest change over nine other
    poles. Raises :class:`SurfaceError` for a body that is not closed.
    """
    check_closed(orient(vertices, triangles))
    total = float(signed_tetrahedra(vertices, triangles, pole).sum())
    spread = max(
        abs(float(signed_tetrahedra(vertices, triangles, q).sum()) - total)
        for q in other_poles(vertices)
    )
    return total, spread


def gradients_by_points(
    body: tuple[F64, I32],
    pole_map: F64,
    cut: RingCut,
    scans: tuple[SphericalTin, SphericalTin],
    counts: tuple[int, int],
) -> list[F64]:
    """Gradients (n, 3) m² of the volume of a closed body by the points of A and of B; counts : n of
    both.
    """
    g = tetrahedra_gradient(*body, pole_map)
    na = len(cut.cuts[0].tin.vertices)
    return [
        by_points(part, each, s, cut.ring, hit, n)
        for part, each, s, hit, n in zip(
            (g[:na], g[na:]), cut.cuts, scans, cut.hits, counts, strict=True
        )
    ]


def cut_by_ring(
    points: tuple[F64, F64],
    scans: tuple[SphericalTin, SphericalTin],
    ring: Ring,
    limits: tuple[float, float],
    radius_m: float,
) -> RingCut:
    """Both surfaces cut by the ring, which runs counter-clockwise as scanner A sees it. Raises
    :class:`VolumeError`: ring_off_surface, ring_touches, ring_sides, ring_lost.
    """
    s_a, s_b = scans
    aims = target(s_a.tin), target(s_b.tin)
    hits_a, hits_b = (cast(ring, aim, name, radius_m) for aim, name in zip(aims, "AB", strict=True))
    if ring_turn(hits_a.point, s_a) < 0.0:
        ring, hits_a, hits_b = ring.reversed(), hits_a.reversed(), hits_b.reversed()
    if ring_turn(hits_b.point, s_b) < 0.0:
        raise VolumeError(
            "the scanners see the ring from opposite sides of the surface", reason="ring_sides"
        )
    return cut_both(points, scans, aims, ring, (hits_a, hits_b), limits, radius_m)


def cut_both(
    points: tuple[F64, F64],
    scans: tuple[SphericalTin, SphericalTin],
    aims: tuple[Target, Target],
    ring: Ring,
    hits: tuple[Hits, Hits],
    limits: tuple[float, float],
    radius_m: float,
) -> RingCut:
    """Cut the ring into both surfaces; where an edge of it is in one of them no edge, both get a
    line midway, until all are.

    Raises :class:`VolumeError` (ring_lost) where that does not end.
    """
    (a, b), (s_a, s_b), (hits_a, hits_b) = points, scans, hits
    drop_a, drop_b = np.zeros(len(a), bool), np.zeros(len(b), bool)
    for _ in range(MAX_ROUNDS):
        cut_a, cut_b = (
            cut_surface(a, drop_a, hits_a, s_a, *limits),
            cut_surface(b, drop_b, hits_b, s_b, *limits),
        )
        missing = np.union1d(cut_a.missing_edges, cut_b.missing_edges)
        if len(missing) == 0:
            return RingCut(ring, (hits_a, hits_b), (cut_a, cut_b))
        middles = ring.middles(missing)
        hits_a, hits_b = (
            h.insert(missing, cast(middles, aim, name, radius_m))
            for h, aim, name in zip((hits_a, hits_b), aims, "AB", strict=True)
        )
        ring = ring.insert(missing, middles)
        if len(ring) > MAX_RING:
            break
    raise lost_ring_error(missing)


def lost_ring_error(missing: I64) -> VolumeError:
    """The error of a ring of which edges (j,) cannot be cut into the surfaces."""
    return VolumeError(
        (
            f"{len(missing)} edges of the ring cannot be cut into the surfaces: returns off the "
            "surface or two surfaces one behind the other tear it; filter the scans "
            "(ladar_volume filter), give a wider --spacing, or lay the ring elsewhere (--polygon)"
        ),
        reason="ring_lost",
        value=len(missing),
    )


def join(a: RingedSurface, b: RingedSurface, k: int) -> tuple[F64, I32]:
    """The closed body between two cut surfaces: A as it is, B turned round, and the wall between
    their rims.
    """
    n = len(a.tin.vertices)
    here, after = np.arange(k), (np.arange(k) + 1) % k
    wall = np.concatenate(
        [np.stack([after, here, n + here], axis=1), np.stack([after, n + here, n + after], axis=1)]
    )
    triangles = np.concatenate(
        [a.tin.triangles[a.inside], n + b.tin.triangles[b.inside][:, [0, 2, 1]], wall]
    )
    return np.concatenate([a.tin.vertices, b.tin.vertices]), triangles.astype(np.int32)


def by_points(
    gradient: F64, cut: RingedSurface, s: SphericalTin, ring: Ring, hits: Hits, n: int
) -> F64:
    """Gradient (n, 3) by the points of a scan from that by the vertices of its cut surface, the
    ring's among them.
    """
    k = len(ring)
    out, at_vertices = np.zeros((n, 3)), np.zeros(s.tin.vertices.shape)
    own = cut.tin.source >= k
    out[cut.tin.source[own] - k] = gradient[own]
    pull(gradient[:k], ring, hits, at_vertices)
    out[s.tin.source] += at_vertices
    return out


def two_surface_budget(
    result: TwoSurfaces,
    noise_a: float | F64,
    noise_b: float | F64,
    transform_b: Transform | None = None,
    source_b: F64 | None = None,
    transform_a: Transform | None = None,
    source_a: F64 | None = None,
) -> dict[str, float]:
    """Variance of the volume by source, m⁶: ``noise_a`` and ``noise_b`` of independent points (a
    sigma, sigmas (n,), m, or covariances (n, 3, 3)), ``registration_a`` and ``registration_b`` from
    the transforms and the points as they were before them, (n, 3) m.
    """
    out = {}
    for name, g, noise in (
        ("noise_a", result.gradient_a, noise_a),
        ("noise_b", result.gradient_b, noise_b),
    ):
        out[name] = float(np.einsum("ni,nij,nj->", g, vertex_covariances(noise, len(g)), g))
    for name, g, T, source in (
        ("registration_a", result.gradient_a, transform_a, source_a),
        ("registration_b", result.gradient_b, transform_b, source_b),
    ):
        if T is not None:
            if source is None or len(source) != len(g):
                raise VolumeError(
                    "a registration's share needs the points as they were before it",
                    reason="volume_registration",
                )
            out[name] = T.variance(g, source)
    return out


def cone_volume(s: SphericalTin, pole_map: F64) -> float:
    """Published: the volume, m³, of the tetrahedra of a surface's relevant triangles and a pole; of
    no meaning by itself.
    """
    return -float(
        signed_tetrahedra(
            s.tin.vertices, s.tin.triangles[s.tin.relevant], np.asarray(pole_map, dtype=np.float64)
        ).sum()
    )


def published_difference(a: SphericalTin, b: SphericalTin, pole_map: F64) -> float:
    """Published: the volume, m³, taken away between surfaces A and B, each over its own
    boundary.
    """
    return cone_volume(b, pole_map) - cone_volume(a, pole_map)


def select_regions(
    points_a: F64, points_b: F64, polygon_xy: F64, margin_m: float
) -> tuple[Bool, Bool]:
    """Points of scan A within a polygon (c, 2) or ``margin_m`` of it, and those of scan B within
    the box of these in plan.

    The box has no bottom and no top: what was dug lies below all of A's points. Raises
    :class:`VolumeError` (region_empty).
    """
    a, b, p = (np.asarray(x, dtype=np.float64) for x in (points_a, points_b, polygon_xy))
    check_polygon(p, margin_m)
    box = ((a[:, :2] >= p.min(axis=0) - margin_m) & (a[:, :2] <= p.max(axis=0) + margin_m)).all(
        axis=1
    )
    r = a[box, :2]
    in_a = box.copy()
    in_a[box] = near_polygon(r, p, margin_m)
    if not in_a.any():
        raise VolumeError("no point of scan A lies within the region", reason="region_empty")
    low, high = a[in_a, :2].min(axis=0), a[in_a, :2].max(axis=0)
    in_b: Bool = ((b[:, :2] >= low) & (b[:, :2] <= high)).all(axis=1)
    if not in_b.any():
        raise VolumeError(
            "no point of scan B lies within the box of scan A's region", reason="region_empty"
        )
    return in_a, in_b


def near_polygon(r: F64, p: F64, margin_m: float) -> Bool:
    """Whether points (k, 2) lie within a polygon (c, 2) or within ``margin_m`` of it."""
    inside, near = np.zeros(len(r), bool), np.full(len(r), np.inf)
    for q, after in zip(p, np.roll(p, -1, axis=0), strict=True):
        d, e = r - q, after - q
        crosses = (q[1] > r[:, 1]) != (after[1] > r[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (d[:, 0] < e[0] * d[:, 1] / e[1])
        share = np.clip((d @ e) / max(float(e @ e), 1e-300), 0.0, 1.0)
        near = np.minimum(near, np.linalg.norm(d - share[:, None] * e, axis=1))
    return np.asarray(inside | (near <= margin_m))


def check_polygon(p: F64, margin_m: float) -> None:
    """Raises :class:`VolumeError` (region_polygon) for what is no polygon (c, 2) with a margin."""
    if (
        p.ndim != 2
        or p.shape[1:] != (2,)
        or len(p) < 3
        or not np.isfinite(p).all()
        or not margin_m >= 0.0
    ):
        raise VolumeError(
            "a region is a polygon of at least three finite corners x, y and a margin of 0 or more",
            reason="region_polygon",
        )
