"""A surface cut along a polygon: triangles that its edges cross become pieces on either side."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, I32, Bool

#: Points this near a line, as a part of the triangle's size, lie on it.
ON_LINE = 1e-12


@dataclass(frozen=True)
class ClippedSurface:
    """points : (n, c) x, y and what is linear over the triangles · inside, outside : (m, 3)
    triangles of them
    """

    points: F64
    inside: I32
    outside: I32


def clip_to_polygon(points: F64, triangles: I32, polygon: F64) -> ClippedSurface:
    """Points (n, c) and triangles (m, 3) cut along a simple polygon (k, 2): the points first, those
    on cuts after them.
    """
    near = polygon[0]
    local = np.column_stack([points[:, :2] - near, points[:, 2:]])
    ring = polygon - near
    edges = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    box = local[triangles][:, :, :2]
    low, high = box.min(axis=1), box.max(axis=1)
    least, most = edges.min(axis=1), edges.max(axis=1)
    touched = np.zeros(len(triangles), bool)
    for one, two in zip(least, most, strict=True):
        touched |= ((one <= high) & (two >= low)).all(axis=1)
    whole, sides, more, pieces = list(np.flatnonzero(~touched)), [], [], []
    count = len(points)
    for number in np.flatnonzero(touched):
        close = ((least <= high[number]) & (most >= low[number])).all(axis=1)
        found = list(split(local[triangles[number]], edges[close]))
        if len(found) < 2:
            whole.append(number)
            continue
        for piece in found:
            fan = [(count, count + k, count + k + 1) for k in range(1, len(piece) - 1)]
            sides.append(piece[:, :2].mean(axis=0))
            pieces.append(fan)
            more.append(piece)
            count += len(piece)
    middle = box[whole].mean(axis=1)
    in_whole, in_piece = contains(ring, middle), contains(ring, np.array(sides).reshape(-1, 2))
    kept = triangles[whole]
    out: list[I32] = []
    for side in (True, False):
        fans = [t for fan, at in zip(pieces, in_piece, strict=True) if at == side for t in fan]
        own = np.array(fans, np.int32).reshape(-1, 3)
        out.append(np.concatenate([kept[in_whole == side], own]).astype(np.int32))
    every = np.concatenate([local, *more])
    every[:, :2] += near
    every[: len(points)] = points
    return ClippedSurface(every, out[0], out[1])


def split(triangle: F64, edges: F64) -> Iterator[F64]:
    """The convex pieces (k, c) of a triangle (3, c) cut along the lines of the edges (e, 2, 2) that
    run through each.
    """
    pieces = [triangle]
    for a, b in edges:
        parted: list[F64] = []
        for piece in pieces:
            parted += halves(piece, a, b) if crosses(piece, a, b) else [piece]
        pieces = parted
    yield from pieces


def crosses(piece: F64, a: F64, b: F64) -> bool:
    """Whether a segment runs through the inside of a convex piece, counter-clockwise (Cyrus & Beck
    1978).
    """
    first, last, d = 0.0, 1.0, b - a
    for k in range(len(piece)):
        p, q = piece[k, :2], piece[(k + 1) % len(piece), :2]
        e = q - p
        at = float(e[0] * (a[1] - p[1]) - e[1] * (a[0] - p[0]))  # positive inside
        slope = float(e[0] * d[1] - e[1] * d[0])
        if slope == 0.0:
            if at <= 0.0:
                return False
        elif slope > 0.0:
            first = max(first, -at / slope)
        else:
            last = min(last, -at / slope)
    return last - first > ON_LINE


def halves(piece: F64, a: F64, b: F64) -> list[F64]:
    """The parts of a convex piece on the left and on the right of the line through a and b; the
    piece alone where one is nothing.
    """
    d = b - a
    side = d[0] * (piece[:, 1] - a[1]) - d[1] * (piece[:, 0] - a[0])
    size = np.ptp(piece[:, :2], axis=0).max() * np.hypot(*d)
    side[np.abs(side) <= ON_LINE * size] = 0.0
    out = []
    for sign in (1.0, -1.0):
        s = sign * side
        ring: list[F64] = []
        for k in range(len(piece)):
            j = (k + 1) % len(piece)
            if s[k] >= 0.0:
                ring.append(piece[k])
            if s[k] * s[j] < 0.0:
                ring.append(piece[k] + side[k] / (side[k] - side[j]) * (piece[j] - piece[k]))
        if len(ring) >= 3 and bool((s > 0.0).any()):
            out.append(np.array(ring))
    return out or [piece]


def contains(ring: F64, xy: F64) -> Bool:
    """Whether a polygon (k, 2) holds places (n, 2), none of them on its edges."""
    inside = np.zeros(len(xy), bool)
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        between = (a[1] > xy[:, 1]) != (b[1] > xy[:, 1])
        if between.any():
            y = xy[between, 1]
            inside[between] ^= xy[between, 0] < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
    return inside
