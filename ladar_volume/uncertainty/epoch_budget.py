"""What two surveys of one place have in common, and the budget of a difference between them
(UNCERTAINTY step 10).

Noise and navigation are each survey's own. Constants of a calibration that both share enter with
the difference of their sensitivities: what shifts both surfaces alike, such as a lever arm flown
the same way, cancels. A transform that laid the new survey on the previous one enters with its
covariance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.registration.transform import Transform
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.uncertainty.navigation_sum import navigation_variance
from ladar_volume.uncertainty.propagation import calibration_groups
from ladar_volume.uncertainty.second_order import (
    BORESIGHT,
    SecondOrder,
    attitude_second_order,
    combine_second_orders,
    second_order,
)
from ladar_volume.uncertainty.volume_budget import Sensitivities, Sources, vertical_sigma

#: Calibration constants that belong to one survey and not to the instrument: the clock offset is
#: set anew with every start.
OWN = frozenset({"clock"})


@dataclass(frozen=True)
class Epoch:
    """One survey as it is compared. surface : its triangulation, in its own map frame · sources :
    every error source of it · t_ns : time of its last data · transform : own map frame to the one
    of the comparison, None for the same
    """

    surface: RepresentedSurface
    sources: Sources
    t_ns: int
    transform: Transform | None = None

    @property
    def tin(self) -> Tin:
        """The surface in the frame of the comparison."""
        tin = self.surface.tin
        return (
            tin
            if self.transform is None
            else dataclasses.replace(tin, vertices=self.transform.apply(tin.vertices))
        )

    def normals(self) -> F64:
        """Normals (n, 3) of the vertices, in the frame of the comparison."""
        n = self.sources.points.normal[self.surface.tin.source]
        return n if self.transform is None else n @ self.transform.R.T

    def sigma_z(self, tin: Tin | None = None) -> F64:
        """Total standard deviation (n,) m of the height of every vertex in its own map frame, all
        sources; of the surface, or of another one made from the same points.
        """
        return vertical_sigma(self.sources, (self.surface.tin if tin is None else tin).source)

    def sensitivities(self, gradient: F64) -> Sensitivities:
        """To every source, of a result with gradient (n, 3) by the vertices in the frame of the
        comparison.
        """
        return self.sources.sensitivities(self._by_points(gradient))

    def naive_sigma(self, gradient: F64) -> float:
        """Sigma of the same result if every point erred alone."""
        return self.sources.naive_sigma(self._by_points(gradient)[:, 0])

    def _by_points(self, gradient: F64) -> F64:
        own = (
            gradient
            if self.transform is None
            else self.transform.scale * gradient @ self.transform.R
        )
        return self.surface.by_points(own[:, None], len(self.sources.points))

    def registration_variance(self, gradient: F64) -> float:
        """What the transform adds to the variance of a result with gradient (n, 3) by the vertices
        in the frame of the comparison.
        """
        return (
            0.0
            if self.transform is None
            else self.transform.variance(gradient, self.surface.tin.vertices)
        )


@dataclass(frozen=True)
class EpochBudget:
    """lines : m⁶ by source, all uncorrelated; those of the previous survey end in ``_previous`` ·
    within, second : as in a volume's budget · sigma_tau_range : m³, with all correlation times
    divided by 3 and multiplied by 3 · sigma_naive : m³ · sigma_separate : m³, if the two surveys
    had nothing in common · smoothing_m3 : what the result is too large by, as in a volume's budget
    """

    lines: dict[str, float]
    within: dict[str, float]
    second: SecondOrder
    sigma_tau_range: tuple[float, float]
    sigma_naive: float
    sigma_separate: float
    smoothing_m3: float

    @property
    def sigma(self) -> float:
        """Standard deviation, m³."""
        return math.sqrt(sum(self.lines.values()))


def shared_columns(columns: int, separate: Collection[str]) -> Bool:
    """Calibration columns (c,) that two surveys share. Raises :class:`VolumeError` for the name of
    no group.
    """
    groups = calibration_groups(columns)
    unknown = sorted(set(separate) - set(groups))
    if unknown:
        raise VolumeError(
            f"no calibration group {', '.join(unknown)}; there are {', '.join(groups)}",
            reason="epochs_group",
            value=unknown,
        )
    out = np.zeros(columns, bool)
    for name, index in groups.items():
        out[index] = name not in separate and name not in OWN
    return out


def cross_covariance(C_new: F64, C_previous: F64, shared: Bool) -> F64:
    """Covariance (c, c) between the calibration errors of two surveys that share columns (c,). What
    is not shared is correlated only through what is: ``C_:S C_SS⁻¹ C_S:``.

    Raises :class:`VolumeError` where the budgets disagree on what is shared.
    """
    C, other = C_new[np.ix_(shared, shared)], C_previous[np.ix_(shared, shared)]
    sigma = np.sqrt(np.diag(C))
    scale = sigma[:, None] * sigma
    if not np.allclose(
        C, other, rtol=1e-6, atol=1e-9 * float(scale.max(initial=0.0))
    ) or not np.allclose(np.diag(C), np.diag(other)):
        raise VolumeError(
            (
                "the budgets of the two surveys disagree on the calibration they share: name "
                "what was calibrated anew as separate"
            ),
            reason="epochs_calibration",
        )
    safe = np.where(sigma > 0.0, sigma, 1.0)
    inverse = np.linalg.pinv(C / (safe[:, None] * safe), hermitian=True) / (safe[:, None] * safe)
    out: F64 = C_new[:, shared] @ inverse @ C_previous[shared]
    return out


def calibration_cross(new: Epoch, previous: Epoch, separate: Collection[str]) -> F64:
    """Covariance (c_new, c_previous) between the calibration errors of two surveys. Raises
    :class:`VolumeError`: see :func:`cross_covariance`; and for sensors of different kinds unless
    every group is separate.
    """
    C_new, C_previous = new.sources.C_cal, previous.sources.C_cal
    shared = shared_columns(len(C_new), separate)
    if len(C_new) == len(C_previous):
        return cross_covariance(C_new, C_previous, shared)
    if shared.any():
        raise VolumeError(
            (
                "the two surveys were made by sensors with different numbers of beams: they "
                "share no calibration"
            ),
            reason="epochs_sensor",
        )
    return np.zeros((len(C_new), len(C_previous)))


def calibration_lines(
    J_new: F64, J_old: F64, C_new: F64, C_old: F64, cross: F64
) -> tuple[dict[str, float], dict[str, float]]:
    """Variances of a difference by group, and the marginals within where groups are correlated:
    then there is one line ``calibration``.
    """
    alone, apart = {}, True
    new, old = calibration_groups(len(J_new)), calibration_groups(len(J_old))
    for name in CALIBRATION_GROUPS:
        i, j = new[name], old[name]
        both = 2.0 * J_new[i] @ cross[np.ix_(i, j)] @ J_old[j]
        alone[name] = max(
            0.0,
            float(
                J_new[i] @ C_new[np.ix_(i, i)] @ J_new[i]
                + J_old[j] @ C_old[np.ix_(j, j)] @ J_old[j]
                + both
            ),
        )
    for C, groups in ((C_new, new), (C_old, old)):
        apart = apart and np.count_nonzero(C) == sum(
            np.count_nonzero(C[np.ix_(i, i)]) for i in groups.values()
        )
    if apart:
        return alone, {}
    return {
        "calibration": max(
            0.0, float(J_new @ C_new @ J_new + J_old @ C_old @ J_old + 2.0 * J_new @ cross @ J_old)
        )
    }, alone


def boresight_second_order(
    new: Sensitivities, old: Sensitivities, C_new: F64, C_old: F64, shared: bool
) -> SecondOrder:
    """Second order of the boresight in a difference; a shared one acts through the sum of the
    curvatures.
    """
    C, C_own = C_new[BORESIGHT, BORESIGHT], C_old[BORESIGHT, BORESIGHT]
    if shared:
        J = new.J_cal[BORESIGHT] + old.J_cal[BORESIGHT]
        return second_order(new.boresight_curvature + old.boresight_curvature, C, float(J @ C @ J))
    first = [
        float(s.J_cal[BORESIGHT] @ B @ s.J_cal[BORESIGHT]) for s, B in ((new, C), (old, C_own))
    ]
    one, two = (
        second_order(new.boresight_curvature, C, first[0]),
        second_order(old.boresight_curvature, C_own, first[1]),
    )
    return SecondOrder(
        one.shift_m3 + two.shift_m3, one.variance_m6 + two.variance_m6, one.matters or two.matters
    )


def epoch_budget(
    new: Epoch,
    previous: Epoch,
    gradient_new: F64,
    gradient_previous: F64,
    separate: Collection[str] = (),
) -> EpochBudget:
    """Budget of a result with gradients (n, 3) and (k, 3) m² by the vertices of both surfaces, in
    the frame of the comparison.

    separate : calibration groups that were determined anew between the surveys. Raises
    :class:`VolumeError`: epochs_group, epochs_calibration, epochs_sensor.
    """
    one, two = new.sensitivities(gradient_new), previous.sensitivities(gradient_previous)
    C_new, C_old = new.sources.C_cal, previous.sources.C_cal
    cross = calibration_cross(new, previous, separate)
    calibration, within = calibration_lines(one.J_cal, two.J_cal, C_new, C_old, cross)
    second = boresight_second_order(one, two, C_new, C_old, "boresight" not in separate)
    own, all_second = lines_of_epochs(((new, one, ""), (previous, two, "_previous")), second)
    lines = {**calibration, **own}
    moved = new.registration_variance(gradient_new) + previous.registration_variance(
        gradient_previous
    )
    if new.transform is not None or previous.transform is not None:
        lines["registration"] = moved
    total = sum(lines.values())
    tau = [
        total + tau_change(new, one, f) + tau_change(previous, two, f)
        for f in (1.0 / 3.0, 1.0, 3.0)
    ]
    alone = calibration_lines(one.J_cal, two.J_cal, C_new, C_old, 0.0 * cross)[0]
    apart = total - sum(calibration.values()) + sum(alone.values())
    apart += boresight_second_order(one, two, C_new, C_old, False).line_m6 - second.line_m6
    naive = math.hypot(new.naive_sigma(gradient_new), previous.naive_sigma(gradient_previous))
    bounds, alone_m3 = (math.sqrt(min(tau)), math.sqrt(max(tau))), math.sqrt(max(apart, 0.0))
    smoothing_m3 = one.smoothing.shift_m3 + two.smoothing.shift_m3
    return EpochBudget(lines, within, all_second, bounds, naive, alone_m3, smoothing_m3)


def lines_of_epochs(
    epochs: Iterable[tuple[Epoch, Sensitivities, str]], boresight: SecondOrder
) -> tuple[dict[str, float], SecondOrder]:
    """Lines (m⁶) of what each survey has of its own, named with its ending, then those of second
    order with the ``boresight``'s; and all that is of second order.
    """
    lines: dict[str, float] = {}
    second_orders = {"boresight_second_order": boresight}
    for epoch, s, end in epochs:
        own = own_lines(epoch, s)
        lines.update({f"{name}{end}": value for name, value in own.items()})
        second_orders[f"attitude_second_order{end}"] = attitude_second_order(
            s.attitude_curvature, epoch.sources.parameters.budget, own["attitude"]
        )
    second_lines, all_second = combine_second_orders(second_orders)
    return {**lines, **second_lines}, all_second


def own_lines(epoch: Epoch, s: Sensitivities) -> dict[str, float]:
    """Variances that are one survey's own, m⁶: noise, navigation and smoothing."""
    return {
        "noise": max(0.0, float(s.C_results[0, 0])),
        "noise_tangential": s.tangential_m6,
        **navigation_variance(s.navigation, epoch.sources.parameters.budget),
        "smoothing": s.smoothing.variance_m6,
    }


def tau_change(epoch: Epoch, s: Sensitivities, factor: float) -> float:
    """By how much the variance from navigation changes where all correlation times are ``factor``
    times as long, m⁶.
    """
    budget = epoch.sources.parameters.budget
    return sum(navigation_variance(s.navigation, budget, factor).values()) - sum(
        navigation_variance(s.navigation, budget).values()
    )
