"""Volume and surface against resolution (seed 003 section 4).

As a coastline's length, the surface of rubble grows the finer it is scanned; its volume converges.
A number without its resolution is no number, so both are computed over a series of thinned clouds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, I64


@dataclass(frozen=True)
class ResolutionSeries:
    """cell_m, points, volume_m3, area_m2 : (k,) each, finest first · dimension : 2 minus the slope
    of log area over log cell: 2 for a smooth surface, towards 3 for rubble · volume_change_m3 :
    spread of the volume over the series
    """

    cell_m: F64
    points: I64
    volume_m3: F64
    area_m2: F64
    dimension: float
    volume_change_m3: float


def thin(points: F64, cell_m: float) -> I64:
    """Indices, ascending, of one point per cell of a cubic grid: the one nearest its centre,
    whatever the order of the points (n, 3).
    """
    p = np.asarray(points, dtype=np.float64)
    if (
        p.ndim != 2
        or p.shape[1:] != (3,)
        or len(p) == 0
        or not np.isfinite(p).all()
        or not cell_m > 0.0
    ):
        raise VolumeError(
            "thinning needs finite points (n, 3) and a cell above zero",
            reason="resolution_input",
            value=cell_m,
        )
    cell = np.floor(p / cell_m)
    far = ((p - (cell + 0.5) * cell_m) ** 2).sum(axis=1)
    order = np.lexsort((p[:, 2], p[:, 1], p[:, 0], far, cell[:, 2], cell[:, 1], cell[:, 0]))
    first = np.append(True, (np.diff(cell[order], axis=0) != 0).any(axis=1))
    return np.sort(order[first]).astype(np.int64)


def resolution_series(
    points: F64, cells_m: Sequence[float], evaluate: Callable[[F64], tuple[float, float]]
) -> ResolutionSeries:
    """Volume (m³) and area (m²) as ``evaluate`` gives them for points thinned to each cell size, m.

    Raises :class:`VolumeError` for fewer than two sizes or an area that is not above zero.
    """
    cells = np.sort(np.asarray(cells_m, dtype=np.float64))
    if len(cells) < 2 or len(np.unique(cells)) < len(cells):
        raise VolumeError(
            "a series needs at least two different cell sizes",
            reason="resolution_input",
            value=cells_m,
        )
    p = np.asarray(points, dtype=np.float64)
    chosen = [thin(p, float(c)) for c in cells]
    results = np.array([evaluate(p[c]) for c in chosen], dtype=np.float64)
    volume, area = results.T
    if not (area > 0).all():
        raise VolumeError("an area that is not above zero", reason="resolution_input", value=area)
    slope = float(np.polyfit(np.log(cells), np.log(area), 1)[0])
    count = np.array([len(c) for c in chosen], np.int64)
    return ResolutionSeries(cells, count, volume, area, 2.0 - slope, float(np.ptp(volume)))
