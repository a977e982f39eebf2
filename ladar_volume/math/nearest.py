"""The nearest points of a cloud that lies in memory along a curve, neighbours beside neighbours.

Groups of consecutive points have boxes, and a complete binary tree of boxes stands above them. Each
search begins with an upper bound of the distance to the k-th nearest point: from the answer for the
place before, or from any k consecutive points. It collects the points within that bound and selects
the k nearest. The answer does not depend on the order of the points; the time does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F64, I32, I64
from ladar_volume.math.box_tree import join_boxes
from ladar_volume.math.kernels import kernel, leaf_kernel, parallel_kernel
from ladar_volume.math.normal_equations import select_kth

#: Points of a group; parts of the work that are shared out to the threads.
GROUP, CHUNKS = 16, 64
#: Factor by which rounding may raise a squared distance.
MARGIN = 1.0 + 1e-12


class NearestIndex(NamedTuple):
    """points : (n, 3) m · boxes : (2 k, 6) low x, y, z and high x, y, z; node i has children 2 i
    and 2 i + 1, groups are k to 2 k − 1
    """

    points: F64
    boxes: F64


@kernel
def group_boxes(points: F64, groups: int) -> F64:
    """The boxes (2 groups, 6) of points (n, 3) in their order."""
    boxes = np.empty((2 * groups, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for i in range(len(points)):
        node = groups + i // GROUP
        for c in range(3):
            boxes[node, c] = min(boxes[node, c], points[i, c])
            boxes[node, 3 + c] = max(boxes[node, 3 + c], points[i, c])
    join_boxes(boxes)
    return boxes


@leaf_kernel
def square_to(points: F64, i: int, place: F64) -> float:
    """Square of the distance from a place (3,) to point i."""
    dx, dy, dz = points[i, 0] - place[0], points[i, 1] - place[1], points[i, 2] - place[2]
    square: float = dx * dx + dy * dy + dz * dz
    return square


@leaf_kernel
def square_to_box(box: F64, place: F64) -> float:
    """Square of the distance from a place (3,) to a box (6,); infinite to one that is empty."""
    dx = max(max(box[0] - place[0], place[0] - box[3]), 0.0)
    dy = max(max(box[1] - place[1], place[1] - box[4]), 0.0)
    dz = max(max(box[2] - place[2], place[2] - box[5]), 0.0)
    square: float = dx * dx + dy * dy + dz * dz
    return square


@leaf_kernel
def bound_of(index: NearestIndex, place: F64, k: int) -> float:
    """An upper bound of the square of the distance to the k-th nearest point: the largest to k
    consecutive points about the group that lies down the path of the nearer child.
    """
    points, boxes = index.points, index.boxes
    node, groups, out = 1, len(boxes) // 2, 0.0
    while node < groups:
        left, right = boxes[2 * node], boxes[2 * node + 1]
        node = 2 * node + (square_to_box(right, place) < square_to_box(left, place))
    first = (node - groups) * GROUP + (GROUP - k) // 2
    first = max(min(first, len(points) - k), 0)
    for i in range(first, min(first + k, len(points))):
        out = max(out, square_to(points, i, place))
    return out


@leaf_kernel
def collect(
    index: NearestIndex, place: F64, bound: float, rows: I64, square: F64, stack: I64
) -> int:
    """The points within a square of a distance from a place (3,), in their order, and their
    squared distances. Returns how many there are, which may exceed the length of ``rows``: the rest
    is then not written.
    """
    points, boxes = index.points, index.boxes
    groups, count = len(boxes) // 2, 0
    stack[0], top = 1, 1
    while top > 0:
        top -= 1
        node = stack[top]
        while 0 < node < groups:
            left = square_to_box(boxes[2 * node], place) <= bound
            right = square_to_box(boxes[2 * node + 1], place) <= bound
            if left and right:
                stack[top] = 2 * node + 1
                top += 1
            node = 2 * node if left else 2 * node + 1 if right else 0
        if node == 0:
            continue
        for i in range((node - groups) * GROUP, min((node - groups + 1) * GROUP, len(points))):
            d = square_to(points, i, place)
            if d <= bound:
                if count < len(rows):
                    rows[count], square[count] = i, d
                count += 1
    return count


@kernel
def search_part(
    index: NearestIndex, places: F64, some: tuple[int, int], out: I32, far: F64
) -> None:
    """The k nearest points of places from some[0] to before some[1], into ``out`` (m, k) where that
    has columns, and how far the last of them is into ``far`` (m,).
    """
    k = out.shape[1]
    rows, square, sorted_ = np.empty(64, np.int64), np.empty(64), np.empty(64)
    stack = np.empty(128, np.int64)
    last = np.inf
    for i in range(some[0], some[1]):
        moved = square_to(places, max(i - 1, 0), places[i])
        bound = MARGIN * (math.sqrt(last) + math.sqrt(moved)) ** 2
        if not moved < last < np.inf:
            bound = min(bound, MARGIN * bound_of(index, places[i], k))
        count = collect(index, places[i], bound, rows, square, stack)
        if count > len(rows):
            rows, square = np.empty(2 * count, np.int64), np.empty(2 * count)
            sorted_ = np.empty(2 * count)
            count = collect(index, places[i], bound, rows, square, stack)
        sorted_[:count] = square[:count]
        last = select_kth(sorted_, count, k - 1)
        far[i] = math.sqrt(last)
        taken = 0
        for j in range(count):
            if square[j] < last:
                out[i, taken] = rows[j]
                taken += 1
        for j in range(count):
            if square[j] == last and taken < k:
                out[i, taken] = rows[j]
                taken += 1


@parallel_kernel
def nearest_kernel(index: NearestIndex, places: F64, out: I32, far: F64) -> None:
    """See :func:`nearest`."""
    n = len(places)
    for chunk in numba.prange(CHUNKS):
        search_part(index, places, (chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS), out, far)


def nearest_index(points: F64) -> NearestIndex:
    """The index of points (n, 3), m; give z = 0 for distances over the plane."""
    points, groups = np.ascontiguousarray(points, dtype=np.float64), 1
    while groups * GROUP < len(points):
        groups *= 2
    return NearestIndex(points, group_boxes(points, groups))


def nearest(index: NearestIndex, places: F64, k: int) -> tuple[I32, F64]:
    """Rows (m, k) of the k points nearest to places (m, 3), in no order, and the distances (m,) m
    of the farthest of them. Of several at that distance the first in the index are taken.

    Raises :class:`ValueError` where the index has fewer than k points.
    """
    if len(index.points) < k:
        raise ValueError(f"{k} neighbours of {len(index.points)} points")
    places = np.ascontiguousarray(places, dtype=np.float64)
    out, far = np.empty((len(places), k), np.int32), np.empty(len(places))
    nearest_kernel(index, places, out, far)
    return out, far
