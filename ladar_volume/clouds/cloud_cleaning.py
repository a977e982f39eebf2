"""Stray points of a cloud: what neither lies on the surface around it nor has company where it is.

A point is isolated where its eighth neighbour in space is far for the points around it. It is a
stray where it is also off the plane through those around it that are not isolated; one that is not
isolated where three quarters of its neighbours agree on a plane, it is far off that, and fewer
than two of them are where it is: corners and edges of bodies have company on their own level.
Neighbours are taken across scan lines (see ``cloud_noise``). Points that plainly lie on a plane
with all those around them (see ``plain_places``) are not asked, unless they lie on such lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ladar_volume.clouds.cloud_noise import CELL, CloudNoise, cloud_noise, thin_by_cells
from ladar_volume.clouds.sampling.isolation import far_from_cloud
from ladar_volume.clouds.sampling.plain_places import plain_points
from ladar_volume.math.equal_rows import rows_of
from ladar_volume.math.kernels import PARTS, inlined, kernel, run_in_threads
from ladar_volume.math.nearest import (
    NearestIndex,
    Some,
    nearest,
    nearest_distances,
    nearest_index,
    search_part,
)
from ladar_volume.math.own_axes import along_own_axes
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.tin.insertion_order import hilbert_order
from ladar_volume.tin.sampled_area import FEWEST, spacings

#: Neighbours in space, those in the plane whose distances are compared, those of a plane.
COMPANY, AROUND, PLANE = 8, 24, 16
#: Mean number of points in a cell of :func:`nearby_minimum`.
MANY = 50
#: Isolated above this many times the lower quartile of the distances around.
ISOLATED = 3.0
#: Off the surface above so many standard deviations, isolated or not; in agreement below.
OFF_ISOLATED, OFF, AGREE = 4.0, 6.0, 3.5
#: Share of the neighbours that agree on a plane; fewest that a point has where it is.
MAJORITY, OWN = 0.75, 2
LIMITS = np.array([OFF_ISOLATED, OFF, AGREE, MAJORITY, OWN])
#: Passes: strays hide one another. Share of neighbours on lines above which they are taken across.
PASSES, LINES = 3, 0.02
#: Reweightings of a plane, and fewest points through which one is laid.
STEPS, LEAST = 10, 6
#: Points whose neighbours are held at once.
BLOCK = 1024
#: Stretches of a large cloud that show its noise, and points of each.
STRETCHES, STRETCH = 64, 4096
#: Share of strays that moves the noise by less than a thousandth: each is a neighbour in eighteen
#: fits, of which those beyond three standard deviations do not count.
UNMOVED = 1e-4
#: Share of the points up to which distances are told of them and of their neighbours alone.
PART = 0.2


@dataclass(frozen=True)
class CleaningResult:
    """kept, strays : (k,), (s,) rows of the cloud, what is kept such that neighbours in space are
    neighbours in memory · isolated_count : how many of the strays are so · noise : of what is kept,
    None where it was not told
    """

    kept: I64
    strays: I64
    isolated_count: int
    noise: CloudNoise | None = None


@kernel
def solve_plane(d: F64, weight: F64, count: int) -> tuple[float, float, float]:
    """Height and slopes of the plane of least weighted squares through the first ``count`` of
    points (m, 3). Points on one line show no slope across it.
    """
    a00 = a01 = a02 = a11 = a12 = a22 = b0 = b1 = b2 = 0.0
    for j in range(count):
        w, x, y, z = weight[j], d[j, 0], d[j, 1], d[j, 2]
        a00, a01, a02 = a00 + w, a01 + w * x, a02 + w * y
        a11, a12, a22 = a11 + w * x * x, a12 + w * x * y, a22 + w * y * y
        b0, b1, b2 = b0 + w * z, b1 + w * x * z, b2 + w * y * z
    ridge = 1e-6 * (a11 + a22) + 1e-300
    a11, a22 = a11 + ridge, a22 + ridge
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c00 + a01 * c01 + a02 * c02
    if not det > 0.0:
        return b0 / a00, 0.0, 0.0
    c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
    return (
        (c00 * b0 + c01 * b1 + c02 * b2) / det,
        (c01 * b0 + c11 * b1 + c12 * b2) / det,
        (c02 * b0 + c12 * b1 + c22 * b2) / det,
    )


@kernel
def least_sizes(d: F64, r: F64, size: F64, count: int, sigma: float) -> tuple[float, float]:
    """The plane of least sizes through the first ``count`` of points (m, 3), by reweighting: its
    height, and the spread about it, at least ``sigma``. r : (m,) becomes the residuals.
    """
    h, gx, gy, spread = float(np.median(d[:count, 2])), 0.0, 0.0, sigma
    for step in range(STEPS + 1):
        for j in range(count):
            r[j] = d[j, 2] - h - gx * d[j, 0] - gy * d[j, 1]
            size[j] = abs(r[j])
        spread = max(1.4826 * np.median(size[:count]), sigma)
        if step < STEPS:
            for j in range(count):
                size[j] = 1.0 / max(size[j], 0.3 * spread)
            h, gx, gy = solve_plane(d, size, count)
    return h, spread


@kernel
def off_plane(
    d: F64, r: F64, size: F64, count: int, sigma: float, isolated: bool, limits: F64
) -> bool:
    """Whether the origin is a stray beside the first ``count`` of points d (m, 3) around it."""
    h, spread = least_sizes(d, r, size, count, sigma)
    agreeing, own = 0, 0
    for j in range(count):
        agreeing += abs(r[j]) <= limits[2] * spread
        # the point itself lies at -h about the plane
        own += abs(r[j] + h) <= limits[2] * spread
    if own >= limits[4]:
        return False
    if isolated:
        return bool(abs(h) > limits[0] * spread)
    return bool(abs(h) > limits[1] * spread and agreeing >= limits[3] * count)


class Cloud(NamedTuple):
    """points : (n, 3) m · flat : (n, 3) the same at height 0 · isolated : (n,) · sigma : m, of
    their heights · limits : (5,) off where isolated, off, agreement (in sigmas), majority (share),
    own company (count)
    """

    points: F64
    flat: F64
    isolated: Bool
    sigma: float
    limits: F64


@inlined
def plane_part(cloud: Cloud, chosen: I64, near: I32, out: Bool) -> None:
    """See :func:`plane_kernel`: some of the points, whose neighbours are near (k, m), rows."""
    m, limits, sigma = near.shape[1], cloud.limits, cloud.sigma
    d, r, size = np.empty((m, 3)), np.empty(m), np.empty(m)
    for i in range(len(chosen)):
        p, count = cloud.points[chosen[i]], 0
        for j in range(m):
            if near[i, j] != chosen[i]:
                for c in range(3):
                    d[count, c] = cloud.points[near[i, j], c] - p[c]
                size[count] = 1.0
                count += 1
        if count < LEAST:
            continue
        alone = cloud.isolated[chosen[i]]
        # most points lie on any plane through those around them
        if not alone and abs(solve_plane(d, size, count)[0]) <= limits[2] * sigma:
            continue
        out[i] = off_plane(d, r, size, count, sigma, alone, limits)


@inlined
def search_and_ask(
    index: NearestIndex, kept: I32, cloud: Cloud, chosen: I64, some: Some, out: Bool, far: F64
) -> None:
    """See :func:`plane_kernel`: a part of the points, block by block: their neighbours are not all
    held at once.
    """
    near, places = np.empty((BLOCK, some.k), np.int32), np.empty((BLOCK, 3))
    for a in range(some.first, some.end, BLOCK):
        own = chosen[a : min(a + BLOCK, some.end)]
        n = len(own)
        for i in range(n):
            places[i] = cloud.flat[own[i]]
        search_part(index, places, Some(0, n, some.k), near, far[a : a + n])
        for i in range(n):
            for j in range(some.k):
                near[i, j] = kept[near[i, j]]
        plane_part(cloud, own, near, out[a : a + n])


@kernel
def plane_kernel(
    parts: I64,
    index: NearestIndex,
    kept: I32,
    cloud: Cloud,
    chosen: I64,
    k: int,
    out: Bool,
    far: F64,
) -> None:
    """Of the points ``chosen`` (m,), rows, those in ``parts`` of :data:`PARTS`: which are strays
    beside the planes of least sizes through the k points nearest to them over the plane, of those
    in the index, which are the rows ``kept``; and how far, m, the last of these is.
    """
    n = len(chosen)
    for part in parts:
        some = Some(part * n // PARTS, (part + 1) * n // PARTS, k)
        search_and_ask(index, kept, cloud, chosen, some, out, far)


def isolated_points(points: F64, flat: F64, asked: I64) -> Bool:
    """Points (n,) of those ``asked`` (k,), rows, whose neighbours in space are far for the points
    around them; flat : (n, 3), the same points at height 0.
    """
    out = np.zeros(len(points), np.bool_)
    index, over = nearest_index(points), nearest_index(flat)
    if len(asked) > PART * len(points):
        distance = nearest_distances(index, points, COMPANY + 1)
        asked = asked[(distance > ISOLATED * nearby_minimum(points, distance)[0])[asked]]
        around = nearest(over, flat[asked], AROUND)[0]
    else:
        around, distance = nearest(over, flat[asked], AROUND)[0], np.full(len(points), np.nan)
        needed = np.zeros(len(points), np.bool_)
        needed[around], needed[asked] = True, True
        distance[needed] = nearest_distances(index, points[needed], COMPANY + 1)
    near = np.partition(distance[around], AROUND // 4, axis=1)[:, AROUND // 4]
    out[asked] = distance[asked] > ISOLATED * near
    return out


def nearby_minimum(points: F64, distance: F64) -> tuple[F64, float]:
    """A lower bound (n,) of the lower quartile of ``distance`` (n,) among the :data:`AROUND` points
    nearest to each of points (n, 3) over the plane: the least in the five by five cells around a
    point; and how far, m, these cells reach at most. It is 0 where the point's own cell holds fewer
    than :data:`AROUND`, since the nearest may then lie beyond those cells.
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    size = max(
        math.sqrt(float(np.prod(high - low)) * MANY / len(points)),
        float((high - low).max()) / len(points),
        1e-300,
    )
    count = np.floor((high - low) / size).astype(np.int64) + 1
    x, y = (np.floor((points[:, k] - low[k]) / size).astype(np.int32) for k in range(2))
    cell = x * count[1] + y
    least = np.full(int(count.prod()), np.inf)
    np.minimum.at(least, cell, distance)
    least = ndimage.minimum_filter(least.reshape(count), 5, mode="constant", cval=np.inf).ravel()
    least[np.bincount(cell, minlength=len(least)) < AROUND] = 0.0
    return least[cell], 3.0 * math.sqrt(2.0) * size


def beside_planes(
    cloud: Cloud,
    good: Bool,
    chosen: I64,
    cells: F64 | None,
    extent: tuple[F64, F64] | None = None,
) -> tuple[Bool, F64]:
    """Which of the points ``chosen`` (k,), rows, are strays beside the good (n,) ones nearest to
    them, and how far (k,), m, the last of these is, infinite where these are too few; with cells
    (n,) m, beside those that are left when one point is taken from each. extent : between what the
    good ones lie where the cloud is a part of another, as in :func:`thin_by_cells`
    """
    rows = np.flatnonzero(good).astype(np.int32)
    out, far = np.zeros(len(chosen), np.bool_), np.full(len(chosen), np.inf)
    if cells is None:
        ask_planes(cloud, rows, chosen, out, far)
        return out, far
    of = np.where(np.isfinite(cells), cells, 0.0)[chosen]
    for cell in np.unique(of).tolist():
        # in their order, neighbours beside neighbours
        kept = rows
        if cell != 0.0:
            kept = np.sort(rows[thin_by_cells(cloud.flat[rows], cell, extent=extent)])
        at = np.flatnonzero(of == cell)
        own, reach = out[at], far[at]
        ask_planes(cloud, rows if len(kept) <= PLANE else kept, chosen[at], own, reach)
        out[at], far[at] = own, np.inf if len(kept) <= PLANE else reach
    return out, far


def ask_planes(cloud: Cloud, kept: I32, chosen: I64, out: Bool, far: F64) -> None:
    """:func:`plane_kernel` beside the points ``kept`` (k,), rows, where there are any."""
    most = min(PLANE + 1, len(kept))
    if most:
        index = nearest_index(rows_of(cloud.flat, kept))
        run_in_threads(plane_kernel, np.arange(PARTS), index, kept, cloud, chosen, most, out, far)
    if most <= PLANE:
        far[:] = np.inf


def clean(points: F64) -> CleaningResult:
    """The points (n, 3), m, that are no strays. A point far from all others is a stray at any
    height; otherwise fewer than :data:`FEWEST` points are left as they are.
    """
    far = far_from_cloud(points)
    if not far.any():
        return _clean_near(points)
    near, away = np.flatnonzero(~far), np.flatnonzero(far)
    done = _clean_near(points[near])
    strays = np.sort(np.concatenate([near[done.strays], away]))
    alone = done.isolated_count + len(away)
    return CleaningResult(near[done.kept], strays, alone, done.noise)


def _clean_near(points: F64) -> CleaningResult:
    """Points (n, 3), m, none of them far from all others."""
    none = np.zeros(0, np.int64)
    if len(points) < FEWEST:
        return CleaningResult(hilbert_order(points[:, :2]).astype(np.int64), none, 0)
    order, r = in_order_of_place(points)
    noise = noise_if_told(stretches(r))
    if noise is None:
        return CleaningResult(order.astype(np.int64), none, 0)
    isolated, stray = find_strays(r, noise)
    strays = np.sort(order[stray]).astype(np.int64)
    if len(strays) > UNMOVED * len(r):
        noise = noise_if_told(stretches(r[~stray]))
    alone = int(np.count_nonzero(isolated & stray))
    return CleaningResult(order[~stray].astype(np.int64), strays, alone, noise)


def stretches(r: F64) -> F64:
    """Points (n, 3), m, in the order of place, or as many of them as show their noise."""
    first, many = stretches_of(len(r))
    return r if many == len(r) else np.concatenate([r[k : k + many] for k in first.tolist()])


def stretches_of(count: int) -> tuple[I64, int]:
    """Where even stretches of so many points along the curve begin (s,), each as dense as all, and
    how many points each has; one of all where these are few.
    """
    if count <= 2 * STRETCHES * STRETCH:
        return np.zeros(1, np.int64), count
    return np.linspace(0, count - STRETCH, STRETCHES).astype(np.int64), STRETCH


def noise_along_curve(points: F64) -> CloudNoise:
    """The noise of points (n, 3), m, that are not in the order of place; raises as
    :func:`cloud_noise` does.
    """
    return cloud_noise(stretches(in_order_of_place(points)[1]))


def noise_if_told(points: F64) -> CloudNoise | None:
    """The noise of points (n, 3), m; None where they do not tell it."""
    try:
        return cloud_noise(points)
    except SurfaceError:
        return None


def in_order_of_place(points: F64) -> tuple[I32, F64]:
    """Rows (n,) of points (n, 3), m, such that neighbours in space are neighbours in memory: the
    searches take half the time. Then, in that order, the points about their middle along their own
    axes.
    """
    order = hilbert_order(points[:, :2])
    r = points[order]
    r[:, 2] -= np.round(r[:, 2].mean())
    r[:, :2] = along_own_axes(r[:, :2])
    return order, r


def least_noise(noise: CloudNoise, extent_m: float) -> float:
    """The noise, m, at least what rounding leaves of coordinates over such an extent."""
    return max(noise.sigma_m, 1e-9 * extent_m)


def find_strays(r: F64, noise: CloudNoise) -> tuple[Bool, Bool]:
    """Which points of r (n, 3), m, along their own axes, are isolated, of those that do not plainly
    lie on the surface, and which are strays.
    """
    flat = r * [1.0, 1.0, 0.0]
    sigma = least_noise(noise, float(np.ptp(r)))
    cells, asked = None, np.arange(len(r), dtype=np.int64)
    if noise.on_lines > LINES:
        cells = CELL * spacings(r[:, :2])
    else:
        asked = np.flatnonzero(~plain_points(r, sigma))
    isolated = isolated_points(r, flat, asked)
    cloud = Cloud(r, flat, isolated, sigma, LIMITS)
    good, chosen = np.ones(len(r), bool), asked
    for _ in range(PASSES):
        found, far = beside_planes(cloud, good & ~isolated, chosen, cells)
        stray = chosen[found]
        stray = stray[good[stray]]
        if not len(stray):
            break
        good[stray] = False
        # only points beside a stray see another plane the next time
        gone = nearest_index(flat[stray[~isolated[stray]]])
        chosen, far = chosen[good[chosen]], far[good[chosen]]
        if not len(gone.points):
            break
        chosen = chosen[nearest(gone, flat[chosen], 1)[1] <= far]
        if not len(chosen):
            break
    return isolated, ~good
