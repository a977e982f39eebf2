"""Cut and fill between two surveys with standard deviations of their own (UNCERTAINTY steps 7, 8
and 10).

Noise of the returns folds into both where nothing changed: that is taken out as above a base
(``volume.near_base``, ``volume.remaining_fold``), and what stays uncertain of it is in both. Each
source goes through the mean slopes: half of it where the surfaces run along each other. What a
whole survey shares lifts one surface off the other, which is no small step where they are close:
its effect on cut and on fill is taken with its curvature, over the normal distribution of the lift.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from ladar_volume.change.change_detection import shared_sigma
from ladar_volume.change.surface_difference import Difference, fineness
from ladar_volume.change.unchanged_ground import remaining_on_ground
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.records import F64, LEAST_UPWARD
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import (
    Epoch,
    EpochBudget,
    calibration_cross,
    epoch_budget,
)
from ladar_volume.uncertainty.smoothing import cut_shift
from ladar_volume.uncertainty.vertex_noise import height_pairs, height_sums, rings_for, vertex_rows
from ladar_volume.volume.near_base import (
    NearBase,
    near_base,
    near_triangles,
    scatter,
    smooth_heights,
)
from ladar_volume.volume.overlay import VolumesBetween
from ladar_volume.volume.prismoids import positive_part

#: A level of zero, above which differences stand.
ZERO = design_surface([0.0])
#: Lines of a budget that are of single returns and patches.
NOISE = tuple(
    f"{name}{end}"
    for name in ("noise", "noise_tangential", "smoothing")
    for end in ("", "_previous")
)
#: Places and weights for means over a standard normal distribution (Gauss-Hermite).
PLACES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
WEIGHTS = WEIGHTS / WEIGHTS.sum()


class CutAndFill(NamedTuple):
    """cut_m3 ± sigma_cut_m3, fill_m3 ± sigma_fill_m3 : corrected, 0 or more · folded_m3 : taken
    from both for noise, over near_area_m2 · smoothing_m3 : taken from cut for what the filter's
    fits smoothed away; less what the net volume had of it, from fill
    """

    cut_m3: float
    fill_m3: float
    sigma_cut_m3: float
    sigma_fill_m3: float
    folded_m3: float
    near_area_m2: float
    smoothing_m3: float


def cut_and_fill(
    new: Epoch,
    previous: Epoch,
    found: VolumesBetween,
    difference: Difference,
    budget: EpochBudget,
    separate: Collection[str] = (),
) -> CutAndFill:
    """Cut and fill of the overlay ``found`` of two surveys, whose difference of heights is
    ``difference`` and whose net volume has the ``budget``.
    """
    near = near_difference(new, previous, difference)
    folded = 0.0 if near is None else near.removed_m3(found.cut_m3, found.fill_m3)
    variance, smoothed = part_variances(new, previous, found, difference, near, separate)
    variance += shared_shift_variances(new, previous, difference, budget, separate)
    if near is not None and near.correction_m3 + near.remaining.fold_m3 > folded:
        # one of the two is 0, and the other the net volume: its noise is no less than that
        variance = np.maximum(variance, sum(budget.lines.get(name, 0.0) for name in NOISE))
    cut, fill = np.sqrt(np.maximum(variance, 0.0)).tolist()
    area = 0.0 if near is None else near.near_area_m2
    cut_m3, fill_m3 = found.cut_m3 - folded, found.fill_m3 - folded
    smoothed = cut_shift(cut_m3, fill_m3, smoothed, budget.smoothing_m3)
    return CutAndFill(
        cut_m3 - smoothed,
        fill_m3 - (smoothed - budget.smoothing_m3),
        cut,
        fill,
        folded,
        area,
        smoothed,
    )


def point_variance(epoch: Epoch) -> F64:
    """Variance (n,) m² of each filtered point's height from the returns' noise."""
    points = epoch.sources.points
    out: F64 = points.variance / np.maximum(np.abs(points.normal[:, 2]), LEAST_UPWARD) ** 2
    return out


def height_noise(epoch: Epoch) -> tuple[Any, F64, float]:
    """Of the heights' noise from the returns: covariance (n, n), sparse, m², of vertices joined by
    an edge, sums (n,) over all, and how many heights share their noise.

    An adjusted height of a partial TIN counts as that of its own point: the points it is a mean of
    lie on the same patches and err alike.
    """
    tin, s = epoch.tin, epoch.sources
    variance = point_variance(epoch)[tin.source]
    X, row = vertex_rows(tin, s.points, s.patches, s.geometry)
    C = height_pairs(tin, s.patches, s.geometry, X, row, variance, tin.triangles)
    chosen = np.arange(len(tin.vertices), dtype=np.int64)
    return C, *height_sums(s.patches, s.geometry, X, row, chosen, variance)


def near_difference(new: Epoch, previous: Epoch, difference: Difference) -> NearBase | None:
    """What noise folds into cut and fill where the surfaces are near each other; None where they
    nowhere are. Vertices of a partial TIN are chosen by their heights: their variances near the
    other surface are raised to what they scatter.
    """
    own, other = (new, previous) if difference.upper_carries else (previous, new)
    (C_own, sums, alike), (C_other, other_sums, other_alike) = (
        height_noise(own),
        height_noise(other),
    )
    C, below, tin = difference.covariance(C_own, other.tin, C_other), other.tin, difference.common()
    # as many of the carrying surface's vertices as stand where one of the other's does
    density = fineness(tin) / max(fineness(below), 1e-300)
    summed = sums + density * (difference.weight * other_sums[difference.corner]).sum(axis=1)
    height, t = tin.vertices[:, 2], tin.triangles
    near = t[near_triangles(t, height, C.diagonal())]
    if not len(near):
        return None
    wider = 1.0
    if any(e.surface.fit is not None for e in (new, previous)):
        wider = scatter(tin, height, C.diagonal(), near)
    rings = rings_for(max(alike, other_alike))
    C, summed = C * wider, wider * summed
    found = near_base(tin, ZERO, C, rings=rings, summed=summed)
    smooth = smooth_heights(tin, height, C.diagonal(), near, rings, summed)
    left = remaining_on_ground(smooth, near, footprint_areas(tin.vertices, near), rings)
    return dataclasses.replace(found, remaining=left)


def part_variances(
    new: Epoch,
    previous: Epoch,
    found: VolumesBetween,
    difference: Difference,
    near: NearBase | None,
    separate: Collection[str],
) -> tuple[F64, float]:
    """Variances (2,) m⁶ of cut and of fill: every source through the mean slopes, what bends with
    the noise, and what remains of the fold; and what smoothing made cut too large by, m³.
    """
    upper, lower = found.gradient_cut, found.lower_cut
    more = 0.0
    if near is not None:
        more = near.curved_m6 + near.remaining.sigma_m3**2
        other = previous if difference.upper_carries else new
        shares = difference.shares(near.gradient_cut, near.gradient_net, len(other.tin.vertices))
        of_upper, of_lower = shares if difference.upper_carries else shares[::-1]
        upper = blend_cut_gradients(of_upper, found.gradient_net, upper)
        lower = blend_cut_gradients(of_lower, found.lower_net, lower)
    cut = epoch_budget(new, previous, upper, lower, separate)
    fill = epoch_budget(
        new, previous, upper - found.gradient_net, lower - found.lower_net, separate
    ).sigma
    return np.array([cut.sigma**2 + more, fill**2 + more]), cut.smoothing_m3


def blend_cut_gradients(share: F64, net: F64, cut: F64) -> F64:
    """Gradients (n, 3) of the cut: a share (n,) of those of the net volume (n, 3), where it is
    known, the given ones elsewhere.
    """
    known = np.isfinite(share)
    out: F64 = cut.copy()
    out[known] = share[known, None] * net[known]
    return out


def shared_shift_variances(
    new: Epoch,
    previous: Epoch,
    difference: Difference,
    budget: EpochBudget,
    separate: Collection[str],
) -> F64:
    """What the variances (2,) m⁶ of cut and of fill differ from first order, since what a whole
    survey shares lifts the surfaces off each other.

    The lift has the standard deviation of each difference (``shared_sigma``). As much of it as the
    net volume's budget has acts everywhere alike; the rest acts on some parts upwards and on as
    many downwards.
    """
    tin = difference.tin
    t = tin.triangles[tin.relevant]
    at = np.unique(t).astype(np.int64)
    upper, cross = difference.upper_carries, calibration_cross(new, previous, separate)
    own, other, cross = (new, previous, cross) if upper else (previous, new, cross.T)
    tau = np.zeros(len(tin.vertices))
    tau[at] = shared_sigma(own, other, difference, at, cross)[at]
    area, height = footprint_areas(tin.vertices, t), tin.vertices[:, 2]
    whole = float(area @ tau[t].mean(axis=1))
    shared = sum(v for name, v in budget.lines.items() if name not in NOISE)
    if not whole > 0.0 or not shared > 0.0:
        return np.zeros(2)
    alike = min(math.sqrt(shared) / whole, 1.0)
    rest = math.sqrt(1.0 - alike**2)
    out = np.zeros(2)
    for i, sign in enumerate((1.0, -1.0)):
        h, lift = sign * height[t], sign * tau[t]
        mean, slope = positive_part(h)
        first = alike * float(area @ (slope * lift).sum(axis=1))
        apart_from, both = np.empty(len(PLACES)), np.empty(len(PLACES))
        for k, x in enumerate(PLACES):
            apart_from[k] = area @ (positive_part(h + alike * x * lift)[0] - mean)
            both[k] = area @ (positive_part(h + rest * x * lift)[0] - mean)
        even = 0.5 * (both + both[::-1])  # the places lie evenly about zero
        out[i] = WEIGHTS @ apart_from**2 - first**2 + WEIGHTS @ even**2
    return out
