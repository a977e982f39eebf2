"""Kernels over voxels: which to refit, and the fits. Each voxel writes its own outputs.

Sums over points run in canonical order (voxel key, then hash), so the same points give the same
bytes whatever the order of arrival, the batching or the number of threads.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np

from ladar_volume.math.array_types import F64, I16, I32, I64, Bool
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import inlined, kernel, parallel_kernel
from ladar_volume.rmls import patch_fit
from ladar_volume.rmls.fit_store import Fits
from ladar_volume.rmls.patch_fit import REACH, StartRule
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    frame_coordinates,
    level_frame,
    mark_flat,
    refit,
    tangent_of,
)
from ladar_volume.rmls.thinning_weights import Thinning, steepest_axis, thinning_of
from ladar_volume.rmls.viewing_geometry import NUMBERS, rotate_vector, viewing_geometry
from ladar_volume.rmls.voxel_store import VoxelArrays, voxels_around

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
            viewing_geometry(aux[slots[index[i]]], g)
            beam = rotate_vector(g[0], g[1], g[2], g[3], g[4:7])
            facing += beam[0] * normal[0] + beam[1] * normal[1] + beam[2] * normal[2]
    if facing > 0.0:
        for k in range(3):
            normal[k] = -normal[k]
        tangent_of(normal, tangent)


@kernel
def refit_rule(rule: FitRule) -> RefitRule:
    """How its surface is refitted, over twice the radius."""
    return RefitRule(2.0 * rule.radius, rule.sigmas, rule.floor, rule.iterations)


@inlined
def _start_plane(
    pts: F64, slots: I32, n: int, store: VoxelArrays, rule: FitRule, voxel: int, near: F64
) -> tuple[int, float, F64, F64]:
    """A plane through random ones of the points (n, 3) about the voxel: (status, its sigma, it, the
    mean of the voxel's own points). near : (3, n) for the points about that mean
    """
    origin, plane = np.zeros(3), np.empty(4)
    _centroid(pts, slots, n, store.cap, voxel, origin)
    m = _ball(pts, n, origin, 2.0 * rule.radius, near)
    if m < rule.min_points:
        return FEW_POINTS, 0.0, plane, origin
    own_seed = mix_bits(np.uint64(store.keys[voxel]) ^ mix_bits(np.uint64(rule.seed)))
    start = StartRule(rule.sample_size, rule.trials, rule.ransac, rule.ransac_threshold)
    sigma = patch_fit.start_plane(near, m, start, own_seed, plane, np.empty(m))
    if sigma < 0.0:
        return NO_PLANE, 0.0, plane, origin
    plane[3] += plane[0] * origin[0] + plane[1] * origin[1] + plane[2] * origin[2]
    return OK, sigma, plane, origin


@inlined
def _refit_surface(
    near: Near,
    m: int,
    sigma: float,
    threshold: float,
    rule: FitRule,
    thinning: Thinning,
    terms: Terms,
) -> tuple[int, float]:
    """Least squares from the points marked inside; too few or too one-sided points for a quadric:
    the plane stands, its quadratic terms are zero with certainty. Returns (inliers, sigma).
    """
    refitting = refit_rule(rule)
    used, s = refit(near, m, rule.p, sigma, refitting, thinning, terms)
    if used < rule.min_points and rule.p == 6:
        mark_flat(near.uvw, m, threshold, near.inside)
        terms.beta[:] = 0.0
        terms.inverse[:] = 0.0
        used, s = refit(near, m, 3, sigma, refitting, thinning, terms)
    return used, s


@kernel
def _inliers_first(slots: I32, near: Near, m: int, cap: int, voxel: int) -> bool:
    """Bring the inliers' slots to the front; returns whether one of them lies in the voxel."""
    k, own = 0, False
    for i in range(m):
        if near.inside[i]:
            slots[k] = slots[near.slots[i]]
            own |= slots[k] // cap == voxel
            k += 1
    return own


@inlined
def _fit_one(
    a: int, slots: I32, n: int, store: VoxelArrays, rule: FitRule, fits: Fits
) -> tuple[int, int, float]:
    """The patch of row a; returns (status, inliers, sigma) and leaves the inliers' slots at the
    front of ``slots``.
    """
    voxel, refitting = fits.voxels[a], refit_rule(rule)
    pts, near = np.empty((n, 3)), np.empty((3, n))
    for i in range(n):
        for k in range(3):
            pts[i, k] = store.r[slots[i], k]
    status, sigma, plane, origin = _start_plane(pts, slots, n, store, rule, voxel, near)
    if status != OK:
        return status, 0, 0.0
    around = Near(near, np.empty(n, np.int64), np.empty(n, np.bool_))
    frame = Frame(fits.centre[a], fits.normal[a], fits.tangent[a])
    centre, normal, tangent = frame.centre, frame.normal, frame.tangent
    sigma = level_frame(pts, n, origin, plane, sigma, refitting, around, frame)
    if sigma < 0.0:
        return NO_PLANE, 0, 0.0
    ball = refitting.ball
    threshold = max(rule.sigmas * sigma, rule.floor, 0.5e-7 * ball)
    m = frame_coordinates(pts, n, centre, normal, tangent, ball, near, around.slots)
    mark_flat(near, m, threshold, around.inside)
    _face_sensor(slots, around.slots, m, around.inside, store.aux, normal, tangent)
    m = frame_coordinates(pts, n, centre, normal, tangent, ball, near, around.slots)
    terms = Terms(fits.beta[a], fits.inverse[a])
    axis = steepest_axis(normal)
    thinning = thinning_of(slots, around.slots, m, store, store.keys[voxel], axis)
    used, s = _refit_surface(around, m, sigma, threshold, rule, thinning, terms)
    if used < rule.min_points:
        return FEW_INLIERS, used, s
    own = _inliers_first(slots, around, m, store.cap, voxel)
    return OK if own else NOT_ON_PATCH, used, s


@inlined
def _fit_row(a: int, store: VoxelArrays, rule: FitRule, fits: Fits) -> None:
    """Fit row a."""
    v = fits.voxels[a]
    slots = fits.members[fits.start[a] : fits.start[a + 1]]
    n = patch_fit.slots_around(
        v, store.keys, store.table, store.counts, store.order, store.cap, slots
    )
    status, used, sigma = _fit_one(a, slots, n, store, rule, fits)
    fits.status[a], fits.sigma[a] = status, sigma
    if status == OK:
        first = store.t_ns[slots[0]]
        total = np.int64(0)
        for i in range(used):
            total += store.t_ns[slots[i]] - first
        fits.used[a], fits.time[a] = used, first + total // used
    else:
        fits.used[a] = 0


@kernel
def fit_patches(index: I64, store: VoxelArrays, rule: FitRule, fits: Fits) -> None:
    """Fit those of ``fits.voxels`` at ``index`` (m,); inlier slots of patch a go to
    ``members[start[a] : start[a] + used[a]]``. start : room for the candidates of each.
    """
    for a in index:
        _fit_row(a, store, rule, fits)


@kernel
def mark_around(voxels: I64, keys: I64, table: I32, reach: int, out: Bool) -> None:
    """Mark those within ``reach`` voxels of each of ``voxels``."""
    near = np.empty((2 * reach + 1) ** 3, np.int64)
    for v in voxels:
        for i in range(voxels_around(keys[v], keys, table, reach, near)):
            out[near[i]] = True
