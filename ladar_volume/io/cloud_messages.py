"""LiDAR clouds: PointCloud2 → :class:`Returns` with a time for every return."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.tables import decode
from ladar_volume.model.errors import CloudError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters
from ladar_volume.model.records import I64, Returns, select

#: Absolute `timestamp` values above this are nanoseconds, below it seconds (1e12 s is 30,000 years
#: ahead).
NANOSECONDS_ABOVE = 1e12
#: Names of the time of a return, in the order of preference.
TIME_FIELDS = ("time", "t", "timestamp", "time_stamp")
#: Offsets and absolute times beyond these (s) are no times of this age, and would not fit into
#: nanoseconds.
LONGEST_OFFSET_S, LATEST_S = 1e6, 9e9
#: A cloud larger than this is no single firing: one time for all of its returns is none.
ONE_TIME_RETURNS = 500


def stamp_ns(message: Any) -> int:
    """Header stamp in int64 nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _check_scalars(columns: dict[str, npt.NDArray[Any]]) -> None:
    """Refuse a cloud without x, y, z, and fields with several values per point."""
    missing = [axis for axis in "xyz" if axis not in columns]
    if missing or any(columns[axis].ndim != 1 for axis in "xyz"):
        raise CloudError(
            f"cloud without scalar field {', '.join(missing) or 'x, y, z'}",
            reason="cloud_no_xyz",
            value=missing,
        )
    vectors = [
        name
        for name in ("ring", "intensity", *TIME_FIELDS)
        if name in columns and columns[name].ndim != 1
    ]
    if vectors:
        raise CloudError(
            f"several values per point in field {', '.join(vectors)}",
            reason="cloud_fields",
            value=vectors,
        )


def returns_from_cloud(message: Any, parameters: GeoreferenceParameters, losses: Losses) -> Returns:
    """Decode a Velodyne (`time`), Ouster-style (`t`) or absolute (`timestamp`) cloud, organised or
    not.

    A row with a NaN coordinate is dropped with all its columns and counted (point_nan), as is one
    with a time that is not finite (point_time). A missing `ring` reads as 0, a missing `intensity`
    as 0.

    Raises
    ------
    CloudError : layout reasons of :func:`ladar_volume.io.tables.decode`; cloud_no_xyz,
        cloud_no_time, cloud_one_time (a time field that
        says the same for every return of a sweep), cloud_all_nan.
    """
    columns = decode(message)
    _check_scalars(columns)
    n = len(columns["x"])
    r_laser = np.empty((n, 3))
    for i, axis in enumerate("xyz"):
        r_laser[:, i] = columns[axis]
    t_ns, timed = _times(columns, stamp_ns(message), n, parameters)
    finite = np.isfinite(r_laser).all(axis=1)
    ring = columns.get("ring", np.zeros(n, np.uint16)).astype(np.uint16, copy=False)
    intensity = columns.get("intensity", np.zeros(n, np.float32)).astype(np.float32, copy=False)
    returns = Returns(t_ns, r_laser, ring, intensity)
    keep = finite & timed
    if keep.all():
        return returns
    losses.add("point_nan", int(n - finite.sum()))
    losses.add("point_time", int((finite & ~timed).sum()))
    if not keep.any():
        raise CloudError(f"none of {n} points is finite", reason="cloud_all_nan", value=n)
    return select(returns, keep)


def _offsets(values: npt.NDArray[Any]) -> tuple[I64, npt.NDArray[np.bool_]]:
    """Offsets from the stamp, ns, and whether each is one; 0 where not."""
    ok = np.abs(values.astype(np.float64)) <= LONGEST_OFFSET_S * (
        1e9 if values.dtype.kind in "iu" else 1.0
    )  # NaN is not
    clean = values if ok.all() else np.where(ok, values, 0)
    if clean.dtype.kind == "f":
        offset = np.rint(clean.astype(np.float64) * 1e9).astype(np.int64)
    else:
        offset = clean.astype(np.int64)  # Ouster: nanoseconds
    return offset, ok


def _times(
    columns: dict[str, npt.NDArray[Any]], stamp: int, n: int, parameters: GeoreferenceParameters
) -> tuple[I64, npt.NDArray[np.bool_]]:
    """Time of each return (ns) and whether it is finite; the offset's sign is taken as it comes."""
    name = next((c for c in TIME_FIELDS if c in columns), None)
    if name is None:
        if parameters.untimed_clouds == "stamp":
            return np.full(n, stamp, np.int64), np.ones(n, np.bool_)
        raise CloudError(
            (
                "cloud without per-point time (time, t or timestamp); "
                "georeference.untimed_clouds: stamp accepts it"
            ),
            reason="cloud_no_time",
        )
    values = columns[name]
    if (
        n > ONE_TIME_RETURNS
        and parameters.untimed_clouds == "refuse"
        and bool((values == values[0]).all())
    ):
        raise CloudError(
            (
                f"field {name} holds one and the same time for {n} returns; "
                "georeference.untimed_clouds: stamp accepts it"
            ),
            reason="cloud_one_time",
            value=n,
        )
    if name.startswith("time") and name != "time":
        return _absolute(values)
    offset, ok = _offsets(values)
    if name == "t" and parameters.stamp_refers_to == "last":
        offset = offset - offset.max()
    return stamp + offset, ok


def _absolute(values: npt.NDArray[Any]) -> tuple[I64, npt.NDArray[np.bool_]]:
    """Times (ns) from seconds or nanoseconds since an epoch, whichever the median is."""
    size = np.abs(values.astype(np.float64))
    finite = size[np.isfinite(size)]
    scale = 1.0 if len(finite) and float(np.median(finite)) > NANOSECONDS_ABOVE else 1e9
    ok = size <= LATEST_S * 1e9 / scale  # NaN is not
    clean = values if ok.all() else np.where(ok, values, 0)
    if clean.dtype.kind in "iu":
        return clean.astype(np.int64) * int(scale), ok
    whole = np.floor(
        clean
    )  # splitting keeps the nanoseconds that a product of 1e18 would round away
    return whole.astype(np.int64) * int(scale) + np.rint((clean - whole) * scale).astype(
        np.int64
    ), ok
