"""What one input point moves: the adjoint of the filter (UNCERTAINTY step 3).

Filtered points that lie near each other were fitted to the same input points, so their errors are
not independent: taken as such, the sigma of a volume comes out 2 to 3 times too small. A quantity
with the derivative ``w_i`` by a move of filtered point i along its normal has, by a move of input
point j along the normal, ``s_j = Σ x_jᵀ (XᵀX)⁻¹ q`` over the fits that hold j, with ``q = Σ w_i
x_i`` over the points that fit projected. Its variance is then ``Σ s_j² noise_j²``. The fits are
made again from what the result says: cells, radii and normals. Which points near an edge the filter
left out of a plane it does not say; they count here.
"""

from __future__ import annotations

from itertools import pairwise

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
    kept = r[result.index] - 0.5 * (r.min(axis=0) + r.max(axis=0))
    tree = cKDTree(kept)
    out = np.zeros(weight.shape)
    for ball in np.unique(result.reach):
        own = np.flatnonzero(result.reach == ball)
        order, _, first, _ = sorted_by_voxel(kept[own], CELL * float(ball))
        for lo, hi in pairwise(first.tolist()):
            cell = own[order[lo:hi]]
            centre = kept[cell].mean(axis=0)
            near = np.asarray(tree.query_ball_point(centre, float(ball)), np.int64)
            near = near if len(near) else cell
            _distribute_weights(kept, result.normal, cell, near, centre, float(ball), weight, out)
    return out


def _distribute_weights(
    kept: F64, normal: F64, cell: I64, near: I64, centre: F64, ball: float, weight: F64, out: F64
) -> None:
    """The weights of one cell's points handed to the points of its fits, one after the other until
    no point is left.
    """
    lean = np.abs(normal[cell] @ normal[cell[0]])
    curved = bool((lean < LEVEL).any() and (lean > ONE_PLANE).all())
    limit = ONE_QUADRIC if curved else ONE_PLANE
    left = cell
    while len(left):
        axis = normal[left[0]]
        same = np.abs(normal[left] @ axis) >= limit
        members = np.union1d(near[np.abs(normal[near] @ axis) >= limit], left[same])
        # a normal may point to either side: rows count along their own
        x, own = (
            _design(kept, normal, axis, members, centre, ball, curved),
            _design(kept, normal, axis, left[same], centre, ball, curved),
        )
        out[members] += x @ (np.linalg.pinv(x.T @ x, hermitian=True) @ (own.T @ weight[left[same]]))
        left = left[~same]


def _design(
    kept: F64, normal: F64, axis: F64, rows: I64, centre: F64, ball: float, curved: bool
) -> F64:
    """Design rows (k, 3) or (k, 6) over the plane across an axis, in units of the ball, for moves
    along the points' own normals.
    """
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    local = (kept[rows] - centre) / ball
    u, v = local @ side, local @ np.cross(axis, side)
    columns = [np.ones(len(rows)), u, v, *((u * u, u * v, v * v) if curved else ())]
    out: F64 = np.stack(columns, axis=1) * np.where(normal[rows] @ axis < 0.0, -1.0, 1.0)[:, None]
    return out
