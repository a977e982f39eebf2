"""Which part of a triangulation was sampled: the convex hull of the points is not taken for the
boundary of what was measured.

How far apart points may lie is told from the points themselves, place by place: the smallest cell
at which a raster of the footprints is filled, so that a block of three by three cells has points in
each (a morphological opening), there and at the doubled cell. Along one scan line no such block
fits: the spacing is that *across* lines, however dense they are and however it grows with range.
From the hull inwards triangles are then taken off whose open side is long against that spacing, as
in the characteristic shapes of Duckham et al. 2008, where what goes behind that side is deep;
holes that the sampled area encloses stay in it, and are counted.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.kernels import in_threads, kernel, leaf_kernel, run_in_ranges
from ladar_volume.math.own_axes import along_own_axes, extent_of, raster_between
from ladar_volume.math.union_find import root_of
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.tin.boundary import part_numbers
from ladar_volume.tin.full_tin import build_tin, footprint_areas, vertex_mask
from ladar_volume.tin.locate import locate, triangle_index
from ladar_volume.tin.relevant import circumdiameter_of, side_length

#: Fewest footprints that show a spacing.
FEWEST = 100
#: Cells grow by this factor; the raster is filled at a cell where it is two steps on as well.
STEP, PERSISTS = math.sqrt(2.0), 2
#: Places at which the least spacing is told, about.
SAMPLED = 20_000
#: Most cells of a raster, and the largest cell in shares of the extent.
MOST_CELLS, LARGEST = 4_000_000, 0.25
#: An open side is long above this many spacings; what lies behind it is deep above as many in the
#: mean.
LONG, DEEP = 2.5, 1.0
#: Points in none of its triangles stand alone beyond so many spacings from it; passes of leaving
#: them out.
ALONE, PASSES = 2.5, 3
#: Circumcircles in an enclosed hole are wider than so many spacings of every corner (diameter), and
#: than so many of one where the surface is bridged: evenly scattered points make none such.
HOLE, BRIDGE = 2.5, 3.5


@dataclass(frozen=True)
class SampledArea:
    """mask : (m,) triangles that count · area_m2, hull_m2 : of these, and of all · spacing_m : that
    of the points, by the median; NaN where they do not show it, and the hull stands in · holes,
    hole_m2 : enclosed holes that are bridged, and their area · parts : that the sampled area has ·
    bridged : (m,) triangles that count and are wide for the spacing at one of their corners, in
    such holes or not · spacings_m : (n,) at each vertex · beyond : points that stand alone outside
    it, and are left out
    """

    mask: Bool
    area_m2: float
    hull_m2: float
    spacing_m: float
    holes: int
    hole_m2: float
    parts: int
    bridged: Bool
    spacings_m: F64
    beyond: int = 0


@leaf_kernel
def cell_in(xy: F64, i: int, low: F64, size: float, width: int) -> Any:
    """The cell of place i of (n, 2) in a raster so wide of square cells, with two empty ones before
    the first, row by row.
    """
    x, y = np.floor((xy[i, 0] - low[0]) / size), np.floor((xy[i, 1] - low[1]) / size)
    return (np.int64(x) + 2) * width + np.int64(y) + 2


class Corners(NamedTuple):
    """Vertices (n, 3) m and triangles (m, 3)."""

    vertices: F64
    triangles: I32


@kernel
def fill_cells(xy: F64, low: F64, size: float, raster: Bool) -> None:
    """Fill the cells of a raster (a, b) that places (n, 2) lie in."""
    width, flat = raster.shape[1], raster.reshape(-1)
    for i in range(len(xy)):
        flat[cell_in(xy, i, low, size, width)] = True


@kernel
def look_up(xy: F64, rows: I64, low: F64, size: float, raster: Bool, out: Bool) -> None:
    """Write what a raster (a, b) says where some (k,) of places (n, 2) lie, all for none."""
    width, flat = raster.shape[1], raster.reshape(-1)
    for i in range(len(out)):
        at = rows[i] if len(rows) else i
        out[i] = flat[cell_in(xy, at, low, size, width)]


def beside_full_blocks(raster: Bool) -> Bool:
    """Cells (a, b) in or beside a block of three by three filled ones."""
    middle = np.zeros_like(raster)
    rows = raster[:-2] & raster[1:-1] & raster[2:]
    middle[1:-1, 1:-1] = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
    tall = middle.copy()
    for k in (1, 2):
        tall[k:] |= middle[:-k]
        tall[:-k] |= middle[k:]
    out = tall.copy()
    for k in (1, 2):
        out[:, k:] |= tall[:, :-k]
        out[:, :-k] |= tall[:, k:]
    return out


def in_filled_cells(xy: F64, extent: tuple[F64, F64], size: float, rows: I64, out: Bool) -> None:
    """Write whether each of places (n, 2) m, between coordinates (2,), or of some rows (k,) of
    them, lies in, or beside, a block of three by three cells of a raster that all hold one of them;
    cells of ``size``.
    """
    low, count = raster_between(extent, size)
    raster = np.zeros(count + 4, bool)
    fill_cells(xy, low, size, raster)
    look_up(xy, rows, low, size, beside_full_blocks(raster), out)


def cell_sizes(some: F64, count: int, extent: tuple[F64, F64]) -> list[float]:
    """Cells, m, at which the raster of so many places is looked at, the least first. some : (k, 2)
    m, those at which the least spacing is told · extent : least and greatest coordinates (2,) m
    """
    wide = np.maximum(extent[1] - extent[0], 1e-300)
    some = np.unique(some, axis=0)
    near = np.asarray(cKDTree(some).query(some, 2)[0])[:, 1] if len(some) > 2 else wide
    least = float(np.median(near)) * math.sqrt(len(some) / count)
    cell = max(least, math.sqrt(float(wide.prod()) / MOST_CELLS), float(wide.max()) * 1e-4)
    sizes = [cell]
    while sizes[-1] * STEP <= LARGEST * float(wide.max()):
        sizes.append(sizes[-1] * STEP)
    return sizes


def spacings(xy: F64, rows: I64 | None = None) -> F64:
    """How far apart points (n, 2) m lie around each, or around some rows (k,) of them, across scan
    lines as along them, m: infinite where nothing around them is filled, and for fewer than
    :data:`FEWEST`. The raster lies along the points' own axes.
    """
    if len(xy) < FEWEST:
        return np.full(len(xy) if rows is None else len(rows), np.inf)
    xy = along_own_axes(xy)
    extent = extent_of(xy)
    sizes = cell_sizes(xy[:: max(1, len(xy) // SAMPLED)], len(xy), extent)
    some = np.zeros(0, np.int64) if rows is None else rows
    filled = np.empty((len(sizes), len(xy) if rows is None else len(rows)), np.bool_)
    in_threads(lambda k: in_filled_cells(xy, extent, sizes[k], some, filled[k]), range(len(sizes)))
    return lasting_sizes(filled, sizes)


def lasting_sizes(filled: Bool, sizes: Sequence[float]) -> F64:
    """The least of the sizes (s,) at which the cells about each of n places are filled (s, n), and
    still are two steps on; where none lasts, the least.
    """
    out = np.empty(filled.shape[1])
    run_in_ranges(lasting_kernel, len(out), filled, np.array(sizes), out)
    return out


@kernel
def lasting_kernel(first: int, end: int, filled: Bool, sizes: F64, out: F64) -> None:
    """See :func:`lasting_sizes`; filled : (s, n), some of the places."""
    for i in range(first, end):
        # a long and narrow strip has no block of three cells at its width
        out[i], last = np.inf, len(sizes) - 1
        for k in range(last, -1, -1):
            if filled[k, i]:
                out[i] = sizes[k]
        for k in range(last - PERSISTS + 1):
            if filled[k, i] and filled[k + PERSISTS, i]:
                out[i] = sizes[k]
                break


@leaf_kernel
def least_at(values: F64, triangles: I32, t: int) -> float:
    """The least of values (n,) at the corners of triangle t."""
    out: float = min(values[triangles[t, 0]], min(values[triangles[t, 1]], values[triangles[t, 2]]))
    return out


@leaf_kernel
def greatest_at(values: F64, triangles: I32, t: int) -> float:
    """The greatest of values (n,) at the corners of triangle t."""
    out: float = max(values[triangles[t, 0]], max(values[triangles[t, 1]], values[triangles[t, 2]]))
    return out


@kernel
def wide_kernel(
    first: int, end: int, tin: Corners, mask: Bool, spacing: F64, bridged: Bool, gap: Bool
) -> None:
    """Write which triangles of the mask (m,) have a circumcircle that is wide for the spacing (n,)
    m at one of their corners, ``bridged``, and at all, ``gap``; of some.
    """
    for t in range(first, end):
        bridged[t] = gap[t] = False
        if mask[t]:
            wide = circumdiameter_of(tin.vertices, tin.triangles, t)
            bridged[t] = wide > BRIDGE * least_at(spacing, tin.triangles, t)
            gap[t] = wide > HOLE * greatest_at(spacing, tin.triangles, t)


class Joined(NamedTuple):
    """root : (m,) of what each triangle is joined to through sides that are long against the
    spacing of both · open_m : (m,) m, length of its sides on the hull that are long against its
    own · single : (m,) whether it has a side, long against its own, across which no triangle is
    """

    root: I32
    open_m: F64
    single: Bool


@kernel
def link_kernel(corners: Corners, neighbours: I32, spacing: F64, own: Bool) -> Joined:
    """Join triangles for a spacing (n,) m. own : (n,) vertices; the lengths are of those sides on
    the hull whose first end by x, then y is one of them.
    """
    m = len(neighbours)
    out = Joined(np.arange(m).astype(np.int32), np.zeros(m), np.zeros(m, np.bool_))
    for t in range(m):
        least = LONG * least_at(spacing, corners.triangles, t)
        for k in range(3):
            o = neighbours[t, k]
            if o >= t:
                continue
            length = side_length(corners.vertices, corners.triangles, t, k)
            if not length > least:
                continue
            if o < 0:
                out.single[t] = True
                a = corners.triangles[t, (k + 1) % 3]
                b = corners.triangles[t, (k + 2) % 3]
                if o == -1 and own[first_of(corners.vertices, a, b)]:
                    out.open_m[t] += length
            elif length > LONG * least_at(spacing, corners.triangles, o):
                join(out.root, t, o)
    return out


@leaf_kernel
def first_of(vertices: F64, a: int, b: int) -> int:
    """Of two vertices the first by x, then y."""
    x, u = vertices[a, 0], vertices[b, 0]
    return a if x < u or (x == u and vertices[a, 1] < vertices[b, 1]) else b


@leaf_kernel
def join(root: I32, t: int, o: int) -> None:
    """Give two triangles one root, the lower of theirs."""
    a, b = root_of(root, t), root_of(root, o)
    if a < b:
        root[b] = a
    else:
        root[a] = b


@kernel
def number_kernel(joined: Joined) -> I32:
    """Number (m,) of the part each triangle belongs to, of those that are joined to another one or
    have an open side, by their first triangle; -1 for others.
    """
    root, m = joined.root, len(joined.root)
    size, out, count = np.zeros(m, np.int32), np.full(m, -1, np.int32), 0
    for t in range(m):
        root[t] = root_of(root, t)
        size[root[t]] += 1
    for t in range(m):
        r = root[t]
        if size[r] == 1 and not joined.single[t]:
            continue
        if r == t:
            out[t] = count
            count += 1
        else:
            out[t] = out[r]
    return out


class OpenParts(NamedTuple):
    """Triangles that are joined through sides that are long against the spacing. number : (m,) of
    the part of each, -1 for those that are joined to none · sums : (k, 3) of each part: area, m²,
    that times the spacing, m³, and length of the long sides on the hull, m
    """

    number: I32
    sums: F64


def deep_parts(sums: F64) -> Bool:
    """Which of parts with sums (k, 3), as :class:`OpenParts` has them, are open to the hull and in
    the mean deeper than the spacing.
    """
    area, by_spacing, length = sums.T
    return np.asarray((length > 0.0) & (area * area > DEEP * by_spacing * length))


def open_parts(tin: Tin, spacing_m: F64, area: F64, own: Bool | None = None) -> OpenParts:
    """The parts of a full TIN that may be open notches and gaps. spacing_m : (n,) of the vertices ·
    area : (m,) m², 0 for triangles that do not count · own : (n,) vertices at whose sides the hull
    counts, all by default
    """
    # between points that show no spacing nothing stands in the way
    at = np.where(np.isfinite(spacing_m), spacing_m, 0.0)
    own = np.ones(len(at), np.bool_) if own is None else own
    joined = link_kernel(Corners(tin.vertices, tin.triangles), tin.neighbours, at, own)
    number = np.asarray(number_kernel(joined))
    some = np.flatnonzero(number >= 0)
    part, n = number[some], int(number.max(initial=-1)) + 1
    least = at[tin.triangles[some]].min(axis=1)
    columns = (area[some], area[some] * least, joined.open_m[some])
    return OpenParts(number, np.column_stack([np.bincount(part, w, n) for w in columns]))


def peel_gaps(tin: Tin, spacing_m: F64, area: F64) -> Bool:
    """Triangles (m,) of a full TIN that are open notches and gaps: joined to the hull through sides
    that are long against the spacing, where what lies behind its sides is in the mean deeper than
    the spacing. spacing_m : (n,) of the vertices · area : (m,) m²
    """
    found = open_parts(tin, spacing_m, area)
    out: Bool = np.append(deep_parts(found.sums), False)[found.number]
    return out


def sampled_area(tin: Tin) -> SampledArea:
    """The sampled part of a full TIN, whose vertices are all footprints."""
    area = np.maximum(footprint_areas(tin.vertices, tin.triangles), 0.0)
    spacing = spacings(tin.vertices[:, :2])
    known = np.isfinite(spacing)
    everything = np.ones(len(tin.triangles), bool)
    if np.count_nonzero(known) < 0.5 * len(spacing):
        return SampledArea(
            everything,
            float(area.sum()),
            float(area.sum()),
            math.nan,
            0,
            0.0,
            1,
            ~everything,
            spacing,
        )
    mask = ~peel_gaps(tin, spacing, area)
    part = part_numbers(tin.neighbours, mask)
    # a part of two or three triangles is no area that was sampled
    size = np.bincount(part[mask], minlength=1)
    mask[mask] = size[part[mask]] > FEWEST // 10
    del part  # what is known of every triangle takes as much memory as the cloud
    bridged, gap, shown = np.empty_like(mask), np.empty_like(mask), np.where(known, spacing, 0.0)
    corners = Corners(tin.vertices, tin.triangles)
    run_in_ranges(wide_kernel, len(mask), corners, mask, shown, bridged, gap)
    number = part_numbers(tin.neighbours, gap)[gap]
    hole = np.bincount(number, area[gap], minlength=1)
    at = shown[tin.triangles[gap]].max(axis=1)
    mean = np.bincount(number, at**2, minlength=1) / np.maximum(np.bincount(number, minlength=1), 1)
    large = hole > (2.0 * HOLE) ** 2 * mean
    gap[gap] = large[number]
    return SampledArea(
        mask,
        float(area[mask].sum()),
        float(area.sum()),
        float(np.median(spacing[known])),
        int(np.count_nonzero(large)) if gap.any() else 0,
        float(area[gap].sum()),
        int(np.count_nonzero(size > FEWEST // 10)),
        bridged,
        spacing,
    )


def isolated_beyond(tin: Tin, mask: Bool, spacing_m: F64) -> Bool:
    """Vertices (n,) that stand alone outside the triangles (m,) that were sampled. spacing_m : (n,)
    of the vertices
    """
    used = vertex_mask(tin, mask)
    out = np.zeros(len(used), bool)
    rest = np.flatnonzero(~used)
    if not len(rest) or not used.any():
        return out
    xy = tin.vertices[:, :2]
    far, near = cKDTree(xy[used]).query(xy[rest])
    out[rest] = far > ALONE * spacing_m[used][near]
    return out


def sampled_without_isolated(tin: Tin) -> tuple[Tin, SampledArea]:
    """A full TIN without the points that stand alone outside the sampled area, which would bend its
    outline, and that area.
    """
    found, beyond = sampled_area(tin), 0
    for _ in range(PASSES):
        alone = isolated_beyond(tin, found.mask, found.spacings_m)
        if not alone.any():
            break
        beyond += int(np.count_nonzero(alone))
        rest = build_tin(tin.vertices[~alone])
        source = tin.source[~alone][rest.source]
        tin = dataclasses.replace(rest, source=source, duplicates=tin.duplicates)
        found = sampled_area(tin)
    return tin, dataclasses.replace(found, beyond=beyond)


def triangles_in_sampled_area(tin: Tin, points: F64) -> tuple[Bool, SampledArea]:
    """Which triangles (m,) of a partial TIN lie where points (n, 3) m sampled, by half of four
    places in each; also that area, with the triangles of the partial TIN that bridge it.
    """
    full, found = sampled_without_isolated(build_tin(points))
    index = triangle_index(full, found.mask)
    p = tin.vertices[tin.triangles, :2]
    weights = [(1, 1, 1), (4, 1, 1), (1, 4, 1), (1, 1, 4)]
    hits, wide = np.zeros(len(p), np.int64), np.zeros(len(p), np.int64)
    for w in weights:
        place = np.einsum("k,mkc->mc", np.array(w, dtype=np.float64) / sum(w), p)
        where = locate(index, place)
        hits += where >= 0
        wide += (where >= 0) & found.bridged[where]
    mask = hits >= 2
    return mask, dataclasses.replace(found, mask=mask, bridged=mask & (wide >= 2))
