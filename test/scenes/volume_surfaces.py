"""Synthetic filtered surfaces: patches of a known height function with chosen covariances and
sensitivities.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ladar_volume.model.records import (
    FilteredPoints,
    FilterUpdate,
    Patches,
    PlatformStates,
    select,
)
from ladar_volume.uncertainty.patch_table import ROWS, ragged_index

BIN_NS = 1_000_000_000
T0 = 1_700_000_000 * BIN_NS


def normal_frame(normal):
    """A tangent and the binormal ``normal x tangent`` of unit normals (m, 3)."""
    tangent = np.stack([normal[:, 2], np.zeros(len(normal)), -normal[:, 0]], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return tangent, np.cross(normal, tangent)


def by_position_and_attitude(patches):
    """Sensitivities (l, p + 2, 6) by the platform's position in the map and by its attitude."""
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.nav_start))
    n, t, M = patches.normal[owner], patches.tangent[owner], patches.M_nav
    axes = np.stack([n] * (M.shape[1] - 2) + [t, np.cross(n, t)], axis=1)
    return np.concatenate([M[..., :1] * axes, M[..., 1:]], axis=2)


def take_patches(patches, rows):
    """The chosen rows (k,) of patches, ragged parts included, in that order."""
    cross, nav = ragged_index(patches.cross_start, rows), ragged_index(patches.nav_start, rows)
    changes = {name: getattr(patches, name)[rows] for name in ROWS}
    return Patches(
        **changes,
        cross_start=np.concatenate([[0], np.cumsum(np.diff(patches.cross_start)[rows])]).astype(
            np.int64
        ),
        cross_key=patches.cross_key[cross],
        cross=patches.cross[cross],
        nav_start=np.concatenate([[0], np.cumsum(np.diff(patches.nav_start)[rows])]).astype(
            np.int64
        ),
        nav_bin=patches.nav_bin[nav],
        M_nav=patches.M_nav[nav],
    )


def surface_update(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    half: float = 10.0,
    spacing: float = 0.5,
    per_patch: int = 2,
    noise: float = 0.01,
    seed: int = 0,
    sensor=(0.0, 0.0, 20.0),
    speed: float = 1.0,
    perturb: float = 0.0,
) -> FilterUpdate:
    """Grid of points over a square of half side ``half``, in square patches of ``per_patch`` points
    a side; degree-1 patches, own blocks only.

    Sensitivities are those of a sensor without rotation that flies along x at ``speed`` and looks
    at every patch from straight above at height ``sensor[2]``.
    """
    rng = np.random.default_rng(seed)
    side = spacing * per_patch
    count = round(2 * half / side)
    centres = (np.arange(count) + 0.5) * side - half
    cx, cy = (a.ravel() for a in np.meshgrid(centres, centres, indexing="ij"))
    eps = 1e-4
    slope = np.stack(
        [height(cx + eps, cy) - height(cx - eps, cy), height(cx, cy + eps) - height(cx, cy - eps)],
        axis=1,
    ) / (2 * eps)
    normal = np.concatenate([-slope, np.ones((len(cx), 1))], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent, binormal = normal_frame(normal)
    centre = np.stack([cx, cy, height(cx, cy)], axis=1)
    m = len(cx)
    offset = (np.arange(per_patch) + 0.5) * spacing - side / 2
    ox, oy = (a.ravel() for a in np.meshgrid(offset, offset, indexing="ij"))
    patch = np.repeat(np.arange(m), len(ox))
    x, y = cx[patch] + np.tile(ox, m), cy[patch] + np.tile(oy, m)
    r = np.stack([x, y, height(x, y) + perturb * rng.standard_normal(len(x))], axis=1)
    d = r - centre[patch]
    local = np.stack([(d * tangent[patch]).sum(1), (d * binormal[patch]).sum(1)], axis=1)
    key = np.arange(m, dtype=np.int64) * 7 + 3
    C = np.zeros((m, 3, 3))
    C[:, 0, 0], C[:, 1, 1], C[:, 2, 2] = (
        noise**2 / 9,
        noise**2 / 9 / side**2,
        noise**2 / 9 / side**2,
    )
    variance = C[patch, 0, 0] + C[patch, 1, 1] * (local**2).sum(1)
    # sensitivities of the three coordinates at the centre, n . dr/dtheta and so on, zero for the
    # slopes
    beams = 16
    M_cal, M_nav = np.zeros((m, 5, 11 + 2 * beams), np.float32), np.zeros((m, 5, 4), np.float32)
    ray = centre - np.stack([cx, cy, np.full(m, sensor[2])], axis=1)
    unit = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    for k, axis in ((0, normal), (3, tangent), (4, binormal)):
        M_cal[:, k, 0] = (axis * unit).sum(1)
        M_cal[:, k, 1:4] = np.cross(ray, axis)
        M_cal[:, k, 4:7], M_cal[:, k, 7:10] = axis, -axis
        M_cal[:, k, 10] = axis[:, 0] * speed
        M_cal[np.arange(m), k, 11 + np.arange(m) % beams] = M_cal[:, k, 0]
        M_nav[:, k, 0], M_nav[:, k, 1:] = 1.0, np.cross(ray, axis)
    bins = T0 // BIN_NS + np.floor((cx + half) / speed).astype(np.int64)
    patches = Patches(
        key,
        centre,
        normal,
        tangent,
        np.zeros((m, 3)),
        np.full(m, noise),
        np.full(m, 9, np.int32),
        bins * BIN_NS,
        np.arange(m + 1),
        key.copy(),
        C,
        M_cal,
        np.arange(m + 1),
        bins,
        M_nav,
    )
    points = FilteredPoints(
        r,
        normal[patch],
        variance,
        np.zeros((len(r), 6), np.float32),
        bins[patch] * BIN_NS,
        key[patch],
        local,
    )
    return FilterUpdate(T0 + 100 * BIN_NS, np.zeros(0, np.int64), points, patches)


def piece(update, rows):
    """The part of an update with the given patches (indices)."""
    patches = take_patches(update.patches, rows)
    points = select(update.points, np.isin(update.points.patch, patches.key))
    return FilterUpdate(update.t_ns, np.zeros(0, np.int64), points, patches)


def platform(seconds: int = 100, rate: int = 10, position=0.02, attitude=2e-4) -> PlatformStates:
    """States of a flight of ``seconds``, with constant covariance."""
    n = seconds * rate
    t = T0 + np.arange(n) * (BIN_NS // rate)
    C = np.zeros((n, 6, 6))
    C[:, range(3), range(3)], C[:, range(3, 6), range(3, 6)] = position**2, attitude**2
    q = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    return PlatformStates(
        t, np.zeros((n, 3)), q, np.zeros((n, 3)), np.zeros((n, 3)), C, np.zeros(n, np.int64)
    )


def cone(x, y, radius=4.0, top=3.0, slope=(0.0, 0.0)):
    """A cone on a plane."""
    return np.maximum(0.0, top * (1.0 - np.hypot(x, y) / radius)) + slope[0] * x + slope[1] * y
