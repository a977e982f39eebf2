"""Whether two clouds are in one system: where nothing changed they are alike; and a difference that
is the same everywhere, or a plane, may be their registration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.volume_verdict import with_lines
from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import footprint_areas

#: Cells in which differences are averaged, about so many; fewest; least part of a cell that counts.
CELLS, FEWEST, FULL = 400, 40, 0.3
#: Share of the cells in the shortest interval, which is where nothing changed, and that interval's
#: length in standard deviations of normal differences.
MODE, LENGTH = 0.25, 0.6373
#: A cell changed beyond so many standard deviations of those that did not.
CHANGED = 5.0
#: Least shares of the area that did not change, and that did, for the two to be told apart.
SAME, OTHER = 0.15, 0.02
#: Neighbouring cells that count as one: ground and registration vary slowly.
ALIKE = 4.0
#: An offset is beyond chance above so many of its standard deviations, and matters above so many of
#: the volume's.
CHANCE, MATTERS = 3.0, 2.0
#: A layer thinner than this share of the width of what both saw may be an offset, and a slope
#: flatter than the second may be a tilt, of the registration.
THIN, FLAT = 0.01, 0.02
#: A layer on a part: this share of the cells at least, whose means lie within this share of its
#: thickness; strips of a flight are seldom further off, m.
PART, EVEN, STRIP_M = 0.1, 0.15, 0.2
#: How many of a unit a metre has; sizes of one place that differ by such a factor to within this.
UNITS = {"feet": 1.0 / 0.3048, "inches": 1.0 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
ALIKE_SIZES = 0.05
#: A plane explains the difference where this share of the area lies on it, and where it leaves less
#: than the second share of the scatter.
MOST_OF_IT, LEFT = 0.6, 0.5


@dataclass(frozen=True)
class UnchangedPart:
    """Where two surfaces are alike. offset_m ± sigma_m : upper minus lower there · scatter_m : of
    the cells' means · share, changed : of the common footprint that is alike, and that is not ·
    named : whether the place was named
    """

    offset_m: float
    sigma_m: float
    scatter_m: float
    share: float
    changed: float
    named: bool = False

    @property
    def is_distinguishable(self) -> bool:
        """Whether enough did not change, and enough did, to tell the two apart."""
        return self.named or (self.share >= SAME and self.changed >= OTHER)


def unit_doubts(one: F64, two: F64) -> list[Doubt]:
    """One of two clouds (n, 3), (m, 3) m is larger than the other, in width and in length, by the
    ratio of two units of length, such as feet and metres.
    """
    wide = np.ptp(one[:, :2], axis=0) / np.maximum(np.ptp(two[:, :2], axis=0), 1e-300)
    for unit, times in UNITS.items():
        for first, ratio in (("first", wide), ("second", 1.0 / np.maximum(wide, 1e-300))):
            if (np.abs(ratio / times - 1.0) < ALIKE_SIZES).all():
                words = (
                    f"the {first} cloud is {times:.4g} times as wide and as long as the other: are "
                    f"its coordinates {unit}? write both in one unit, or name the CRS in each file"
                )
                return [Doubt("units", words, times)]
    return []


class CellMeans(NamedTuple):
    """A surface by square cells of a side, m, from low (2,) on. mean, area : (k,) m and m², of
    cells that are full enough · cell : (k, 2) their numbers
    """

    mean: F64
    area: F64
    cell: I64
    low: F64
    side: float


def cell_means(tin: Tin, cells: int = CELLS) -> CellMeans:
    """Mean heights of a surface by cells, about so many."""
    area = footprint_areas(tin.vertices, tin.triangles)
    corners = tin.vertices[tin.triangles]
    middle, height = corners[:, :, :2].mean(axis=1), corners[:, :, 2].mean(axis=1)
    side = math.sqrt(float(area.sum()) / cells)
    low = middle.min(axis=0)
    cell = np.floor((middle - low) / side).astype(np.int64)
    first, at = distinct_cells(cell)
    own: F64 = np.bincount(at, area).astype(np.float64)
    mean = np.bincount(at, area * height) / np.maximum(own, 1e-300)
    full = own > FULL * side * side
    return CellMeans(mean[full], own[full], cell[first[full]], low, side)


def unchanged_cells(cells: CellMeans) -> UnchangedPart | None:
    """The part of cells that did not change: about the shortest interval that holds a quarter of
    them. None for too few.
    """
    mean, area = cells.mean, cells.area
    if len(mean) < FEWEST:
        return None
    order = np.sort(mean)
    count = max(2, math.ceil(MODE * len(order)))
    spans = order[count - 1 :] - order[: len(order) - count + 1]
    first = int(np.argmin(spans))
    middle = float(np.median(order[first : first + count]))
    scatter = max(float(spans[first]) / LENGTH, 1e-9)
    for _ in range(10):
        inside = np.abs(mean - middle) <= CHANCE * scatter
        middle = float(np.median(mean[inside]))
        spread = 1.4826 * float(np.median(np.abs(mean[inside] - middle)))
        if abs(spread - scatter) <= 1e-3 * scatter:
            break
        scatter = max(spread, 1e-9)
    total = float(area.sum())
    alike = np.abs(mean - middle) <= CHANCE * scatter
    other = np.abs(mean - middle) > CHANGED * scatter
    sigma = scatter / math.sqrt(max(np.count_nonzero(alike) / ALIKE, 1.0))
    return UnchangedPart(
        middle, sigma, scatter, float(area[alike].sum()) / total, float(area[other].sum()) / total
    )


def with_offset(volume: CloudVolume, found: UnchangedPart) -> tuple[CloudVolume, list[Doubt]]:
    """The volume with the offset of two clouds where nothing changed in sigma."""
    effect = found.offset_m * volume.area_m2
    beyond = abs(found.offset_m) > CHANCE * found.sigma_m
    if not (found.is_distinguishable and beyond and abs(effect) > MATTERS * volume.sigma_m3):
        return volume, []
    words = (
        f"over {100 * found.share:.0f} % of the common footprint the two clouds are alike but for "
        f"{1e3 * found.offset_m:.3g} ± {1e3 * found.sigma_m:.2g} mm of height: if nothing changed "
        f"there, {effect:.4g} m³ of the net volume are no change; register them again, or move "
        "one by it"
    )
    volume = with_lines(volume, {"registration": effect**2 + (found.sigma_m * volume.area_m2) ** 2})
    return volume, [Doubt("offset", words, found.offset_m)]


def uniform_doubts(volume: CloudVolume, found: UnchangedPart) -> list[Doubt]:
    """All that both saw is apart by one thin layer: nothing tells it from an offset."""
    effect, thick = found.offset_m * volume.area_m2, abs(found.offset_m)
    if (
        found.named
        or found.changed >= OTHER
        or not CHANCE * found.sigma_m < thick <= THIN * math.sqrt(volume.area_m2)
        or abs(effect) <= MATTERS * volume.sigma_m3
    ):
        return []
    words = (
        f"all that both clouds saw is {1e3 * found.offset_m:.3g} ± {1e3 * found.sigma_m:.2g} mm "
        f"apart: {effect:.4g} m³ are a layer as thick everywhere, or an error of the registration; "
        "survey ground around it that did not change, or register the clouds again"
    )
    return [Doubt("offset", words, found.offset_m)]


def level_doubts(volume: CloudVolume, cells: CellMeans, found: UnchangedPart) -> list[Doubt]:
    """A part of what both saw is apart by one thin layer, nearly as even as what did not change.
    A strip of a flight whose heights are off looks like this.
    """
    away = np.abs(cells.mean - found.offset_m)
    far = np.flatnonzero(away > CHANGED * found.scatter_m)
    count = math.ceil(PART * len(cells.mean))
    if found.named or not found.is_distinguishable or len(far) < count:
        return []
    order = far[np.argsort(cells.mean[far])]
    mean = cells.mean[order]
    spans = mean[count - 1 :] - mean[: len(mean) - count + 1]
    first = int(np.argmin(spans))
    level = float(np.median(mean[first : first + count]))
    even = max(CHANCE * found.scatter_m, EVEN * abs(level - found.offset_m))
    own = order[np.abs(mean - level) <= even]
    area, thick = float(cells.area[own].sum()), level - found.offset_m
    effect = thick * area
    if (
        float(spans[first]) > even
        or abs(thick) > min(THIN * math.sqrt(area), STRIP_M)
        or abs(effect) <= MATTERS * volume.sigma_m3
    ):
        return []
    x, y = (cells.low + cells.side * (np.median(cells.cell[own], axis=0) + 0.5)).tolist()
    words = (
        f"over {area:.3g} m² about ({x:.1f}, {y:.1f}) m the first cloud lies evenly "
        f"{1e3 * abs(thick):.3g} mm {'higher' if thick > 0.0 else 'lower'} than where nothing "
        f"changed: {effect:.4g} m³ are a layer that was laid or taken there, or a strip of one "
        "flight whose heights are off; look at that place, or adjust the strips"
    )
    return [Doubt("offset", words, thick)]


class FittedPlane(NamedTuple):
    """Through the means of cells. slope : (2,) · sigma : of either slope · scatter_m : of the means
    about it · on_it : (k,) cells that lie on it
    """

    slope: F64
    sigma: float
    scatter_m: float
    on_it: Bool


def plane_through(cells: CellMeans) -> FittedPlane | None:
    """The plane that most cells lie on: of least sizes, by reweighting, then of least squares over
    those that lie on it; None for too few.
    """
    mean, place = cells.mean, cells.side * (cells.cell - cells.cell.mean(axis=0))
    if len(mean) < FEWEST:
        return None
    X = np.column_stack([np.ones(len(mean)), place])
    weight, on_it, scatter = np.ones(len(mean)), np.ones(len(mean), np.bool_), 0.0
    beta = np.zeros(3)
    for step in range(30):
        beta = np.linalg.lstsq(weight[:, None] * X, weight * mean, rcond=None)[0]
        left = np.abs(mean - X @ beta)
        scatter = max(1.4826 * float(np.median(left)), 1e-9)
        on_it = left <= CHANCE * scatter
        weight = on_it.astype(np.float64) if step >= 20 else np.maximum(left, 0.3 * scatter) ** -0.5
    spread = float(np.min(np.ptp(place[on_it], axis=0))) / math.sqrt(12.0)
    sigma = scatter / max(spread, 1e-300) / math.sqrt(np.count_nonzero(on_it) / ALIKE)
    return FittedPlane(beta[1:], sigma, scatter, on_it)


def tilt_doubts(volume: CloudVolume, cells: CellMeans, found: UnchangedPart) -> list[Doubt]:
    """The difference of most that both saw is a plane that rises a little: cut on one side, fill on
    the other.
    """
    fit = None if found.named else plane_through(cells)
    if fit is None:
        return []
    slope, own = float(np.hypot(*fit.slope)), cells.area[fit.on_it]
    tilt = cells.side * (cells.cell[fit.on_it] @ fit.slope)
    tilt = tilt - np.average(tilt, weights=own)
    effect = 0.5 * float(own @ np.abs(tilt))
    level = math.sqrt(float(np.average(tilt**2, weights=own)))
    if (
        not CHANCE * fit.sigma < slope <= FLAT
        or own.sum() < MOST_OF_IT * cells.area.sum()
        or fit.scatter_m > LEFT * math.hypot(level, fit.scatter_m)
        or effect <= MATTERS * max(volume.sigma_cut_m3, volume.sigma_fill_m3)
    ):
        return []
    share = 100.0 * own.sum() / cells.area.sum()
    words = (
        f"over {share:.0f} % of the common footprint the difference of "
        f"the two clouds is a plane that rises by {1e3 * slope:.3g} ± {1e3 * fit.sigma:.2g} mm a "
        f"metre: {effect:.4g} m³ of cut and as much fill are a tilt of the registration, where "
        "nobody graded the place; register the clouds again"
    )
    return [Doubt("tilt", words, slope)]


def registration_doubts(volume: CloudVolume, cells: CellMeans, found: UnchangedPart) -> list[Doubt]:
    """What of all that both saw may be their registration: the whole, a part, or a tilt."""
    return [
        *uniform_doubts(volume, found),
        *level_doubts(volume, cells, found),
        *tilt_doubts(volume, cells, found),
    ]
