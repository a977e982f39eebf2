"""Contours of a TIN: exact lines of one height through its triangles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, I32, I64

#: Contours that an automatic interval aims at, and most that are written.
WANTED, MOST = 12, 2000


@dataclass(frozen=True)
class Contour:
    """height_m · line : (k, 2) m, closed where its first point is its last · index : every fifth"""

    height_m: float
    line: F64
    index: bool


def interval_of(low_m: float, high_m: float) -> float:
    """A round interval, m: 1, 2 or 5 times a power of ten."""
    span = (high_m - low_m) / WANTED
    if not span > 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(span))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= span * (1.0 - 1e-9))


def contours(vertices: F64, triangles: I32, interval_m: float) -> Iterator[Contour]:
    """Contours at whole multiples of the interval; higher ground is on their left. A vertex at the
    height itself counts as above it, so that every line goes through edges and never ends inside.

    Raises :class:`OutputError` for more contours than a map can show.
    """
    z = vertices[:, 2]
    count = float(z.max() - z.min()) / interval_m
    if not count < MOST:
        raise OutputError(
            f"contours every {interval_m:g} m are {count:,.0f} heights: give a wider "
            "interval (--contour-interval)",
            reason="output_contours",
            value=interval_m,
        )
    first, last = math.ceil(z.min() / interval_m), math.floor(z.max() / interval_m)
    corner = z[triangles]
    low, high = corner.min(axis=1), corner.max(axis=1)
    for number in range(first, last + 1):
        level = number * interval_m
        crossed = triangles[(low < level) & (high >= level)]
        for line in lines_at(vertices, crossed, level):
            yield Contour(level, line, number % 5 == 0)


def lines_at(vertices: F64, crossed: I32, level: float) -> Iterator[F64]:
    """The lines of one level through triangles (m, 3) that have a vertex below it and one not."""
    above = vertices[:, 2][crossed] >= level
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    row = np.arange(len(crossed))
    i, j, k = (crossed[row, (alone + n) % 3].astype(np.int64) for n in range(3))
    up = above[row, alone]
    # higher ground on the left: from the edge before the lone upper vertex to the one after it
    one, two = edge_key(i, j), edge_key(i, k)
    start, end = np.where(up, one, two), np.where(up, two, one)
    keys, place = np.unique(np.concatenate([start, end]), return_inverse=True)
    a, b = vertices[keys >> 32], vertices[keys & 0xFFFFFFFF]
    share = (level - a[:, 2]) / (b[:, 2] - a[:, 2])
    points = a[:, :2] + share[:, None] * (b[:, :2] - a[:, :2])
    for chain in chains(place[: len(row)], place[len(row) :]):
        yield points[chain]


def edge_key(a: I64, b: I64) -> I64:
    """One number for an edge, whichever way round."""
    return (np.minimum(a, b) << 32) | np.maximum(a, b)


def chains(start: I64, end: I64) -> Iterator[list[int]]:
    """Chains of directed segments, each place beginning and ending one at most."""
    follow = dict(zip(start.tolist(), end.tolist(), strict=True))
    entered = set(follow.values())
    heads = [place for place in follow if place not in entered]
    for head in heads:
        chain = [head]
        while chain[-1] in follow:
            chain.append(follow.pop(chain[-1]))
        yield chain
    while follow:
        first, to = follow.popitem()
        chain = [first, to]
        while chain[-1] != first:
            chain.append(follow.pop(chain[-1]))
        yield chain
