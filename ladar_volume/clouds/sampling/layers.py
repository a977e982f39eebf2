"""Two layers of points, one above the other: strips that do not fit together, a roof or leaves
above what is measured. The surface through all points lies between them and is neither.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_noise import neighbours
from ladar_volume.clouds.sampling.rounding_step import rounding_steps
from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Doubt

#: Places that are looked at; fewest neighbours in a layer; the gap between two layers in standard
#: deviations within them: noise of one layer has such a gap at one place in a hundred.
MOST, FEWEST, GAP = 2000, 4, 2.0
#: Blocks along each side of the site, share of its places from which on a block has layers, and
#: share of the blocks from which on they are told: steps and single walls have fewer.
BLOCKS, OFTEN, SHARE = 8, 0.15, 0.2
#: Layers less than so many steps apart, to which heights were rounded, are those of the rounding.
ROUNDED = 2.5


class Layers(NamedTuple):
    """share : of the site that has two layers · apart_m : by which they are apart, the median"""

    share: float
    apart_m: float


def two_layers(points: F64, rows: I64) -> Layers:
    """The layers of points (n, 3) m about some of them, rows (k,).

    At each place the heights of the neighbours above their mean plane are split at the widest gap
    between them that leaves four on either side.
    """
    some = rows[:: max(1, math.ceil(len(rows) / MOST))]
    if len(points) < 10 * FEWEST or not len(some):
        return Layers(0.0, 0.0)
    near = neighbours(points, np.arange(len(points)), some)
    return layers_of(near, points[some], lambda: float(rounding_steps(points)[2]))


def layers_of(near: F64, places: F64, step_m: Callable[[], float]) -> Layers:
    """The layers about places (k, 3) m, from the points (k, m, 3) nearest to each. step_m : to
    which heights were rounded, asked where there are layers
    """
    h = np.sort(heights_above_plane(near), axis=1)
    k = h.shape[1]
    cut = np.arange(FEWEST, k - FEWEST + 1)
    gap = h[:, cut] - h[:, cut - 1]
    at = cut[np.argmax(gap, axis=1)]
    upper = np.arange(k) >= at[:, None]
    n_up = upper.sum(axis=1)
    high, low = (h * upper).sum(axis=1) / n_up, (h * ~upper).sum(axis=1) / (k - n_up)
    within = h - np.where(upper, high[:, None], low[:, None])
    spread = np.sqrt((within**2).sum(axis=1) / (k - 2))
    split = gap.max(axis=1) > GAP * np.maximum(spread, 1e-12)
    block = blocks(places[:, :2])
    often = np.bincount(block, split) > OFTEN * np.bincount(block)
    layered = often[block]
    if not (split & layered).any():
        return Layers(0.0, 0.0)
    apart_m = float(np.median((high - low)[split & layered]))
    if apart_m < ROUNDED * step_m():
        return Layers(0.0, 0.0)
    return Layers(float(layered.mean()), apart_m)


def blocks(xy: F64) -> I64:
    """The block (k,) of each place (k, 2) m."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    at = np.clip(BLOCKS * (xy - low) / np.maximum(high - low, 1e-300), 0, BLOCKS - 1).astype(int)
    out: I64 = at[:, 0] * BLOCKS + at[:, 1]
    return out


def heights_above_plane(near: F64) -> F64:
    """Heights (k, m) of points (k, m, 3) above the plane that fits each of the m best."""
    d = near - near.mean(axis=1, keepdims=True)
    X = np.concatenate([np.ones_like(d[..., :1]), d[..., :2]], axis=2)
    N = np.einsum("nki,nkj->nij", X, X) + 1e-12 * np.eye(3)
    beta = np.linalg.solve(N, np.einsum("nki,nk->ni", X, d[..., 2])[..., None])[..., 0]
    out: F64 = d[..., 2] - np.einsum("nki,ni->nk", X, beta)
    return out


def layer_doubts(found: Layers, area_m2: float, sigma_m3: float) -> tuple[list[Doubt], float]:
    """The doubt, and what it adds to sigma, m³: the truth is anywhere from one layer to the
    other.
    """
    more = found.share * found.apart_m * area_m2 / 2.0
    if found.share < SHARE or not more > sigma_m3:
        return [], 0.0
    words = (
        f"on {100 * found.share:.0f} % of the site the points lie in two layers, "
        f"{found.apart_m:.3g} m apart, and the volume is that of their mean: strips that do not "
        "fit together, a roof or plants above; register the strips (epochs), take one, choose "
        f"--classes, or cut away what is above; {more:.3g} m³ of sigma"
    )
    return [Doubt("layers", words, found.apart_m)], more
