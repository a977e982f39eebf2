"""The streaming stage: fixes, attitudes and returns in, mapped points and platform states out.

Nothing here raises on bad data: a sample or return that cannot be used is counted in
:attr:`Georeferencer.losses`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.clock_check import Lead, SweepTimes
from ladar_volume.georeference.clock_restart import Restart
from ladar_volume.georeference.error_budget import independent_sigmas
from ladar_volume.georeference.fix_steps import FixSteps
from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.georeference.mapping import (
    IN_VEHICLE,
    MAPPED,
    NO_POSE,
    OUTSIDE_REGION,
    map_returns,
    region_box,
    vehicle_box,
)
from ladar_volume.georeference.mounting_check import MountingCheck
from ladar_volume.georeference.rate_check import RateCheck
from ladar_volume.georeference.sample_admission import (
    JUMP_S,
    TimeOrder,
    fix_covariance,
    imu_attitude,
    odometry_pose,
)
from ladar_volume.georeference.trajectory import Trajectory
from ladar_volume.math.se3 import quaternion_from_matrix
from ladar_volume.model import records as rec
from ladar_volume.model.errors import InputError, ParameterValueError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters, Parameters
from ladar_volume.model.records import (
    F64,
    I64,
    Datum,
    Fix,
    ImuSample,
    MappedPoints,
    OdometrySample,
    PlatformStates,
    Returns,
)

#: The waiting clock advances with the clouds' own time, but by no more than this per cloud, so one
#: corrupt stamp expires nothing.
_LARGEST_STEP_NS = 1_000_000_000
#: Least share of what waits of a cloud that is mapped before the rest.
WORTH_IT = 0.25
#: Returns that wait at most, 0.5 GB, and clouds: a LiDAR clock that stands still expires none.
MOST_WAITING, MOST_CLOUDS = 10_000_000, 20_000
#: Poses may advance by so many times ``max_pending_s`` without reaching what waits: the LiDAR's own
#: clock, which decides where it runs, is sooner.
POSES_PAST = 2.0

S = TypeVar("S")
#: What is admitted: a sample with its covariance, and an attitude where it has one; or returns.
Sample: TypeAlias = (
    tuple[Fix, F64] | tuple[ImuSample, F64, F64] | tuple[OdometrySample, F64, F64] | Returns
)


@dataclass(frozen=True)
class _WaitingReturns:
    returns: Returns  # times already in navigation time
    first_ns: int
    last_ns: int
    arrived_ns: int  # on the waiting clock
    poses_ns: int  # on the clock of the poses, when it arrived

    def split_at(
        self, until_ns: int, least: float
    ) -> tuple[_WaitingReturns | None, _WaitingReturns | None]:
        """The returns up to a time, and those later. Where the former are less than a share
        ``least`` of all, they wait with the others.
        """
        if self.last_ns <= until_ns:
            return self, None
        early = self.returns.t_ns <= until_ns
        if np.count_nonzero(early) < max(least * len(early), 1.0):
            return None, self
        part, rest = rec.select(self.returns, early), rec.select(self.returns, ~early)
        return (
            replace(self, returns=part, last_ns=int(part.t_ns.max())),
            replace(self, returns=rest, first_ns=int(rest.t_ns.min())),
        )


class Georeferencer:
    """Turns returns into mapped points as soon as the trajectory covers them.

    What comes out does not depend on how the topics are interleaved, as long as each is in order
    and none lags the clouds by more than ``max_pending_s``. ``MappedPoints.t_ns`` is navigation
    time, ``t_lidar + clock_offset_s``.

    Where the time of two topics goes back together (a looping recording), everything begins anew
    and :attr:`restarts` counts one more. What the arrival of the messages tells of the clocks is in
    :attr:`cloud_lead`, :attr:`fix_lead` and :attr:`sweeps`.

    Raises :class:`ParameterValueError` for a half-given datum or a malformed box.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._p = parameters.georeference
        self._budget = parameters.budget
        self.losses = Losses()
        self.mount = mounting(parameters.calibration, self._p.pose_source)
        self._sigmas = independent_sigmas(parameters.budget)
        self._vehicle = vehicle_box(_box("vehicle_box_m", self._p.vehicle_box_m))
        self._region = region_box(_box("region_m", self._p.region_m))
        self._datum = _datum(self._p)
        self._restart = Restart()
        self._begin()

    def _begin(self) -> None:
        self.trajectory = Trajectory(self._p, self.mount.lever_antenna)
        jump = max(JUMP_S, 2 * self._p.max_position_gap_s, 2 * self._p.max_attitude_gap_s)
        self._fixes: TimeOrder[tuple[Fix, F64]] = TimeOrder("fix", jump)
        self._imus: TimeOrder[tuple[ImuSample, F64, F64]] = TimeOrder("imu", jump)
        self._odometry: TimeOrder[tuple[OdometrySample, F64, F64]] = TimeOrder("odometry", jump)
        self._frame = LocalFrame(self._datum) if self._datum is not None else None
        self._waiting: list[_WaitingReturns] = []
        self._waiting_clock_ns = 0
        self._newest_cloud_ns: int | None = None
        self._pose_clock_ns = 0
        self._newest_pose_ns: int | None = None
        self._points: list[MappedPoints] = []
        self._states: list[PlatformStates] = []
        self.fix_steps = FixSteps()
        self.mounting_check = MountingCheck(self.mount)
        self.rate_check = RateCheck()
        self.cloud_lead, self.fix_lead, self.sweeps = Lead(), Lead(), SweepTimes()

    @property
    def restarts(self) -> int:
        """How often the time of the data began again."""
        return self._restart.count

    @property
    def datum(self) -> Datum | None:
        """Origin of the map frame: from the parameters, else the first usable fix; None until
        then.
        """
        return self._frame.datum if self._frame is not None else None

    @property
    def pending(self) -> int:
        """Returns that wait for the trajectory."""
        return sum(len(w.returns) for w in self._waiting)

    @property
    def mapped(self) -> int:
        """Mapped returns that nobody has taken yet."""
        return sum(len(points) for points in self._points)

    def add_fix(self, fix: Fix) -> None:
        """One GNSS fix. Refusals: fix_no_fix, fix_nan, fix_out_of_range, fix_unknown_covariance,
        fix_bad_covariance, fix_duplicate, fix_time_backwards, fix_clock_back, fix_time_jump;
        fix_unused where odometry is the pose source.
        """
        if self._p.pose_source != "gnss_imu":
            return self.losses.add("fix_unused")
        try:
            C = fix_covariance(fix, self._budget, self._p.unknown_covariance)
        except InputError as error:
            return self.losses.add(error.reason)
        return self._arrive("fix", fix.t_ns, (fix, C))

    def _take_fix(self, sample: tuple[Fix, F64]) -> None:
        self.fix_lead.add_reference_clock(sample[0].t_ns)
        for good, C_enu in self._in_order(self._fixes, sample[0].t_ns, sample):
            self._add_position(good, C_enu)

    def _add_position(self, fix: Fix, C_enu: F64) -> None:
        if self._frame is None:
            self._frame = LocalFrame(Datum(fix.latitude_deg, fix.longitude_deg, fix.height_m))
        turn = self._frame.convergence(fix.latitude_deg, fix.longitude_deg)
        p_map = self._frame.to_map(fix.latitude_deg, fix.longitude_deg, fix.height_m)
        self.fix_steps.add(fix.t_ns, p_map)
        self.trajectory.add_position(
            fix.t_ns, p_map, turn @ C_enu @ turn.T, quaternion_from_matrix(turn)
        )

    def add_imu(self, imu: ImuSample) -> None:
        """One attitude. Refusals: imu_no_orientation, imu_nan, imu_not_unit,
        imu_unknown_covariance, imu_bad_covariance, imu_duplicate, imu_time_backwards,
        imu_clock_back, imu_time_jump; imu_unused where odometry is the pose source.
        """
        if self._p.pose_source != "gnss_imu":
            return self.losses.add("imu_unused")
        try:
            q, C = imu_attitude(imu, self._budget, self._p.unknown_covariance)
        except InputError as error:
            return self.losses.add(error.reason)
        return self._arrive("imu", imu.t_ns, (imu, q, C))

    def _take_imu(self, sample: tuple[ImuSample, F64, F64]) -> None:
        for good, q_good, C_good in self._in_order(self._imus, sample[0].t_ns, sample):
            self.trajectory.add_attitude(good.t_ns, q_good, good.omega_body, C_good)
            self.rate_check.add(good.t_ns, q_good, good.omega_body)
            self._refer(good.t_ns)

    def add_odometry(self, sample: OdometrySample) -> None:
        """One pose: its own point takes the antenna's place and a = 0. Refusals as for the IMU,
        with ``odometry_``.
        """
        if self._p.pose_source != "odometry":
            return self.losses.add("odometry_unused")
        try:
            q, C = odometry_pose(sample, self._budget, self._p.unknown_covariance)
        except InputError as error:
            return self.losses.add(error.reason)
        return self._arrive("odometry", sample.t_ns, (sample, q, C))

    def _take_odometry(self, sample: tuple[OdometrySample, F64, F64]) -> None:
        for good, q_good, C_good in self._in_order(self._odometry, sample[0].t_ns, sample):
            self.trajectory.add_position(good.t_ns, good.p_map_body, C_good[:3, :3])
            self.trajectory.add_attitude(
                good.t_ns, q_good, good.omega_body, C_good[3:, 3:], C_good[:3, 3:]
            )
            self.rate_check.add(good.t_ns, q_good, good.omega_body)
            self._refer(good.t_ns)

    def _refer(self, t_ns: int) -> None:
        self.cloud_lead.reference(t_ns)
        self.fix_lead.reference(t_ns)
        self._pose_clock_ns += _credible_advance(self._newest_pose_ns, t_ns)
        self._newest_pose_ns = t_ns

    def _arrive(self, kind: str, t_ns: int, sample: Sample) -> None:
        """Every admitted sample comes through here, in the order of arrival."""
        again, samples, dropped = self._restart.push(kind, int(t_ns), sample)
        if again:
            self._lose_waiting()
            self.losses.add("point_before_restart", self.mapped)
            self._begin()
        for reason in dropped:
            if kind == "cloud":
                self.losses.add("point_before_restart", len(sample))
            else:
                self.losses.add(reason)
        self._take(samples)

    def _take(self, samples: list[tuple[str, Any]]) -> None:
        takers: dict[str, Callable[[Any], None]] = {
            "fix": self._take_fix,
            "imu": self._take_imu,
            "odometry": self._take_odometry,
            "cloud": self._take_cloud,
        }
        for kind, sample in samples:
            takers[kind](sample)
        self._advance()

    def _in_order(self, order: TimeOrder[S], t_ns: int, sample: S) -> list[S]:
        accepted, refused = order.push(int(t_ns), sample)
        for reason in refused:
            self.losses.add(reason)
        return accepted

    def add_returns(self, returns: Returns) -> None:
        """One cloud, laser frame and LiDAR time. Returns are refused as point_nan, point_range,
        point_intensity, point_ring, point_time (a time far from all others of the cloud); the rest
        waits for the trajectory.
        """
        shapes = (np.shape(returns.r_laser), np.shape(returns.ring), np.shape(returns.intensity))
        n = len(returns)
        if shapes != ((n, 3), (n,), (n,)):
            return self.losses.add("cloud_malformed")
        kept = self._gate(returns)
        if len(kept):
            return self._arrive("cloud", int(kept.t_ns.max()), kept)
        return self._advance()

    def _take_cloud(self, kept: Returns) -> None:
        first, last = int(kept.t_ns.min()), int(kept.t_ns.max())
        self.cloud_lead.add_reference_clock(last)
        self.sweeps.add(first, last)
        self.mounting_check.add_returns(kept)
        self._tick(last)
        self._waiting.append(
            _WaitingReturns(kept, first, last, self._waiting_clock_ns, self._pose_clock_ns)
        )
        while len(self._waiting) > 1 and (
            self.pending > MOST_WAITING or len(self._waiting) > MOST_CLOUDS
        ):
            self.losses.add("point_waiting_full", len(self._waiting.pop(0).returns))

    def _gate(self, returns: Returns) -> Returns:
        p = self._p
        # squares: three multiplications per return instead of a root
        range2 = np.einsum("ij,ij->i", returns.r_laser, returns.r_laser)
        nan = ~np.isfinite(range2)
        # written so that a cloud without intensity (NaN) passes
        bad = {
            "point_nan": nan,
            "point_range": ~nan
            & ((range2 < p.range_min_m**2) | (range2 > p.range_max_m**2) | (range2 == 0.0)),
            "point_intensity": (returns.intensity < p.intensity_min)
            | (returns.intensity > p.intensity_max),
            "point_ring": returns.ring >= p.beams,
        }
        late = self.sweeps.corrupt(returns.t_ns)
        if late is not None:  # one such return would keep its whole cloud waiting for that time
            bad["point_time"] = late
        dropped = np.zeros(len(returns), bool)
        for reason, mask in bad.items():
            self.losses.add(reason, int(np.count_nonzero(mask & ~dropped)))
            dropped |= mask
        kept = rec.select(returns, ~dropped) if dropped.any() else returns
        return Returns(kept.t_ns + self.mount.clock_ns, kept.r_laser, kept.ring, kept.intensity)

    def _tick(self, cloud_ns: int) -> None:
        self._waiting_clock_ns += _credible_advance(self._newest_cloud_ns, cloud_ns)
        self._newest_cloud_ns = cloud_ns

    def _has_expired(self, cloud: _WaitingReturns) -> bool:
        """Whether clouds, or poses, have gone on for too long since this one came."""
        pending_ns = self._p.max_pending_s * 1e9
        return (
            self._waiting_clock_ns - cloud.arrived_ns > pending_ns
            or self._pose_clock_ns - cloud.poses_ns > POSES_PAST * pending_ns
        )

    def _advance(self, least: float = WORTH_IT) -> None:
        """Map what is known the fate of. A part of a cloud, at least such a share, need not wait
        for the rest.
        """
        if not self._waiting:
            return
        decided, begin = self.trajectory.decided_ns, self.trajectory.begin_ns
        known_ns = max(
            t for t in (decided, None if begin is None else begin - 1, -1) if t is not None
        )
        if all(w.first_ns > known_ns and not self._has_expired(w) for w in self._waiting):
            return
        self._decide()
        waiting, self._waiting = self._waiting, []
        for cloud in waiting:
            part, rest = (
                (cloud, None) if self._has_expired(cloud) else cloud.split_at(known_ns, least)
            )
            if part is not None:
                self._map(part, decided)
            if rest is not None:
                self._waiting.append(rest)

    def _decide(self) -> None:
        states = self.trajectory.decide()
        if states is not None:
            self._states.append(states)
            self.mounting_check.add_states(states)

    def _map(self, cloud: _WaitingReturns, decided_ns: int | None) -> None:
        returns = cloud.returns
        path = self.trajectory.window(cloud.first_ns, cloud.last_ns)
        mapped = map_returns(
            returns.t_ns,
            returns.r_laser,
            path,
            self.mount,
            self._sigmas,
            self._vehicle,
            self._region,
        )
        status = mapped.status
        self._count_uncovered(returns.t_ns[status == NO_POSE], decided_ns)
        self.losses.add("point_vehicle", int(np.count_nonzero(status == IN_VEHICLE)))
        self.losses.add("point_region", int(np.count_nonzero(status == OUTSIDE_REGION)))
        points = MappedPoints(
            returns.t_ns, mapped.r_map, mapped.C_ind, returns.ring, returns.intensity
        )
        good: npt.NDArray[np.bool_] = status == MAPPED
        if not good.all():
            points = rec.select(points, good)
        if len(points):
            self._points.append(points)

    def _count_uncovered(self, t_ns: I64, decided_ns: int | None) -> None:
        if len(t_ns) == 0:
            return
        begin = self.trajectory.begin_ns
        before = t_ns < begin if begin is not None else np.zeros(len(t_ns), bool)
        after = ~before & (t_ns > decided_ns if decided_ns is not None else True)
        self.losses.add("point_before_trajectory", int(np.count_nonzero(before)))
        self.losses.add("point_pose_timeout", int(np.count_nonzero(after)))
        self.losses.add("point_pose_gap", int(np.count_nonzero(~before & ~after)))

    def take_points(self) -> list[MappedPoints]:
        """What was decided since the last call, clouds or parts of them, in order of time; one of
        which nothing is left gives no record.
        """
        out, self._points = self._points, []
        return out

    def take_platform(self) -> PlatformStates | None:
        """The platform states since the last call, or None."""
        self._decide()
        out, self._states = self._states, []
        return rec.concatenate(out) if out else None

    def finish(self) -> None:
        """End of data: returns that still wait are lost as point_trajectory_end; nothing is
        extrapolated.
        """
        self._take(self._restart.finish())
        self._advance(0.0)
        self._lose_waiting()

    def _lose_waiting(self) -> None:
        for reason in self._fixes.finish() + self._imus.finish() + self._odometry.finish():
            self.losses.add(reason)
        self.losses.add("point_trajectory_end", self.pending)
        self._waiting.clear()


def _credible_advance(before_ns: int | None, now_ns: int) -> int:
    """How far a clock has gone on, ns: never back, and by no more than a step that is credible."""
    return 0 if before_ns is None else min(max(now_ns - before_ns, 0), _LARGEST_STEP_NS)


def _datum(p: GeoreferenceParameters) -> Datum | None:
    values = (p.datum_latitude_deg, p.datum_longitude_deg, p.datum_height_m)
    given = [not math.isnan(v) for v in values]
    if not any(given):
        return None
    if not all(given):
        raise ParameterValueError(
            "georeference.datum_*: latitude, longitude and height must be given together",
            value=values,
        )
    return Datum(*values)


def _box(key: str, values: tuple[float, ...]) -> tuple[float, ...]:
    if values and (len(values) != 6 or any(not values[i] < values[i + 3] for i in range(3))):
        raise ParameterValueError(
            (
                f"georeference.{key}: {list(values)} is not xmin, ymin, zmin, xmax, ymax, "
                "zmax with each minimum below its maximum"
            ),
            value=values,
        )
    return values
