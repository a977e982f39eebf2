"""Which sphere of one frame is which of the other: found from the distances between the centres.

Three centres of the source and three of the target whose sides are of equal length (two and their
difference of heights, where levelled) give a transform; all numberings by which most centres then
fall on one another are kept. Source: interpretation tree of pairwise distances, Grimson &
Lozano-Perez 1987, in the form that grows from one triple.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.records import F64, I64
from ladar_volume.registration.transform import nearest_transform

#: Triples (pairs, where levelled) of the source that a search begins from, the widest first.
MOST_BASES = 60
#: Centres of one frame beyond which no search is made.
MOST_CENTRES = 40
#: A side agrees within so many sigma of both ends, and within this share of the whole extent.
SIDE_SIGMAS, SIDE_SHARE = 6.0, 2e-4


@dataclass(frozen=True)
class Numbering:
    """partner : (n,) int64, row of the target for each centre of the source, −1 for none · scale"""

    partner: I64
    scale: float

    def __len__(self) -> int:
        return int((self.partner >= 0).sum())


def extent(x: F64) -> float:
    """Root of the summed variance of centres (n, 3), m."""
    return float(np.sqrt(((x - x.mean(axis=0)) ** 2).sum() / max(len(x), 1)))


def invariant_sides(x: F64, index: I64, levelled: bool) -> F64:
    """What no motion changes of triples (k, 3) of centres: three lengths; of pairs (k, 2): the
    length in plan and the difference of heights, m.
    """
    p = x[index]
    if levelled:
        d = p[:, 1] - p[:, 0]
        return np.column_stack([np.linalg.norm(d[:, :2], axis=1), d[:, 2]])
    d = p[:, [1, 2, 2]] - p[:, [0, 0, 1]]
    out: F64 = np.linalg.norm(d, axis=2)
    return out


def widest_bases(x: F64, levelled: bool) -> I64:
    """The widest triples (k, 3), or pairs (k, 2), of centres (n, 3)."""
    index = np.array(list(itertools.combinations(range(len(x)), 2 if levelled else 3)), np.int64)
    p = x[index]
    if levelled:
        size = np.linalg.norm((p[:, 1] - p[:, 0])[:, :2], axis=1)
    else:
        size = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return index[np.argsort(-size, kind="stable")[:MOST_BASES]]


def pair_nearest(moved: F64, y: F64, tolerance_m: float) -> I64:
    """Row of the nearest target centre (n,) within the tolerance where each is the other's nearest,
    else −1.
    """
    far = np.linalg.norm(moved[:, None] - y[None], axis=2)
    near, back = far.argmin(axis=1), far.argmin(axis=0)
    rows = np.arange(len(moved))
    good = (far[rows, near] <= tolerance_m) & (back[near] == rows)
    return np.where(good, near, -1).astype(np.int64)


def numberings(
    x: F64, y: F64, sigma_m: float, *, levelled: bool = False, scale: float | None = 1.0
) -> list[Numbering]:
    """All numberings that lay most centres x (n, 3) of the source on centres y (m, 3) of the
    target, most centres first; empty where no three (two, where levelled) agree.

    sigma_m : of a centre's coordinate, in the target frame · scale : None where it is free
    """
    size = 2 if levelled else 3
    if min(len(x), len(y)) < size or max(len(x), len(y)) > MOST_CENTRES:
        return []
    tolerance = SIDE_SIGMAS * sigma_m * 2.0**0.5 + SIDE_SHARE * extent(y)
    target = np.array(list(itertools.permutations(range(len(y)), size)), np.int64)
    there, found = invariant_sides(y, target, levelled), {}
    longest = max(float(there[:, 0].max()), 1e-300)
    for base in widest_bases(x, levelled):
        here = invariant_sides(x, base[None], levelled)[0]
        if here[0] <= 1e-9 * longest * (1.0 if scale is None else 1.0 / scale):
            continue
        s = there[:, 0] / here[0] if scale is None else np.full(len(there), scale)
        for k in np.flatnonzero((np.abs(there - s[:, None] * here) <= tolerance).all(axis=1)):
            one = grow_numbering(x, y, (base, target[k]), float(s[k]), tolerance, (levelled, scale))
            if len(one) >= size:
                found[one.partner.tobytes()] = one
    return sorted(found.values(), key=lambda one: -len(one))


def grow_numbering(
    x: F64,
    y: F64,
    pair: tuple[I64, I64],
    factor: float,
    tolerance_m: float,
    kind: tuple[bool, float | None],
) -> Numbering:
    """The numbering that grows from a pair of bases: what falls together after their transform, and
    again after that of all found. kind : (levelled, scale or None)
    """
    a, b = pair
    partner, levelled, scale = np.full(len(x), -1, np.int64), *kind
    # a short base turns what is far from it: the first tolerance is wider by that lever
    lever = 1.0 + extent(x) / max(extent(x[a]), 1e-300)
    for reach in (2.0 * lever, 2.0):
        if len(a) < len(pair[0]):
            break
        fixed = factor if scale is None and len(a) == len(pair[0]) else scale
        T = nearest_transform(x[a], y[b], x[a].mean(axis=0), levelled, fixed)
        partner = pair_nearest(T.apply(x), y, reach * tolerance_m)
        a, factor = np.flatnonzero(partner >= 0), T.scale
        b = partner[a]
    return Numbering(partner, factor)
