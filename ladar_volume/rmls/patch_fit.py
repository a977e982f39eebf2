"""The robust fit of one patch (seed 002 Algorithm 1), as compiled kernels.

Random planes through few points, best median of residuals (LMedS) or best truncated squared
residuals (weighted RANSAC, MSAC) → tangent frame at the foot point → least-squares refit on its
inliers, iterated to a fixed point (``frame``). Residuals are taken along the patch normal, never
vertically, so that walls work as floors do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.math.array_types import F64, I32, I64, U64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import kernel
from ladar_volume.math.normal_equations import select_kth
from ladar_volume.rmls.voxel_store import voxels_around

#: A patch looks at the voxels up to this many away; a ball of radius 2r about a centre in the voxel
#: needs two.
REACH = 2
#: Voxels it looks at, at most.
AROUND = (2 * REACH + 1) ** 3
#: 1 / Phi^-1(3/4): the median of |normal residuals| to their standard deviation.
MAD = 1.4826
#: Distances between two looks at whether a trial is lost.
BLOCK = 64
OK, FEW_POINTS, NO_PLANE, FEW_INLIERS, NOT_ON_PATCH = 0, 1, 2, 3, 4


class StartRule(NamedTuple):
    """How a start plane is sampled. size : points of a sample, 3 or 4 · trials : samples · ransac :
    the best has the least squares truncated at ``threshold``, m, else the least median
    """

    size: int
    trials: int
    ransac: bool
    threshold: float


@kernel
def slots_around(
    v: int, keys: I64, table: I32, count: I32, order: I32, cap: int, slots: I32
) -> Any:
    """Slots of all points in the voxels around voxel v, in canonical order (voxel, then hash);
    returns how many.
    """
    near, n = np.empty(AROUND, np.int64), 0
    for a in range(voxels_around(keys[v], keys, table, REACH, near)):
        for q in range(count[near[a]]):
            slots[n] = order[near[a] * cap + q]
            n += 1
    return n


@kernel
def random_below(state: U64, n: int) -> Any:
    """The next random number from 0 to before n."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    return np.int64(mix_bits(state[0]) % np.uint64(n))


@kernel
def _sample_plane(r: F64, n: int, size: int, state: U64, pick: I64, plane: F64) -> Any:
    """A plane (normal, offset) through three random points of r (3, n), or the mean plane of four;
    False where degenerate.
    """
    for a in range(size):
        pick[a] = random_below(state, n)
        for b in range(a):
            if pick[b] == pick[a]:
                return False
    i, j, k = pick[0], pick[1], pick[2]
    if size == 4:
        l = pick[3]
        # the cross product of a quadrangle's diagonals is the normal of its mean plane
        a0, a1, a2 = r[0, k] - r[0, i], r[1, k] - r[1, i], r[2, k] - r[2, i]
        b0, b1, b2 = r[0, l] - r[0, j], r[1, l] - r[1, j], r[2, l] - r[2, j]
    else:
        a0, a1, a2 = r[0, j] - r[0, i], r[1, j] - r[1, i], r[2, j] - r[2, i]
        b0, b1, b2 = r[0, k] - r[0, i], r[1, k] - r[1, i], r[2, k] - r[2, i]
    n0, n1, n2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    sides = np.sqrt((a0 * a0 + a1 * a1 + a2 * a2) * (b0 * b0 + b1 * b1 + b2 * b2))
    if not length > 1e-3 * sides:
        return False
    plane[0], plane[1], plane[2] = n0 / length, n1 / length, n2 / length
    offset = 0.0
    for a in range(size):
        offset += plane[0] * r[0, pick[a]] + plane[1] * r[1, pick[a]] + plane[2] * r[2, pick[a]]
    plane[3] = offset / size
    return True


@kernel
def median_or_bound(r: F64, n: int, plane: F64, best: float, work: F64) -> Any:
    """Median of the distances of r (3, n) to a plane; ``best`` as soon as it is known not to be
    below.
    """
    k = n // 2
    above = 0
    for block in range(0, n, BLOCK):
        end = min(block + BLOCK, n)
        for i in range(block, end):
            d = abs(r[0, i] * plane[0] + r[1, i] * plane[1] + r[2, i] * plane[2] - plane[3])
            work[i] = d
            above += d >= best
        if above >= n - k:
            return best
    return select_kth(work, n, k)


@kernel
def truncated_squares(r: F64, n: int, plane: F64, best: float, limit: float) -> Any:
    """Sum of squared distances of r (3, n) to a plane, each at most ``limit``; infinite as soon as
    it exceeds ``best``.
    """
    score = 0.0
    for i in range(n):
        d = r[0, i] * plane[0] + r[1, i] * plane[1] + r[2, i] * plane[2] - plane[3]
        score += min(d * d, limit)
        if score > best:
            return np.inf
    return score


@kernel
def start_plane(r: F64, n: int, rule: StartRule, seed: np.uint64, plane: F64, work: F64) -> float:
    """The best of random planes over r (3, n); returns its robust sigma, −1 where every sample was
    degenerate. work : (n,)
    """
    state = np.empty(1, np.uint64)
    state[0] = seed
    trial, pick = np.empty(4), np.empty(4, np.int64)
    best = np.inf
    for _ in range(rule.trials):
        if not _sample_plane(r, n, rule.size, state, pick, trial):
            continue
        if rule.ransac:
            score = truncated_squares(r, n, trial, best, rule.threshold * rule.threshold)
        else:
            score = median_or_bound(r, n, trial, best, work)
        if score < best:
            best = score
            plane[:] = trial
    if best == np.inf:
        return -1.0
    for i in range(n):
        work[i] = abs(r[0, i] * plane[0] + r[1, i] * plane[1] + r[2, i] * plane[2] - plane[3])
    return float(MAD * (1.0 + 5.0 / max(n - 3, 1)) * select_kth(work, n, n // 2))
