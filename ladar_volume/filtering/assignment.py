"""Which point belongs to which of several planes, and the planes from their points, to a fixed point."""

from __future__ import annotations

from typing import Any

import numpy as np

from ladar_volume.filtering.pieces import MOST, bounds, distance, fit_plane, nearest_pieces, nearest_planes
from ladar_volume.model.kernels import kernel

#: Rounds of assignment and refit.
ROUNDS = 8
#: Share of the points nearest to a plane that must be its own beyond doubt, to be fitted to these alone.
SURE = 0.25
#: Least width of the strip of these, as standard deviation in noise sigma.
WIDTH = 1.5
#: Rounds before the points beyond doubt tell where planes end.
SETTLING = 1
#: Planes closer than this, as the sine of their angle, are one where they also lie within the noise of each other.
SAME_SINE = 0.1


@kernel
def clearances(planes: Any, count: Any, side: Any, sigma: Any, threshold: Any, out: Any) -> None:
    """out (k, k): how far from plane b a foot point on plane a must lie for the point to be a's beyond doubt.

    Points of b err by up to 2 sigma and count for a within the threshold. Where a is known to end at b, b's points stand over
    a's own side only if the angle between the two pieces is acute; else just their noise reaches across the edge.
    """
    for a in range(count):
        for b in range(count):
            c = planes[a, 0] * planes[b, 0] + planes[a, 1] * planes[b, 1] + planes[a, 2] * planes[b, 2]
            out[a, b] = threshold * abs(c) + 2.0 * sigma
            if side[a, b] != 0 and side[b, a] != 0:
                # directions in each plane away from the edge: t_a = side_ab (n_b - c n_a), so t_a . t_b = -side side c (1 - c²)
                fold = -side[a, b] * side[b, a] * c
                out[a, b] = threshold * c * fold / abs(c) + 2.0 * sigma if fold > 0.0 else 2.0 * sigma * (1.0 - c * c)


@kernel
def assign(x: Any, m: Any, planes: Any, count: Any, side: Any, clear: Any, threshold: Any, label: Any) -> None:
    """Label every point with its plane; −1 beyond the threshold of all, −2 where its plane is in doubt.

    In doubt are the points along an intersection: a choice by distance would pull the planes towards each other. The strip is
    cut by where the *foot point* lies, which does not depend on the point's own noise.
    """
    for i in range(m):
        label[i] = -1
        nearest = np.inf
        for a in range(count):
            d = distance(x[i], planes[a])
            if abs(d) > threshold:
                continue
            own = True
            for b in range(count):
                if b == a:
                    continue
                c = planes[a, 0] * planes[b, 0] + planes[a, 1] * planes[b, 1] + planes[a, 2] * planes[b, 2]
                e = distance(x[i], planes[b]) - d * c  # of the foot point
                e = e * side[a, b] if side[a, b] != 0 else abs(e)
                own = own and e > clear[a, b]
            if own and abs(d) < nearest:
                nearest = abs(d)
                label[i] = a
            elif label[i] == -1:
                label[i] = -2


@kernel
def drop_plane(planes: Any, means: Any, inverses: Any, used: Any, count: Any, k: Any) -> Any:
    """Close the gap of plane k; returns the new count."""
    for j in range(k, count - 1):
        planes[j], means[j], inverses[j], used[j] = planes[j + 1], means[j + 1], inverses[j + 1], used[j + 1]
    return count - 1


@kernel
def merge_same(planes: Any, means: Any, inverses: Any, used: Any, count: Any, sigma: Any) -> Any:
    """Drop planes that another one explains: nearly parallel, and within the noise of it at their own centre."""
    k = count - 1
    while k > 0:
        for j in range(k):
            c = abs(planes[j, 0] * planes[k, 0] + planes[j, 1] * planes[k, 1] + planes[j, 2] * planes[k, 2])
            near = abs(distance(means[k], planes[j])) < sigma
            if near and np.sqrt(max(0.0, 1.0 - c * c)) < SAME_SINE:
                count = drop_plane(planes, means, inverses, used, count, k)
                break
        k -= 1
    return count


@kernel
def refine(
    x: Any, m: Any, planes: Any, means: Any, inverses: Any, used: Any, count: Any, sigma: Any, threshold: Any, least: Any, side: Any,
    label: Any,
) -> Any:  # fmt: skip
    """Assign and refit all planes until no label changes. Returns the number of planes.

    A plane with too few points beyond doubt, or in too narrow a strip to tell its tilt from the noise, is fitted to all that are
    nearest to its piece.
    """
    before, nearest, clear, trial = np.full(m, -3), np.empty(m, np.int64), np.zeros((MOST, MOST)), np.empty(4)
    nearest_planes(x, m, planes, count, threshold * threshold, label)
    bounds(x, m, label, planes, count, sigma, side)
    for step in range(ROUNDS):
        clearances(planes, count, side, sigma, threshold, clear)
        assign(x, m, planes, count, side, clear, threshold, label)
        nearest_pieces(x, m, planes, count, side, threshold * threshold, nearest)
        for k in range(count):
            trial[:] = planes[k]
            sure, width = fit_plane(x, m, label, k, trial, means[k], inverses[k])
            if sure < max(least, np.int64(SURE * np.count_nonzero(nearest == k))) or width < WIDTH * sigma:
                for i in range(m):
                    if nearest[i] == k:
                        label[i] = k
        changed = False
        for i in range(m):
            changed |= before[i] != label[i]
            before[i] = label[i]
        if not changed:
            break
        k = count - 1
        while k >= 0:
            used[k], _ = fit_plane(x, m, label, k, planes[k], means[k], inverses[k])
            if used[k] == 0:
                count = drop_plane(planes, means, inverses, used, count, k)
                nearest_planes(x, m, planes, count, threshold * threshold, label)
            k -= 1
        count = merge_same(planes, means, inverses, used, count, sigma)
        if step < SETTLING:
            nearest_planes(x, m, planes, count, threshold * threshold, label)
        bounds(x, m, label, planes, count, sigma, side)
    return count
