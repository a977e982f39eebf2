"""Which point belongs to which of several planes, and the planes from their points, to a fixed
point.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import (
    MOST,
    bounds,
    distance,
    fit_shares,
    nearest_on_piece,
    nearest_planes,
    on_line,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Most rounds of sharing out and refitting; and where the cell will choose again.
ROUNDS, FIRST_ROUNDS = 30, 8
#: A result that describes the points worse than its start by this factor has lost its way. The
#: description itself, which gives each point to one piece, is too crude for less: it prefers planes
#: that lean into the corners.
WORSE = 1.05
#: Rounds before the points' own shares tell where planes end.
SETTLING = 1
#: Movement of a plane over the neighbourhood, in noise sigma, below which it has settled.
SETTLED = 0.02
#: Least sum of shares a plane is fitted to.
FEWEST = 4.0
#: Planes closer than this, as the sine of their angle, are one where they also lie within this many
#: sigma of each other: nearly so far apart come two planes to lie that share one slab of uniform
#: noise, where it is a little larger than believed.
SAME_SINE, SAME_SIGMAS = 0.1, 1.25


@leaf_kernel
def pieces_cost(
    x: F64,
    m: int,
    planes: F64,
    count: int,
    side: I64,
    limit: float,
    sigma: float,
    most: float,
    support: I64,
) -> Any:
    """Description length of points (m, 3) on the bounded pieces, in squared distances: truncated
    squares, and what it takes to say to which piece a point belongs where its position does not
    tell. support (k,) gets the number of points nearest to each piece.

    Without the second term a slab of noise is described better by two planes within it than by the
    one in its middle.
    """
    cost, saying = 0.0, 0.0
    support[:count] = 0
    for i in range(m):
        nearest, which, several = limit, -1, 0
        for a in range(count):
            if distance(x[i], planes[a]) ** 2 >= limit:  # no piece is nearer than its plane
                continue
            q0, q1, q2, on = nearest_on_piece(x[i], a, planes, count, side)
            d = (x[i, 0] - q0) ** 2 + (x[i, 1] - q1) ** 2 + (x[i, 2] - q2) ** 2
            several += on == 0 and d < limit
            if d < nearest:
                nearest, which = d, a
        cost += nearest
        if several > 1:
            saying += 2.0 * np.log(several) * sigma * sigma
        if which >= 0:
            support[which] += 1
        if cost + saying > most:
            break
    return cost + saying, cost


@kernel
def share_out(
    x: F64,
    m: int,
    planes: F64,
    count: int,
    side: I64,
    sigma: float,
    threshold: float,
    share: F64,
    label: I64,
) -> None:
    """share (k, m): the probability that a point belongs to each piece, and label (m,) of the
    likeliest, −1 for none.

    The noise lies along the normal, so a point of a piece has its foot on that piece: where a foot
    lies beyond the intersection that bounds the plane, the point is not the plane's. Along an
    intersection a point may be of either; all or nothing would pull the planes towards each other,
    since each would lose its points on the far side of the other. Surfaces are sampled alike, so
    the likelihoods need no further weights; an outlier is as likely as a point at the threshold.
    Whether a point is one is asked of each plane alone: with the likelihoods of all together,
    points before an edge, which no other plane explains, would count for less than those behind it,
    and planes that meet would be drawn in.
    """
    _share_out(
        x,
        m,
        planes,
        count,
        side,
        sigma,
        threshold,
        np.empty((MOST, MOST)),
        np.empty(MOST),
        share,
        label,
    )


@leaf_kernel
def _share_out(
    x: F64,
    m: int,
    planes: F64,
    count: int,
    side: I64,
    sigma: float,
    threshold: float,
    cosine: F64,
    d: F64,
    share: F64,
    label: I64,
) -> None:
    none = np.exp(-0.5 * threshold * threshold / (sigma * sigma))
    for a in range(count):
        for b in range(count):
            cosine[a, b] = (
                planes[a, 0] * planes[b, 0]
                + planes[a, 1] * planes[b, 1]
                + planes[a, 2] * planes[b, 2]
            )
    for i in range(m):
        total, best = 0.0, none
        label[i] = -1
        for a in range(count):
            d[a] = distance(x[i], planes[a])
        for a in range(count):
            share[a, i] = 0.0
            if abs(d[a]) > threshold:
                continue
            own = True
            for b in range(count):
                if side[a, b] != 0:
                    own = own and side[a, b] * (d[b] - d[a] * cosine[a, b]) >= 0.0
            if own:
                share[a, i] = np.exp(-0.5 * d[a] * d[a] / (sigma * sigma))
                total += share[a, i]
                if share[a, i] > best:
                    best = share[a, i]
                    label[i] = a
        for a in range(count):
            if share[a, i] > 0.0:
                share[a, i] *= share[a, i] / (total * (share[a, i] + none))


@leaf_kernel
def certain(x: F64, m: int, plane: F64, sigma: float, share: F64, out: F64) -> None:
    """What the points tell of a plane, over what they would if they were known to be its own (Louis
    1982): a doubtful point tells less, and less the farther it lies off. Its mean over the doubt is
    never below zero, single points count as zero where they would be.
    """
    for i in range(m):
        d = distance(x[i], plane) / sigma
        out[i] = max(0.0, share[i] - share[i] * (1.0 - share[i]) * d * d)


@kernel
def drop_plane(planes: F64, means: F64, inverses: F64, used: F64, count: int, k: int) -> Any:
    """Close the gap of plane k; returns the new count."""
    for j in range(k, count - 1):
        planes[j], means[j], inverses[j], used[j] = (
            planes[j + 1],
            means[j + 1],
            inverses[j + 1],
            used[j + 1],
        )
    return count - 1


@kernel
def merge_same(planes: F64, means: F64, inverses: F64, used: F64, count: int, sigma: float) -> Any:
    """Drop planes that another one explains: nearly parallel, and within the noise of it at their
    own centre.
    """
    k = count - 1
    while k > 0:
        for j in range(k):
            c = abs(
                planes[j, 0] * planes[k, 0]
                + planes[j, 1] * planes[k, 1]
                + planes[j, 2] * planes[k, 2]
            )
            near = abs(distance(means[k], planes[j])) < SAME_SIGMAS * sigma
            if near and np.sqrt(max(0.0, 1.0 - c * c)) < SAME_SINE:
                count = drop_plane(planes, means, inverses, used, count, k)
                break
        k -= 1
    return count


@kernel
def refine(
    x: F64,
    m: int,
    reach: float,
    planes: F64,
    means: F64,
    inverses: F64,
    used: F64,
    count: int,
    sigma: float,
    threshold: float,
    rounds: int,
    side: I64,
    label: I64,
    across: float = 0.0,
) -> Any:
    """Share out the points (m, 3) within ``reach`` and refit all planes, in turn until none moves
    (expectation and maximisation), for ``rounds`` at most, and as many again after a plane is
    dropped.

    Planes whose points lie on a line less than ``across`` wide are dropped. Returns the number of
    planes; ``used``, ``means`` and ``inverses`` give their covariance.
    """
    share, before, start, at_first = np.zeros((MOST, m)), np.empty(4), planes.copy(), count
    support, limit, price = (
        np.empty(MOST, np.int64),
        threshold * threshold,
        3.0 * np.log(m) * sigma * sigma,
    )
    nearest_planes(x, m, planes, count, limit, label)
    bounds(x, m, label, planes, count, sigma, side)
    worst = WORSE * (
        pieces_cost(x, m, planes, count, side, limit, sigma, np.inf, support)[0] + count * price
    )
    step = 0
    while step < rounds:
        share_out(x, m, planes, count, side, sigma, threshold, share, label)
        moved, lost, k = 0.0, False, count - 1
        while k >= 0:
            before[:] = planes[k]
            used[k] = fit_shares(x, m, share[k], planes[k], means[k], inverses[k])
            if used[k] < FEWEST or (count > 1 and on_line(used[k], inverses[k], across)):
                count, lost = drop_plane(planes, means, inverses, used, count, k), True
            else:
                turn = (
                    (before[0] - planes[k, 0]) ** 2
                    + (before[1] - planes[k, 1]) ** 2
                    + (before[2] - planes[k, 2]) ** 2
                )
                moved = max(moved, abs(before[3] - planes[k, 3]) + reach * np.sqrt(turn))
            k -= 1
        size = count
        count = merge_same(planes, means, inverses, used, count, sigma)
        if count < size or lost:
            step = -1  # what is left has all its rounds
        if step < SETTLING:
            nearest_planes(x, m, planes, count, limit, label)
        elif moved < SETTLED * sigma:
            break
        bounds(x, m, label, planes, count, sigma, side)
        step += 1
    if (
        pieces_cost(x, m, planes, count, side, limit, sigma, worst, support)[0] + count * price
        > worst
    ):
        count = at_first
        planes[:] = start
        nearest_planes(x, m, planes, count, limit, label)
        bounds(x, m, label, planes, count, sigma, side)
    share_out(x, m, planes, count, side, sigma, threshold, share, label)
    for k in range(count):
        certain(x, m, planes[k], sigma, share[k], share[k])
        before[:] = planes[k]
        used[k] = max(FEWEST, fit_shares(x, m, share[k], before, means[k], inverses[k]))
    return count
