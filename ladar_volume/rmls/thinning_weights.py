"""What each return of a capped voxel stands for in a fit.

A voxel keeps so many returns at most, whatever it was offered. Along a surface that is even: the
scanner's dense places count as much as the sparse ones. Across it, it is not: where a surface runs
along the border of two layers of voxels, each layer keeps as many, and the few returns beyond the
border would count as much as the many on this side, which draws the fit over the border. So the
returns of one column of voxels, along the axis nearest to the surface's normal, share the column's
weight by what they stand for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.math.array_types import F32, F64, I32, I64, Bool
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.rmls.patch_fit import REACH
from ladar_volume.rmls.voxel_store import BITS, VoxelArrays

#: Voxels in a row of those that a patch looks at, and columns of them.
ROW = 2 * REACH + 1
COLUMNS = ROW * ROW
#: How many hashes there are.
HASHES = 2.0**64


class Thinning(NamedTuple):
    """Of n points about a patch: the column that each lies in, how many each stands for, and its
    weight, which :func:`balance` writes. Without columns every weight stays 1.
    """

    column: I32
    stands: F64
    weight: F64


@kernel
def unthinned(n: int) -> Thinning:
    """Of n points, all that there were."""
    return Thinning(np.empty(0, np.int32), np.empty(0), np.ones(n))


@leaf_kernel
def standing(voxel: int, store: VoxelArrays) -> Any:
    """How many points offered each one stands for that a voxel holds: one where it is not full,
    else by its highest hash. Of n even hashes the k-th lowest, h, gives n = (k − 1) / h without
    bias.
    """
    cap = store.cap
    if store.counts[voxel] < cap:
        return 1.0
    highest = np.float64(store.hashes[store.order[voxel * cap + cap - 1]])
    return max(1.0, (cap - 1.0) / cap * HASHES / max(highest, 1.0))


@leaf_kernel
def steepest_axis(normal: F64) -> Any:
    """The axis nearest to a normal; of equal ones the last."""
    x, y, z = abs(normal[0]), abs(normal[1]), abs(normal[2])
    return 2 if z >= x and z >= y else 1 if y >= x else 0


@leaf_kernel
def column_of(key: int, centre_key: int, axis: int) -> Any:
    """The column along an axis, of those about the voxel ``centre_key``, that a voxel lies in."""
    mask = (1 << BITS) - 1
    i = (key >> (2 * BITS)) - (centre_key >> (2 * BITS)) + REACH
    j = ((key >> BITS) & mask) - ((centre_key >> BITS) & mask) + REACH
    k = (key & mask) - (centre_key & mask) + REACH
    return j * ROW + k if axis == 0 else i * ROW + k if axis == 1 else i * ROW + j


@kernel
def thinning_of(slots: I32, index: I64, m: int, store: VoxelArrays, key: int, axis: int) -> Any:
    """The thinning of the points ``slots[index[:m]]`` about the voxel of this key."""
    out = Thinning(np.empty(m, np.int32), np.empty(m), np.ones(m))
    last, column, stands = -1, 0, 1.0
    for i in range(m):
        voxel = slots[index[i]] // store.cap
        if voxel != last:
            last = voxel
            column = column_of(store.keys[voxel], key, axis)
            stands = standing(voxel, store)
        out.column[i], out.stands[i] = column, stands
    return out


@kernel
def balance(thinning: Thinning, m: int, inside: Bool) -> None:
    """Weights of the points (m,) marked inside: within each column by what they stand for, in the
    mean 1.
    """
    if len(thinning.column) == 0:
        return
    held, stood = np.zeros(COLUMNS), np.zeros(COLUMNS)
    for i in range(m):
        if inside[i]:
            held[thinning.column[i]] += 1.0
            stood[thinning.column[i]] += thinning.stands[i]
    for i in range(m):
        if inside[i]:
            column = thinning.column[i]
            thinning.weight[i] = thinning.stands[i] * (held[column] / stood[column])


@kernel
def weigh_inliers(
    rows: I64, start: I64, used: I64, members: I32, normal: F64, store: VoxelArrays, weights: F32
) -> None:
    """The weights that the inliers of these patches had in their fits, as ``members`` lists
    them.
    """
    for a in rows:
        n = used[a]
        mine = members[start[a] : start[a] + n]
        thinning = thinning_of(
            mine, np.arange(n), n, store, store.keys[a], steepest_axis(normal[a])
        )
        balance(thinning, n, np.ones(n, np.bool_))
        for i in range(n):
            weights[start[a] + i] = thinning.weight[i]
