"""Whether a body stands on a terrace of its own, such as a slab or a filled pad, which the outline
takes in: much of its area lies about one height a little above the base, far more than at some
height below that and at some height not far above it, and a part of the body lies above it. What
is filtered has soft edges: just beside that height lies some of the terrace, too.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32, I64, Plane, Tin
from ladar_volume.tin.boundary import border
from ladar_volume.tin.relevant import longest_sides

#: Heights of a terrace above the base, m; half the range of heights that is one, in standard
#: deviations of the ground about the base, wide and, for a low one on uneven ground, narrow; and
#: the least of these, m.
HEIGHTS, HALF, LEAST_M = (0.05, 1.0), (2.0, 1.0), 0.0125
#: A terrace has so many times the least area of as wide a range anywhere below it, and of one that
#: ends within so many of its own widths above it; its least mean width, m; and the share of the
#: volume above it.
TIMES, REACH, WIDE_M, ABOVE = 2.0, 4, 0.2, 0.15
#: Triangles bridge what was not seen from so many times the usual longest side on.
SPARSE = 4.0


def terrace_points(tin: Tin, base: Plane, inside_m2: F64, spread_m: float, radius_m: float) -> I64:
    """Vertices (k,) on a terrace within the outline, inside_m2 (m,) m² of each triangle; none where
    there is none. spread_m : standard deviation of the ground about the base · radius_m : of the
    filter; wider triangles bridge what was not seen, and each is much area about one height.
    """
    rows = np.flatnonzero(inside_m2 > 0.0)
    side = longest_sides(tin.vertices, tin.triangles, rows)
    rows = rows[side <= max(radius_m, SPARSE * float(np.median(side)))]
    area = inside_m2[rows]
    mean = mean_heights(height_above(tin.vertices, base), tin.triangles, rows)
    wide = WIDE_M * float(border(tin, inside_m2 > 0.0)[1].sum())
    for half in (times * max(spread_m, LEAST_M) for times in HALF):
        at = terrace_height(mean, area, half)
        on = np.abs(mean - at) <= half
        more, total = (float(area @ np.maximum(mean - low, 0.0)) for low in (at, 0.0))
        if at > 0.0 and float(area[on].sum()) >= wide and more >= ABOVE * total:
            out = np.unique(tin.triangles[rows[on]]).astype(np.int64)
            return out[np.abs(height_above(tin.vertices[out], base) - at) <= half]
    return np.zeros(0, np.int64)


@kernel
def mean_heights(height: F64, triangles: I32, rows: I64) -> F64:
    """Means (k,) m of the heights (n,) m at the corners of the triangles ``rows`` (k,)."""
    out = np.empty(len(rows))
    for k in range(len(rows)):
        t = rows[k]
        out[k] = (height[triangles[t, 0]] + height[triangles[t, 1]] + height[triangles[t, 2]]) / 3.0
    return out


def terrace_height(height: F64, area: F64, half: float) -> float:
    """The height about which, within half, m, the most area (k,) m² of heights (k,) m lies, of
    those with far less somewhere below and somewhere not far above; 0 where there is none.
    """
    at, low, high, bins = height_bins(half)
    return height_among(at, np.histogram(height, bins, (low, high), weights=area)[0])


def height_bins(half: float) -> tuple[F64, float, float, int]:
    """Heights (k,) m about which a terrace is sought, and from where to where areas are summed by
    height, m, in how many bins.
    """
    step = 0.5 * half
    at = np.arange(max(HEIGHTS[0], 2.5 * half), HEIGHTS[1], step)
    low = float(at[0] - 6.0 * step) if len(at) else 0.0
    bins = len(at) + 7 + 4 * REACH
    return at, low, low + bins * step, bins


def height_among(at: F64, by_bin: F64) -> float:
    """The height of :func:`terrace_height` from the areas (bins,) m² by height."""
    if not len(at):
        return 0.0
    n, reach = len(at), 4 * REACH
    four = np.convolve(by_bin, np.ones(4), "valid")  # from each bin on: as high as 2 half
    own, below = four[4 : n + 4], np.minimum.accumulate(four)[:n]
    above = np.lib.stride_tricks.sliding_window_view(four[8:], reach - 3)[:n].min(axis=1)
    own = np.where(own > TIMES * np.maximum(below, above), own, 0.0)
    return float(at[np.argmax(own)]) if own.any() else 0.0
