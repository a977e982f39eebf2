"""The method on one page: georeference → filter → surface → volume.

The same three stage objects run here, in the nodes and in notebooks; this is the only place that
wires them without ROS.
"""

from __future__ import annotations

from ladar_volume.clouds.survey.return_store import ReturnStore
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    Datum,
    Estimate,
    Fix,
    ImuSample,
    MappedPoints,
    OdometrySample,
    Returns,
)
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.estimator import VolumeEstimator


class Engine:
    """From sensor samples to a volume with its covariance.

    Feed samples in the order of each topic, call :meth:`step` as often as wanted and
    :meth:`estimate` at any time; neither the interleaving of topics nor the batching changes the
    result.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self.georeferencer = Georeferencer(parameters)
        self.filter = SurfaceFilter(parameters)
        self.estimator = VolumeEstimator(parameters)
        self.points_mapped = 0
        #: The mapped returns, where closed bodies are made of them in the end.
        self.returned = ReturnStore(parameters.filter.radius_m)
        self._restarts = 0

    def add_fix(self, fix: Fix) -> None:
        """An antenna position."""
        self.georeferencer.add_fix(fix)

    def add_imu(self, sample: ImuSample) -> None:
        """An attitude."""
        self.georeferencer.add_imu(sample)

    def add_odometry(self, sample: OdometrySample) -> None:
        """A pose, where odometry is the pose source."""
        self.georeferencer.add_odometry(sample)

    def add_returns(self, returns: Returns) -> None:
        """A cloud; it waits until the trajectory covers it."""
        self.georeferencer.add_returns(returns)

    def step(self) -> list[MappedPoints]:
        """Hand what is georeferenced to the filter; returns the clouds that became ready, for
        whoever logs them. Where the time of the data began again (a looping recording), the surface
        begins anew.
        """
        if self.georeferencer.restarts != self._restarts:
            self._restarts, self.points_mapped = self.georeferencer.restarts, 0
            self.returned = ReturnStore(self.parameters.filter.radius_m)
            self.filter, self.estimator = (
                SurfaceFilter(self.parameters),
                VolumeEstimator(self.parameters),
            )
        states = self.georeferencer.take_platform()
        if states is not None:
            self.filter.add_platform(states)
            self.estimator.add_platform(states)
        clouds = self.georeferencer.take_points()
        for points in clouds:
            self.points_mapped += len(points)
            if self.parameters.volume.kind == "bodies":
                self.returned.add(points.r_map)
            self.filter.add(points)
        return clouds

    def estimate(self) -> Estimate:
        """The volume from all points that have arrived; raises a GroundError, SurfaceError or
        VolumeError where there is none yet.
        """
        self.step()
        update = self.filter.update()
        if update is not None:
            self.estimator.add(update)
        return self.estimator.estimate()

    def finish(self) -> Estimate:
        """End of the data: what still waits for a pose is lost and counted; the final estimate."""
        self.georeferencer.finish()
        self.step()
        update = self.filter.finish()
        if update is not None:
            self.estimator.add(update)
        return self.estimator.estimate()

    @property
    def datum(self) -> Datum | None:
        """Origin of the map frame, once known."""
        return self.georeferencer.datum

    @property
    def losses(self) -> Losses:
        """What every stage dropped, by reason."""
        total = Losses()
        for stage in (self.georeferencer, self.filter, self.estimator):
            total.merge(stage.losses)
        total.merge(self.estimator.screen_losses)
        return total
