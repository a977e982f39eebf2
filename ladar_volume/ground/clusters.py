"""Euclidean clusters: points connected by steps of at most a given distance.

Cells with the distance as diagonal hold points that are all connected; two cells are joined where a
pair of their points is near enough. Cells that are joined already, by way of nearer ones, need no
such test, so dense clouds cost no list of pairs. The result does not depend on the order of the
points.
"""

from __future__ import annotations

import itertools

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.math.union_find import root_of
from ladar_volume.model.errors import ObjectError
from ladar_volume.model.records import F64, I64, Bool

#: Bits of a packed cell number per axis.
BITS = 21
#: Half of the steps to cells that can hold a point within the distance, nearest first.
STEPS = sorted(
    (s for s in itertools.product(range(-2, 3), repeat=3) if s > (0, 0, 0)),
    key=lambda s: (sum(c * c for c in s), s),
)


@kernel
def join_cells(points: F64, start: I64, left: I64, right: I64, limit2: float, root: I64) -> None:
    """Join cells left[k] and right[k] (k,) in ``root`` where two of their points (rows start[c] to
    start[c + 1]) are near enough.
    """
    for k in range(len(left)):
        a, b = root_of(root, left[k]), root_of(root, right[k])
        if a == b:
            continue
        near = False
        for i in range(start[left[k]], start[left[k] + 1]):
            for j in range(start[right[k]], start[right[k] + 1]):
                x, y, z = (
                    points[i, 0] - points[j, 0],
                    points[i, 1] - points[j, 1],
                    points[i, 2] - points[j, 2],
                )
                if x * x + y * y + z * z <= limit2:
                    near = True
                    break
            if near:
                break
        if near:
            root[max(a, b)] = min(a, b)


@kernel
def flatten_roots(root: I64) -> None:
    """Every cell (c,) straight to its root: none is after the cells it leads to."""
    for i in range(len(root)):
        root[i] = root[root[i]]


def component_labels(points: F64, distance_m: float) -> I64:
    """Number (n,) of the connected component of each point (n, 3) m, components in no particular
    order.

    Raises :class:`ObjectError` where the distance is too small for the extent of the points.
    """
    edge = distance_m / np.sqrt(3.0) * (1.0 - 1e-9)
    cell = np.floor((points - points.min(axis=0)) / edge)
    if cell.max() >= 2**BITS - 4:
        raise ObjectError(
            f"points {np.ptp(points, axis=0).max():g} m apart cannot be connected in "
            f"steps of {distance_m:g} m: raise distance_m or cut "
            "the cloud",
            reason="object_distance",
            value=distance_m,
        )
    number = cell.astype(np.int64) + 2  # steps of two stay positive
    key = (number[:, 0] << 2 * BITS) | (number[:, 1] << BITS) | number[:, 2]
    order = np.argsort(key, kind="stable")
    unique, first = np.unique(key[order], return_index=True)
    start = np.append(first, len(points)).astype(np.int64)
    ordered, root = np.ascontiguousarray(points[order]), np.arange(len(unique), dtype=np.int64)
    for x, y, z in STEPS:
        wanted = unique + (x << 2 * BITS) + (y << BITS) + z
        right = np.minimum(np.searchsorted(unique, wanted), len(unique) - 1).astype(np.int64)
        left = np.flatnonzero(unique[right] == wanted).astype(np.int64)
        join_cells(ordered, start, left, right[left], distance_m * distance_m, root)
    flatten_roots(root)
    label = np.empty(len(points), dtype=np.int64)
    label[order] = np.repeat(root, np.diff(start))
    return label


def clusters(points: F64, distance_m: float, min_points: int, chosen: Bool | None = None) -> I64:
    """Labels (n,) of clusters of the chosen points with at least ``min_points`` points: 0 the
    largest, equal ones by their first point in x, y, z; −1 for the others.
    """
    rows = np.arange(len(points)) if chosen is None else np.flatnonzero(chosen)
    out = np.full(len(points), -1, dtype=np.int64)
    if len(rows) == 0:
        return out
    p = points[rows]
    _, component, count = np.unique(
        component_labels(p, distance_m), return_inverse=True, return_counts=True
    )
    first = np.full(len(count), len(p), dtype=np.int64)
    rank = np.empty(len(p), dtype=np.int64)
    rank[np.lexsort((p[:, 2], p[:, 1], p[:, 0]))] = np.arange(len(p))
    np.minimum.at(first, component.ravel(), rank)
    by_size = np.lexsort((first, -count))
    new = np.full(len(count), -1, dtype=np.int64)
    kept = by_size[count[by_size] >= min_points]
    new[kept] = np.arange(len(kept))
    out[rows] = new[component.ravel()]
    return out
