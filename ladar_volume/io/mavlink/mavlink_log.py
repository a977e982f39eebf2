"""An autopilot's log of either kind as one stream of records."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ladar_volume.io.mavlink.mavlink_dataflash import DataFlashLog
from ladar_volume.io.mavlink.mavlink_heights import SEA_LEVEL
from ladar_volume.io.mavlink.mavlink_poses import InertialSample
from ladar_volume.io.mavlink.mavlink_records import Record
from ladar_volume.io.mavlink.mavlink_session import MavlinkSession
from ladar_volume.io.mavlink.mavlink_tlog import tlog_frames
from ladar_volume.model.errors import BagError
from ladar_volume.model.losses import Losses
from ladar_volume.model.mavlink_parameters import MavlinkParameters
from ladar_volume.model.records import Fix, ImuSample, OdometrySample

#: What a record is to the pipeline; raw inertial data is nothing to it.
ROLE: dict[type, str] = {
    Fix: "fix",
    ImuSample: "imu",
    OdometrySample: "odometry",
    InertialSample: "",
}


def log_file(url: str) -> Path | None:
    """The path where a url names a log file, ``.tlog`` or ``.bin``; else None."""
    path = url.removeprefix("file:")
    return Path(path) if path.lower().endswith((".tlog", ".bin")) else None


class MavlinkLog:
    """A .tlog (stamps after ``mavlink.clock``) or a DataFlash .bin (stamps in UTC). Raises
    BagError: bag_missing, bag_format, bag_clock.
    """

    def __init__(self, path: Path, parameters: MavlinkParameters) -> None:
        if not path.is_file():
            raise BagError(f"{path}: no such log", reason="bag_missing", value=str(path))
        if log_file(str(path)) is None:
            raise BagError(f"{path}: neither .tlog nor .bin", reason="bag_format", value=str(path))
        self.path = path
        self._noise = Losses()
        self._session = MavlinkSession(parameters)
        self._dataflash = DataFlashLog(path, parameters) if path.suffix.lower() == ".bin" else None

    def records(self) -> Iterator[Record]:
        """All records in the order of the log; once."""
        if self._dataflash is not None:
            yield from self._dataflash.records()
            return
        for t_ns, frame in tlog_frames(self.path, self._noise):
            yield from self._session.feed(frame, t_ns)

    def losses(self) -> Losses:
        """What was refused so far, by reason."""
        if self._dataflash is not None:
            return self._dataflash.losses
        total = self._session.losses()
        total.merge(self._noise)
        return total

    def status(self) -> dict[str, Any]:
        """The log in a few lines."""
        if self._dataflash is None:
            return self._session.status()
        return {
            "height": self.height_reference,
            "clock": "UTC by GPS time",
            "clock_sigma_s": f"{self._dataflash.line.sigma_ns * 1e-9:.6f}",
        }

    @property
    def height_reference(self) -> str:
        """What the heights of the fixes so far refer to; empty before the first."""
        source = self._dataflash or self._session.decoder
        return source.heights.reference

    @property
    def ellipsoidal(self) -> bool:
        """Whether the heights of the fixes so far are above the ellipsoid."""
        return self.height_reference != SEA_LEVEL

    def digest(self) -> str:
        """sha256 of the file."""
        with self.path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
