"""The method on one page: georeference → filter → surface → base → volume.

============  ====================================================  ================================
step          what is done                                          from what to what
============  ====================================================  ================================
georeference  The pose is interpolated at the time of each return;  ``Returns``, ``Fix``,
              the LiDAR equation maps it, with the covariance of    ``ImuSample`` →
              its range and angles.                                 ``MappedPoints``, states
filter        Robust moving least squares fits a patch to each      ``MappedPoints`` →
              voxel's neighbourhood, projects points on it, and     ``FilterUpdate``
              keeps how it moves with every error source.
surface       The filtered points become a Delaunay TIN, full or    ``FilterUpdate`` →
              partial; its heights have variances.                  ``SurveyedSurface``
base          A robust ground (or level, plane) is fitted, bodies   ``SurveyedSurface`` →
              on it are outlined, objects taken out, gaps bridged.  ``SurveyOnBase``
volume        Prismoids between surface and base; the gradient by   ``SurveyOnBase`` →
              every point gives the variance by each error source;  ``Estimate``
              the survey's own redundancy tests it.
============  ====================================================  ================================

The same stage objects run here, in the nodes and in notebooks; this is the only place that wires
them without ROS. docs/architecture.md says which room each step is in.
"""

from __future__ import annotations

from ladar_volume.clouds.survey.return_store import ReturnStore
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    Datum,
    Estimate,
    FilterUpdate,
    Fix,
    ImuSample,
    MappedPoints,
    OdometrySample,
    PlatformStates,
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
        """Georeference what has its poses, and hand it to the filter; returns the clouds that
        became ready, for whoever logs them. Where the time of the data began again (a looping
        recording), the surface begins anew.
        """
        if self.georeferencer.restarts != self._restarts:
            self._begin_anew()
        states, clouds = self.georeference()
        if states is not None:
            self.filter.add_platform(states)
            self.estimator.add_platform(states)
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
        return self.measure(self.filter.update())

    def finish(self) -> Estimate:
        """End of the data: what still waits for a pose is lost and counted; the final estimate."""
        self.georeferencer.finish()
        self.step()
        return self.measure(self.filter.finish())

    def georeference(self) -> tuple[PlatformStates | None, list[MappedPoints]]:
        """Georeference: new states of the platform, and the clouds that they cover."""
        return self.georeferencer.take_platform(), self.georeferencer.take_points()

    def measure(self, update: FilterUpdate | None) -> Estimate:
        """Surface, base and volume of the filtered points, with what the filter changed last."""
        if update is not None:
            self.estimator.add(update)
        surface = self.estimator.survey()
        on_base = self.estimator.base(surface)
        return self.estimator.volume(on_base)

    def _begin_anew(self) -> None:
        self._restarts, self.points_mapped = self.georeferencer.restarts, 0
        self.returned = ReturnStore(self.parameters.filter.radius_m)
        self.filter = SurfaceFilter(self.parameters)
        self.estimator = VolumeEstimator(self.parameters)

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
