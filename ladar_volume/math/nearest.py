"""The nearest points of a cloud that lies in memory along a curve, neighbours beside neighbours.

Groups of consecutive points have boxes, and a complete binary tree of boxes stands above them. The
points near a block of places are gathered at once, within what was far enough for the block before;
where that is not enough a place searches alone, nearer boxes first. The answer does not depend on
the order of the points; the time does.
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
#: Places of a block, room for the points near one, and what is more than enough for the next.
BLOCK, ROOM, WIDER = 24, 512, 1.2


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
def insert_square(best: F64, square: float) -> None:
    """Put a number below the last of the ascending ``best`` (k,) in its place; the last goes."""
    i = len(best) - 1
    while i > 0 and best[i - 1] > square:
        best[i] = best[i - 1]
        i -= 1
    best[i] = square


@leaf_kernel
def kth_square(index: NearestIndex, place: F64, best: F64, stack: I64) -> float:
    """The square of the distance to the k-th nearest point, with those of all k in ``best`` (k,):
    nearer boxes are looked at first, and none that is farther than the k-th point so far.
    """
    points, boxes = index.points, index.boxes
    groups = len(boxes) // 2
    best[:] = np.inf
    stack[0], top = 1, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if square_to_box(boxes[node], place) > best[-1]:
            continue
        while node < groups:
            left = square_to_box(boxes[2 * node], place)
            right = square_to_box(boxes[2 * node + 1], place)
            nearer = np.int64(right < left)
            if max(left, right) <= best[-1]:
                stack[top] = 2 * node + 1 - nearer
                top += 1
            node = 2 * node + nearer
        for i in range((node - groups) * GROUP, min((node - groups + 1) * GROUP, len(points))):
            d = square_to(points, i, place)
            if d < best[-1]:
                insert_square(best, d)
    last: float = best[-1]
    return last


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


class Some(NamedTuple):
    """Places from ``first`` to before ``end``, and how many points near each are asked for."""

    first: int
    end: int
    k: int


class Gathered(NamedTuple):
    """Room for the points about a block of places. row : (c,) of the points · at : (3, c) m, where
    they are · far : (c,) m², of all from one place · near, square : (c,) numbers and m² of those
    within a distance · sorted : (c,) m², to be put in order · stack : (128,) of nodes · box : (6,)
    of the block
    """

    row: I64
    at: F64
    far: F64
    near: I64
    square: F64
    sorted: F64
    stack: I64
    box: F64


@leaf_kernel
def square_between(one: F64, two: F64) -> float:
    """Square of the distance between boxes (6,); infinite to one that is empty."""
    out = 0.0
    for c in range(3):
        d = max(max(one[c] - two[3 + c], two[c] - one[3 + c]), 0.0)
        out += d * d
    return out


@leaf_kernel
def gather(index: NearestIndex, found: Gathered, bound: float) -> int:
    """The points within a square of a distance from the box of a block, in their order. Returns how
    many there are, or -1 where they are more than there is room for.
    """
    points, boxes, stack, box = index.points, index.boxes, found.stack, found.box
    groups, count = len(boxes) // 2, 0
    stack[0], top = 1, 1
    while top > 0:
        top -= 1
        node = stack[top]
        if not square_between(boxes[node], box) <= bound:
            continue
        if node < groups:
            stack[top], stack[top + 1] = 2 * node + 1, 2 * node
            top += 2
            continue
        if count + GROUP > len(found.row):
            return -1
        for i in range((node - groups) * GROUP, min((node - groups + 1) * GROUP, len(points))):
            found.row[count] = i
            for c in range(3):
                found.at[c, count] = points[i, c]
            # one that is too far leaves its place to the next
            count += square_to_box(box, points[i]) <= bound
    return count


@leaf_kernel
def within(found: Gathered, count: int, place: F64, bound: float) -> int:
    """How many of the points gathered lie within a square of a distance from a place (3,): these
    stand first in ``near`` and ``square``, in their order.
    """
    x, y, z, n = place[0], place[1], place[2], 0
    far, at = found.far, found.at
    for j in range(count):
        dx, dy, dz = at[0, j] - x, at[1, j] - y, at[2, j] - z
        far[j] = dx * dx + dy * dy + dz * dz
    for j in range(count):
        found.near[n], found.square[n], found.sorted[n] = found.row[j], far[j], far[j]
        n += far[j] <= bound
    return n


@leaf_kernel
def write_nearest(rows: I64, square: F64, count: int, last: float, out: I32) -> None:
    """Write the rows that are nearer than a squared distance into out (k,), then as many of those
    at that distance as it has room for.
    """
    taken, k = 0, len(out)
    for j in range(count):
        if square[j] < last:
            out[taken] = rows[j]
            taken += 1
    for j in range(count):
        if square[j] == last and taken < k:
            out[taken] = rows[j]
            taken += 1


@kernel
def search_one(index: NearestIndex, place: F64, k: int, out: I32) -> float:
    """The k nearest points of one place (3,), into out (k,), which may be empty, and the square of
    the distance to the last of them.
    """
    rows, square, stack = np.empty(64, np.int64), np.empty(64), np.empty(128, np.int64)
    last: float = kth_square(index, place, square[:k] if k <= 64 else np.empty(k), stack)
    if len(out):
        count = collect(index, place, last, rows, square, stack)
        if count > len(rows):
            rows, square = np.empty(count, np.int64), np.empty(count)
            count = collect(index, place, last, rows, square, stack)
        write_nearest(rows, square, count, last, out)
    return last


@leaf_kernel
def box_of(places: F64, first: int, end: int, box: F64) -> None:
    """Write the box (6,) of the places from ``first`` to before ``end``."""
    for c in range(3):
        box[c], box[3 + c] = np.inf, -np.inf
        for i in range(first, end):
            box[c], box[3 + c] = min(box[c], places[i, c]), max(box[3 + c], places[i, c])


@kernel
def search_part(index: NearestIndex, places: F64, some: Some, out: I32, far: F64) -> None:
    """The k nearest points of some places (m, 3), into ``out`` (m, k), which may have no columns,
    and how far the last of them is into ``far`` (m,).

    The points near a block of places are gathered once: those within the distance that was enough
    for the block before, and a little more. A place for which that is not enough searches alone.
    """
    first, end, k, c = some.first, some.end, some.k, ROOM
    found = Gathered(
        np.empty(c, np.int64),
        np.empty((3, c)),
        np.empty(c),
        np.empty(c, np.int64),
        np.empty(c),
        np.empty(c),
        np.empty(128, np.int64),
        np.empty(6),
    )
    guess = -1.0
    for a in range(first, end, BLOCK):
        b = min(a + BLOCK, end)
        count, widest = -1, 0.0
        if guess > 0.0:
            box_of(places, a, b, found.box)
            count = gather(index, found, guess)
        for i in range(a, b):
            n, last = 0, np.inf
            if count >= k:
                n = within(found, count, places[i], guess)
            if n >= k:
                last = select_kth(found.sorted, n, k - 1)
                if out.shape[1]:
                    write_nearest(found.near, found.square, n, last, out[i])
            else:
                last = search_one(index, places[i], k, out[i])
            far[i] = math.sqrt(last)
            widest = max(widest, last)
        guess = WIDER * widest


@parallel_kernel
def nearest_kernel(index: NearestIndex, places: F64, k: int, out: I32, far: F64) -> None:
    """See :func:`nearest`."""
    n = len(places)
    for chunk in numba.prange(CHUNKS):
        some = Some(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS, k)
        search_part(index, places, some, out, far)


def nearest_index(points: F64) -> NearestIndex:
    """The index of points (n, 3), m; give z = 0 for distances over the plane."""
    points, groups = np.ascontiguousarray(points, dtype=np.float64), 1
    while groups * GROUP < len(points):
        groups *= 2
    return NearestIndex(points, group_boxes(points, groups))


def check_count(index: NearestIndex, k: int) -> None:
    """Raise :class:`ValueError` where the index has fewer than k points."""
    if len(index.points) < k:
        raise ValueError(f"{k} neighbours of {len(index.points)} points")


def nearest(index: NearestIndex, places: F64, k: int) -> tuple[I32, F64]:
    """Rows (m, k) of the k points nearest to places (m, 3), in no order, and the distances (m,) m
    of the farthest of them. Of several at that distance the first in the index are taken.

    Raises :class:`ValueError` where the index has fewer than k points.
    """
    check_count(index, k)
    places = np.ascontiguousarray(places, dtype=np.float64)
    out, far = np.empty((len(places), k), np.int32), np.empty(len(places))
    nearest_kernel(index, places, k, out, far)
    return out, far


def nearest_distances(index: NearestIndex, places: F64, k: int) -> F64:
    """How far (m,) m the k-th nearest point of places (m, 3) is; raises as :func:`nearest` does."""
    check_count(index, k)
    places = np.ascontiguousarray(places, dtype=np.float64)
    far = np.empty(len(places))
    nearest_kernel(index, places, k, np.empty((len(places), 0), np.int32), far)
    return far
