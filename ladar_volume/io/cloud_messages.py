"""LiDAR clouds: PointCloud2 or VelodyneScan → :class:`Returns` with a time for every return."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ladar_volume.io.drivers.dual_returns import one_echo
from ladar_volume.io.drivers.point_layouts import (
    INTENSITY_FIELDS,
    RING_FIELDS,
    TIME_FIELDS,
    intensities_of,
    layout_of,
    rings_of,
)
from ladar_volume.io.drivers.return_times import return_times
from ladar_volume.io.drivers.velodyne_scan import returns_from_scan
from ladar_volume.io.tables import decode
from ladar_volume.model.errors import CloudError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters
from ladar_volume.model.records import Returns, select


class CloudField(Protocol):
    """sensor_msgs/PointField."""

    name: str


class Cloud(Protocol):
    """sensor_msgs/PointCloud2, as far as it is read here."""

    header: object
    fields: Sequence[CloudField]


#: Most points of one cloud: a sweep of the densest rotating scanners has 0.3 million.
MOST_RETURNS = 4_000_000
#: All fields that are read; drivers write many more.
READ = frozenset(("x", "y", "z", *TIME_FIELDS, *RING_FIELDS, *INTENSITY_FIELDS))


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
    vectors = [name for name, values in columns.items() if values.ndim != 1]
    if vectors:
        raise CloudError(
            f"several values per point in field {', '.join(vectors)}",
            reason="cloud_fields",
            value=vectors,
        )


def returns_from_cloud(message: Any, parameters: GeoreferenceParameters, losses: Losses) -> Returns:
    """Decode a PointCloud2 or, as :func:`returns_from_scan`, a VelodyneScan. Of two echoes of one
    firing one is taken; the others are counted (point_dual_return).

    Raises
    ------
    CloudError : as :func:`returns_from_points` and :func:`returns_from_scan`.
    ParameterValueError : packets of a scanner with another number of beams.
    """
    if hasattr(message, "packets"):
        returns = returns_from_scan(message, parameters)
    else:
        returns = returns_from_points(message, parameters, losses)
        if not any(f.name in TIME_FIELDS for f in message.fields):
            return returns
    keep = one_echo(returns)
    if keep.all():
        return returns
    losses.add("point_dual_return", len(keep) - int(np.count_nonzero(keep)))
    return select(returns, keep)


def _check_count(n: int) -> None:
    if n > MOST_RETURNS:
        raise CloudError(
            f"{n} points in one cloud, a sweep has at most {MOST_RETURNS}: send one cloud a sweep",
            reason="cloud_too_many",
            value=n,
        )


def returns_from_points(
    message: Cloud, parameters: GeoreferenceParameters, losses: Losses
) -> Returns:
    """Decode a cloud of any layout of :mod:`ladar_volume.io.drivers.point_layouts`, organised or
    not.

    A row with a NaN coordinate is dropped with all its columns and counted (point_nan), as is one
    with a time that is not finite (point_time). A missing ring reads as 0, a missing intensity as
    0.

    Raises
    ------
    CloudError : layout reasons of :func:`ladar_volume.io.tables.decode`; reasons of
        :func:`ladar_volume.io.drivers.return_times.return_times`; cloud_no_xyz, cloud_all_nan,
        cloud_too_many.
    """
    columns = decode(message, READ)
    _check_scalars(columns)
    n = len(columns["x"])
    _check_count(n)
    layout = layout_of([str(f.name) for f in message.fields])
    r_laser = np.empty((n, 3))
    for i, axis in enumerate("xyz"):
        with np.errstate(invalid="ignore"):  # a signalling NaN is one like another
            r_laser[:, i] = columns[axis]
    t_ns, timed = return_times(columns, layout, stamp_ns(message), parameters)
    finite = np.isfinite(r_laser).all(axis=1)
    returns = Returns(
        t_ns, r_laser, rings_of(columns, layout, n), intensities_of(columns, layout, n)
    )
    keep = finite & timed
    if keep.all():
        return returns
    losses.add("point_nan", int(n - finite.sum()))
    losses.add("point_time", int((finite & ~timed).sum()))
    if not keep.any():
        raise CloudError(f"none of {n} points is finite", reason="cloud_all_nan", value=n)
    return select(returns, keep)
