"""Which driver wrote a cloud, and in which of its fields ring, time and intensity are.

| driver | time of a return | ring |
|---|---|---|
| velodyne_pointcloud | ``time`` float32, s from the stamp | ``ring`` uint16 |
| ouster_ros | ``t`` uint32, ns from the stamp | ``ring`` uint16 |
| hesai_ros_driver, rslidar_sdk | ``timestamp`` float64, s since 1970 | ``ring`` uint16 |
| hesai_lidar (ROS 1) | the same, before ``ring`` | ``ring`` uint16 |
| livox_ros_driver2 | ``timestamp`` float64, ns since 1970 | ``line`` uint8 |
| the same, converted | ``offset_time`` uint32, ns from the stamp | ``line`` uint8 |
| nebula (Autoware) | ``time_stamp`` uint32, ns from the stamp | ``channel`` uint16 |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.model.records import F32, U16

#: Names of each kind of field, in the order of preference.
TIME_FIELDS = ("time", "t", "offset_time", "timestamp", "time_stamp")
RING_FIELDS = ("ring", "line", "channel")
INTENSITY_FIELDS = ("intensity", "reflectivity")
#: Times since an epoch; the others count from the stamp of the message.
ABSOLUTE = frozenset({"timestamp", "time_stamp"})
#: A ring that no scanner has: what a field of another type holds beyond uint16.
NO_RING = np.iinfo(np.uint16).max
#: Fields that together are of one driver alone.
SIGNATURES = (
    ("Ouster", frozenset({"t", "ring"})),
    ("Livox", frozenset({"tag", "line"})),
    ("Velodyne", frozenset({"time", "ring"})),
    ("Nebula", frozenset({"time_stamp", "channel"})),
)


@dataclass(frozen=True)
class PointLayout:
    """driver : its usual name, "" where none is known · time, ring, intensity : names of fields,
    "" where there is none
    """

    driver: str
    time: str
    ring: str
    intensity: str

    @property
    def words(self) -> str:
        """For a message: what kind of cloud this is."""
        return f"cloud of {self.driver}" if self.driver else "cloud"


def layout_of(names: Collection[str]) -> PointLayout:
    """The layout of a cloud by the names of its fields in their order."""
    order, fields = list(names), set(names)
    driver = next((name for name, own in SIGNATURES if own <= fields), "")
    if not driver and {"timestamp", "ring"} <= fields:
        # one order of the same fields is that of two drivers, but RoboSense's own feature
        first = order.index("ring") < order.index("timestamp")
        driver = "Hesai or RoboSense" if first else "Hesai"
        driver = "RoboSense" if "feature" in fields else driver

    def of(candidates: tuple[str, ...]) -> str:
        return next((name for name in candidates if name in fields), "")

    return PointLayout(driver, of(TIME_FIELDS), of(RING_FIELDS), of(INTENSITY_FIELDS))


def rings_of(columns: Mapping[str, npt.NDArray[Any]], layout: PointLayout, points: int) -> U16:
    """Ring (n,) of each return, 0 without such a field, :data:`NO_RING` for what is no ring: a
    number below zero, of a fraction or too large does not wrap into a good one.
    """
    if not layout.ring:
        return np.zeros(points, np.uint16)
    values = columns[layout.ring]
    if values.dtype in (np.dtype(np.uint8), np.dtype(np.uint16)):
        return values.astype(np.uint16, copy=False)
    good = (values >= 0) & (values < NO_RING)  # NaN is neither
    good &= values == np.floor(values)
    return np.where(good, values, NO_RING).astype(np.uint16)


def intensities_of(
    columns: Mapping[str, npt.NDArray[Any]], layout: PointLayout, points: int
) -> F32:
    """Intensity (n,) of each return, 0 without such a field."""
    if not layout.intensity:
        return np.zeros(points, np.float32)
    return columns[layout.intensity].astype(np.float32, copy=False)
