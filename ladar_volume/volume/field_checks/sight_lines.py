"""What lines of sight tell of a surface that was not seen: it lies below them.

Behind an edge is a shadow. The farthest point that was seen beyond it lies on the line of sight
that passes the edge, and all between lies below that line: a tighter bound than the smooth
continuation of the rim, which has no edge.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.model.records import F64, I64, Bool, PatchTable

#: A rim point lies on the line of sight of another one: within so much of its direction in plan,
#: and where the slope between the two is at least so much of the line's.
ALONG, GRAZING = math.cos(math.radians(15.0)), 0.75
#: Of the points that stand nearly in the way of a line the edge is where the slope is the largest,
#: or at least so much of that.
EDGE = 0.9
#: Views that differ more than this, as from all sides, are of no one line: length of their mean.
ONE_SIDED = 0.85


def patch_views(patches: PatchTable) -> F64:
    """Mean unit vectors (m, 3) from each patch to the laser: what a bias of the ranges would move
    it by, along normal, tangent and binormal. In 32 bits, as they are sent.
    """
    p = patches.beta.shape[1]
    normal, tangent = patches.normal.astype(np.float32), patches.tangent.astype(np.float32)
    axes = np.stack([normal, tangent, np.cross(normal, tangent)], axis=1).astype(np.float64)
    by_range = patches.M_cal[:, [0, p, p + 1], 0].astype(np.float64)
    out: F64 = -np.einsum("mk,mkc->mc", by_range, axes)
    return out


def sight_slopes(view: F64) -> tuple[F64, F64]:
    """Directions in plan (n, 2) of views (n, 3), and how much they rise per metre there; infinite
    where a point was seen from several sides, from right above, or from below.
    """
    flat, length = np.hypot(view[:, 0], view[:, 1]), np.linalg.norm(view, axis=1)
    one = (length > ONE_SIDED) & (flat > 1e-6) & (view[:, 2] > 0.0)
    safe = np.where(one, flat, 1.0)
    return view[:, :2] / safe[:, None], np.where(one, view[:, 2] / safe, math.inf)


def grazing_pairs(r: F64, direction: F64, slope: F64) -> tuple[I64, I64]:
    """Of points r (n, 3) with their lines of sight: pairs (k,), (k,) of one whose line passes the
    other one, which stands nearly in its way: the edge of what casts the shadow.
    """
    step = r[None, :, :2] - r[:, None, :2]
    far = np.hypot(step[..., 0], step[..., 1])
    ahead = np.einsum("ijc,ic->ij", step, direction)
    rise = (r[None, :, 2] - r[:, None, 2]) / np.where(far > 0.0, far, math.inf)
    found: Bool = (ahead >= ALONG * far) & (rise > 0.0) & (rise >= GRAZING * slope[:, None])
    best = np.where(found, rise, 0.0).max(axis=1, initial=0.0)
    seen, edge = np.nonzero(found & (rise >= EDGE * best[:, None]))
    return seen, edge


def shadow_heights(r: F64, view: F64, xy: F64, beside_m: float) -> F64:
    """Heights (k,) m that a surface in shadow keeps below at places xy (k, 2), infinite where these
    are in none. r : (n, 3) m, seen points around, with views (n, 3) · beside_m : how far from a
    line of sight a place still is in its shadow.
    """
    out = np.full(len(xy), math.inf)
    direction, slope = sight_slopes(view)
    seen, edge = grazing_pairs(r, direction, slope)
    if not len(seen):
        return out
    start, step = r[seen], r[edge] - r[seen]
    square = (step[:, :2] ** 2).sum(axis=1)
    for k in range(len(xy)):
        part = ((xy[k] - start[:, :2]) * step[:, :2]).sum(axis=1) / square
        at = start[:, :2] + part[:, None] * step[:, :2]
        near = (part >= 0.0) & (part <= 1.0) & (np.hypot(*(at - xy[k]).T) <= beside_m)
        if near.any():
            out[k] = float((start[near, 2] + part[near] * step[near, 2]).min())
    return out
