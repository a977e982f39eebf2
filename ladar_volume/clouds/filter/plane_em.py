"""Which point belongs to which of several planes, and the planes from their points, to a fixed
point.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.clouds.filter.cell_records import Pieces, PointSample
from ladar_volume.clouds.filter.sharp_planes import (
    MOST,
    bounding_sides,
    distance,
    fit_plane,
    fit_shares,
    nearest_on_piece,
    nearest_planes,
    on_line,
)
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import inlined, kernel, leaf_kernel

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
#: Two planes of more noise than believed: nowhere farther apart than this many sigma where their
#: points are; a gap beyond which a dip between them would show, in sigma; density in the middle
#: third of it over that about the two planes, below which there is one.
SLAB_SIGMAS, TOLD_SIGMAS, DIP = 4.0, 2.0, 0.8
#: Points of two planes are laterally mixed where no more than this share of the variance of their
#: belonging lies between the squares, this many a side, of a net over them.
BETWEEN, SQUARES = 0.2, 4


class Shares(NamedTuple):
    """share : (MOST, m) probability that a point belongs to each piece · cosine : (MOST, MOST)
    between planes, d : (MOST,) distances of a point from them: working arrays
    """

    share: F64
    cosine: F64
    d: F64


@kernel
def room_for_shares(m: int) -> Shares:
    """Room for the shares of m points."""
    return Shares(np.zeros((MOST, m)), np.empty((MOST, MOST)), np.empty(MOST))


@leaf_kernel
def pieces_cost(
    sample: PointSample, planes: F64, count: int, side: I64, most: float, support: I64
) -> Any:
    """Description length of the sample on the bounded pieces, in squared distances: truncated
    squares, and what it takes to say to which piece a point belongs where its position does not
    tell. Returns (length, truncated squares alone); a length beyond ``most`` is not summed to its
    end. support (k,) gets the number of points nearest to each piece.

    Without the second term a slab of noise is described better by two planes within it than by the
    one in its middle.
    """
    x, sigma, limit = sample.x, sample.sigma, sample.threshold * sample.threshold
    cost, saying = 0.0, 0.0
    support[:count] = 0
    for i in range(sample.n):
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


@leaf_kernel
def membership_shares(sample: PointSample, pieces: Pieces, count: int, shares: Shares) -> None:
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
    planes, share = pieces.planes, shares.share
    none = np.exp(-0.5 * sample.threshold * sample.threshold / (sample.sigma * sample.sigma))
    for a in range(count):
        for b in range(count):
            shares.cosine[a, b] = (
                planes[a, 0] * planes[b, 0]
                + planes[a, 1] * planes[b, 1]
                + planes[a, 2] * planes[b, 2]
            )
    for i in range(sample.n):
        total = _likelihoods(i, sample, pieces, count, shares, none)
        for a in range(count):
            if share[a, i] > 0.0:
                share[a, i] *= share[a, i] / (total * (share[a, i] + none))


@leaf_kernel
def _likelihoods(
    i: int, sample: PointSample, pieces: Pieces, count: int, shares: Shares, none: float
) -> Any:
    """Likelihood of point i on each piece to its shares, and its label; returns their sum."""
    share, d, side = shares.share, shares.d, pieces.side
    sigma, total, best = sample.sigma, 0.0, none
    pieces.label[i] = -1
    for a in range(count):
        d[a] = distance(sample.x[i], pieces.planes[a])
    for a in range(count):
        share[a, i] = 0.0
        if abs(d[a]) > sample.threshold:
            continue
        own = True
        for b in range(count):
            if side[a, b] != 0:
                own = own and side[a, b] * (d[b] - d[a] * shares.cosine[a, b]) >= 0.0
        if own:
            share[a, i] = np.exp(-0.5 * d[a] * d[a] / (sigma * sigma))
            total += share[a, i]
            if share[a, i] > best:
                best = share[a, i]
                pieces.label[i] = a
    return total


@leaf_kernel
def information_ratio(sample: PointSample, plane: F64, share: F64) -> None:
    """What the points tell of a plane, over what they would if they were known to be its own (Louis
    1982), in place of their shares (m,): a doubtful point tells less, and less the farther it lies
    off. Its mean over the doubt is never below zero, single points count as zero where they would
    be.
    """
    for i in range(sample.n):
        d = distance(sample.x[i], plane) / sample.sigma
        share[i] = max(0.0, share[i] - share[i] * (1.0 - share[i]) * d * d)


@kernel
def drop_plane(pieces: Pieces, count: int, k: int) -> Any:
    """Close the gap of plane k; returns the new count."""
    for j in range(k, count - 1):
        pieces.planes[j], pieces.means[j] = pieces.planes[j + 1], pieces.means[j + 1]
        pieces.inverses[j], pieces.used[j] = pieces.inverses[j + 1], pieces.used[j + 1]
    return count - 1


@inlined
def merge_coincident(pieces: Pieces, count: int, sigma: float) -> Any:
    """Drop planes that another one explains: nearly parallel, and within the noise of it at their
    own centre.
    """
    planes, means = pieces.planes, pieces.means
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
                count = drop_plane(pieces, count, k)
                break
        k -= 1
    return count


@leaf_kernel
def _lateral_square(x: F64, low: F64, step: F64, axis: int | np.intp) -> Any:
    """Number of the square that a point lies in, in a net over the two axes beside ``axis``."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    i = min(int((x[u] - low[u]) / step[u]), SQUARES - 1)
    return i * SQUARES + min(int((x[v] - low[v]) / step[v]), SQUARES - 1)


@kernel
def laterally_mixed(x: F64, label: I64, a: int, b: int, axis: int | np.intp) -> Any:
    """Whether the points (m, 3) labelled a and b lie among each other as seen along ``axis``: the
    squares of a net hardly tell which is which. Two surfaces side by side have squares of their
    own.
    """
    low, step = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(label)):
        if label[i] == a or label[i] == b:
            for k in range(3):
                low[k], step[k] = min(low[k], x[i, k]), max(step[k], x[i, k])
    step[:] = np.maximum((step - low) / SQUARES, 1e-300)
    number = np.zeros((2, SQUARES * SQUARES))
    for i in range(len(label)):
        if label[i] == a or label[i] == b:
            number[int(label[i] == b), _lateral_square(x[i], low, step, axis)] += 1.0
    own, other = number[0].sum(), number[1].sum()
    share, between, squares = other / max(own + other, 1.0), 0.0, -1
    for c in range(SQUARES * SQUARES):
        n = number[0, c] + number[1, c]
        if n > 0.0:
            between += (number[1, c] - n * share) ** 2 / n
            squares += 1
    # chance alone puts as much between the squares as there are squares, less one
    return between <= share * (1.0 - share) * (BETWEEN * (own + other) + squares)


@kernel
def one_slab(sample: PointSample, pieces: Pieces, a: int, b: int) -> Any:
    """Whether two planes share one slab of more noise than believed: nearly parallel, nowhere far
    apart where their labelled points are, these laterally mixed, and as dense midway between the
    planes as about them.
    """
    x, label, p, q = sample.x, pieces.label[: sample.n], pieces.planes[a], pieces.planes[b]
    c = p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    if np.sqrt(max(0.0, 1.0 - c * c)) >= SAME_SINE:
        return False
    sign, own, other, middle, ends = 1.0 if c > 0.0 else -1.0, 0, 0, 0, 0
    for i in range(sample.n):
        if label[i] != a and label[i] != b:
            continue
        own, other = own + (label[i] == a), other + (label[i] == b)
        d = distance(x[i], p)
        gap = d - sign * distance(x[i], q)
        if abs(gap) > SLAB_SIGMAS * sample.sigma:
            return False
        if abs(gap) > TOLD_SIGMAS * sample.sigma:
            middle += abs(d / gap - 0.5) < 1.0 / 6.0
            ends += min(abs(d / gap), abs(d / gap - 1.0)) < 1.0 / 6.0
    if own == 0 or other == 0 or 2.0 * middle < DIP * ends:
        return False
    return laterally_mixed(x, label, a, b, np.argmax(np.abs(p[:3])))


@kernel
def merge_slabs(sample: PointSample, pieces: Pieces, count: int) -> Any:
    """Of planes that share one slab, one is left, fitted to the points of both. Returns the number
    of planes.
    """
    limit, k = sample.threshold * sample.threshold, count - 1
    while k > 0:
        nearest_planes(sample.x, sample.n, pieces.planes, count, limit, pieces.label)
        for j in range(k):
            if one_slab(sample, pieces, j, k):
                pieces.label[: sample.n][pieces.label[: sample.n] == k] = j
                fit_plane(
                    sample.x,
                    sample.n,
                    pieces.label,
                    j,
                    pieces.planes[j],
                    pieces.means[j],
                    pieces.inverses[j],
                )
                count = drop_plane(pieces, count, k)
                break
        k -= 1
    return count


@kernel
def _find_bounding_planes(sample: PointSample, pieces: Pieces, count: int) -> None:
    """Label the points with their nearest planes, and see which planes bound each other."""
    limit, label = sample.threshold * sample.threshold, pieces.label
    nearest_planes(sample.x, sample.n, pieces.planes, count, limit, label)
    bounding_sides(sample.x, sample.n, label, pieces.planes, count, sample.sigma, pieces.side)


@kernel
def _price_pieces(sample: PointSample, pieces: Pieces, count: int, most: float) -> Any:
    """Length of the pieces' description with their own parameters."""
    support = np.empty(MOST, np.int64)
    length, _ = pieces_cost(sample, pieces.planes, count, pieces.side, most, support)
    return length + count * (3.0 * np.log(sample.n) * sample.sigma * sample.sigma)


@inlined
def _refit_all(
    sample: PointSample, reach: float, pieces: Pieces, count: int, shares: Shares, across: float
) -> Any:
    """Refit all planes by the points' shares. Returns (number of planes left, farthest that one
    moved within ``reach``).
    """
    planes, moved, k, before = pieces.planes, 0.0, count - 1, np.empty(4)
    while k >= 0:
        before[:] = planes[k]
        used = fit_shares(
            sample.x, sample.n, shares.share[k], planes[k], pieces.means[k], pieces.inverses[k]
        )
        pieces.used[k] = used
        if used < FEWEST or (count > 1 and on_line(used, pieces.inverses[k], across)):
            count = drop_plane(pieces, count, k)
        else:
            turn = (
                (before[0] - planes[k, 0]) ** 2
                + (before[1] - planes[k, 1]) ** 2
                + (before[2] - planes[k, 2]) ** 2
            )
            moved = max(moved, abs(before[3] - planes[k, 3]) + reach * np.sqrt(turn))
        k -= 1
    return merge_coincident(pieces, count, sample.sigma), moved


@inlined
def _covariances(sample: PointSample, pieces: Pieces, count: int, shares: Shares) -> None:
    """``used``, ``means`` and ``inverses`` of the planes as they are, by what the points tell."""
    membership_shares(sample, pieces, count, shares)
    for k in range(count):
        information_ratio(sample, pieces.planes[k], shares.share[k])
        plane = pieces.planes[k].copy()
        used = fit_shares(
            sample.x, sample.n, shares.share[k], plane, pieces.means[k], pieces.inverses[k]
        )
        pieces.used[k] = max(FEWEST, used)


@kernel
def refine(
    sample: PointSample, reach: float, pieces: Pieces, count: int, rounds: int, across: float
) -> Any:
    """Share out the points within ``reach`` and refit all planes, in turn until none moves
    (expectation and maximisation), for ``rounds`` at most, and as many again after a plane is
    dropped.

    Planes that share one slab are merged before, and planes whose points lie on a line less than
    ``across`` wide are dropped. Returns the number of
    planes; ``used``, ``means`` and ``inverses`` give their covariance.
    """
    count = merge_slabs(sample, pieces, count)
    shares, start, at_first = room_for_shares(sample.n), pieces.planes.copy(), count
    _find_bounding_planes(sample, pieces, count)
    worst = WORSE * _price_pieces(sample, pieces, count, np.inf)
    step = 0
    while step < rounds:
        membership_shares(sample, pieces, count, shares)
        size = count
        count, moved = _refit_all(sample, reach, pieces, count, shares, across)
        if count < size:
            step = -1  # what is left has all its rounds
        if step < SETTLING:
            limit = sample.threshold * sample.threshold
            nearest_planes(sample.x, sample.n, pieces.planes, count, limit, pieces.label)
        elif moved < SETTLED * sample.sigma:
            break
        bounding_sides(
            sample.x, sample.n, pieces.label, pieces.planes, count, sample.sigma, pieces.side
        )
        step += 1
    if _price_pieces(sample, pieces, count, worst) > worst:
        count = at_first
        pieces.planes[:] = start
        _find_bounding_planes(sample, pieces, count)
    _covariances(sample, pieces, count, shares)
    return count
