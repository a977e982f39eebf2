"""Two echoes of one firing (dual return mode): one of them is taken.

Both lie on one beam and share its errors of direction and time, so as two points they would halve
the noise that the filter believes in. The farther one is taken: dust, rain and leaves are nearer.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.records import F64, Bool, Returns

#: Two echoes of a firing lie on one line through the scanner, m, up to so much and so much of the
#: nearer range: lasers leave the axis up to 11 mm above the centre.
BESIDE_M, BESIDE_RAD = 0.02, 0.001
#: Where more of the firings than this share have three returns, times are coarse and tell nothing.
COARSE = 0.01


def one_echo(returns: Returns) -> Bool:
    """Which returns (n,) to keep: of two of one ring at one time on one line the farther, or the
    later in the cloud of two alike.
    """
    n = len(returns)
    keep = np.ones(n, np.bool_)
    key = (returns.t_ns - returns.t_ns.min()) * 65536 + returns.ring
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    if not same.any() or np.count_nonzero(same[1:] & same[:-1]) > COARSE * n:
        return keep
    first, second = order[:-1][same], order[1:][same]
    a, b = returns.r_laser[first], returns.r_laser[second]
    near_is_first = np.einsum("ij,ij->i", a, a) <= np.einsum("ij,ij->i", b, b)
    near = np.where(near_is_first[:, None], a, b)
    far = np.where(near_is_first[:, None], b, a)
    pair = _on_one_line(near, far)
    keep[np.where(near_is_first, first, second)[pair]] = False
    return keep


def _on_one_line(near: F64, far: F64) -> Bool:
    """Whether the nearer point (n, 3) lies on the way to the farther, seen from the origin."""
    length = np.sqrt(np.einsum("ij,ij->i", near, near))
    reach = np.sqrt(np.einsum("ij,ij->i", far, far))
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.einsum("ij,ij->i", near, far) / reach
        beside = np.linalg.norm(near - along[:, None] * far / reach[:, None], axis=1)
        found: Bool = (along > 0) & (beside <= BESIDE_M + BESIDE_RAD * length)
    return found
