"""Places inside the outline where nothing was seen: found by the length of the triangles that span
them, bridged, and their volume told with its variance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import base_height
from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.math.kernels import kernel
from ladar_volume.model.parameters import VolumeParameters
from ladar_volume.model.records import F64, I32, I64, Bool, Gap, Plane, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import any_corner, footprint_areas, vertex_mask
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.relevant import longest_sides
from ladar_volume.uncertainty.ground_field import HALVINGS
from ladar_volume.volume.field_checks.gap_kriging import (
    ObservedPoints,
)
from ladar_volume.volume.field_checks.unseen_surface import (
    APART,
    CELLS,
    UnseenVolume,
    unseen_surface,
)
from ladar_volume.volume.more_data import longest_edges
from ladar_volume.volume.outline import components
from ladar_volume.volume.polygon import areas_inside

#: Triangles with an edge so many times the usual one span a gap, and parts of them with the area of
#: a square of so many usual edges are one.
GAP, LEAST = 4.0, 3.0
#: Longest edge of a triangle from a body across an open gap, over the square root of its area.
ACROSS = 0.5
#: Gaps whose surface is looked at, the largest first; the others count with the mean variance of
#: these per area squared.
MOST = 6
#: Standard deviation of what was not seen above which there is doubt, over that of all else and
#: over the volume, where it is no less than so much of all else; share of the area that was not
#: seen above which there is.
UNSEEN, UNSEEN_OF_VOLUME, UNSEEN_PART, UNSEEN_AREA = 1.0, 0.005, 0.3, 0.1


@dataclass(frozen=True)
class Gaps:
    """triangle : (m,) number of the gap each triangle spans, -1 for none · areas : (k,) m², the
    largest gap first · usual_m : usual length of an edge
    """

    triangle: I32
    areas: F64
    usual_m: float

    @property
    def area_m2(self) -> float:
        """Of all gaps."""
        return float(self.areas.sum())


@dataclass(frozen=True)
class BridgedVolume:
    """What gaps do to a volume. more_m3 : what the surface over them has beyond the triangles that
    span them · variance_m6 : of the whole · gaps : the largest first · unknown_m2 : of gaps of
    whose surface nothing can be told
    """

    more_m3: float
    variance_m6: float
    gaps: tuple[Gap, ...]
    unknown_m2: float


def bridging_triangles(
    tin: Tin, base: Plane, inside_m2: F64, polygon: F64 | None, p: VolumeParameters
) -> Bool:
    """Triangles (m,) that do not count for their long edges, but span a gap inside the outline.

    In a polygon these are all that lie in it; without an outline those that are enclosed. Around
    bodies they touch the outline (inside_m2 (m,)
    > 0), and lie in its convex hull or have a corner on a body; where nothing that was seen
    encloses the gap, such a corner counts if the triangle is short against the body.
    """
    out = np.zeros(len(tin.triangles), np.bool_)
    left: Bool = ~tin.relevant
    if not left.any():
        return out
    if polygon is not None:
        whole = dataclasses.replace(tin, relevant=np.ones(len(left), np.bool_))
        return left & (areas_inside(whole, polygon) > 0.0)
    part = components(tin, left)
    inside: Bool = inside_m2 > 0.0
    beside = any_corner(tin.neighbours, np.append(inside, False))  # -1 is none of them
    count = int(part.max()) + 1
    touches = np.bincount(part[left], beside[left], count) > 0
    outer = np.bincount(part[left], (tin.neighbours[left] < 0).any(axis=1), count) > 0
    rows = np.flatnonzero(left)
    if p.outline == "all":
        out[rows] = ~outer[part[rows]]
        return out
    rows = rows[touches[part[rows]]]
    if not len(rows):
        return out
    height = height_above(tin.vertices, base)
    body = vertex_mask(tin, inside) & (height > p.object_height_m)
    near = within_hull(tin.vertices[vertex_mask(tin, inside), :2], tin, rows)
    short = longest_edges(tin, rows) <= ACROSS * float(np.sqrt(inside_m2.sum()))
    near |= any_corner(tin.triangles[rows], body) & (short | ~outer[part[rows]])
    out[rows[near]] = True
    return out


def within_hull(xy: F64, tin: Tin, rows: I64) -> Bool:
    """Which of triangles ``rows`` (k,) have their centroid in the convex hull of xy (n, 2)."""
    try:
        sides = ConvexHull(xy).equations
    except QhullError:
        return np.zeros(len(rows), np.bool_)
    middle = tin.vertices[tin.triangles[rows], :2].mean(axis=1)
    out: Bool = (middle @ sides[:, :2].T + sides[:, 2] <= 1e-9).all(axis=1)
    return out


def find_gaps(tin: Tin, inside_m2: F64, spacing_m: F64 | None = None) -> Gaps:
    """The gaps of the triangles that count, with their area inside_m2 (m,) m². spacing_m : (n,) of
    the vertices, where points lie closer in one place than in another; what is usual is the median
    edge, or the spacing at two corners of a triangle: a lone point in a gap tells of none.
    """
    inside = inside_m2 > 0.0
    longest = longest_sides(tin.vertices, tin.triangles, np.flatnonzero(inside))
    usual = float(np.median(longest)) if len(longest) else 0.0
    near = None if spacing_m is None else spacing_m[tin.triangles[inside]]
    over, here = spanning(longest, usual, near)
    wide = inside.copy()
    wide[inside] = over
    number = np.full(len(inside), -1, np.int32)
    if not wide.any():
        return Gaps(number, np.zeros(0), usual)
    part = components(tin, wide)
    area: F64 = np.bincount(part[wide], inside_m2[wide]).astype(np.float64)
    square: F64 = np.bincount(part[wide], here[over] ** 2).astype(np.float64)
    order = gaps_among(area, np.bincount(part[wide]), square)
    rank = np.full(len(area), -1, np.int64)
    rank[order] = np.arange(len(order))
    number[wide] = rank[part[wide]]
    return Gaps(number, area[order], usual)


def spanning(longest: F64, usual_m: float, spacing_m: F64 | None) -> tuple[Bool, F64]:
    """Which triangles with longest edges (m,) m are wider than gaps are, and what is usual there
    (m,) m. spacing_m : (m, 3) at their corners, None for the same everywhere
    """
    here = np.full(len(longest), usual_m)
    if spacing_m is not None:
        near = np.where(np.isfinite(spacing_m), spacing_m, 0.0)
        here = np.maximum(usual_m, np.median(near, axis=1))
    return np.asarray(longest > GAP * here), here


def gaps_among(area: F64, count: I64, square: F64) -> I64:
    """Which parts are gaps, the largest first: areas (k,) m² of parts of so many (k,) triangles
    each, and sums (k,) m² of the squares of what is usual at these.
    """
    order = np.argsort(-area, kind="stable")
    return order[area[order] > LEAST**2 * (square / count)[order]]


@kernel
def halves(corners: F64, side: float, out: F64) -> int:
    """Triangles (k, 3, 3), each halved across its longest edge in plan until none is longer than
    ``side``: x, y, z of the middle and the area of each part into ``out`` (n, 4); how many, which
    may be more than n.
    """
    stack, count = np.empty((HALVINGS, 10)), 0
    for t in range(len(corners)):
        stack[0, :9] = corners[t].copy().reshape(9)
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        stack[0, 9] = 0.5 * abs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        left = 1
        while left > 0:
            left -= 1
            p, w = stack[left, :9].copy().reshape(3, 3), stack[left, 9]
            best, at = 0.0, 0
            for k in range(3):
                d = (p[k, 0] - p[(k + 1) % 3, 0]) ** 2 + (p[k, 1] - p[(k + 1) % 3, 1]) ** 2
                if d > best:
                    best, at = d, k
            if best <= side * side or left + 2 >= HALVINGS:
                if count < len(out):
                    for c3 in range(3):
                        out[count, c3] = (p[0, c3] + p[1, c3] + p[2, c3]) / 3.0
                    out[count, 3] = w
                count += 1
                continue
            i, j, k = at, (at + 1) % 3, (at + 2) % 3
            for c3 in range(3):
                m = 0.5 * (p[i, c3] + p[j, c3])
                stack[left, c3], stack[left, 3 + c3], stack[left, 6 + c3] = p[i, c3], m, p[k, c3]
                stack[left + 1, c3], stack[left + 1, 3 + c3] = m, p[j, c3]
                stack[left + 1, 6 + c3] = p[k, c3]
            stack[left, 9] = stack[left + 1, 9] = 0.5 * w
            left += 2
    return count


def places_of(corners: F64, share: F64) -> tuple[F64, F64, F64]:
    """Places (k, 2) m all over triangles with corners (t, 3, 3), about :data:`CELLS` of them, their
    areas (k,) m², of which a ``share`` (t,) counts, and the mean heights (k,) m of the triangles
    there.
    """
    (ux, uy, _), (vx, vy, _) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = 0.5 * np.abs(ux * vy - uy * vx)
    # a sliver makes up to four parts for each side of its length, whatever its area
    edges = (np.roll(corners, 1, axis=1) - corners)[:, :, :2]
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    length = float(longest[share > 0.0].sum())
    side = max(float(np.sqrt((area * share).sum() / CELLS)), length / (64 * CELLS))
    some = np.empty((256 * CELLS + 4 * len(corners), 4))
    parts = []
    for t in np.flatnonzero(share > 0.0):
        count = halves(np.ascontiguousarray(corners[t : t + 1]), side, some)
        own = some[: min(count, len(some))].copy()
        own[:, 3] *= share[t]
        parts.append(own)
    made = np.concatenate(parts)
    square = np.floor((made[:, :2] - made[:, :2].min(axis=0)) / side).astype(np.int64)
    _, at = distinct_cells(square)
    weight: F64 = np.bincount(at, made[:, 3]).astype(np.float64)
    x, y, z = (np.bincount(at, made[:, 3] * made[:, k]) / weight for k in range(3))
    return np.column_stack([x, y]), weight, z


def in_own_order(corners: F64, share: F64) -> tuple[F64, F64]:
    """Triangles (t, 3, 3), each from its first corner by x, then y, in the order of these, and
    their shares (t,): the same whatever the triangles' numbers.
    """
    first = np.lexsort((corners[:, :, 1], corners[:, :, 0]), axis=1)[:, 0]
    turn = (first[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[:, :, None], axis=1)
    order = np.lexsort((*corners[:, 1, 1::-1].T, *corners[:, 0, 1::-1].T))
    return corners[order], share[order]


def gap_over(
    corners: F64, share: F64, seen: ObservedPoints | None
) -> tuple[Gap, UnseenVolume | None]:
    """The gap that triangles with corners (t, 3, 3) m span, heights above the base, of which a
    share (t,) counts, and its surface; None where nothing can be told of it, as where nothing is
    known of what was seen.
    """
    return gap_at(corners, gap_places(corners, share), seen)


def gap_places(corners: F64, share: F64) -> tuple[F64, F64, F64]:
    """Places all over a gap, as :func:`places_of` gives them, whatever the triangles' numbers."""
    corners, share = in_own_order(corners, share)
    return places_of(corners, np.clip(share, 0.0, 1.0))


def gap_at(
    corners: F64, places: tuple[F64, F64, F64], seen: ObservedPoints | None
) -> tuple[Gap, UnseenVolume | None]:
    """The same from its :func:`gap_places`."""
    (xy, weight, height), found = places, None
    if seen is not None:
        apart = APART * np.asarray(seen.tree.query(xy)[0])
        found = unseen_surface(seen, xy, weight, apart, height)
    x, y = ((weight @ xy) / weight.sum()).tolist()
    size = np.ptp(corners[:, :, :2].reshape(-1, 2), axis=0)
    more = 0.0 if found is None else found.volume_m3 - float(weight @ height)
    sigma = float("nan") if found is None else found.variance_m6**0.5
    return Gap(x, y, float(weight.sum()), float(size.max()), sigma, more), found


def corners_above(tin: Tin, base: Plane, rows: I64) -> F64:
    """Corners (t, 3, 3) m of triangles ``rows`` (t,), their heights above the base."""
    corners = tin.vertices[tin.triangles[rows]]
    corners[:, :, 2] -= base_height(base, corners[:, :, :2].reshape(-1, 2)).reshape(-1, 3)
    return corners


def views_above(base: Plane, xy: F64, view: F64) -> F64:
    """Views (n, 3) from xy (n, 2) m as they rise above the base, which may rise itself."""
    out = view.copy()
    out[:, 2] -= base_height(base, xy + view[:, :2]) - base_height(base, xy)
    return out


def seen_above(tin: Tin, base: Plane, variance: F64, view: F64 | None = None) -> ObservedPoints:
    """What was seen of the surface, above the base, its spacing not told. variance : (n,) m² of the
    vertex heights · view : (n, 3) mean unit vectors to where the vertices were seen from, if that
    is known.
    """
    used = vertex_mask(tin, tin.relevant)
    r = tin.vertices[used].copy()
    r[:, 2] -= base_height(base, r[:, :2])
    looked = None if view is None else views_above(base, r[:, :2], view[used])
    return ObservedPoints.of(r, variance[used], math.nan, looked)


def bridged_volume(
    tin: Tin, base: Plane, inside_m2: F64, gaps: Gaps, seen_points: Callable[[], ObservedPoints]
) -> BridgedVolume:
    """What the gaps do to the volume above the base. seen_points : gives what :func:`seen_above`
    does, asked where there are gaps
    """
    if not len(gaps.areas):
        return BridgedVolume(0.0, 0.0, (), 0.0)
    seen = dataclasses.replace(seen_points(), spacing_m=gaps.usual_m)
    made = []
    for number in range(min(MOST, len(gaps.areas))):
        rows = np.flatnonzero(gaps.triangle == number)
        whole = footprint_areas(tin.vertices, tin.triangles[rows])
        share = inside_m2[rows] / np.maximum(whole, 1e-300)
        made.append(gap_over(corners_above(tin, base, rows), share, seen))
    return bridged_together(made, gaps.areas)


def bridged_together(made: list[tuple[Gap, UnseenVolume | None]], areas: F64) -> BridgedVolume:
    """What gaps do together: the largest of all, whose areas are (k,) m², with their surfaces."""
    more = total = unknown = 0.0
    for gap, found in made:
        if found is None:
            unknown += gap.area_m2
            continue
        more, total = more + gap.more_m3, total + found.variance_m6
    # the variance of |h|³ in a gap of diameter d goes with d³ times its area²
    size = areas**3.5
    total *= float(size.sum() / size[:MOST].sum())
    return BridgedVolume(more, total, tuple(gap for gap, _ in made), unknown)


def hidden_m6(tin: Tin, base: Plane, part: F64, gaps: Gaps, hidden: F64) -> float:
    """Variance, m⁶, of what points at ``hidden`` (h, 2) m hid, in strips too narrow to be gaps:
    the surface lies anywhere between the lowest and the highest corner of a triangle that spans
    them, all along a strip alike. part : (m,) m² of each triangle that counts
    """
    if not len(hidden):
        return 0.0
    at = locate(triangle_index(tin, part > 0.0), hidden)
    under = np.zeros(len(part), np.bool_)
    under[at[at >= 0]] = True
    under &= gaps.triangle < 0
    if not under.any():
        return 0.0
    room = part * np.ptp(height_above(tin.vertices, base)[tin.triangles], axis=1)
    by_strip = np.bincount(components(tin, under)[under], room[under])
    return float(by_strip @ by_strip) / 12.0


def gap_doubts(
    found: BridgedVolume, gap_m2: float, area_m2: float, volume_m3: float, sigma_m3: float
) -> list[Doubt]:
    """Too much was not seen: gap_m2 of area_m2. sigma_m3 : of the volume without it."""
    sigma, share = math.sqrt(found.variance_m6), gap_m2 / max(area_m2, 1e-300)
    # a volume next to nothing, as between two surveys of unchanged ground, is no measure
    least = max(UNSEEN_OF_VOLUME * abs(volume_m3), UNSEEN_PART * sigma_m3)
    large = sigma > min(UNSEEN * sigma_m3, least)
    if not (large or share > UNSEEN_AREA or found.unknown_m2 > 0.0):
        return []
    gap = found.gaps[0]
    words = (
        f"{gap_m2:.3g} m² ({100 * share:.1f} %) inside the outline were not seen and are bridged, "
        f"{sigma:.2g} m³ of sigma; the largest gap, {gap.area_m2:.3g} m², is at ({gap.x_m:.1f}, "
        f"{gap.y_m:.1f}) m: survey that place"
    )
    return [Doubt("unseen", words, share)]
