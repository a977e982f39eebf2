"""Returns that stand alone, off every surface: birds, dust, mixed pixels, multiple reflections.

A plane seen from the scanner is linear in ``1 / (range · cosine)`` over gnomonic coordinates. About
each return such a plane is fitted to its neighbours in direction, by least absolute residuals. A
return far off it stands alone unless some neighbours are as far off on the same side: these make an
edge, a second surface, or a boulder, which stay. Where nothing is seen (the sky) a return has no
such plane: there it stands alone by its distance to the nearest others, as a share of its range.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.change.spherical_tin import unit_directions
from ladar_volume.model.records import F64, I64, Bool

#: Neighbours in direction, how many of them keep a return, and by how many robust sigma one is off.
AROUND, COMPANY, OFF_SIGMAS = 24, 3, 6.0
#: A neighbour is company where it is off by this share of what the return is off, to its inverse.
COMPANY_SHARE = 0.5
#: Which neighbour in space measures the spacing, and how many times the usual one is too far.
NEIGHBOUR, SPARSE = 4, 10.0
MAD_TO_SIGMA = 1.4826
#: Rounds over what is left, steps of the reweighted fit, and returns that are held at once.
ROUNDS, STEPS, BLOCK = 3, 6, 1 << 15


def isolated_returns(points: F64, scanner: F64) -> Bool:
    """Returns (n,) that stand alone among points (n, 3) m seen from a scanner (3,) m.

    Raises :class:`SurfaceError` for points that are not finite, or one at the scanner.
    """
    direction, distance = unit_directions(points, scanner)
    if len(direction) <= AROUND:
        return np.zeros(len(direction), bool)
    r = np.asarray(points, dtype=np.float64)
    far, _ = cKDTree(r).query(r, NEIGHBOUR + 1)
    spacing: F64 = np.asarray(far, dtype=np.float64)[:, NEIGHBOUR] / distance
    alone: Bool = spacing > SPARSE * float(np.median(spacing))
    for _ in range(ROUNDS):
        left = np.flatnonzero(~alone)
        found = left[isolated_mask(direction[left], distance[left])]
        alone[found] = True
        if not len(found):
            break
    return alone


def isolated_mask(direction: F64, distance: F64) -> Bool:
    """Returns (n,) that stand alone among directions (n, 3) and distances (n,) m."""
    n, tree = len(direction), cKDTree(direction)
    if n <= AROUND:
        return np.zeros(n, bool)
    own, sigma, company = np.empty(n), np.empty(n), np.empty(n, np.int64)
    for first in range(0, n, BLOCK):
        rows = np.arange(first, min(first + BLOCK, n))
        near = np.asarray(tree.query(direction[rows], AROUND + 1)[1], dtype=np.int64)
        # a return in exactly the same direction may come first: the return itself is left out
        near = np.where(near == rows[:, None], near[:, -1:], near)[:, :AROUND]
        at = slice(first, first + len(rows))
        own[at], sigma[at], company[at] = plane_residuals(direction, distance, rows, near)
    limit = OFF_SIGMAS * np.maximum(sigma, float(np.median(sigma)))
    out: Bool = (np.abs(own) > limit) & (company < COMPANY)
    return out


def plane_residuals(direction: F64, distance: F64, rows: I64, near: I64) -> tuple[F64, F64, I64]:
    """How far returns (k,) are off the plane of their neighbours (k, c), m along the beam, the
    robust sigma of the neighbours, m, and how many are off as far on the same side.
    """
    axis = direction[rows]
    helper = np.eye(3)[np.abs(axis).argmin(axis=1)]
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(axis, u)
    d = direction[near]
    cosine = np.maximum((d * axis[:, None]).sum(axis=2), 1e-3)
    plan = np.stack([(d * e[:, None]).sum(axis=2) / cosine for e in (u, v)], axis=2)
    size = np.maximum(np.abs(plan).max(axis=(1, 2)), 1e-12)[:, None, None]
    X = np.concatenate([np.ones((*near.shape, 1)), plan / size], axis=2)
    inverse = 1.0 / (distance[near] * cosine)
    x = least_absolute(X, inverse)
    flat = np.maximum((X * x[:, None]).sum(axis=2), 1e-3 * inverse)
    off = distance[near] - 1.0 / (flat * cosine)
    here = 1.0 / np.maximum(x[:, 0], 1e-3 / distance[rows])
    own = distance[rows] - here
    sigma = MAD_TO_SIGMA * np.median(np.abs(off), axis=1)
    share = off / np.where(own == 0.0, 1e-300, own)[:, None]
    alike = (share >= COMPANY_SHARE) & (share <= 1.0 / COMPANY_SHARE)
    return own, sigma, alike.sum(axis=1)


def least_absolute(X: F64, y: F64) -> F64:
    """Parameters (k, 3) of least absolute residuals of y (k, c) on X (k, c, 3), reweighted."""
    w = np.ones_like(y)
    floor = 1e-9 * np.abs(y).max(axis=1)
    for _ in range(STEPS):
        N = np.einsum("kci,kc,kcj->kij", X, w, X)
        N += 1e-9 * np.trace(N, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        x = np.linalg.solve(N, np.einsum("kci,kc,kc->ki", X, w, y)[..., None])[..., 0]
        v = np.abs(y - (X * x[:, None]).sum(axis=2))
        w = 1.0 / np.maximum(v, np.maximum(0.1 * np.median(v, axis=1), floor)[:, None])
        w /= w.max(axis=1)[:, None]
    out: F64 = x
    return out
