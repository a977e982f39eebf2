"""What one input point moves: the adjoint of the filter (UNCERTAINTY step 3).

Filtered points that lie near each other were fitted to the same input points, so their errors are
not independent: taken as such, the sigma of a volume comes out 2 to 3 times too small. A quantity
with the derivative ``w_i`` by a move of filtered point i along its normal has, by a move of input
point j along the normal, ``s_j = Σ x_jᵀ (XᵀX)⁻¹ q`` over the fits that hold j, with ``q = Σ w_i
x_i`` over the points that fit projected. Its variance is then ``Σ s_j² noise_j²``. The fits are
made again from what the result says: cells, radii, points and normals. Two faces of a thin wall, or
of a box, in one neighbourhood have parallel normals of any sign and are told apart by where they
lie. Which points near an edge the filter left out of a plane the result does not say; they count
here.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.cell_cover import CELL
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.clouds.filter.point_reduction import sorted_by_voxel
from ladar_volume.model.errors import FilterError
from ladar_volume.model.records import F64, I64

#: Points whose normals enclose less than this cosine are of one plane, and of one quadric.
ONE_PLANE, ONE_QUADRIC = float(np.cos(np.radians(30.0))), 0.5
#: Normals in a cell that agree to this cosine lie on a plane.
LEVEL = 1.0 - 1e-9
#: A point is on a sheet from which it lies less than so many sigmas of the noise.
ON_SHEET = 4.0
#: Points are no more exact than this share of the cloud's size.
EXACT = 1e-9


class _Kept(NamedTuple):
    """The kept points: raw, r : (k, 3) m before and after the filter, about a common origin ·
    normal : (k, 3) · noise_m : (k,) m
    """

    raw: F64
    r: F64
    normal: F64
    noise_m: F64

    def off_plane(self, r: F64, rows: I64, first: int) -> F64:
        """How far points r (m, 3) of numbers rows (m,) lie from the plane of the filtered point
        ``first``, in sigmas (m,).
        """
        return np.asarray(
            np.abs((r - self.r[first]) @ self.normal[first]) / self.noise_m[rows], np.float64
        )

    def off_quadric(self, rows: I64, own: I64) -> F64:
        """How far filtered points rows (m,) lie from the quadric through those of ``own``, in
        sigmas (m,): those of the same sheet, fitted by other cells, within the noise.
        """
        axis, centre = self.normal[own[0]], self.r[own].mean(axis=0)
        size = float(np.ptp(self.r[own], axis=0).max()) or 1.0
        local = self.r[own] - centre, self.r[rows] - centre
        x, at = (_columns(away / size, axis, True) for away in local)
        beta = np.linalg.lstsq(x, local[0] @ axis, rcond=1e-9)[0]
        off = local[1] @ axis - at @ beta
        return np.asarray(np.abs(off) / self.noise_m[rows], np.float64)


def influence(r: F64, result: CloudResult, weight: F64) -> F64:
    """Derivatives s (k, c) by moves of the kept input points along their normals, from those
    ``weight`` (k, c) by moves of the filtered ones.

    r : (n, 3) m, the input of the filter. Raises :class:`FilterError` where the result does not say
    how it was fitted (reduced points, published order).
    """
    if result.reach is None:
        words = (
            "points that were reduced, or filtered in the published order, do not say what "
            "they share"
        )
        raise FilterError(words, reason="filter_influence")
    middle = 0.5 * (r.min(axis=0) + r.max(axis=0))
    noise = np.ones(len(result.r)) if result.noise is None else result.noise
    noise = np.maximum(noise, EXACT * float(np.ptp(r)))
    kept = _Kept(r[result.index] - middle, result.r - middle, result.normal, noise)
    tree = cKDTree(kept.raw)
    out = np.zeros(weight.shape)
    for ball in np.unique(result.reach):
        rows = np.flatnonzero(result.reach == ball)
        order, _, first, _ = sorted_by_voxel(kept.raw[rows], CELL * float(ball))
        for lo, hi in pairwise(first.tolist()):
            cell = rows[order[lo:hi]]
            centre = kept.raw[cell].mean(axis=0)
            near = np.asarray(tree.query_ball_point(centre, float(ball)), np.int64)
            near = near if len(near) else cell
            _distribute_weights(kept, cell, near, centre, float(ball), weight, out)
    return out


def _distribute_weights(
    kept: _Kept, cell: I64, near: I64, centre: F64, ball: float, weight: F64, out: F64
) -> None:
    """The weights of one cell's points handed to the points of its fits: to each sheet those near
    points that lie on it rather than on another.
    """
    lean = np.abs(kept.normal[cell] @ kept.normal[cell[0]])
    curved = bool((lean < LEVEL).any() and (lean > ONE_PLANE).all())
    sheets, apart = _sheets(kept, cell, near, curved)
    nearest = np.argmin(apart, axis=0)
    for k, own in enumerate(sheets):
        members = np.union1d(near[(nearest == k) & (apart[k] <= ON_SHEET)], own)
        axis = kept.normal[own[0]]
        # a normal may point to either side: rows count along their own
        x, of = (
            _columns((kept.raw[rows] - centre) / ball, axis, curved)
            * np.where(kept.normal[rows] @ axis < 0.0, -1.0, 1.0)[:, None]
            for rows in (members, own)
        )
        out[members] += x @ (np.linalg.pinv(x.T @ x, hermitian=True) @ (of.T @ weight[own]))


def _sheets(kept: _Kept, cell: I64, near: I64, curved: bool) -> tuple[list[I64], F64]:
    """The sheets of a cell as rows of their points, and how far the near points (m,) lie from each,
    (s, m) in sigmas of their noise: infinitely where their normals differ.
    """
    limit = ONE_QUADRIC if curved else ONE_PLANE
    sheets, apart, left = [], [], cell
    while len(left):
        first = left[0]
        same = np.abs(kept.normal[left] @ kept.normal[first]) >= limit
        if not curved:
            same &= kept.off_plane(kept.r[left], left, first) <= ON_SHEET
        same[0] = True
        own = left[same]
        off = kept.off_quadric(near, own) if curved else kept.off_plane(kept.raw[near], near, first)
        agrees = np.abs(kept.normal[near] @ kept.normal[first]) >= limit
        sheets.append(own)
        apart.append(np.where(agrees, off, np.inf))
        left = left[~same]
    return sheets, np.array(apart)


def _columns(local: F64, axis: F64, curved: bool) -> F64:
    """Design rows (k, 3), or (k, 6) if curved, of places (k, 3) over the plane across an axis."""
    x, y, z = axis.tolist()
    k = int(np.argmin(np.abs(axis)))
    side = np.array([(0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)][k])
    side /= np.linalg.norm(side)
    a, b, c = side.tolist()
    u, v = local @ side, local @ np.array([y * c - z * b, z * a - x * c, x * b - y * a])
    columns = [np.ones(len(local)), u, v, *((u * u, u * v, v * v) if curved else ())]
    return np.stack(columns, axis=1)
