"""Ground that did not change tells whether two surveys lie on each other as well as their budgets
say.

Where it is named, its mean difference of heights is tested against what both budgets, a transform
among them, allow of that mean. Where it is not, the vertices whose difference is within their own
noise stand for it; where hardly any are, the commonest difference does. A misregistration that
stands out is no part of the budget: its effect on the whole volume enters the variance, and the
verdict says so.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from ladar_volume.change.change_detection import ChangeMap, weighted_sigma
from ladar_volume.change.epoch_change import EpochDifference, within_outline
from ladar_volume.change.surface_difference import Difference
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Tin
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.volume.polygon import areas_inside, check_polygon

#: A difference within so many of its sigmas is none, and a mean beyond so many stands out.
WITHIN, STANDS_OUT = 3.0, 3.0
#: Steps to where most of the ground agrees.
CLIMB_STEPS = 50
#: Share of the common area below which no ground is taken for stable.
LEAST_SHARE = 0.2
#: Share of the smaller survey that both cover: below the first it is doubtful, below the second
#: refused.
SMALL_OVERLAP, NO_OVERLAP = 0.5, 0.02


@dataclass(frozen=True)
class StableGround:
    """offset_m ± sigma_m : mean difference of heights on ground taken for unchanged, and what the
    budgets allow of it · share : of the common area · named : whether it was named · overlap :
    share of the smaller survey that both cover · area_m2 : that both cover
    """

    offset_m: float
    sigma_m: float
    share: float
    named: bool
    overlap: float
    area_m2: float

    @property
    def effect_m3(self) -> float:
        """What the offset does to the volume over all that both cover."""
        return self.offset_m * self.area_m2

    @property
    def is_significant(self) -> bool:
        """Whether the offset is more than the budgets allow."""
        return abs(self.offset_m) > STANDS_OUT * self.sigma_m


def stable_ground(
    new: Epoch,
    previous: Epoch,
    difference: Difference,
    change: ChangeMap,
    separate: Collection[str] = (),
    named: F64 | None = None,
    polygon: F64 | None = None,
) -> StableGround:
    """The mean difference on unchanged ground: within the polygon ``named`` (c, 2) m, or found.

    Raises :class:`VolumeError` (epochs_stable: nothing of it is common ground; epochs_overlap).
    """
    used = change.area_m2 > 0.0
    total = float(change.area_m2.sum())
    overlap = total / max(min(area(within_outline(new.tin, polygon)), area(previous.tin)), 1e-300)
    check_overlap(total, overlap)
    if named is None:
        weight = np.where(unchanged_vertices(change, used), change.area_m2, 0.0)
    else:
        t = change.tin.triangles[change.tin.relevant]
        inside = areas_inside(change.tin, check_polygon(named))[change.tin.relevant]
        weight = np.bincount(t.ravel(), np.repeat(inside / 3.0, 3), len(used))
    sum_m2, chosen = float(weight.sum()), weight > 0.0
    if not sum_m2 > 0.0:
        raise VolumeError(
            "nothing that both surveys cover lies within the stable ground",
            reason="epochs_stable",
        )
    weight = weight / sum_m2
    offset = float(weight[chosen] @ change.difference_m[chosen])
    sigma = weighted_sigma(new, previous, difference, weight, separate)
    return StableGround(offset, sigma, sum_m2 / total, named is not None, overlap, total)


def check_overlap(common_m2: float, overlap: float) -> None:
    """Raises :class:`VolumeError` (epochs_overlap) where two surveys have next to nothing in
    common; overlap : share of the smaller one.
    """
    if overlap < NO_OVERLAP:
        raise VolumeError(
            f"the two surveys have {common_m2:.3g} m² in common, {100.0 * overlap:.2g} % of the "
            "smaller one: too little to compare; is it the same place, in the same frame?",
            reason="epochs_overlap",
            value=overlap,
        )


def area(tin: Tin) -> float:
    """Relevant area in plan, m²."""
    return float(footprint_areas(tin.vertices, tin.triangles[tin.relevant]).sum())


def unchanged_vertices(change: ChangeMap, used: Bool) -> Bool:
    """Vertices (n,) whose difference is the commonest one within its noise. The search begins among
    those within all of their sigma, or where these are few, among all, and climbs to where most lie
    (mean shift, Fukunaga & Hostetler 1975).
    """
    d, s = change.difference_m, np.maximum(change.sigma_m, 1e-12)
    with np.errstate(invalid="ignore"):
        near: Bool = used & (np.abs(d) <= WITHIN * s)
    if change.area_m2[near].sum() < LEAST_SHARE * change.area_m2.sum():
        near = used
    noise = np.maximum(change.sigma_noise_m, 1e-12)
    middle = commonest(d[near], change.area_m2[near], float(np.median(noise[near])))
    out = near
    for _ in range(CLIMB_STEPS):
        with np.errstate(invalid="ignore"):
            out = used & (np.abs(d - middle) <= WITHIN * noise)
        last, middle = middle, float(np.average(d[out], weights=change.area_m2[out]))
        if last == middle:
            break
    return out


def commonest(d: F64, weight: F64, width: float) -> float:
    """The value around which most weight of values d (n,) lies within ``width``."""
    order = np.argsort(d, kind="stable")
    x, w = d[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    last = np.searchsorted(x, x + 2.0 * width, side="right")
    best = int(np.argmax(w[last] - w[:-1]))
    return float(np.median(x[best : last[best]]))


def with_stable_ground(found: EpochDifference, ground: StableGround) -> EpochDifference:
    """The difference with the misregistration in its variance, where it stands out."""
    if not ground.is_significant:
        return found
    line = {"stable_ground": ground.effect_m3**2}
    budget = replace(found.budget, lines={**found.budget.lines, **line})
    v = found.volume
    volume = replace(v, sigma_m3=budget.sigma, budget_m6={**v.budget_m6, **line})
    z = v.volume_m3 / budget.sigma
    return replace(
        found,
        volume=volume,
        budget=budget,
        z=z,
        p_value=math.erfc(abs(z) / math.sqrt(2.0)),
        sigma_cut_m3=math.hypot(found.sigma_cut_m3, ground.effect_m3),
        sigma_fill_m3=math.hypot(found.sigma_fill_m3, ground.effect_m3),
    )


def epoch_verdict(ground: StableGround) -> Verdict:
    """What speaks against a difference of two surveys."""
    if ground.is_significant:
        return Verdict((registration_doubt(ground), *overlap_doubts(ground)))
    return Verdict(tuple(coverage_doubts(ground)))


def coverage_doubts(ground: StableGround) -> list[Doubt]:
    """How much of what both cover did not change, and how much both cover."""
    doubts = []
    if not ground.named and ground.share < LEAST_SHARE:
        doubts.append(
            Doubt(
                "no_stable_ground",
                f"only {100.0 * ground.share:.0f} % of the common ground is without change, too "
                "little to test how the surveys lie on each other: survey more of the ground "
                "around, or name stable ground by --stable",
                ground.share,
            )
        )
    return doubts + overlap_doubts(ground)


def overlap_doubts(ground: StableGround) -> list[Doubt]:
    """How much both surveys cover."""
    if ground.overlap >= SMALL_OVERLAP:
        return []
    words = (
        f"the surveys have {ground.area_m2:.3g} m² in common, {100.0 * ground.overlap:.0f} % of "
        "the smaller one: what changed elsewhere is not in the volume; name the place by --polygon "
        "if that is meant"
    )
    return [Doubt("overlap", words, ground.overlap)]


def registration_doubt(ground: StableGround) -> Doubt:
    """The doubt of surveys that do not lie on each other."""
    where = "the stable ground" if ground.named else "the ground that agrees best"
    ratio = abs(ground.offset_m) / max(ground.sigma_m, 1e-300)
    return Doubt(
        "registration",
        f"{where} ({100.0 * ground.share:.0f} % of the common area) differs by "
        f"{1e3 * ground.offset_m:+.1f} mm in the mean, {ratio:.1f} times what the budgets allow, "
        f"which is {ground.effect_m3:+.3g} m³ over the whole: lay the surveys on each other "
        "(ladar_volume register, --transform), give their true budgets, or name stable ground by "
        "--stable",
        ground.effect_m3,
    )
