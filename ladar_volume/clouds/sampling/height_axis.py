"""Which column of a cloud holds heights: models leave many programs with y up.

Over a cell of the other two columns the height of a surface hardly changes, while each of those
changes as far as the surface reaches.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64

#: Points that are looked at, and points in a cell, on average and at least.
MOST, MANY, LEAST = 20_000, 10.0, 3
#: Fewest cells that tell, and so many times as thick is no surface over x and y.
CELLS, THICKER = 20, 10.0


def thickness(r: F64, axis: int) -> float:
    """Mean standard deviation, m, of one column of points (n, 3) over cells of the other two; NaN
    where few cells hold three points.
    """
    flat = np.delete(r, axis, axis=1)
    flat = flat - flat.min(axis=0)
    size = math.sqrt(float(np.ptp(flat, axis=0).prod()) * MANY / len(r))
    if not size > 0.0:
        return math.nan
    at = np.floor(flat / size).astype(np.int64)
    _, cell = distinct_cells(at)
    count = np.bincount(cell)
    off = r[:, axis] - (np.bincount(cell, r[:, axis]) / count)[cell]
    full = count >= LEAST
    if np.count_nonzero(full) < CELLS:
        return math.nan
    return float(np.sqrt(np.bincount(cell, off**2)[full] / count[full]).mean())


def check_height_axis(r: F64) -> None:
    """Refuse points (n, 3) that are a surface over x and z, or y and z, and none over x and y.
    Raises :class:`InputError` (input_height_axis; value: the ratio of their thicknesses).
    """
    some = r[:: max(1, len(r) // MOST)]
    thick = [thickness(some, axis) for axis in range(3)]
    other = int(np.nanargmin(thick[:2])) if not np.isnan(thick[:2]).all() else 0
    if not thick[2] > THICKER * thick[other]:
        return
    name = "xy"[other]
    words = (
        f"heights seem to lie in column {name}: the points are {thick[other]:.2g} m thick over the "
        f"other two columns, and {thick[2]:.2g} m over x and y; write the cloud with z up"
    )
    raise InputError(words, reason="input_height_axis", value=thick[2] / thick[other])
