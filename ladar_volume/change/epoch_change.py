"""The volume between two surveys of one place (UNCERTAINTY steps 8 and 10).

Both surfaces are overlaid over their common footprint; net is positive where the new one is higher.
Cut and fill are corrected for the noise that folds into them where nothing changed. The budget is
that of ``epoch_budget``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from ladar_volume.change.surface_difference import Difference, difference, fineness
from ladar_volume.model.records import F64, Tin, Volume
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import Epoch, EpochBudget, epoch_budget
from ladar_volume.uncertainty.vertex_noise import height_pairs, height_sums, rings_for, vertex_rows
from ladar_volume.volume.near_base import Fold, fold, near_triangles, node_covariances
from ladar_volume.volume.outline import boundary_loop
from ladar_volume.volume.overlay import Between, between
from ladar_volume.volume.polygon import areas_inside, check_polygon
from ladar_volume.volume.volume_loads import vertex_variance

#: Name of the base of a difference.
BASE = "epoch before, over the common footprint"


@dataclass(frozen=True)
class EpochDifference:
    """volume : new minus previous over the common footprint · budget · z : the volume in standard
    deviations · p_value : two-sided probability of a |z| at least as large if nothing had changed
    """

    volume: Volume
    budget: EpochBudget
    z: float
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether zero lies outside the interval."""
        return abs(self.z) > self.volume.coverage_factor


def within_outline(tin: Tin, polygon: F64 | None) -> Tin:
    """The surface with those triangles relevant of which at least half lies within a polygon (c, 2)
    m.
    """
    if polygon is None:
        return tin
    inside = areas_inside(tin, check_polygon(polygon)) >= 0.5 * footprint_areas(
        tin.vertices, tin.triangles
    )
    return dataclasses.replace(tin, relevant=tin.relevant & inside)


def epoch_difference(
    new: Epoch, previous: Epoch, separate: Collection[str] = (), polygon: F64 | None = None
) -> tuple[EpochDifference, Difference]:
    """New minus previous over the common footprint (within a polygon (c, 2) m, where given), and
    the difference of heights.

    Cut is what the new surface stands above the previous one, fill what it lies below; both are
    corrected for the noise that folds into them. Raises :class:`VolumeError` as
    :func:`epoch_budget` does, and where the two surfaces have no area in common.
    """
    upper, lower = within_outline(new.tin, polygon), previous.tin
    found, apart = between(upper, lower), difference(upper, lower)
    budget = epoch_budget(new, previous, found.gradient_net, found.lower_net, separate)
    near = near_correction(new, previous, apart)
    volume = as_volume(new, previous, found, apart, budget, near)
    z = (
        volume.volume_m3 / budget.sigma
        if budget.sigma > 0.0
        else math.copysign(math.inf, volume.volume_m3)
    )
    return EpochDifference(volume, budget, z, math.erfc(abs(z) / math.sqrt(2.0))), apart


def height_noise(epoch: Epoch) -> tuple[Any, F64, float]:
    """Of the heights' noise from the returns: covariance (n, n), sparse, m², of vertices joined by
    an edge, sums (n,) over all, and how many heights share their noise.
    """
    tin, s = epoch.tin, epoch.sources
    variance = vertex_variance(epoch.surface, s.points)
    X, row = vertex_rows(tin, s.points, s.patches, s.geometry)
    C = height_pairs(tin, s.patches, s.geometry, X, row, variance, tin.triangles)
    chosen = np.arange(len(tin.vertices), dtype=np.int64)
    return C, *height_sums(s.patches, s.geometry, X, row, chosen, variance)


def near_correction(new: Epoch, previous: Epoch, apart: Difference) -> Fold | None:
    """What noise folds into cut and fill where the surfaces are near each other; None where they
    nowhere are.
    """
    own, other = (new, previous) if apart.upper_carries else (previous, new)
    (C_own, sums, alike), (C_other, other_sums, other_alike) = (
        height_noise(own),
        height_noise(other),
    )
    C, below = apart.covariance(C_own, other.tin, C_other), other.tin
    # as many of the carrying surface's vertices as stand where one of the other's does
    density = fineness(apart.tin) / max(fineness(below), 1e-300)
    summed = sums + density * (apart.weight * other_sums[apart.corner]).sum(axis=1)
    height, variance, chosen = apart.tin.vertices[:, 2], C.diagonal(), apart.tin.relevant
    near = apart.tin.triangles[chosen]
    near = near[near_triangles(near, height, variance)]
    if not len(near):
        return None
    return fold(
        apart.tin,
        height,
        variance,
        near,
        node_covariances(C, near),
        rings_for(max(alike, other_alike)),
        summed,
    )


def change_centroid(apart: Difference, heights: F64) -> tuple[float, float, float]:
    """Mean place (x, y, z) m of the change, either way, on the surface with vertex heights (n,)."""
    t = apart.tin.triangles[apart.tin.relevant]
    weight = (
        footprint_areas(apart.tin.vertices, t) * np.abs(apart.tin.vertices[t, 2].mean(axis=1))
        + 1e-300
    )
    x, y = (weight @ apart.tin.vertices[t, :2].mean(axis=1)) / weight.sum()
    return float(x), float(y), float(weight @ heights[t].mean(axis=1) / weight.sum())


def as_volume(
    new: Epoch,
    previous: Epoch,
    found: Between,
    apart: Difference,
    budget: EpochBudget,
    near: Fold | None,
) -> Volume:
    """The difference as a volume whose base is the epoch before."""
    p, tin = new.sources.parameters.volume, apart.tin
    folded = 0.0 if near is None else near.taken(found.cut_m3, found.fill_m3)
    return Volume(
        found.net_m3,
        budget.sigma,
        p.confidence,
        NormalDist().inv_cdf(0.5 + p.confidence / 2),
        found.cut_m3 - folded,
        found.fill_m3 - folded,
        found.area_m2,
        BASE,
        False,
        change_centroid(apart, (new if apart.upper_carries else previous).tin.vertices[:, 2]),
        budget.lines,
        budget.sigma_tau_range,
        budget.sigma_naive,
        boundary_loop(tin, tin.relevant),
        len(np.unique(tin.triangles[tin.relevant])),
        int(np.count_nonzero(tin.relevant)),
        new.t_ns,
        folded,
        0.0 if near is None else near.near_area_m2,
        budget.within,
        budget.second.shift_m3,
        budget.second.matters,
    )
