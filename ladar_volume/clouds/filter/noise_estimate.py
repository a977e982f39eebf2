"""How far points scatter about a robust quadric through them: the noise, told from small
neighbourhoods.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ladar_volume.math.array_types import U64
from ladar_volume.math.kernels import kernel, parallel_kernel
from ladar_volume.rmls.patch_fit import StartRule, start_plane
from ladar_volume.rmls.tangent_frame import (
    Frame,
    Near,
    RefitRule,
    Terms,
    coordinates,
    level_frame,
    mark_flat,
    refit,
)
from ladar_volume.rmls.voxel_store import _mix

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
        out[i] = _mix(numbers[i])
    return out


@parallel_kernel
def scatter(r: Any, near: Any, seed: Any, sigma: Any) -> None:
    """Standard deviation (s,) m along the normal of the points ``near`` (s, k), indices into r (n,
    3), from a robust quadric, a plane where they are too few; NaN where they have no extent.
    """
    for s in numba.prange(len(near)):
        k = near.shape[1]
        pts, across_points, plane, work = (
            np.empty((k, 3)),
            np.empty((3, k)),
            np.empty(4),
            np.empty(k),
        )
        origin, ball = np.zeros(3), 0.0
        for i in range(k):
            square = 0.0
            for c in range(3):
                pts[i, c] = r[near[s, i], c] - r[near[s, 0], c]
                across_points[c, i] = pts[i, c]
                square += pts[i, c] * pts[i, c]
            ball = max(ball, np.sqrt(square) * 1.0001)
        sigma[s] = np.nan
        if ball == 0.0:
            continue
        guess = start_plane(
            across_points,
            k,
            StartRule(3, TRIALS, False, 0.0),
            _mix(np.uint64(seed) ^ _mix(np.uint64(s))),
            plane,
            work,
        )
        if guess < 0.0:
            continue
        uvw, index, inside = np.empty((4, k)), np.empty(k, np.int64), np.empty(k, np.bool_)
        centre, normal, tangent, beta, inverse = (
            np.empty(3),
            np.empty(3),
            np.empty(3),
            np.zeros(6),
            np.empty((6, 6)),
        )
        flat = level_frame(
            pts,
            k,
            origin,
            plane,
            guess,
            RefitRule(ball, SIGMAS, 0.0, REFITS),
            Near(uvw, index, inside),
            Frame(centre, normal, tangent),
        )
        if flat < 0.0:
            continue
        sigma[s] = flat
        # a ball about a noisy point cuts the noise off along its rim: only the cylinder that lies
        # within it whatever the noise
        rim = ball * ball - (CUT * flat) ** 2
        m = 0
        for i in range(coordinates(pts, k, centre, normal, tangent, 2.0 * ball, uvw, index)):
            if 4.0 * ball * ball * (uvw[0, i] ** 2 + uvw[1, i] ** 2) <= rim:
                uvw[:, m] = uvw[:, i]
                m += 1
        if m < FEWEST:
            continue
        mark_flat(uvw, m, SIGMAS * flat, inside)
        used, curved = refit(
            uvw,
            m,
            6,
            flat,
            RefitRule(2.0 * ball, SIGMAS, 0.0, REFITS),
            inside,
            Terms(beta, inverse),
        )
        if used > m // 2:
            sigma[s] = curved
