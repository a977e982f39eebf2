"""Edges and corners as published (seed 002 section 4.2): up to three planes in one neighbourhood,
each in what the last left over.

Where the points off a plane are more than a share of the neighbourhood, they are fitted again. Two
planes meet in a line, three in a vertex; of each plane only the half with more of its points
counts. The source tells halves apart by octants of the map's axes; here they are the two sides of
the other plane, so any orientation works.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.clouds.filter.sharp_planes import distance, nearest_piece
from ladar_volume.clouds.published.published_rules import limit_of
from ladar_volume.clouds.published.random_samples import plane_and_scatter, sampled_plane
from ladar_volume.math.kernels import kernel

#: Most planes in a neighbourhood: the source omits four and more.
FACETS = 3
#: Planes at less than this sine of their angle have no intersection that means anything.
PARALLEL = 0.1
#: Depth beyond an edge, m, that is still on it.
ON_EDGE = 1e-9


@kernel
def nearest_distance(x: Any, planes: Any, count: Any) -> Any:
    """Distance of a point (3,) to the nearest of the planes, without bounds."""
    best = np.inf
    for k in range(count):
        best = min(best, abs(distance(x, planes[k])))
    return best


@kernel
def assign(x: Any, m: Any, planes: Any, count: Any, threshold: Any, label: Any) -> Any:
    """Label points (m, 3) with their nearest plane, −1 beyond the threshold of all; returns whether
    any label changed.
    """
    changed = False
    for i in range(m):
        own, best = -1, threshold
        for k in range(count):
            d = abs(distance(x[i], planes[k]))
            if d <= best:
                own, best = k, d
        changed |= label[i] != own
        label[i] = own
    return changed


@kernel
def settle(
    x: Any,
    m: Any,
    planes: Any,
    count: Any,
    sigma: Any,
    adapt: Any,
    rules: Any,
    label: Any,
    means: Any,
    inverses: Any,
    used: Any,
) -> Any:
    """Assign points and refit planes until no label changes. Returns (sigma, −1 where a plane lost
    its support; threshold).

    adapt : the threshold follows the scatter of the inliers, else it stays with the ``sigma``
    given.
    """
    label[:m] = -2
    threshold = limit_of(sigma, rules)
    for _ in range(rules.iterations):
        if not assign(x, m, planes, count, threshold, label):
            break
        square, free = 0.0, 0
        for k in range(count):
            used[k], s = plane_and_scatter(x, m, label, k, planes[k], means[k], inverses[k])
            if used[k] < rules.least:
                return -1.0, threshold
            square += s * s * (used[k] - 3)
            free += used[k] - 3
        sigma = np.sqrt(square / free)
        if adapt:
            threshold = limit_of(sigma, rules)
    return sigma, threshold


@kernel
def next_facet(
    x: Any, xt: Any, free: Any, left: Any, rules: Any, state: Any, s: Any, plane: Any
) -> Any:
    """A plane, refitted to a fixed point, among the points free[:left] of x (m, 3), which become
    those it leaves over.

    Returns (sigma, −1 for none; how many it leaves over; trials).
    """
    some, some_t, label = np.empty((left, 3)), np.empty((3, left)), np.empty(left, np.int64)
    for a in range(left):
        for k in range(3):
            some[a, k] = some_t[k, a] = x[free[a], k]
    planes, means, inverses, used = (
        np.zeros((1, 4)),
        np.zeros((1, 3)),
        np.zeros((1, 3, 3)),
        np.zeros(1, np.int64),
    )
    sigma, made = sampled_plane(
        some_t,
        left,
        rules.sample,
        rules.trials,
        rules.ransac,
        rules.ransac_threshold,
        rules.confidence,
        state,
        s.pick,
        s.work,
        planes[0],
    )
    if sigma < 0.0:
        return sigma, left, made
    # no adaption yet: across an edge the scatter would grow with the threshold, and the threshold
    # with it
    sigma, threshold = settle(
        some, left, planes, 1, sigma, False, rules, label, means, inverses, used
    )
    if sigma < 0.0:
        return sigma, left, made
    plane[:] = planes[0]
    rest = 0
    for a in range(left):
        if abs(distance(some[a], plane)) > threshold:
            free[rest] = free[a]
            rest += 1
    return sigma, rest, made


@kernel
def halves(x: Any, m: Any, label: Any, planes: Any, count: Any, side: Any) -> None:
    """side (k, k): +1 or −1, the side of another plane on which more of a plane's points lie; 0 for
    no majority or no intersection to speak of.
    """
    for a in range(count):
        for b in range(count):
            side[a, b] = 0
            c = (
                planes[a, 0] * planes[b, 0]
                + planes[a, 1] * planes[b, 1]
                + planes[a, 2] * planes[b, 2]
            )
            if a == b or 1.0 - c * c < PARALLEL * PARALLEL:
                continue
            balance = 0
            for i in range(m):
                if label[i] == a:
                    balance += 1 if distance(x[i], planes[b]) > 0.0 else -1
            side[a, b] = 1 if balance > 0 else -1 if balance < 0 else 0


@kernel
def fit_facets(
    x: Any,
    xt: Any,
    m: Any,
    rules: Any,
    state: Any,
    s: Any,
    planes: Any,
    means: Any,
    inverses: Any,
    used: Any,
    side: Any,
) -> Any:
    """One plane, or two or three where the ratio of outliers says so, fitted together to x (m, 3)
    with their halves.

    Returns (number of planes, sigma, threshold, trials).
    """
    for i in range(m):
        s.free[i] = i
    left, count, made = m, 0, 0
    sigma = first_sigma = threshold = -1.0
    start = np.empty((FACETS, 4))
    while count < FACETS and left >= rules.least and (count == 0 or left > rules.edges * m):
        sigma, rest, more = next_facet(x, xt, s.free, left, rules, state, s, start[count])
        made += more
        # a plane through scattered outliers is no facet: its points must pass the same ratio test
        if sigma < 0.0 or (count > 0 and left - rest <= rules.edges * m):
            break
        first_sigma = sigma if count == 0 else first_sigma
        count += 1
        left = rest
    while count > 0:  # together; where one of them starves, without the last
        planes[:count] = start[:count]
        sigma, threshold = settle(
            x, m, planes, count, first_sigma, True, rules, s.label, means, inverses, used
        )
        if sigma >= 0.0:
            break
        count -= 1
    if count > 1:
        halves(x, m, s.label, planes, count, side)
    return count, sigma, threshold, made


@kernel
def project_on_facets(x: Any, planes: Any, count: Any, side: Any, snap: Any, q: Any) -> Any:
    """Where a point (3,) goes, to q (3,). Returns (plane, distance, whether it is to be taken out
    as beyond an intersection).

    snap : to the nearest point of the half planes, which may lie on an edge or in a vertex. Else to
    the nearest plane, if the foot lies in its half.
    """
    p, square, _ = nearest_piece(x, planes, count, side, q)
    d = np.sqrt(square)
    if snap:
        return p, d, False
    p, best = 0, np.inf
    for k in range(count):
        if abs(distance(x, planes[k])) < best:
            p, best = k, abs(distance(x, planes[k]))
    height = distance(x, planes[p])
    for k in range(3):
        q[k] = x[k] - height * planes[p, k]
    for b in range(count):
        if side[p, b] * distance(q, planes[b]) < -ON_EDGE:
            return p, d, True
    return p, best, False
