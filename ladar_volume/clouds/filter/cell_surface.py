"""One pass over a whole cloud: every cell finds its surface, one quadric or several planes, and
projects its own points.

The choice is by the Bayesian information criterion on residuals cut off at the outlier threshold: a
quadric costs six parameters, a plane three. All residuals are distances to the surface along its
normal.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter import plane_agreement, plane_em, plane_set_selection, sharp_planes
from ladar_volume.clouds.filter.orthogonal_quadric import foot_on_quadric
from ladar_volume.clouds.filter.single_surface import bend, flat, nearest_to_origin
from ladar_volume.math.array_types import F64, I8, I32, I64, Bool
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.rmls.patch_fit import AROUND, REACH
from ladar_volume.rmls.tangent_frame import across
from ladar_volume.rmls.voxel_store import _mix, voxels_around

KEPT, OUTLIER, FEW_POINTS, NO_SURFACE, BEYOND_EDGE, UNSUPPORTED = 0, 1, 2, 3, 4, 5
#: Planes each cell finds for itself and its neighbours.
OFFERED = 3
#: What lies within this many sigma of a plane found is not searched for the next one.
EXPLAINED = 2.0
#: Turns: leaders search their planes; the others take over what a neighbour found where it explains
#: their points, and else search too; in the last one cells of several planes, and such as are not
#: explained, choose again among what all around them found, or take the planes that these agree in.
TURNS = 3
LAST = TURNS - 1
#: A cell and those next to it.
NEXT = 27
#: Support of a projected point: this many points within the radius that holds PATCH of them on a
#: full surface.
SUPPORT, PATCH = 4, 20


@kernel
def gather(v: int, keys: I64, table: I32, first: I64, r: F64, out: I64) -> Any:
    """Indices of all points (sorted by voxel) in the voxels around voxel v; returns how many. With
    an empty ``out`` only counts.
    """
    near, n = np.empty(AROUND, np.int64), 0
    for a in range(voxels_around(keys[v], keys, table, REACH, near)):
        for i in range(first[near[a]], first[near[a] + 1]):
            if len(out):
                out[n] = i
            n += 1
    return n


@leaf_kernel
def around(r: F64, first: I64, v: int, slots: I64, n: int, ball: float, origin: F64, x: F64) -> Any:
    """Mean of the cell's own points to origin (3,), and the gathered points within ``ball`` of it,
    about it, to x; returns how many.
    """
    lo, hi = first[v], first[v + 1]
    origin[:] = 0.0
    for i in range(lo, hi):
        for k in range(3):
            origin[k] += r[i, k] / (hi - lo)
    m = 0
    for i in range(n):
        square = 0.0
        for k in range(3):
            x[m, k] = r[slots[i], k] - origin[k]
            square += x[m, k] * x[m, k]
        if square <= ball * ball:
            m += 1
    return m


@leaf_kernel
def supported(x: F64, m: int, origin: F64, q: F64, square: float) -> Any:
    """Whether enough points (m, 3) about ``origin`` lie around q: planes end nowhere, surfaces
    do.
    """
    near = 0
    for i in range(m):
        d = 0.0
        for k in range(3):
            d += (x[i, k] + origin[k] - q[k]) ** 2
        near += d <= square
        if near > SUPPORT:  # one of them is the projected point itself
            return True
    return False


@kernel
def main_planes(
    which: I64,
    keys: I64,
    table: I32,
    first: I64,
    r: F64,
    ball: float,
    noise: F64,
    limit: F64,
    trials: int,
    least: int,
    seed: int,
    planes: F64,
    found: I64,
    width: F64,
) -> None:
    """The planes that the points near the cells ``which`` lie on, most points first, as ``n·x = o``
    (v, OFFERED, 4) and their number (v,).

    Each is sought among what the former ones do not explain. They are what a cell and its
    neighbours have to choose from. Points on a line less than ``width`` (v,) wide tell none.
    """
    for v in which:
        sigma, threshold = noise[v], limit[v]
        empty = np.empty(0, np.int64)
        n = gather(v, keys, table, first, r, empty)
        slots, x, origin = np.empty(n, np.int64), np.empty((n + 1, 3)), np.empty(3)
        gather(v, keys, table, first, r, slots)
        m = around(r, first, v, slots, n, ball, origin, x)
        found[v] = 0
        state, label, mean, inverse = (
            np.empty(1, np.uint64),
            np.full(m, -1),
            np.empty(3),
            np.empty((3, 3)),
        )
        state[0] = _mix(np.uint64(keys[v]) ^ _mix(np.uint64(seed)))
        free = np.arange(m)
        left = m
        for _ in range(OFFERED):
            plane = planes[v, found[v]]
            if (
                left < least
                or sharp_planes.best_plane(
                    x, free, left, ball, sharp_planes.SCORE_SIGMAS * sigma, trials, state, plane
                )
                <= 0.0
            ):
                break
            used = 0
            for _ in range(3):
                label[:] = -1
                for j in range(left):
                    label[free[j]] = (
                        0 if abs(sharp_planes.distance(x[free[j]], plane)) <= threshold else -1
                    )
                used = sharp_planes.fit_plane(x, m, label, 0, plane, mean, inverse)
            if used < least:
                break
            rest = 0
            for j in range(left):
                if abs(sharp_planes.distance(x[free[j]], plane)) > EXPLAINED * sigma:
                    free[rest] = free[j]
                    rest += 1
            left = rest
            if sharp_planes.on_line(used, inverse, width[v]):
                continue
            plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
            found[v] += 1


@kernel
def offers(v: int, keys: I64, table: I32, planes: F64, found: I64, origin: F64, out: F64) -> Any:
    """Planes of the cells around cell v, about ``origin``; returns how many."""
    near, n = np.empty(AROUND, np.int64), 0
    for i in range(voxels_around(keys[v], keys, table, REACH, near)):
        for a in range(found[near[i]]):
            out[n] = planes[near[i], a]
            out[n, 3] -= out[n, 0] * origin[0] + out[n, 1] * origin[1] + out[n, 2] * origin[2]
            n += 1
    return n


@kernel
def sets_around(
    v: int, keys: I64, table: I32, sets: F64, sizes: I64, origin: F64, out: F64, out_sizes: I64
) -> Any:
    """The sets of several planes of the cells next to cell v and its own, about ``origin``; returns
    how many.
    """
    near, n = np.empty(NEXT, np.int64), 0
    for i in range(voxels_around(keys[v], keys, table, 1, near)):
        w = near[i]
        if sizes[w] > 1:
            out_sizes[n] = sizes[w]
            for a in range(sizes[w]):
                out[n, a] = sets[w, a]
                out[n, a, 3] -= (
                    sets[w, a, 0] * origin[0]
                    + sets[w, a, 1] * origin[1]
                    + sets[w, a, 2] * origin[2]
                )
            n += 1
    return n


@leaf_kernel
def foot_on_planes(
    x: F64,
    origin: F64,
    planes: F64,
    count: int,
    side: I64,
    means: F64,
    inverses: F64,
    used: F64,
    q: F64,
    n_out: F64,
) -> Any:
    """Foot point q and normal on the nearest piece of planes about ``origin``; returns (distance,
    variance of the plane there over sigma², 0 inside the piece, 1 on an edge, 2 in a vertex).
    """
    for k in range(3):
        n_out[k] = x[k] - origin[k]
    a, square, on = sharp_planes.nearest_piece(n_out, planes, count, side, q)
    share = sharp_planes.plane_share(q, used[a], means[a], inverses[a])
    for k in range(3):
        q[k] += origin[k]
        n_out[k] = planes[a, k]
    return np.sqrt(square), share, on


@kernel
def surface_of(
    v: int,
    keys: I64,
    table: I32,
    sets: F64,
    sizes: I64,
    turn: int,
    x: F64,
    m: int,
    n: int,
    r: F64,
    slots: I64,
    origin: F64,
    own: F64,
    ball: float,
    degree: int,
    candidates: F64,
    offered: int,
    sigma: float,
    threshold: float,
    least: int,
    iterations: int,
    quadric: tuple[F64, F64, F64, F64, F64],
    planes: F64,
    side: I64,
    label: I64,
) -> Any:
    """Several planes for the cell, not yet refined, and its quadric. Returns (number of planes; sum
    of truncated squares of the quadric, infinite where it is not wanted). What neighbours found
    comes first: it makes search and quadric superfluous where it leaves no more than the noise.
    """
    lent, lent_sizes = np.empty((NEXT, sharp_planes.MOST, 4)), np.empty(NEXT, np.int64)
    number = sets_around(v, keys, table, sets, sizes, origin, lent, lent_sizes)
    lent, lent_sizes, reach = lent[:number], lent_sizes[:number], 0.5 * ball
    count, cost = plane_set_selection.best_lent(
        x, m, reach, lent, lent_sizes, sigma, threshold, least, planes, side, label
    )
    if turn == LAST and count > 0 and sizes[v] > 1:
        return plane_agreement.common(
            x,
            m,
            own,
            reach,
            lent,
            lent_sizes,
            count,
            cost,
            sigma,
            threshold,
            least,
            planes,
            side,
            label,
        ), np.inf
    well = (
        plane_set_selection.steady(x, m, own, planes, count, sigma, threshold, side, label)
        if count > 0
        else 0
    )
    if well == 2:
        return count, np.inf
    curve, most = np.inf, sharp_planes.MOST
    if degree == 2:
        curve, most = bend(
            x,
            m,
            n,
            r,
            slots,
            origin,
            keys[v],
            candidates,
            offered,
            ball,
            sigma,
            threshold,
            least,
            iterations,
            quadric,
        )
    if most == 0:
        return 0, curve
    if turn < LAST and well == 0:
        found = np.empty((sharp_planes.MOST, 4))
        size, length = plane_set_selection.found_planes(
            x, m, candidates, offered, sigma, threshold, least, most, found, side, label
        )
        if length < cost:
            count = size
            planes[:count] = found[:count]
    return count, curve


@kernel
def filter_cell(
    v: int,
    keys: I64,
    table: I32,
    main: F64,
    found: I64,
    sets: F64,
    sizes: I64,
    turn: int,
    slots: I64,
    n: int,
    r: F64,
    first: I64,
    order: I64,
    mine: Bool,
    ball: float,
    degree: int,
    sigma: float,
    threshold: float,
    least: int,
    iterations: int,
    snap: bool,
    q: F64,
    normals: F64,
    variance: F64,
    reason: I8,
    chosen: F64,
    width: float,
) -> Any:
    """Surface of one cell, and its own points projected. Returns (number of planes, −1 for a
    quadric, 0 for none; mean truncated square of all points near the cell over sigma²).
    """
    lo, hi = first[v], first[v + 1]
    origin, x = np.zeros(3), np.empty((n + 1, 3))
    m = around(r, first, v, slots, n, ball, origin, x)
    if m < least:
        verdict(lo, hi, order, mine, FEW_POINTS, reason)
        return 0, 9.0
    candidates = np.empty((OFFERED * AROUND, 4))
    offered = offers(v, keys, table, main, found, origin, candidates)
    planes, means, inverses = (
        np.zeros((sharp_planes.MOST, 4)),
        np.zeros((sharp_planes.MOST, 3)),
        np.zeros((sharp_planes.MOST, 3, 3)),
    )
    used, label, side = (
        np.zeros(sharp_planes.MOST),
        np.empty(m, np.int64),
        np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64),
    )
    quadric = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(6), np.zeros((6, 6))
    price, limit = sigma * sigma * np.log(m), threshold * threshold
    length, square, curve, count = limit * m, limit * m, np.inf, 0
    if offered > 0:
        planes[0] = candidates[nearest_to_origin(candidates, offered)]
        allowed = 3 * price if degree == 2 else np.inf
        count, used[0], square = flat(
            x, m, ball, sigma, threshold, allowed, planes[0], means[0], inverses[0], label
        )
    if count == 0:
        count, curve = surface_of(
            v,
            keys,
            table,
            sets,
            sizes,
            turn,
            x,
            m,
            n,
            r,
            slots,
            origin,
            r[lo:hi] - origin,
            ball,
            degree,
            candidates,
            offered,
            sigma,
            threshold,
            least,
            iterations,
            quadric,
            planes,
            side,
            label,
        )
        if count > 0:
            rounds = plane_em.ROUNDS if turn == LAST or count == 1 else plane_em.FIRST_ROUNDS
            count = plane_em.refine(
                x,
                m,
                ball,
                planes,
                means,
                inverses,
                used,
                count,
                sigma,
                threshold,
                rounds,
                side,
                label,
                width,
            )
            length, square = plane_em.pieces_cost(
                x,
                m,
                planes,
                count,
                side,
                limit,
                sigma,
                np.inf,
                np.empty(sharp_planes.MOST, np.int64),
            )
    curved = curve + 6 * price < length + 3 * count * price
    if not curved and count == 0:
        verdict(lo, hi, order, mine, NO_SURFACE, reason)
        return 0, 9.0
    centre, normal, tangent, beta, inverse = quadric
    across_t, reach = np.empty(3), ball * ball * PATCH / m + 4.0 * sigma * sigma
    across(normal, tangent, across_t)
    for i in range(lo, hi):
        to = order[i]
        if not mine[to]:
            continue
        if curved:
            d, share = foot_on_quadric(
                r[i], centre, normal, tangent, across_t, beta, inverse, q[to], normals[to]
            )
            on = 0
        else:
            d, share, on = foot_on_planes(
                r[i], origin, planes, count, side, means, inverses, used, q[to], normals[to]
            )
        variance[to] = share * sigma * sigma
        if d > threshold:
            reason[to] = OUTLIER
        elif on > 0 and not snap:
            reason[to] = BEYOND_EDGE
        else:
            reason[to] = KEPT if supported(x, m, origin, q[to], reach) else UNSUPPORTED
    for a in range(count):
        chosen[a] = planes[a]
        chosen[a, 3] += (
            planes[a, 0] * origin[0] + planes[a, 1] * origin[1] + planes[a, 2] * origin[2]
        )
    return -1 if curved else count, (curve if curved else square) / (m * sigma * sigma)


@kernel
def verdict(lo: int, hi: int, order: I64, mine: Bool, why: int, reason: I8) -> None:
    """One reason for all points of a cell."""
    for i in range(lo, hi):
        if mine[order[i]]:
            reason[order[i]] = why


@kernel
def filter_cells(
    which: I64,
    keys: I64,
    table: I32,
    first: I64,
    r: F64,
    main: F64,
    found: I64,
    sets: F64,
    sizes: I64,
    turn: int,
    order: I64,
    mine: Bool,
    ball: float,
    degree: int,
    noise: F64,
    limit: F64,
    least: int,
    iterations: int,
    snap: bool,
    q: F64,
    normals: F64,
    variance: F64,
    reason: I8,
    kind: I64,
    misfit: F64,
    chosen: F64,
    width: F64,
) -> None:
    """The cells ``which`` of points (n, 3) sorted by voxel, ``order`` (n,) the place of each among
    the points as given: that is where a cell writes what becomes of those of its own points that
    are ``mine``.
    """
    for v in which:
        empty = np.empty(0, np.int64)
        n = gather(v, keys, table, first, r, empty)
        slots = np.empty(n, np.int64)
        gather(v, keys, table, first, r, slots)
        kind[v], misfit[v] = filter_cell(
            v,
            keys,
            table,
            main,
            found,
            sets,
            sizes,
            turn,
            slots,
            n,
            r,
            first,
            order,
            mine,
            ball,
            degree,
            noise[v],
            limit[v],
            least,
            iterations,
            snap,
            q,
            normals,
            variance,
            reason,
            chosen[v],
            width[v],
        )
