"""The volume stage: keeps the current filtered surface and estimates base, outline, volume and its
budget.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import numpy as np

from ladar_volume.math.run_concurrently import run_concurrently
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    F64,
    Estimate,
    FilteredPoints,
    FilterUpdate,
    HeldPatches,
    PatchTable,
    Plane,
    PlatformStates,
    StandingObject,
    Tin,
    Volume,
)
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.patch_table import PatchStore
from ladar_volume.uncertainty.volume_budget import Sources, vertical_sigma
from ladar_volume.volume.base import all_grounds
from ladar_volume.volume.field_checks.field_verdict import (
    BodyInField,
    SurveyInField,
    assess_field,
    bridged_footing,
    passes_of,
    variance_ratio,
)
from ladar_volume.volume.field_checks.findings import Findings
from ladar_volume.volume.field_checks.object_removal import (
    objects_by_body,
    without_objects,
)
from ladar_volume.volume.field_checks.surface_choice import usual_surface, with_choice
from ladar_volume.volume.field_checks.survey_surface import survey_surface
from ladar_volume.volume.measured_body import (
    Footing,
    MeasuredBody,
    SurveyedSurface,
    body_surface,
    footing_of,
    joint_sigma,
    measure_body,
    surveyed_surface,
    volume_of,
)
from ladar_volume.volume.more_data import MoreData, more_data
from ladar_volume.volume.volume_loads import KeepRoughness, result_gradients

#: Bodies whose joint covariance is computed: the work grows with the number of pairs.
MAX_JOINT = 8


class SurveyOnBase(NamedTuple):
    """survey : the surface, without objects and with bridges · footing : its base and the outlines
    of the bodies · objects : what was taken out
    """

    survey: SurveyedSurface
    footing: Footing
    objects: tuple[StandingObject, ...]


class VolumeEstimator:
    """From filtered points and patches to a volume with its budget.

    Feed :meth:`add_platform` and :meth:`add` in the order they come; :meth:`estimate` depends only
    on their union. No raw point is held: memory follows the surface.
    """

    def __init__(self, parameters: Parameters, navigation: NavigationBins | None = None) -> None:
        self.parameters = parameters
        self.losses = Losses()
        self._navigation = (
            NavigationBins(parameters.filter.nav_bin_s) if navigation is None else navigation
        )
        self.store = PatchStore()
        self._surface_now: RepresentedSurface | None = None
        self._sources_now: Sources | None = None
        self._main: tuple[SurveyedSurface, Footing, MeasuredBody] | None = None
        self._findings: Findings | None = None
        self._unseen_m6 = 0.0
        self._mixed_count = 0
        self._t_ns = 0
        self._newest_bin = -1

    @classmethod
    def from_updates(
        cls, parameters: Parameters, navigation: NavigationBins, updates: Iterable[FilterUpdate]
    ) -> VolumeEstimator:
        """The estimator of a surface that was kept, with the covariance of the platform by time
        bin.
        """
        estimator = cls(parameters, navigation)
        for update in updates:
            estimator.add(update)
        return estimator

    def set_parameters(self, parameters: Parameters) -> None:
        """Another base, outline or ground for the next estimate; the surface stays."""
        self.parameters = parameters
        self._surface_now = self._sources_now = self._findings = None

    def add_platform(self, states: PlatformStates) -> None:
        """New platform states; only the mean covariance per time bin is kept."""
        self._navigation.add(states)
        self._sources_now = None

    def add(self, update: FilterUpdate) -> None:
        """What changed in the filtered surface."""
        self._surface_now = self._sources_now = self._main = (
            None  # the surface before would be held beside the new one
        )
        self.store.replace(update)
        self.losses.merge(self.store.losses)
        self.store.losses = Losses()
        self._heard(update.t_ns, update.patches)

    def hold(self, points: FilteredPoints, patches: HeldPatches, t_ns: int) -> None:
        """A whole surface, by key, in place of what there is. t_ns : time of its newest return"""
        self._surface_now = self._sources_now = self._main = None
        self.store.hold(points, patches)
        self._heard(t_ns, patches)

    def _heard(self, t_ns: int, patches: PatchTable) -> None:
        self._t_ns = max(self._t_ns, t_ns)
        self._newest_bin = max(self._newest_bin, int(patches.nav_bin.max(initial=-1)))

    @property
    def awaits_path(self) -> bool:
        """Whether the newest of the surface was seen after the last platform state: where states
        and surface come on two ways, states are then still on theirs.
        """
        return self._newest_bin > self._navigation.newest

    def estimate(self, naive: bool = True, ask_all: bool = True) -> Estimate:
        """The volume from everything so far: :meth:`survey`, :meth:`base` and :meth:`volume`, whose
        errors it raises.
        """
        return self.volume(self.base(self.survey()), naive, ask_all)

    def survey(self) -> SurveyedSurface:
        """Surface: the TIN of the filtered points, with its error sources. Raises
        :class:`SurfaceError` where the points do not span one, :class:`VolumeError` where the
        platform's covariance is not yet known for all of it.
        """
        points, patches = self._current()
        surface = self.surface(points)
        return surveyed_surface(surface, points, patches, self._sources(points, patches))

    def base(self, survey: SurveyedSurface) -> SurveyOnBase:
        """Base: the surface that volumes stand on, the outlines of the bodies on it; objects are
        taken out, and what was not seen is bridged. Raises :class:`GroundError` where no base can
        be fitted, :class:`VolumeError` where nothing lies inside the outline.
        """
        found = without_objects(survey, footing_of(survey, self.parameters), self.parameters)
        self._mixed_count = int(np.count_nonzero(found.mixed))
        survey, footing = bridged_footing(found.survey, found.footing, self.parameters)
        return SurveyOnBase(survey, footing, found.objects)

    def volume(self, on_base: SurveyOnBase, naive: bool = True, ask_all: bool = True) -> Estimate:
        """Volume: prismoids between surface and base, the budget of each body, and its verdict.
        Without ``naive``, which is printed beside it in results, that sigma is NaN. Without
        ``ask_all`` what the slow checks found before counts, while the bodies are the same.
        """
        survey, footing, objects = on_base
        found = self._findings_on(survey.tin, footing, ask_all)
        keep = partial(found.of_survey, "roughness")
        (main, volumes), passes = run_concurrently(
            lambda: self._measured(survey, footing, naive, keep),
            lambda: found.of_survey("passes", lambda: passes_of(survey, footing, self.parameters)),
        )
        self._main = survey, footing, main
        joint = joint_covariance(
            [v.sigma_m3**2 for v in volumes],
            lambda a, b: joint_sigma(survey, footing, (a, b), self.parameters, keep) ** 2,
        )
        check = self.parameters.volume.budget_check
        larger = np.sqrt([variance_ratio(v, passes.agreement, check) for v in volumes])
        field = SurveyInField(survey, footing, passes, self.parameters)
        volumes = self._assessed(field, main, volumes, objects, found)
        volumes = with_choice(volumes, self.parameters.tin, self._usual_volumes)
        self._unseen_m6 = volumes[0].budget_m6.get("unseen", 0.0)
        if joint is not None:  # what two bodies share, and what each has of its own
            joint *= larger[:, None] * larger
            np.fill_diagonal(joint, [v.sigma_m3**2 for v in volumes])
        base, grounds = self._grounds(survey, footing, main)
        return Estimate(volumes[0], survey.tin, base, grounds, volumes, joint)

    def _measured(
        self, survey: SurveyedSurface, footing: Footing, naive: bool, keep: KeepRoughness
    ) -> tuple[MeasuredBody, tuple[Volume, ...]]:
        """The main body, and the volume of each; what others need meanwhile is held for one."""
        radius_m = self.parameters.filter.radius_m

        def measured(number: int) -> tuple[MeasuredBody, Volume]:
            on = body_surface(survey, footing, footing.part(number), radius_m)
            body = measure_body(survey, footing, on, self.parameters, naive, keep, number == 0)
            return body, volume_of(footing, body, self.parameters, self._t_ns)

        main, volume = measured(0)
        return main, (volume, *(measured(number)[1] for number in range(1, footing.bodies)))

    def _assessed(
        self,
        field: SurveyInField,
        main: MeasuredBody,
        volumes: tuple[Volume, ...],
        objects: tuple[StandingObject, ...],
        found: Findings,
    ) -> tuple[Volume, ...]:
        """The volumes with every line and doubt of the field; bodies are on one ground."""
        radius_m, out = self.parameters.filter.radius_m, list[Volume]()
        each = zip(volumes, objects_by_body(objects, volumes), field.footing.parts(), strict=True)
        for number, (volume, own, part) in enumerate(each):
            on = body_surface(field.survey, field.footing, part, radius_m)
            body = BodyInField(on, main.rough, own)
            out.append(assess_field(field, body, volume, found.of_body(number)))
        return tuple(out)

    def _findings_on(self, tin: Tin, footing: Footing, ask_all: bool) -> Findings:
        """What the slow checks found of these bodies before, or nothing yet."""
        found = self._findings
        if ask_all or found is None or not found.suit(tin, footing.parts()):
            found = self._findings = Findings(tin, footing.parts())
        return found

    def _usual_volumes(self) -> tuple[Volume, ...]:
        """Of the surface with the usual vertices and diagonals."""
        other = copy.copy(self)
        other.set_parameters(usual_surface(self.parameters))
        return other.estimate(naive=False).bodies

    def epoch(self) -> Epoch:
        """Everything so far as one survey, to be compared with another. Raises
        :class:`SurfaceError` where there is no surface.
        """
        points, patches = self._current()
        return Epoch(self.surface(points), self._sources(points, patches), self._t_ns)

    @property
    def screen_losses(self) -> Losses:
        """What the median screen and filter left out and changed in the present surface, and points
        of mixed returns that the last volume left out.
        """
        made = self._surface_now
        if made is None:
            return Losses()
        counts = {"point_screened": made.screened_count, "point_levelled": made.levelled_count}
        return Losses({**counts, "point_mixed": self._mixed_count})

    @property
    def footing(self) -> Footing:
        """Base and bodies of the last estimate. Raises :class:`VolumeError` without one."""
        if self._main is None:
            raise VolumeError("no estimate yet", reason="volume_no_estimate")
        return self._main[1]

    def more_data(self) -> MoreData:
        """Where another pass would make sigma of the present estimate's main body smaller. Raises
        :class:`VolumeError` without one.
        """
        if self._main is None:
            raise VolumeError("no estimate yet", reason="volume_no_estimate")
        survey, footing, body = self._main
        sources, surface = survey.sources, survey.surface
        gradient = result_gradients(
            survey.tin,
            footing.base,
            body.solid,
            len(sources.points),
            surface,
            coefficients=False,
            vertex=body.on.vertex,
        )[:, 0]
        sigma_z = vertical_sigma(sources, survey.tin.source)
        return more_data(
            survey.tin,
            body.on.whole > 0,
            gradient,
            sources,
            sigma_z,
            survey.height_variance,
            body.budget.sigma,
            self._unseen_m6,
        )

    def with_same_path(self) -> VolumeEstimator:
        """An estimator without a surface that knows the platform's path so far: returns still on
        their way refer to it.
        """
        return VolumeEstimator(self.parameters, copy.deepcopy(self._navigation))

    def _current(self) -> tuple[FilteredPoints, PatchTable]:
        points, patches = self.store.points, self.store.patches
        if points is None or patches is None or len(points) < 3:
            raise SurfaceError(
                "no surface yet: fewer than three filtered points",
                reason="surface_too_few_points",
                value=0 if points is None else len(points),
            )
        return points, patches

    def surface(self, points: FilteredPoints) -> RepresentedSurface:
        if self._surface_now is None:
            self._surface_now = survey_surface(points, self.parameters)
        return self._surface_now

    def _sources(self, points: FilteredPoints, patches: PatchTable) -> Sources:
        if self._sources_now is None:
            self._sources_now = Sources(points, patches, self._navigation, self.parameters)
        return self._sources_now

    def _grounds(
        self, survey: SurveyedSurface, footing: Footing, main: MeasuredBody
    ) -> tuple[Plane, tuple[Plane, ...]]:
        """The base with the covariance that the returns' noise gives it, and all ground surfaces
        with it.
        """
        base = footing.base
        grounds = all_grounds(
            survey.tin, survey.height_variance, base, footing.inside, self.parameters
        )
        if not len(base.support):
            return base, grounds
        base = dataclasses.replace(base, C_beta=main.budget.C_results[1:, 1:])
        return base, (base, *grounds[1:])


def joint_covariance(
    variance: list[float], pair_variance: Callable[[int, int], float]
) -> F64 | None:
    """Covariance (k, k) m⁶ of k volumes from the variances of each and of any two together: every
    source is a quadratic form, so ``2 C_ab = Var(a + b) − Var(a) − Var(b)``. None for one volume,
    and for more than eight.
    """
    k = len(variance)
    if not 1 < k <= MAX_JOINT:
        return None
    C = np.diag(np.asarray(variance, dtype=np.float64))
    for a in range(k):
        for b in range(a):
            C[a, b] = C[b, a] = 0.5 * (pair_variance(a, b) - variance[a] - variance[b])
    return C
