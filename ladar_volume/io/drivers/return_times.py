"""The time of every return of a cloud, int64 ns: from offsets to the stamp or from times since
1970, in the unit that the numbers themselves allow. What no scanner does is refused, not read.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.drivers.point_layouts import ABSOLUTE, PointLayout
from ladar_volume.model.errors import CloudError
from ladar_volume.model.parameters import GeoreferenceParameters
from ladar_volume.model.records import I64, Bool

#: Offsets and absolute times beyond these (s) are no times of this age, and would not fit into
#: nanoseconds.
LONGEST_OFFSET_S, LATEST_S = 1e6, 9e9
#: A time since 1970 before this (s, the year 2000) is of a clock that was never set.
EARLIEST_S = 946_684_800.0
#: Units of times since 1970, per second.
UNITS = (1, 1_000, 1_000_000, 1_000_000_000)
#: A clock that was never set may be that of the stamps too: within this of them, s.
SAME_CLOCK_S = 60.0
#: Half of the returns further from the stamp than this (s): the unit is another one.
LONGEST_SWEEP_S = 10.0
#: A cloud larger than this is no single firing: one time for all of its returns is none.
ONE_TIME_RETURNS = 500
#: Of so many values the median is taken, about: it chooses between units, a thousand apart.
SAMPLE = 1000
#: A cloud all around the scanner in less than this (s): no scanner turns as fast.
FASTEST_TURN_S = 1e-3
#: Share of the returns that each quadrant has, at least, of a cloud all around.
QUADRANT = 0.05

Values = npt.NDArray[Any]


def return_times(
    columns: dict[str, Values],
    layout: PointLayout,
    stamp_ns: int,
    parameters: GeoreferenceParameters,
) -> tuple[I64, Bool]:
    """Time of each return (n,) and whether it is one; 0 or the stamp where not.

    Raises CloudError: cloud_no_time, cloud_one_time (the same for every return of a sweep),
    cloud_time_unit, cloud_time_epoch.
    """
    n = len(columns["x"])
    if not layout.time:
        if parameters.untimed_clouds == "stamp":
            return np.full(n, stamp_ns, np.int64), np.ones(n, np.bool_)
        raise CloudError(
            f"{layout.words} without per-point time (time, t, offset_time or timestamp); "
            "georeference.untimed_clouds: stamp accepts it",
            reason="cloud_no_time",
        )
    values = columns[layout.time]
    refuse = parameters.untimed_clouds == "refuse"
    if refuse:
        _check_one_time(values, layout)
    # 32 bits hold no time since 1970 but whole seconds
    wide = values.dtype.itemsize == 8
    if wide and (layout.time in ABSOLUTE or _epoch_unit(_middle(values)) is not None):
        t_ns, ok = _since_epoch(values, layout, stamp_ns)
    else:
        offset, ok = _offsets(values, layout)
        if layout.time == "t" and parameters.stamp_refers_to == "last":
            offset = offset - offset.max()
        t_ns = stamp_ns + offset
    if refuse and n > ONE_TIME_RETURNS:
        _check_turn(columns, t_ns[ok], layout)
    return t_ns, ok


def _check_one_time(values: Values, layout: PointLayout) -> None:
    """Refuse the same time for all returns of a sweep."""
    n = len(values)
    if n > ONE_TIME_RETURNS and bool((values == values[0]).all()):
        raise CloudError(
            f"field {layout.time} holds one and the same time for {n} returns; "
            "georeference.untimed_clouds: stamp accepts it",
            reason="cloud_one_time",
            value=n,
        )


def _middle(values: Values) -> float:
    """The median size of some of the values; 0 without a finite one."""
    with np.errstate(invalid="ignore"):  # bits that are no number
        some = np.abs(values[:: max(len(values) // SAMPLE, 1)].astype(np.float64))
    some = some[np.isfinite(some)]
    return float(np.median(some)) if len(some) else 0.0


def _epoch_unit(middle: float) -> int | None:
    """Units per second of a time since 1970; None for what is none after the year 2000."""
    return next((unit for unit in UNITS if EARLIEST_S <= middle / unit <= LATEST_S), None)


def _offsets(values: Values, layout: PointLayout) -> tuple[I64, Bool]:
    """Offsets from the stamp, ns, and whether each is one: whole numbers are nanoseconds, others
    seconds.
    """
    unit = 1e9 if values.dtype.kind in "iu" else 1.0
    with np.errstate(invalid="ignore"):
        size = np.abs(values.astype(np.float64)) / unit
    ok = size <= LONGEST_OFFSET_S  # NaN is not
    middle = _middle(values) / unit
    if middle > LONGEST_SWEEP_S:
        raise CloudError(
            f"{layout.words}: field {layout.time} ({values.dtype}) read as "
            f"{'nanoseconds' if unit > 1.0 else 'seconds'} lies {middle:.3g} s from the stamp, "
            "and no sweep lasts so long: its driver writes another unit, or times since another "
            "epoch; update it or convert the recording",
            reason="cloud_time_unit",
            value=middle,
        )
    clean = values if ok.all() else np.where(ok, values, 0)
    if clean.dtype.kind == "f":
        return np.rint(clean.astype(np.float64) * 1e9).astype(np.int64), ok
    return clean.astype(np.int64), ok


def _since_epoch(values: Values, layout: PointLayout, stamp_ns: int) -> tuple[I64, Bool]:
    """Times (ns) since 1970 from seconds, milli-, micro- or nanoseconds."""
    size = np.abs(values.astype(np.float64))
    unit = _unit(values, layout, stamp_ns)
    ok = size <= LATEST_S * unit  # NaN is not
    clean = values if ok.all() else np.where(ok, values, 0)
    scale = 1_000_000_000 // unit
    if clean.dtype.kind in "iu":
        return clean.astype(np.int64) * scale, ok
    whole = np.floor(clean)  # a product of 1e18 would round nanoseconds away
    rest = np.rint((clean - whole) * scale).astype(np.int64)
    return whole.astype(np.int64) * scale + rest, ok


def _unit(values: Values, layout: PointLayout, stamp_ns: int) -> int:
    """Units per second: those of a time since 1970, else those beside the stamp."""
    middle = _middle(values)
    known = _epoch_unit(middle)
    if known is not None:
        return known
    for unit in (1, 1_000_000_000):
        if abs(middle / unit - stamp_ns * 1e-9) <= SAME_CLOCK_S:
            return unit
    raise CloudError(
        f"{layout.words}: field {layout.time} ({values.dtype}) is about {middle:.6g}, neither a "
        "time since 1970 nor beside the stamp: the scanner's clock is not set (PTP, GPS), or the "
        "driver writes offsets; set the clock, or let the driver stamp with the computer's",
        reason="cloud_time_epoch",
        value=middle,
    )


def _check_turn(columns: dict[str, Values], t_ns: I64, layout: PointLayout) -> None:
    """Refuse a cloud all around the scanner whose times span no turn: their unit is another one."""
    if not len(t_ns):
        return
    span = 1e-9 * float(t_ns.max() - t_ns.min())
    if span >= FASTEST_TURN_S:
        return
    x, y = columns["x"], columns["y"]
    seen = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
    quadrant = 2 * (x[seen] > 0) + (y[seen] > 0)
    if len(quadrant) < ONE_TIME_RETURNS:
        return
    if np.bincount(quadrant, minlength=4).min() < QUADRANT * len(quadrant):
        return
    raise CloudError(
        f"{layout.words}: by field {layout.time} ({columns[layout.time].dtype}) returns from all "
        f"around came within {1e6 * span:.3g} us, and no scanner turns so fast: its driver writes "
        "another unit; update it or convert the recording",
        reason="cloud_time_unit",
        value=span,
    )
