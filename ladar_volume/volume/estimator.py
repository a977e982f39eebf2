"""The volume stage: keeps the current filtered surface and estimates base, outline, volume and its
budget.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable
from statistics import NormalDist
from typing import TypeVar

import numpy as np

from ladar_volume.ground.ground_adjoint import ground_inverse
from ladar_volume.math.run_concurrently import at_once
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    F64,
    Estimate,
    FilteredPoints,
    FilterUpdate,
    Patches,
    Plane,
    PlatformStates,
    Tin,
    Volume,
)
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.tin.represent import Represented, SurfaceOptions, represent
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.patch_table import PatchStore
from ladar_volume.uncertainty.volume_budget import Budget, Sources, vertical_sigma
from ladar_volume.volume.base import all_grounds, area_by_body, base_and_outline, polygon_of
from ladar_volume.volume.centroid import centroid
from ladar_volume.volume.chord_bias import cut_and_fill_chords
from ladar_volume.volume.more_data import MoreData, more_data
from ladar_volume.volume.near_base import Fold
from ladar_volume.volume.outline import boundary_loop
from ladar_volume.volume.polygon import clipped_prismoids
from ladar_volume.volume.prismoids import Prismoids, prismoids
from ladar_volume.volume.volume_loads import (
    base_name,
    ground_field,
    near_correction,
    result_gradients,
    vertex_variance,
)

B = TypeVar("B")

#: Bodies whose joint covariance is computed: the work grows with the number of pairs.
MAX_JOINT = 8


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
        self._store = PatchStore()
        self._surface_now: Represented | None = None
        self._sources_now: Sources | None = None
        self._main: tuple[Represented, Plane, F64, Prismoids, Budget, Sources, F64] | None = None
        self._t_ns = 0

    def set_parameters(self, parameters: Parameters) -> None:
        """Another base, outline or ground for the next estimate; the surface stays."""
        self.parameters = parameters
        self._surface_now = self._sources_now = None

    def add_platform(self, states: PlatformStates) -> None:
        """New platform states; only the mean covariance per time bin is kept."""
        self._navigation.add(states)
        self._sources_now = None

    def add(self, update: FilterUpdate) -> None:
        """What changed in the filtered surface."""
        self._surface_now = self._sources_now = self._main = (
            None  # the surface before would be held beside the new one
        )
        self._store.replace(update)
        self.losses.merge(self._store.losses)
        self._store.losses = Losses()
        self._t_ns = max(self._t_ns, update.t_ns)

    def estimate(self, naive: bool = True) -> Estimate:
        """The volume from everything so far; without ``naive``, which is printed beside it in
        results, that sigma is NaN.

        Raises :class:`SurfaceError` where the points do not span a surface, :class:`GroundError`
        where no base can be fitted, :class:`VolumeError` where nothing lies inside the outline or
        the platform's covariance is not yet known for all of the surface.
        """
        points, patches = self._current()
        surface = self._surface(points)
        height_variance = vertex_variance(surface, points)
        base, inside = self._base_and_outline(surface.tin, height_variance)
        return self._result(surface, base, inside, points, patches, height_variance, naive)

    def epoch(self) -> Epoch:
        """Everything so far as one survey, to be compared with another. Raises
        :class:`SurfaceError` where there is no surface.
        """
        points, patches = self._current()
        return Epoch(self._surface(points), self._sources(points, patches), self._t_ns)

    def more_data(self) -> MoreData:
        """Where another pass would make sigma of the present estimate's main body smaller. Raises
        :class:`VolumeError` without one.
        """
        if self._main is None:
            raise VolumeError("no estimate yet", reason="volume_no_estimate")
        surface, base, part, solid, budget, sources, variance = self._main
        gradient = result_gradients(
            surface.tin, base, solid, len(sources.points), surface, coefficients=False
        )[:, 0]
        sigma_z = vertical_sigma(sources, surface.tin.source)
        return more_data(surface.tin, part > 0, gradient, sources, sigma_z, variance, budget.sigma)

    def restarted(self) -> VolumeEstimator:
        """An estimator without a surface that knows the platform's path so far: returns still on
        their way refer to it.
        """
        return VolumeEstimator(self.parameters, copy.deepcopy(self._navigation))

    def _current(self) -> tuple[FilteredPoints, Patches]:
        points, patches = self._store.points, self._store.patches
        if points is None or patches is None or len(points) < 3:
            raise SurfaceError(
                "no surface yet: fewer than three filtered points",
                reason="surface_too_few_points",
                value=0 if points is None else len(points),
            )
        return points, patches

    def _surface(self, points: FilteredPoints) -> Represented:
        if self._surface_now is None:
            v = self.parameters.volume
            adjust = (
                "none" if v.vertex_ratio == 1.0 else "rms"
            )  # copies of a footprint stay out, as they always have
            options = SurfaceOptions(
                ratio=v.vertex_ratio,
                adjust=adjust,
                relevant=v.relevant,
                max_edge_m=v.max_edge_m,
                max_circumdiameter_m=v.max_circumdiameter_m,
            )
            self._surface_now = represent(points.r_map, options, measured=False)
        return self._surface_now

    def _sources(self, points: FilteredPoints, patches: Patches) -> Sources:
        if self._sources_now is None:
            self._sources_now = Sources(points, patches, self._navigation, self.parameters)
        return self._sources_now

    def _base_and_outline(self, tin: Tin, height_variance: F64) -> tuple[Plane, F64]:
        return base_and_outline(tin, height_variance, self.parameters)

    def _result(
        self,
        surface: Represented,
        base: Plane,
        inside: F64,
        points: FilteredPoints,
        patches: Patches,
        height_variance: F64,
        naive: bool,
    ) -> Estimate:
        sources = self._sources(points, patches)
        parts = area_by_body(surface.tin, base, inside, self.parameters.volume)
        inverse = ground_inverse(surface.tin.vertices, base) if len(base.support) else None

        def solved(part: F64, beside: Callable[[F64], B]) -> tuple[Prismoids, Budget, B]:
            solid = self._solid(surface.tin, base, part)

            def rough_m6() -> float:
                field = ground_field(
                    surface.tin, base, solid, part, height_variance, sources, inverse
                )
                return 0.0 if field is None else field.variance_m6

            def gradients() -> F64:  # large: held for the naive sigma alone
                return result_gradients(surface.tin, base, solid, len(points), surface, inverse)

            held = gradients() if naive else None
            base_m6, (sensitivities, more) = at_once(
                rough_m6,
                lambda: (
                    sources.sensitivities(gradients() if held is None else held),
                    beside(part),
                ),
            )
            # afterwards: it uses and completes what the roughness knows of the patches' errors
            naive_m3 = math.nan if held is None else sources.naive_sigma(held[:, 0])
            return solid, sources.budget(sensitivities, base_m6, naive_m3), more

        def near(part: F64) -> Fold | None:
            return near_correction(surface, base, part, points, patches, sources.geometry)

        made = [solved(part, near) for part in parts]
        self._main = surface, base, parts[0], *made[0][:2], sources, height_variance
        normal = points.normal[surface.tin.source]
        volumes = tuple(
            self._volume(surface.tin, normal, base, part, *one)
            for part, one in zip(parts, made, strict=True)
        )
        grounds = all_grounds(surface.tin, height_variance, base, inside, self.parameters)
        if len(base.support):
            base = dataclasses.replace(base, C_beta=made[0][1].C_results[1:, 1:])
            grounds = (base, *grounds[1:])
        joint = joint_covariance(
            [v.sigma_m3**2 for v in volumes],
            lambda a, b: solved(parts[a] + parts[b], lambda _: None)[1].sigma ** 2,
        )
        return Estimate(volumes[0], surface.tin, base, grounds, volumes, joint)

    def _solid(self, tin: Tin, base: Plane, inside: F64) -> Prismoids:
        if self.parameters.volume.outline == "polygon":
            return clipped_prismoids(tin, base, polygon_of(self.parameters.volume), inside > 0)
        return prismoids(tin, base, inside > 0)

    def _volume(
        self,
        tin: Tin,
        normal: F64,
        base: Plane,
        inside: F64,
        solid: Prismoids,
        budget: Budget,
        near: Fold | None,
    ) -> Volume:
        p, mask = self.parameters, inside > 0
        above, below = cut_and_fill_chords(tin, normal, base, inside)
        folded = 0.0 if near is None else near.taken(solid.cut_m3, solid.fill_m3)
        return Volume(
            volume_m3=solid.net_m3 - above - below,
            sigma_m3=budget.sigma,
            confidence=p.volume.confidence,
            coverage_factor=NormalDist().inv_cdf(0.5 + p.volume.confidence / 2),
            cut_m3=solid.cut_m3 - folded - above,
            fill_m3=solid.fill_m3 - folded + below,
            area_m2=solid.area_m2,
            base=base_name(p),
            base_same_survey=p.volume.base == "ground",
            centroid_map=centroid(tin, base, inside),
            budget_m6=budget.lines,
            sigma_tau_range_m3=budget.sigma_tau_range,
            sigma_naive_m3=budget.sigma_naive,
            outline=polygon_of(p.volume)
            if p.volume.outline == "polygon"
            else boundary_loop(tin, mask),
            vertices=int(np.count_nonzero(vertex_mask(tin, mask))),
            triangles=int(np.count_nonzero(mask)),
            t_ns=self._t_ns,
            folded_m3=folded,
            budget_within_m6=budget.within,
            near_area_m2=0.0 if near is None else near.near_area_m2,
            second_order_m3=budget.second.shift_m3,
            second_order_matters=budget.second.matters,
            chord_m3=above + below,
        )


def joint_covariance(variance: list[float], of_two: Callable[[int, int], float]) -> F64 | None:
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
            C[a, b] = C[b, a] = 0.5 * (of_two(a, b) - variance[a] - variance[b])
    return C
