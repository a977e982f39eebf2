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

import numpy as np

from ladar_volume.change.cut_and_fill import CutAndFill, cut_and_fill
from ladar_volume.change.surface_difference import Difference, difference
from ladar_volume.model.records import F64, Tin, Volume
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import Epoch, EpochBudget, epoch_budget
from ladar_volume.volume.outline import boundary_loop
from ladar_volume.volume.overlay import VolumesBetween, volumes_between
from ladar_volume.volume.polygon import areas_inside, check_polygon

#: Name of the base of a difference.
BASE = "epoch before, over the common footprint"


@dataclass(frozen=True)
class EpochDifference:
    """volume : new minus previous over the common footprint · budget · z : the volume in standard
    deviations · p_value : two-sided probability of a |z| at least as large if nothing had changed ·
    sigma_cut_m3, sigma_fill_m3 : of the volume's cut and fill
    """

    volume: Volume
    budget: EpochBudget
    z: float
    p_value: float
    sigma_cut_m3: float
    sigma_fill_m3: float

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
    found, apart = volumes_between(upper, lower), difference(upper, lower)
    budget = epoch_budget(new, previous, found.gradient_net, found.lower_net, separate)
    parts = cut_and_fill(new, previous, found, apart, budget, separate)
    volume = as_volume(new, previous, found, apart, budget, parts)
    z = (
        volume.volume_m3 / budget.sigma
        if budget.sigma > 0.0
        else math.copysign(math.inf, volume.volume_m3)
    )
    p_value = math.erfc(abs(z) / math.sqrt(2.0))
    found_out = EpochDifference(volume, budget, z, p_value, parts.sigma_cut_m3, parts.sigma_fill_m3)
    return found_out, apart


def change_centroid(difference: Difference, heights: F64) -> tuple[float, float, float]:
    """Mean place (x, y, z) m of the change, either way, on the surface with vertex heights (n,)."""
    t = difference.tin.triangles[difference.tin.relevant]
    weight = (
        footprint_areas(difference.tin.vertices, t)
        * np.abs(difference.tin.vertices[t, 2].mean(axis=1))
        + 1e-300
    )
    x, y = (weight @ difference.tin.vertices[t, :2].mean(axis=1)) / weight.sum()
    return float(x), float(y), float(weight @ heights[t].mean(axis=1) / weight.sum())


def as_volume(
    new: Epoch,
    previous: Epoch,
    found: VolumesBetween,
    difference: Difference,
    budget: EpochBudget,
    parts: CutAndFill,
) -> Volume:
    """The difference as a volume whose base is the epoch before."""
    p, tin = new.sources.parameters.volume, difference.tin
    return Volume(
        found.net_m3 - budget.smoothing_m3,
        budget.sigma,
        p.confidence,
        NormalDist().inv_cdf(0.5 + p.confidence / 2),
        parts.cut_m3,
        parts.fill_m3,
        found.area_m2,
        BASE,
        False,
        change_centroid(
            difference, (new if difference.upper_carries else previous).tin.vertices[:, 2]
        ),
        budget.lines,
        budget.sigma_tau_range,
        budget.sigma_naive,
        boundary_loop(tin, tin.relevant),
        len(np.unique(tin.triangles[tin.relevant])),
        int(np.count_nonzero(tin.relevant)),
        new.t_ns,
        parts.folded_m3,
        parts.near_area_m2,
        budget.within,
        budget.second.shift_m3,
        budget.second.matters,
        smoothing_m3=budget.smoothing_m3,
    )
