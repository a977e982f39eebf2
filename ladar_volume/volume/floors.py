"""Floors and tops from the second differences of cut volumes (seed 000 section 4.2), and the offset
between two sequences (5.4).

The first derivative of the cut volume by the level is minus the area above it, the second the area
per metre of height: flat parts of the surface are spikes. Second differences over equal steps are
that density, seen through a hat of one step each way; such hats reproduce straight lines, so the
centroid of a spike is the mean height of its area to a small part of the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.volume.cutfill import cut_sequence, sequence_gradient, triangle_heights

#: A spike ends where it has fallen to this share of its height above the background.
SPIKE_FOOT = 0.03
#: The most levels one call looks at; beyond it the step is certainly a mistake.
MAX_LEVELS = 1_000_000


@dataclass(frozen=True)
class Event:
    """A level at which flat surface appears or ends. level_m : mean height of the spike · area_m2 :
    flat area in it · width_m : standard deviation of its heights (noise, tilt), the hat removed ·
    first, last : indices of the levels it spans
    """

    level_m: float
    area_m2: float
    width_m: float
    first: int
    last: int


@dataclass(frozen=True)
class Floors:
    """floor, top : the lowest and the highest event (the same where there is one) · events : all,
    upwards · level_m : (m,) equally spaced · cut_m3 : (m,) · first_m3, second_m3 : (m − 1,), (m −
    2,) differences
    """

    floor: Event
    top: Event
    events: tuple[Event, ...]
    level_m: F64
    cut_m3: F64
    first_m3: F64
    second_m3: F64


def spikes(level_m: F64, cut_m3: F64, least_share: float = 0.02) -> tuple[Event, ...]:
    """Events in a sequence of cut volumes (m,) at equally spaced ascending levels (m,), those of at
    least ``least_share`` of all area.

    Raises :class:`VolumeError` for fewer than five levels, or levels that are not equally spaced
    and ascending.
    """
    level, step, cut = checked_levels(level_m, cut_m3)
    area = np.diff(cut, 2) / step  # area in the hat of each inner level, m²
    background = float(np.median(area))
    rest = area - background
    smooth = np.convolve(np.pad(rest, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
    total, free, found = float(np.maximum(area, 0.0).sum()), np.ones(len(area), bool), []
    while free.any() and total > 0.0:
        peak = int(np.argmax(np.where(free, smooth, -np.inf)))
        first, last = reach(smooth, free, peak)
        free[first : last + 1] = False
        part = rest[first : last + 1]
        size = float(part.sum())
        if size < least_share * total:
            break
        z = level[first + 1 : last + 2]
        mean = float(part @ z / size)
        spread = (
            float(part @ (z - mean) ** 2 / size) - step * step / 6.0
        )  # the hat adds a sixth of its half width squared
        found.append(Event(mean, size, float(np.sqrt(max(spread, 0.0))), first + 1, last + 1))
    return tuple(sorted(found, key=lambda e: e.level_m))


def checked_levels(level_m: F64, cut_m3: F64) -> tuple[F64, float, F64]:
    """Levels (m,) m, their step, and cut volumes (m,) m³, as :func:`spikes` needs them."""
    level, cut = np.asarray(level_m, dtype=np.float64), np.asarray(cut_m3, dtype=np.float64)
    if level.ndim != 1 or level.shape != cut.shape or len(level) < 5:
        raise VolumeError(
            "second differences need at least five levels and their volumes",
            reason="volume_levels",
            value=level.shape,
        )
    step = (level[-1] - level[0]) / (len(level) - 1)
    if (
        not step > 0
        or not np.allclose(np.diff(level), step, rtol=1e-6, atol=0.0)
        or not np.isfinite(cut).all()
    ):
        raise VolumeError("levels must ascend by equal steps", reason="volume_levels", value=step)
    return level, step, cut


def reach(smooth: F64, free: Bool, peak: int) -> tuple[int, int]:
    """First and last index of the spike about ``peak``: outwards until it has fallen to its foot,
    or meets another.
    """
    foot, ends = SPIKE_FOOT * smooth[peak], []
    for direction in (-1, 1):
        i = peak
        while (
            0 <= i + direction < len(smooth)
            and free[i + direction]
            and (smooth[i] > foot or i == peak)
        ):
            i += direction
        ends.append(i)
    return ends[0], ends[1]


def floors(
    tin: Tin,
    step_m: float,
    base: Plane | None = None,
    mask: Bool | None = None,
    least_share: float = 0.02,
) -> Floors:
    """Floor and top of a surface: its events at levels ``step_m`` apart over its whole height
    (three steps beyond at both ends).

    Raises :class:`VolumeError` for a bad step, or where nothing is flat enough to make a spike.
    """
    h, _, _ = triangle_heights(tin, base, mask)
    low, high = float(h.min()) - 3.0 * step_m, float(h.max()) + 3.0 * step_m
    if not step_m > 0 or not np.isfinite(step_m) or (high - low) / step_m > MAX_LEVELS:
        raise VolumeError(
            f"the step between levels is {step_m} m", reason="volume_levels", value=step_m
        )
    level = np.floor(low / step_m) * step_m + step_m * np.arange(
        int(np.ceil((high - low) / step_m)) + 2
    )
    cut = cut_sequence(tin, level, base, mask).cut_m3
    events = spikes(level, cut, least_share)
    if not events:
        raise VolumeError(
            "no level stands out: the surface has no flat part", reason="volume_no_floor"
        )
    return Floors(events[0], events[-1], events, level, cut, np.diff(cut), np.diff(cut, 2))


def event_gradient(
    tin: Tin, found: Floors, event: Event, base: Plane | None = None, mask: Bool | None = None
) -> F64:
    """Derivatives (n,) of an event's level by the vertex heights, the span of its spike and the
    background held fixed.
    """
    step = found.level_m[1] - found.level_m[0]
    z = found.level_m[event.first : event.last + 1]
    pull = (z - event.level_m) / event.area_m2 / step
    weights = np.zeros(len(z) + 2)
    for k, w in enumerate((1.0, -2.0, 1.0)):
        weights[k : k + len(z)] += w * pull
    return sequence_gradient(
        tin, found.level_m[event.first - 1 : event.last + 2], weights, base, mask
    )


@dataclass(frozen=True)
class Offset:
    """offset_m : d with ``a(z + d) ≈ b(z)`` in the sense of least squares · sigma_m : its standard
    deviation, from the residuals as if independent · sum_m6 : least sum of squared differences ·
    levels : how many differences
    """

    offset_m: float
    sigma_m: float
    sum_m6: float
    levels: int


def offset_sums(level_m: F64, cut_a: F64, cut_b: F64, offsets_m: F64) -> F64:
    """Sums of squared differences (k,) m⁶ of ``a(z + d) − b(z)`` for offsets d (k,), over the
    levels z that all of them leave inside; between levels a is a cubic spline. The published choice
    tries multiples of the step.
    """
    level, a, b = check_pair(level_m, cut_a, cut_b)
    d = np.asarray(offsets_m, dtype=np.float64)
    inside = (level + d.min() >= level[0]) & (level + d.max() <= level[-1])
    if inside.sum() < 3:
        raise VolumeError(
            "the offsets leave fewer than three levels to compare",
            reason="volume_offset",
            value=offsets_m,
        )
    from scipy.interpolate import CubicSpline  # slow to load, and seldom asked for

    spline = CubicSpline(level, a)
    return np.array([float(((spline(level[inside] + o) - b[inside]) ** 2).sum()) for o in d])


def check_pair(level_m: F64, cut_a: F64, cut_b: F64) -> tuple[F64, F64, F64]:
    """The two sequences by ascending level."""
    level, a, b = (np.asarray(v, dtype=np.float64) for v in (level_m, cut_a, cut_b))
    order = np.argsort(level)
    if (
        level.ndim != 1
        or not level.shape == a.shape == b.shape
        or len(level) < 4
        or not (np.diff(level[order]) > 0).all()
    ):
        raise VolumeError(
            "two sequences over the same, distinct levels are needed",
            reason="volume_levels",
            value=level.shape,
        )
    return level[order], a[order], b[order]


def parabola_minimum(offsets_m: F64, sums: F64) -> float:
    """Lowest point of the parabola through the least of the sums tried and its two neighbours;
    offsets ascend by equal steps.
    """
    d, s = np.asarray(offsets_m, dtype=np.float64), np.asarray(sums, dtype=np.float64)
    k = min(max(int(np.argmin(s)), 1), len(s) - 2)
    left, middle, right = s[k - 1 : k + 2]
    bend = left - 2.0 * middle + right
    return float(d[k] if bend <= 0 else d[k] + 0.5 * (d[k + 1] - d[k]) * (left - right) / bend)


def sequence_offset(level_m: F64, cut_a: F64, cut_b: F64, reach_m: float) -> Offset:
    """Offset within ± ``reach_m`` between two sequences over the same levels, for the least sum of
    squared differences.
    """
    level, a, b = check_pair(level_m, cut_a, cut_b)
    inside = (level - reach_m >= level[0]) & (level + reach_m <= level[-1])
    if not reach_m > 0 or inside.sum() < 3:
        raise VolumeError(
            "the offsets leave fewer than three levels to compare",
            reason="volume_offset",
            value=reach_m,
        )
    from scipy.interpolate import CubicSpline  # slow to load, and seldom asked for

    spline, z, target = CubicSpline(level, a), level[inside], b[inside]
    tried = np.linspace(-reach_m, reach_m, 41)
    start = int(np.argmin([((spline(z + d) - target) ** 2).sum() for d in tried]))
    bounds = (float(tried[max(start - 1, 0)]), float(tried[min(start + 1, 40)]))
    scale = float((target**2).sum()) or 1.0
    best = minimize_scalar(
        lambda d: ((spline(z + d) - target) ** 2).sum() / scale,
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-9},
    )
    d = float(best.x)
    r, slope = spline(z + d) - target, spline(z + d, 1)
    information = float(slope @ slope)
    sigma = float(np.sqrt(r @ r / (len(z) - 1) / information)) if information > 0 else float("inf")
    return Offset(d, sigma, float(r @ r), len(z))


def surface_offset(tin_a: Tin, tin_b: Tin, level_m: F64, steps: int = 30) -> Offset:
    """Offset d between two surfaces such that their cut volumes ``a(z + d) ≈ b(z)`` at the levels z
    (m,): Gauss-Newton on the exact sequences, without interpolation. Levels should lie where both
    show the same (seed 000: between box and instrument).
    """
    z = np.asarray(level_m, dtype=np.float64)
    target, d, change = cut_sequence(tin_b, z).cut_m3, 0.0, np.inf
    for _ in range(steps):
        a = cut_sequence(tin_a, z + d)
        information = float(a.above_m2 @ a.above_m2)
        if information <= 0.0 or len(z) < 2:
            raise VolumeError(
                "the levels lie above the surface: there is nothing to compare",
                reason="volume_offset",
            )
        r = a.cut_m3 - target
        change = float(a.above_m2 @ r) / information
        if abs(change) <= 1e-12 + 1e-10 * abs(d):
            return Offset(
                d, float(np.sqrt(r @ r / (len(z) - 1) / information)), float(r @ r), len(z)
            )
        d += change
    raise VolumeError(
        "the offset between the surfaces did not settle", reason="volume_offset", value=change
    )
