"""A surface where nothing was seen, from what was seen around it: its mean height and the variance
of its volume.

The surface is kriged from its rim (:mod:`.gap_kriging`) with the covariance ``c |h|³``. The factor
c is the survey's own: the same gap is laid over places around it that were seen, the volume there
is predicted from the rim alone, and the mean of ``error² / predicted variance`` is c.

In the shadow of an edge (:mod:`.sight_lines`) the surface is not smooth: there it lies anywhere
between the line of sight and the steepest slope of loose material.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.volume.field_checks.gap_kriging import (
    ObservedPoints,
    above_film,
    diameter,
    predict_heights,
    predict_integral,
    rim_points,
)
from ladar_volume.volume.field_checks.sight_lines import shadow_heights

#: Places of a gap where its surface is predicted, at most.
CELLS = 80
#: No point of a gap laid over seen places is nearer to a place than so much of what is in the gap.
APART = 0.8
#: Places over which the gap is laid, at most, within so many of its diameters; sizes that are tried
#: until there are enough of them.
TRIALS, AWAY, SIZES, ENOUGH = 12, 2.5, (1.0, 0.7, 0.5, 0.35), 6
#: Standard deviation of what the smooth surface adds to the chords, over itself, before the gap was
#: laid over seen places, and how many of these it counts for.
DOUBTED, BEFORE = 0.5, 4.0
#: Standard deviation of where a surface falls that is level on both sides of a gap, over the area
#: between smooth surface and chords, above them and below. That of a step of 45 degrees anywhere
#: from end to end, even odds, in gaps 1.75 to 2.2 times as wide as it is high: in the shadow of an
#: edge, which is where most such gaps come from, the surface falls at once.
FALLS = 3.5
#: What is less than so many standard deviations of the points' noise is no fall.
NOISE = 3.0
#: Slope that loose material keeps, at most; a surface that is seen to be steeper has no such bound.
REPOSE = math.tan(math.radians(45.0))
#: A place of a gap laid over what was seen has a point within so many spacings.
FILLED = 2.0


@dataclass(frozen=True)
class GapTrial:
    """A gap laid over a seen place: squares, m², of the mean height's error, beyond its noise, of
    its standard deviation for c = 1, and of the difference between smooth surface and chords.
    """

    error_m2: float
    unit_m2: float
    bulge_m2: float


@dataclass(frozen=True)
class UnseenVolume:
    """The volume of an unseen surface, m³ above height 0, its variance, m⁶, and from how many gaps
    laid over seen places the variance was told.
    """

    volume_m3: float
    variance_m6: float
    trials: int


def width_of(apart: F64) -> float:
    """Of the widest circle in a gap, m; apart : (k,) m as for :func:`unseen_surface`."""
    return 2.0 * float(apart.max()) / APART


def within_repose(r: F64, xy: F64, weight: F64, z: F64) -> tuple[F64, float]:
    """Heights z (k,) m at xy (k, 2) no lower and no higher than slopes of loose material allow from
    points r (n, 3), and the volume between these bounds, m³; as they are, and NaN, where the points
    themselves are steeper.
    """
    d = cdist(xy, r[:, :2]) * REPOSE
    high, low = (r[:, 2] + d).min(axis=1), (r[:, 2] - d).max(axis=1)
    if not (low <= high + 1e-9).all():
        return z, math.nan
    return np.clip(z, low, high), float(weight @ (high - low))


def swing_m6(seen: ObservedPoints, rim: I64, xy: F64, weight: F64) -> float:
    """Of a smooth surface over one as tight as a film: the square of what lies between the two,
    above and below, less what is left of it in all, m⁶. On the way between two levels it is above
    on one side and below on the other, and nobody knows where it falls. What the points' noise may
    be is left out.
    """
    above, noise = above_film(seen, rim, xy)
    above = weight * np.sign(above) * np.maximum(np.abs(above) - NOISE * noise, 0.0)
    both, net = float(np.abs(above).sum()), float(above.sum())
    return max(both**2 - net**2, 0.0) if math.isfinite(both) else 0.0


def trial_places(seen: ObservedPoints, xy: F64, weight: F64) -> F64:
    """Shifts (k, 2) m of a gap, in a spiral about it, evenly over the disc around."""
    size = diameter(float(weight.sum()))
    number = np.arange(1, 8 * TRIALS + 1)
    radius = AWAY * size * np.sqrt(number / len(number))
    angle = number * math.pi * (3.0 - math.sqrt(5.0))  # the golden angle: no direction twice
    out = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return out[np.argsort(radius, kind="stable")]


def try_gap(seen: ObservedPoints, xy: F64, weight: F64, apart: F64) -> list[GapTrial]:
    """The gap laid over seen places."""
    out: list[GapTrial] = []
    filled = FILLED * seen.spacing_m
    for shift in trial_places(seen, xy, weight):
        place = xy + shift
        d, at = seen.tree.query(place, distance_upper_bound=1.001 * filled)
        if float(np.max(d)) > filled:
            continue  # not wholly seen
        rim = rim_points(seen, place, weight, apart, width_of(apart))
        found = predict_integral(seen, rim, place, weight)
        if found is None or found.unit_m6 <= 0.0:
            continue
        error = float(weight @ seen.r[np.asarray(at), 2]) - found.volume_m3
        own = float((weight**2) @ seen.variance[np.asarray(at)])
        bulge = found.volume_m3 - float(weight @ predict_heights(seen, rim, place, 1))
        scale = float(weight.sum()) ** 2  # of heights: gaps of several sizes go together
        out.append(
            GapTrial(
                max(error**2 - found.noise_m6 - own, 0.0) / scale,
                found.unit_m6 / scale,
                bulge**2 / scale,
            )
        )
        if len(out) >= TRIALS:
            break
    return out


def scale_from_trials(trials: list[GapTrial], shape_m2: float) -> tuple[float, float]:
    """The factor c, and the share of a smooth surface's difference from chords that is a standard
    deviation, squared, for a gap with that difference (mean height, squared) shape_m2.
    """
    c = float(np.mean([t.error_m2 / t.unit_m2 for t in trials])) if trials else 0.0
    before = BEFORE * shape_m2
    error = math.fsum(min(t.error_m2, t.bulge_m2) for t in trials)
    bulge = math.fsum(t.bulge_m2 for t in trials)
    total = before + bulge
    return c, (before * DOUBTED**2 + error) / total if total > 0.0 else 0.0


@dataclass(frozen=True)
class Shadow:
    """Of a gap's places: which are in shadow (k,), the middle (k,) m of the heights that their
    surface may have, and the volume between these bounds, m³.
    """

    dark: Bool
    middle: F64
    room_m3: float


def shadow_of(seen: ObservedPoints, rim: I64, xy: F64, weight: F64) -> Shadow:
    """The part of a gap of places xy (k, 2) m with areas weight (k,) m² that is in shadow: below
    the line of sight, and above the rim's lowest point and the steepest slopes of loose material,
    where the rim itself keeps to these.
    """
    none = np.zeros(len(xy), np.bool_)
    if not len(seen.view) or not len(rim):
        return Shadow(none, np.zeros(len(xy)), 0.0)
    r = seen.r[rim]
    high = shadow_heights(r, seen.view[rim], xy, seen.spacing_m)
    dark = np.isfinite(high)
    steep, _ = within_repose(r, xy, weight, np.full(len(xy), -math.inf))
    low = np.minimum(np.maximum(steep, r[:, 2].min(initial=math.inf)), high)
    middle = np.where(dark, 0.5 * (low + high), 0.0)
    return Shadow(dark, middle, float(weight[dark] @ (high - low)[dark]))


def trials_of(seen: ObservedPoints, xy: F64, weight: F64, apart: F64) -> list[GapTrial]:
    """The gap laid over seen places, smaller where there are too few for it."""
    trials: list[GapTrial] = []
    centre = (weight @ xy) / weight.sum()
    for size in SIZES:
        trials += try_gap(seen, centre + size * (xy - centre), size**2 * weight, size * apart)
        if len(trials) >= ENOUGH:
            break
    return trials


def unseen_surface(
    seen: ObservedPoints, xy: F64, weight: F64, apart: F64, chord: F64
) -> UnseenVolume | None:
    """The surface of a gap of places xy (k, 2) m with areas weight (k,) m², and how well it is
    known; None where nothing can be told of it.

    apart : (k,) m, distance from each place within which no point was seen · chord : (k,) m,
    heights of the triangles that span it. Where the slopes at the rim go on until they meet, the
    surface lies a third further from the chords than the smooth one (exact for a cone in a round
    gap); where they end at the rim it lies as low as the chords. So half of the difference between
    smooth surface and chords counts as a standard deviation, less where seen places tell otherwise.
    """
    rim = rim_points(seen, xy, weight, np.zeros(len(xy)), width_of(apart))
    shade = shadow_of(seen, rim, xy, weight)
    lit = np.where(shade.dark, 0.0, weight)
    found = predict_integral(seen, rim, xy, lit)
    if found is None:
        return None
    z, room = within_repose(seen.r[rim], xy, lit, predict_heights(seen, rim, xy))
    trials = trials_of(seen, xy, weight, apart) if lit.any() else []
    net_m6, swing = float(lit @ (z - chord)) ** 2, swing_m6(seen, rim, xy, lit)
    factor, share = scale_from_trials(trials, (net_m6 + swing) / float(weight.sum()) ** 2)
    variance = factor * found.unit_m6 + found.noise_m6
    variance += share * (net_m6 + (FALLS / DOUBTED) ** 2 * swing)
    if math.isfinite(room):
        variance = min(variance, room**2 / 12.0) if trials else room**2 / 12.0
    elif trials:  # a wall is at the rim: no slope bounds the gap, but the heights around it do
        between_m3 = float(lit.sum() * np.ptp(seen.r[rim, 2]))
        variance = min(variance, between_m3**2 / 12.0)
    elif lit.any():
        return None
    volume_m3 = float(weight @ np.where(shade.dark, shade.middle, z))
    return UnseenVolume(volume_m3, variance + shade.room_m3**2 / 12.0, len(trials))
