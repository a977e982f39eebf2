"""Parallel kernels over voxels: which to refit, and the fits. Each iteration writes its own
outputs.

Sums over points run in canonical order (voxel key, then hash), so the same points give the same
bytes whatever the order of arrival, the batching or the number of threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F64, I16, I32, I64, Bool
from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.rmls import patch_fit
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.patch_fit import REACH
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    coordinates,
    level_frame,
    mark_flat,
    refit,
    tangent_of,
)
from ladar_volume.rmls.viewing_geometry import NUMBERS, recall, rotated
from ladar_volume.rmls.voxel_store import VoxelArrays, _mix, voxels_around

OK, FEW_POINTS, NO_PLANE, FEW_INLIERS, NOT_ON_PATCH = (
    patch_fit.OK,
    patch_fit.FEW_POINTS,
    patch_fit.NO_PLANE,
    patch_fit.FEW_INLIERS,
    patch_fit.NOT_ON_PATCH,
)


class FitRule(NamedTuple):
    """How a patch is fitted: range r and parameters p of the surface; points per random sample,
    samples, and whether truncated squares choose the start; threshold in robust sigma with its
    floor; fewest inliers; refits; seed. Lengths in m.
    """

    radius: float
    p: int
    sample_size: int
    trials: int
    ransac: bool
    ransac_threshold: float
    sigmas: float
    floor: float
    min_points: int
    iterations: int
    seed: int


@parallel_kernel
def count_candidates(voxels: I64, store: VoxelArrays, out: I64) -> None:
    """Points in the voxels around each of ``voxels``: an upper bound of its inliers."""
    for a in numba.prange(len(voxels)):
        near, n = np.empty(patch_fit.AROUND, np.int64), 0
        for i in range(voxels_around(store.keys[voxels[a]], store.keys, store.table, REACH, near)):
            n += store.counts[near[i]]
        out[a] = n


@kernel
def _centroid(pts: F64, slots: I32, n: int, cap: int, voxel: int, origin: F64) -> None:
    """Mean of the voxel's own points."""
    own = 0
    for i in range(n):
        if slots[i] // cap == voxel:
            own += 1
            for k in range(3):
                origin[k] += pts[i, k]
    for k in range(3):
        origin[k] /= own


@kernel
def _ball(pts: F64, n: int, origin: F64, ball: float, near: F64) -> Any:
    """Points within ``ball`` of ``origin`` to near (3, m); returns m."""
    m = 0
    for i in range(n):
        # relative to the centroid: offsets of planes keep their digits far from the map's origin
        x, y, z = pts[i, 0] - origin[0], pts[i, 1] - origin[1], pts[i, 2] - origin[2]
        if x * x + y * y + z * z <= ball * ball:
            near[0, m], near[1, m], near[2, m] = x, y, z
            m += 1
    return m


@kernel
def _face_sensor(
    slots: I32, index: I64, m: int, inside: Bool, aux: I16, normal: F64, tangent: F64
) -> None:
    """Turn the normal against the mean beam of the inliers."""
    facing = 0.0
    g = np.empty(NUMBERS)
    for i in range(m):
        if inside[i]:
            recall(aux[slots[index[i]]], g)
            beam = rotated(g[0], g[1], g[2], g[3], g[4:7])
            facing += beam[0] * normal[0] + beam[1] * normal[1] + beam[2] * normal[2]
    if facing > 0.0:
        for k in range(3):
            normal[k] = -normal[k]
        tangent_of(normal, tangent)


@kernel
def _fit_one(
    a: int, slots: I32, n: int, store: VoxelArrays, rule: FitRule, seed: int, fits: Fits
) -> Any:
    """The patch of row a; returns (status, inliers, sigma) and leaves the inliers' slots at the
    front of ``slots``.
    """
    voxel, cap, r, ball = fits.voxels[a], store.cap, store.r, 2.0 * rule.radius
    centre, normal, tangent = fits.centre[a], fits.normal[a], fits.tangent[a]
    beta, inverse = fits.beta[a], fits.inverse[a]
    sigmas, floor = rule.sigmas, rule.floor
    refitting, terms = RefitRule(ball, sigmas, floor, rule.iterations), Terms(beta, inverse)
    pts, near = np.empty((n, 3)), np.empty((3, n))
    for i in range(n):
        for k in range(3):
            pts[i, k] = r[slots[i], k]
    origin = np.zeros(3)
    _centroid(pts, slots, n, cap, voxel, origin)
    m = _ball(pts, n, origin, ball, near)
    if m < rule.min_points:
        return FEW_POINTS, 0, 0.0
    plane = np.empty(4)
    sigma = patch_fit.start_plane(
        near,
        m,
        rule.sample_size,
        rule.trials,
        rule.ransac,
        rule.ransac_threshold,
        seed,
        plane,
        np.empty(m),
    )
    if sigma < 0.0:
        return NO_PLANE, 0, 0.0
    plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    index, inside = np.empty(n, np.int64), np.empty(n, np.bool_)
    sigma = level_frame(
        pts,
        n,
        origin,
        plane,
        sigma,
        refitting,
        Near(near, index, inside),
        Frame(centre, normal, tangent),
    )
    if sigma < 0.0:
        return NO_PLANE, 0, 0.0
    threshold = max(sigmas * sigma, floor, 0.5e-7 * ball)
    m = coordinates(pts, n, centre, normal, tangent, ball, near, index)
    mark_flat(near, m, threshold, inside)
    _face_sensor(slots, index, m, inside, store.aux, normal, tangent)
    m = coordinates(pts, n, centre, normal, tangent, ball, near, index)
    used, s = refit(near, m, rule.p, sigma, refitting, inside, terms)
    if used < rule.min_points and rule.p == 6:
        # too few or too one-sided points for a quadric: the plane stands, its quadratic terms are
        # zero with certainty
        mark_flat(near, m, threshold, inside)
        beta[:] = 0.0
        inverse[:] = 0.0
        used, s = refit(near, m, 3, sigma, refitting, inside, terms)
    if used < rule.min_points:
        return FEW_INLIERS, used, s
    k, own = 0, False
    for i in range(m):
        if inside[i]:
            slots[k] = slots[index[i]]
            own |= slots[k] // cap == voxel
            k += 1
    return OK if own else NOT_ON_PATCH, used, s


@kernel
def _fit_row(a: int, store: VoxelArrays, rule: FitRule, fits: Fits) -> None:
    """Fit row a."""
    v = fits.voxels[a]
    slots = fits.members[fits.start[a] : fits.start[a + 1]]
    n = patch_fit.gather(v, store.keys, store.table, store.counts, store.order, store.cap, slots)
    own_seed = _mix(np.uint64(store.keys[v]) ^ _mix(np.uint64(rule.seed)))
    status, used, sigma = _fit_one(a, slots, n, store, rule, own_seed, fits)
    fits.status[a], fits.sigma[a] = status, sigma
    if status == OK:
        first = store.t_ns[slots[0]]
        total = np.int64(0)
        for i in range(used):
            total += store.t_ns[slots[i]] - first
        fits.used[a], fits.time[a] = used, first + total // used
    else:
        fits.used[a] = 0


@parallel_kernel
def fit_patches(store: VoxelArrays, rule: FitRule, fits: Fits) -> None:
    """Fit every voxel of ``fits.voxels``; inlier slots of patch a go to
    ``members[start[a] : start[a] + used[a]]``. start : (m + 1,) room for the candidates of each.
    """
    for a in numba.prange(len(fits.voxels)):
        _fit_row(a, store, rule, fits)


@kernel
def mark_around(voxels: I64, keys: I64, table: I32, reach: int, out: Bool) -> None:
    """Mark those within ``reach`` voxels of each of ``voxels``."""
    near = np.empty((2 * reach + 1) ** 3, np.int64)
    for v in voxels:
        for i in range(voxels_around(keys[v], keys, table, reach, near)):
            out[near[i]] = True
