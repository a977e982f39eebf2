"""How far points scatter about a robust quadric through them: the noise, told from small
neighbourhoods.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.math.array_types import F64, I64, U64
from ladar_volume.math.hashing import mix_bits
from ladar_volume.math.kernels import kernel, parallel_kernel, signed
from ladar_volume.rmls.patch_fit import StartRule, start_plane
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    frame_coordinates,
    level_frame,
    mark_flat,
    refit,
)
from ladar_volume.rmls.thinning_weights import unthinned

#: Random planes per neighbourhood; refits towards the fixed point.
TRIALS, REFITS = 60, 20
#: Points within this many sigma of the quadric count; two points on either side of it are this many
#: apart.
SIGMAS, CUT = 3.0, 4.0
#: Fewest points of a quadric whose residuals tell the noise.
FEWEST = 15


@kernel
def hashes(numbers: U64) -> Any:
    """Hash of each of numbers (n,) uint64."""
    out = np.empty_like(numbers)
    for i in range(len(numbers)):
        out[i] = mix_bits(numbers[i])
    return out


@kernel
def _centre_on_first(r: F64, near: I64, pts: F64, across_points: F64) -> Any:
    """The points ``near`` (k,) about the first of them, m, to pts (k, 3) and across_points (3, k);
    returns the radius of a ball that holds them.
    """
    ball = 0.0
    for i in range(len(near)):
        square = 0.0
        for c in range(3):
            pts[i, c] = r[near[i], c] - r[near[0], c]
            across_points[c, i] = pts[i, c]
            square += pts[i, c] * pts[i, c]
        ball = max(ball, np.sqrt(square) * 1.0001)
    return ball


@kernel
def _within_rim(pts: F64, frame: Frame, ball: float, flat: float, hood: Near) -> Any:
    """Coordinates of the points (k, 3) that tell the noise, to ``hood.uvw``; returns how many.

    A ball about a noisy point cuts the noise off along its rim: only the cylinder that lies within
    it whatever the noise.
    """
    uvw, rim, m = hood.uvw, ball * ball - (CUT * flat) ** 2, 0
    centre, normal, tangent = frame
    for i in range(
        frame_coordinates(pts, len(pts), centre, normal, tangent, 2.0 * ball, uvw, hood.slots)
    ):
        if 4.0 * ball * ball * (uvw[0, i] ** 2 + uvw[1, i] ** 2) <= rim:
            uvw[:, m] = uvw[:, i]
            m += 1
    return m


@kernel
def _scatter_of(s: int, r: F64, near: I64, seed: int) -> Any:
    """Standard deviation, m, of the points ``near`` (k,) of sample s, as :func:`scatter`."""
    k = len(near)
    pts, across_points, plane = np.empty((k, 3)), np.empty((3, k)), np.empty(4)
    ball = _centre_on_first(r, near, pts, across_points)
    if ball == 0.0:
        return np.nan
    rule, key = StartRule(3, TRIALS, False, 0.0), mix_bits(np.uint64(seed) ^ mix_bits(np.uint64(s)))
    guess = start_plane(across_points, k, rule, key, plane, np.empty(k))
    if guess < 0.0:
        return np.nan
    hood = Near(np.empty((4, k)), np.empty(k, np.int64), np.empty(k, np.bool_))
    frame = Frame(np.empty(3), np.empty(3), np.empty(3))
    level = RefitRule(ball, SIGMAS, 0.0, REFITS)
    flat = level_frame(pts, k, np.zeros(3), plane, guess, level, hood, frame)
    if flat < 0.0:
        return np.nan
    m = _within_rim(pts, frame, ball, flat, hood)
    if m < FEWEST:
        return flat
    mark_flat(hood.uvw, m, SIGMAS * flat, hood.inside)
    wide, terms = RefitRule(2.0 * ball, SIGMAS, 0.0, REFITS), Terms(np.zeros(6), np.empty((6, 6)))
    used, curved = refit(hood, m, 6, flat, wide, unthinned(m), terms)
    return curved if used > m // 2 else flat


@parallel_kernel
def scatter(r: F64, near: I64, seed: int, sigma: F64) -> None:
    """Standard deviation (s,) m along the normal of the points ``near`` (s, k), indices into r (n,
    3), from a robust quadric, a plane where they are too few; NaN where they have no extent.
    """
    for s in numba.prange(len(near)):
        sigma[s] = _scatter_of(signed(s), r, near[s], seed)
