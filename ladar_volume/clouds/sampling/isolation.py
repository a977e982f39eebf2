"""Which points that lie on no surface belong to the survey, and which lie by themselves.

What is dense about a place is told from the points next to it that are known to belong: at most
some times their spacing. Points that pass belong too, and tell the spacing further on, though
hardly more than that which let them pass: rings that widen with the range are followed outwards, in
any unit and without a sensor's place, and strays do not pass one another on through free air. The
spacing is that of the second neighbour: returns have one on either side along their line.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.nearest import nearest_distances, nearest_index
from ladar_volume.math.space_curve import curve_order
from ladar_volume.model.records import F64, Bool

#: Neighbours whose distance is the spacing; points next to one that tell what is usual; how many
#: times that one hands on, at most; rounds of growth.
NEXT, USUAL, HANDS, ROUNDS = 2, 5, 1.2, 12
#: A point farther from a cloud than this many times its width is not part of it. The width leaves
#: out this share of the points, at least one, at either end of each axis.
FAR, END = 100.0, 0.001


def far_from_cloud(r: F64) -> Bool:
    """Which (n,) of points (n, 3) lie so far from the others that no grid holds both, such as
    0, 0, 0 among map coordinates, or a height of -9999 where there is none.
    """
    n = len(r)
    left_out = max(1, int(END * n))
    if n < 4 * left_out:
        return np.zeros(n, np.bool_)
    ends = (0, left_out, n - 1 - left_out, n - 1)
    least, low, high, most = np.array([np.partition(column, ends)[list(ends)] for column in r.T]).T
    room = FAR * float((high - low).max())
    if not room > 0.0 or ((least >= low - room) & (most <= high + room)).all():
        return np.zeros(n, np.bool_)
    return np.asarray(((r < low - room) | (r > high + room)).any(axis=1), np.bool_)


def second_neighbour_distance(r: F64) -> F64:
    """Distance (n,) m of points (n, 3) to the second of their neighbours."""
    order, out = curve_order(r), np.empty(len(r))
    along = r[order]
    out[order] = nearest_distances(nearest_index(along), along, min(NEXT + 1, len(r)))
    return out


def connected_to_known(r: F64, known: Bool, own_m: F64, candidates: Bool, times: float) -> Bool:
    """Which (n,) of the ``candidates`` belong to what is ``known`` (n,) to belong.

    own_m : (n,) m, spacing of each point · times : what is usual that a spacing may be
    """
    known, left, own = known.copy(), candidates & ~known, own_m.copy()
    passed = np.zeros(len(r), np.bool_)
    for _ in range(ROUNDS):
        if not left.any() or not known.any():
            break
        base, open_ = np.flatnonzero(known), np.flatnonzero(left)
        k = min(USUAL, len(base))
        near = cKDTree(r[base], balanced_tree=False).query(r[open_], k=k, workers=-1)[1]
        usual = np.median(own[base[near.reshape(len(open_), k)]], axis=1)
        near_by = own[open_] <= times * usual
        new = open_[near_by]
        if not len(new):
            break
        own[new] = np.minimum(own[new], HANDS * usual[near_by])
        known[new], left[new], passed[new] = True, False, True
    return passed
