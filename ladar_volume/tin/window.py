"""The map and its bins (seed 000 section 2.4): the rectangle that a triangulation covers, and where
the insertion starts.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64, Bool

#: Low x, low y, high x, high y, m.
Window = tuple[float, float, float, float]
#: Most bins of a grid.
MOST = 2**26


def map_window(xy: F64, window: Window | None = None) -> Window:
    """The map: the window asked for, or the bounding box of the points xy (n, 2). Raises
    :class:`SurfaceError` where it has no area.
    """
    if window is None:
        if len(xy) == 0:
            raise SurfaceError(
                "no points, and no map window", reason="surface_too_few_points", value=0
            )
        low, high = xy.min(axis=0), xy.max(axis=0)
        window = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    x0, y0, x1, y1 = (float(v) for v in window)
    if not (np.isfinite([x0, y0, x1, y1]).all() and x1 > x0 and y1 > y0):
        raise SurfaceError(f"the map {window} has no area", reason="surface_window", value=window)
    return x0, y0, x1, y1


def inside(xy: F64, window: Window) -> Bool:
    """Points (n,) of xy (n, 2) on the map, its border included."""
    out: Bool = (
        (xy[:, 0] >= window[0])
        & (xy[:, 1] >= window[1])
        & (xy[:, 0] <= window[2])
        & (xy[:, 1] <= window[3])
    )
    return out


def corners(window: Window) -> F64:
    """The corners (4, 2) of a map, counter-clockwise from the lowest x and y."""
    x0, y0, x1, y1 = window
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def grid(window: Window, bins_per_row: int) -> tuple[int, int]:
    """Bins per row (along x) and per column of the grid whose bins are as square as can be.

    Raises :class:`SurfaceError` below one bin per row, or above :data:`MOST` in all; with one bin
    per row a map ever so high has that many.
    """
    if bins_per_row < 1:
        raise SurfaceError(
            f"{bins_per_row} bins per row; there must be one or more",
            reason="surface_bins",
            value=bins_per_row,
        )
    ratio = (window[3] - window[1]) / (window[2] - window[0])
    per_column = max(1, round(min(bins_per_row * ratio, MOST)))
    if bins_per_row > 1 and bins_per_row * per_column > MOST:
        raise SurfaceError(
            f"{bins_per_row} bins per row are more than {MOST} in all",
            reason="surface_bins",
            value=bins_per_row,
        )
    return bins_per_row, per_column


@kernel
def central_kernel(
    xy: F64, open_: Bool, x0: float, y0: float, dx: float, dy: float, nx: int, ny: int
) -> I64:
    """Per bin, column after column (nx ny,), the open point nearest the centre, the first of
    equals, or -1.
    """
    best, least = np.full(nx * ny, -1, np.int64), np.full(nx * ny, np.inf)
    for i in range(len(xy)):
        if not open_[i]:
            continue
        a, b = min(int((xy[i, 0] - x0) / dx), nx - 1), min(int((xy[i, 1] - y0) / dy), ny - 1)
        x, y = (xy[i, 0] - x0) / dx - (a + 0.5), (xy[i, 1] - y0) / dy - (b + 0.5)
        d = x * x * (dx / dy) + y * y * (dy / dx)
        if d < least[a * ny + b]:
            best[a * ny + b], least[a * ny + b] = i, d
    return best


def central_points(xy: F64, open_: Bool, window: Window, bins_per_row: int) -> I64:
    """Initial binning: indices (k,) of the point nearest the centre of every bin that has an open
    point, by column first, by row second.
    """
    nx, ny = grid(window, bins_per_row)
    size = (window[2] - window[0]) / nx, (window[3] - window[1]) / ny
    best: I64 = central_kernel(np.ascontiguousarray(xy), open_, window[0], window[1], *size, nx, ny)
    return best[best >= 0]


def default_bins(window: Window, vertices: int) -> int:
    """Bins per row that put about a tenth of the vertices into the initial triangulation (as 15 to
    40 bins for 5,000 vertices do).
    """
    ratio = (window[3] - window[1]) / (window[2] - window[0])
    bins = max(1, min(vertices, int(np.sqrt(min(vertices, MOST) / 10.0 / ratio))))
    while bins > 1 and bins * max(1, round(bins * ratio)) > vertices:
        bins -= 1
    return bins
