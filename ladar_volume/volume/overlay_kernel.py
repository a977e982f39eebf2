"""Kernels of the overlay of two triangulations: pairs of triangles, clipped and integrated.

For each triangle of one surface (the subject) those of the other that it meets are found from
neighbour to neighbour: where a piece was cut off by an edge, the triangle beyond that edge comes
next. What the pieces found so leave of the subject's area - at the rim of the other surface, over
its holes, where very many small triangles lie below a large one - sends the subject to the other
surface's tree instead, so nothing depends on the walk being complete.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from ladar_volume.math.kernels import inlined, kernel, parallel_kernel, signed
from ladar_volume.model.records import F64, I64
from ladar_volume.tin.locate import CHUNKS, search_boxes
from ladar_volume.volume.triangle_clipping import CORNERS, PAIR, ROWS, A, B, add_piece, clip_pair

#: Steps of a walk to a triangle's centre and triangles met below one, beyond which the tree is
#: asked.
STEPS, FEW = 1024, 96
#: Part of a triangle's area that pieces may miss by rounding.
MISSED = 1e-9
#: Pieces whose integrals wait to be added to the other surface's triangles, per chunk. Only one
#: thread adds, always in the same order.
WAITING = 4096


class Overlaid(NamedTuple):
    """Two surfaces. corners : (m, 3, 3) x, y and height of the subject's triangles, m · other : (k,
    3, 3) of the other surface, in the order of its tree · neighbours : (k, 3) in that order, −1 for
    none · tree : its boxes · sign : 1 where the subject is the upper one, else −1
    """

    corners: F64
    other: F64
    neighbours: I64
    tree: F64
    sign: float


class Integrals(NamedTuple):
    """Where pieces go. out : (m, 2, 4) integrals by triangle of the subject · ids, rows : (chunks,
    waiting) and (chunks, waiting, 6) triangles of the other surface and what waits to be added to
    them; of no chunk where that is not wanted
    """

    out: F64
    ids: I64
    rows: F64


class Scratch(NamedTuple):
    """Of one chunk. w : (rows, corners) of the clipping · triangles : (n,) triangles met."""

    w: F64
    triangles: I64


@kernel
def walk(corners: F64, neighbours: I64, start: int, x: float, y: float) -> int:
    """Triangle that holds a point, or borders it by rounding, walking from triangle ``start``; −1
    where the walk ends elsewhere.
    """
    t = start
    for _ in range(STEPS):
        if t < 0:
            return -1
        leave = -1
        for k in range(3):
            i, j = (k + 1 if k < 2 else 0), (k - 1 if k > 0 else 2)
            px, py = corners[t, i, 0], corners[t, i, 1]
            if (corners[t, j, 0] - px) * (y - py) - (corners[t, j, 1] - py) * (x - px) < 0.0:
                leave = k
                break
        if leave < 0:
            return t
        t = neighbours[t, leave]
    return -1


@kernel
def shift(corners: F64, t: int, x0: float, y0: float, w: F64, row: int) -> None:
    """Triangle t about a point into the scratch: differences of large map coordinates are exact or
    nearly so, their products are not.
    """
    for k in range(3):
        w[row, k], w[row + 1, k], w[row + 2, k] = (
            corners[t, k, 0] - x0,
            corners[t, k, 1] - y0,
            corners[t, k, 2],
        )


@kernel
def note(w: F64, o: int, ids: I64, rows: F64, chunk: int, used: int) -> int:
    """Keeps a piece's integrals by the other surface for later; returns how many are kept."""
    ids[chunk, used] = o
    for side in range(2):
        rows[chunk, used, 3 * side] = w[PAIR + side, 0]
        rows[chunk, used, 3 * side + 1], rows[chunk, used, 3 * side + 2] = (
            w[PAIR + side, 4],
            w[PAIR + side, 5],
        )
    return used + 1


@inlined
def along_neighbours(
    t: int,
    start: int,
    pair: Overlaid,
    into: Integrals,
    scratch: Scratch,
    chunk: int,
    used: int,
) -> tuple[float, int, int]:
    """Adds the pieces of triangle t met from neighbour to neighbour, beginning with triangle
    ``start``, to ``out[t]``: their area, how many pieces are kept now, and the last triangle with a
    piece, −1 for none.
    """
    w, found, ids = scratch.w, scratch.triangles, into.ids
    x0, y0 = pair.corners[t, 0, 0], pair.corners[t, 0, 1]
    covered, last, i, count = 0.0, -1, 0, 1
    found[0] = start
    while i < count and count <= FEW - 3:
        o = found[i]
        i += 1
        shift(pair.other, o, x0, y0, w, B)
        s, n, cut = clip_pair(w)
        if n < 3:
            continue
        covered += add_piece(t, pair.sign, w, s, n, into.out)
        last = o
        if len(ids) > 0:
            used = note(w, o, ids, into.rows, chunk, used)
        for k in range(3):
            beyond = pair.neighbours[o, k]
            if (cut >> k) & 1 == 0 or beyond < 0:
                continue
            known = False
            for j in range(count):
                known = known or found[j] == beyond
            if not known:
                found[count] = beyond
                count += 1
    return (covered if i == count else -1.0), used, last


@inlined
def from_tree(
    t: int,
    entry: int,
    pair: Overlaid,
    into: Integrals,
    scratch: Scratch,
    chunk: int,
    used: int,
) -> tuple[int, int, int]:
    """Adds the pieces of triangle t with those whose boxes it meets, from the one numbered
    ``entry`` on: where to go on (−1: all done), how many pieces are kept now, and the last triangle
    with a piece, −1 for none.
    """
    corners, other, w, found, ids = pair.corners, pair.other, scratch.w, scratch.triangles, into.ids
    stack, box, last = np.empty(128, np.int64), np.empty(4), -1
    for c in range(2):
        box[c] = min(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c])
        box[2 + c] = max(corners[t, 0, c], corners[t, 1, c], corners[t, 2, c])
    count = search_boxes(pair.tree, len(other), box, stack, found)
    if count > len(found):
        found = np.empty(count, np.int64)
        search_boxes(pair.tree, len(other), box, stack, found)
    while entry < count:
        if len(ids) > 0 and used == WAITING:
            return entry, used, last
        o = found[entry]
        entry += 1
        shift(other, o, corners[t, 0, 0], corners[t, 0, 1], w, B)
        s, n, _ = clip_pair(w)
        if n >= 3:
            add_piece(t, pair.sign, w, s, n, into.out)
            last = o
            if len(ids) > 0:
                used = note(w, o, ids, into.rows, chunk, used)
    return -1, used, last


@kernel
def chunk_kernel(chunk: int, stop: int, state: I64, pair: Overlaid, into: Integrals) -> None:
    """Works on the triangles of a chunk until they end or the pieces fill ``rows``. state[chunk] :
    next triangle, next entry of its tree search (−1: not begun), where the last walk ended, pieces
    kept.
    """
    corners, scratch = pair.corners, Scratch(np.empty((ROWS, CORNERS)), np.empty(1024, np.int64))
    w = scratch.w
    t, entry, last, used = state[chunk, 0], state[chunk, 1], state[chunk, 2], 0
    while t < stop and used + FEW <= WAITING:
        x0, y0 = corners[t, 0, 0], corners[t, 0, 1]
        shift(corners, t, x0, y0, w, A)
        area = 0.5 * (w[A, 1] * w[A + 1, 2] - w[A + 1, 1] * w[A, 2])
        if area <= 0.0:  # a sliver whose area rounds to nothing holds no volume
            t += 1
            continue
        if entry < 0:
            before, covered, entry = used, -1.0, 0
            at = walk(
                pair.other,
                pair.neighbours,
                last,
                x0 + (w[A, 1] + w[A, 2]) / 3.0,
                y0 + (w[A + 1, 1] + w[A + 1, 2]) / 3.0,
            )
            if at >= 0:
                covered, used, at = along_neighbours(t, at, pair, into, scratch, chunk, used)
            if abs(covered - area) <= MISSED * area:
                t, entry, last = t + 1, -1, at
                continue
            used = before
            into.out[t] = 0.0
        entry, used, at = from_tree(t, entry, pair, into, scratch, chunk, used)
        last = at if at >= 0 else last
        if entry >= 0:
            break
        t += 1
    state[chunk, 0], state[chunk, 1], state[chunk, 2], state[chunk, 3] = t, entry, last, used


@kernel
def add_kept_pieces(state: I64, ids: I64, rows: F64, back: F64) -> None:
    """Adds the kept pieces to the triangles (k, 2, 4) of the other surface."""
    for chunk in range(len(ids)):
        for i in range(state[chunk, 3]):
            o = ids[chunk, i]
            for side in range(2):
                for c in range(3):
                    back[o, side, c] += rows[chunk, i, 3 * side + c]


@parallel_kernel
def overlay_kernel(
    corners: F64, other: F64, neighbours: I64, tree: F64, sign: float, both: bool
) -> tuple[F64, F64]:
    """Integrals (m, 2, 4) over each triangle (m, 3, 3), x, y and height of its corners, above and
    below the other surface: area, those of the second and third barycentric coordinate, and
    ∫|difference|; with ``both`` also (k, 2, 4) the first three by the triangles of the other
    surface. Both are in the order of their trees; neighbours : (k, 3) of the other surface in that
    order, −1 for none.
    """
    m = len(corners)
    out, back = np.zeros((m, 2, 4)), np.zeros((len(other) if both else 0, 2, 4))
    ids, rows = (
        np.empty((CHUNKS if both else 0, WAITING), np.int64),
        np.empty((CHUNKS if both else 0, WAITING, 6)),
    )
    pair = Overlaid(corners, other, neighbours, tree, sign)
    into = Integrals(out, ids, rows)
    state = np.zeros((CHUNKS, 4), np.int64)
    state[:, 1:3] = -1
    for chunk in range(CHUNKS):
        state[chunk, 0] = chunk * m // CHUNKS
    left = CHUNKS
    while left > 0:
        for chunk in numba.prange(CHUNKS):
            chunk_kernel(signed(chunk), (chunk + 1) * m // CHUNKS, state, pair, into)
        if both:
            add_kept_pieces(state, ids, rows, back)
        left = 0
        for chunk in range(CHUNKS):
            left += 1 if state[chunk, 0] < (chunk + 1) * m // CHUNKS else 0
    return out, back
