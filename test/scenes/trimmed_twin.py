"""Plain twin of the noise of neighbourhoods by least trimmed squares: all at once, by LAPACK."""

from __future__ import annotations

import numpy as np

from ladar_volume.clouds.sampling.trimmed_noise import (
    COVERED,
    CUT,
    MISSED,
    PLANE,
    QUANTILE,
    REFITS,
    RIDGE,
    STEPS,
)
from ladar_volume.model.records import F64, I64, Bool


def trimmed_noise(r: F64, near: I64) -> F64:
    """Standard deviation (s,) m along the normal of the points ``near`` (s, k), indices into r (n,
    3); fewer than k points end with −1. NaN where they tell none.
    """
    there = near >= 0
    uvw = _principal(r[near] - r[near[:, :1]], there)
    size = np.sqrt(np.max(np.sum(uvw**2, axis=2) * there, axis=1))
    u, v = uvw[:, :, 2] / size[:, None], uvw[:, :, 1] / size[:, None]
    rows = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    flat = _scatter(rows[:, :, :3], uvw[:, :, 0], there, size)
    curved = _scatter(rows, uvw[:, :, 0], there, size)
    return np.asarray(np.where(curved < PLANE * flat, curved, flat))


def _principal(x: F64, there: Bool) -> F64:
    """Points (s, k, 3) along the principal axes of those that are there, the normal first."""
    weight = there / there.sum(axis=1, keepdims=True)
    x = x - np.einsum("sk,ski->si", weight, x)[:, None]
    axes = np.linalg.eigh(np.einsum("sk,ski,skj->sij", weight, x, x))[1]
    return np.asarray(np.einsum("ski,sij->skj", x, axes))


def _scatter(rows: F64, height: F64, there: Bool, size: F64) -> F64:
    """Standard deviation (s,) m of heights (s, k) about the surface with design rows (s, k, p)."""
    used, count = there, there.sum(axis=1)
    most = np.minimum(np.ceil(COVERED * count).astype(np.int64), count) - 1
    distance, limit = np.zeros(height.shape), np.zeros(len(height))
    for _ in range(STEPS):
        distance = _distance(rows, height, used, size)
        ranked = np.sort(np.where(there, distance, np.inf), axis=1)
        limit = np.take_along_axis(ranked, most[:, None], axis=1)[:, 0]
        used = there & (distance <= limit[:, None])
    sigma = limit / QUANTILE
    for _ in range(REFITS):
        used = there & (distance <= CUT * sigma[:, None])
        distance = _distance(rows, height, used, size)
        free = np.maximum(used.sum(axis=1) - rows.shape[2], 1)
        sigma = np.sqrt(np.sum(distance**2 * used, axis=1) / free / MISSED)
    return np.asarray(sigma)


def _distance(rows: F64, height: F64, used: Bool, size: F64) -> F64:
    """Distances (s, k) from the least squares surface of the points used."""
    weighted = rows * used[:, :, None]
    normal = np.einsum("skp,skq->spq", weighted, rows)
    normal += RIDGE * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(rows.shape[2])
    right = np.einsum("skp,sk->sp", weighted, height)
    beta = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    slope = np.sum((beta[:, 1:3] / size[:, None]) ** 2, axis=1)
    off = np.abs(height - np.einsum("skp,sp->sk", rows, beta))
    return np.asarray(off / np.sqrt(1.0 + slope)[:, None])
