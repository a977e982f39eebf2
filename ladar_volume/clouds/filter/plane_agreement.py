"""The planes that neighbourhoods agree in: where more planes come together than any one of them
told apart, together they know them all.

Every cell chooses the planes that describe its own surroundings. Of three within a few widths of
the noise it may miss one and lean the others, but then its neighbours, which see more of one and
less of another, rarely err alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.cell_records import (
    BestSet,
    NeighbourSets,
    PieceBounds,
    PointSample,
)
from ladar_volume.clouds.filter.plane_set_selection import (
    CHANCE,
    contains_plane,
    description_length,
    fit_quality,
    planes_coincide,
    remove_plane,
    thin_sample,
)
from ladar_volume.clouds.filter.sharp_planes import MOST, distance, nearest_planes
from ladar_volume.math.array_types import F64, I64
from ladar_volume.math.kernels import kernel, leaf_kernel

#: Planes agree that are nowhere in half the neighbourhood farther apart than this, in sigma; within
#: the second they are no two.
AGREE, APART = 0.75, 1.5
#: A plane that so many of the sets have, and one set of this many, is agreed in.
VOTES, OF = 3, 4


@kernel
def neighbours_agree(
    planes: F64, count: int, sets: NeighbourSets, reach: float, sigma: float
) -> Any:
    """Whether the neighbours' sets agree in every one of ``count`` planes."""
    number = len(sets.planes)
    for b in range(count):
        votes = 0
        for a in range(number):
            votes += contains_plane(sets.planes[a], sets.sizes[a], planes[b], reach, AGREE * sigma)
        if votes < VOTES or OF * votes < number:
            return False
    return True


@kernel
def planes_by_vote(sets: NeighbourSets, reach: float, sigma: float, out: F64) -> Any:
    """The planes that most of the neighbours' sets agree in, to out (n, 4), the most frequent
    first; returns how many.
    """
    total, n, number = sets.sizes.sum(), 0, 0
    each, votes = np.empty((total, 4)), np.ones(total, np.int64)
    for a in range(len(sets.planes)):
        for k in range(sets.sizes[a]):
            each[n] = sets.planes[a, k]
            n += 1
    for a in range(n):
        for b in range(a):
            if planes_coincide(each[a], each[b], reach, AGREE * sigma):
                votes[a] += 1
                votes[b] += 1
    while number < len(out):
        best = np.argmax(votes)
        if votes[best] == 0:
            break
        out[number] = each[best]
        for a in range(n):
            if planes_coincide(each[a], out[number], reach, APART * sigma):
                votes[a] = 0
        number += 1
    return number


@kernel
def drop_unsupported(sample: PointSample, planes: F64, size: int, need: int, label: I64) -> Any:
    """Drop planes to which fewer than ``need`` points of the sample are nearest, the one with
    fewest first; returns how many are left.
    """
    support, limit = np.empty(MOST, np.int64), sample.threshold * sample.threshold
    while size > 0:
        nearest_planes(sample.x, sample.n, planes, size, limit, label)
        support[:size] = 0
        for i in range(sample.n):
            if label[i] >= 0:
                support[label[i]] += 1
        k = np.argmin(support[:size])
        if support[k] >= need:
            break
        size = remove_plane(planes, size, k, planes)
    return size


@leaf_kernel
def leave_one_out_squares(y: F64, n: int, planes: F64, size: int, limit: float, out: F64) -> None:
    """Sum of the squared distances of points (n, 3) to the nearest of the planes but one, each at
    most the limit, to out (size,): for every plane that is left out.
    """
    total = 0.0
    out[:size] = 0.0
    for i in range(n):
        nearest, second, which = limit, limit, 0
        for k in range(size):
            d = distance(y[i], planes[k])
            if d * d < nearest:
                nearest, second, which = d * d, nearest, k
            elif d * d < second:
                second = d * d
        total += nearest
        out[which] += second - nearest
    for k in range(size):
        out[k] += total


@kernel
def drop_superfluous(sample: PointSample, planes: F64, size: int, bounds: PieceBounds) -> Any:
    """Drop planes one at a time, whichever shortens the description of the points that the sample
    stands for most, as long as one does; returns how many are left. The sum of the squares to
    the unbounded planes is a lower bound; they come in its order.
    """
    n, m, limit = sample.n, sample.m, sample.threshold * sample.threshold
    other, least = np.zeros((MOST, 4)), np.empty(MOST)
    price = 3.0 * np.log(m) * sample.sigma * sample.sigma
    length = description_length(sample, planes, size, 0, np.inf, bounds)
    while size > 1:
        best = -1
        leave_one_out_squares(sample.x, n, planes, size, limit, least)
        for k in np.argsort(least[:size]):
            if least[k] * m / n + (size - 1) * price >= length:
                break
            left = remove_plane(planes, size, k, other)
            shorter = description_length(sample, other, left, 0, length, bounds)
            if shorter < length:
                best, length = k, shorter
        if best < 0:
            break
        size = remove_plane(planes, size, best, planes)
    return size


@kernel
def consensus_planes(
    whole: PointSample,
    own: F64,
    reach: float,
    sets: NeighbourSets,
    best: BestSet,
    least: int,
    planes: F64,
    bounds: PieceBounds,
) -> Any:
    """The planes that the neighbours' sets agree in, without those that explain nothing here, where
    they describe all points better than the planes of the ``best`` single set, which ``planes``
    holds. Returns their number.

    Not asked where the neighbours agree in the planes of that set, and these leave no more than the
    noise.
    """
    count, sigma = best.size, whole.sigma
    if (
        neighbours_agree(planes, count, sets, reach, sigma)
        and fit_quality(whole, own, planes, count, bounds) == 2
    ):
        return count
    sample, need = thin_sample(whole, least)
    trial = np.zeros((MOST, 4))
    size = planes_by_vote(sets, reach, sigma, trial)
    size = drop_unsupported(sample, trial, size, max(need // 2, 1), bounds.label)
    known = 0
    for a in range(size):
        known += contains_plane(planes, count, trial[a], reach, AGREE * sigma)
    if size == 0 or known == size == count:
        return count
    size = drop_superfluous(sample, trial, size, bounds)
    need = max(least // 2, int(0.5 * CHANCE * whole.m))
    if description_length(whole, trial, size, need, best.cost, bounds) < best.cost:
        planes[:size] = trial[:size]
        return size
    return count
