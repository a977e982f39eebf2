"""Other readings of the ground of all tiles: :mod:`ladar_volume.clouds.ground_readings` and
:mod:`ladar_volume.volume.field_checks.base_readings` to what one process gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ladar_volume.clouds.ground_readings import (
    FEWEST_POINTS,
    TOE_PART,
    TOE_SPACINGS,
    GroundReadings,
    uneven_stretches,
)
from ladar_volume.ground.polynomial import COEFFICIENTS, base_height, degree_of, design_surface
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.tiles import tile_volume
from ladar_volume.tiles.readings import tile_outside, tile_support
from ladar_volume.tiles.readings.tile_outside import Region
from ladar_volume.tiles.readings.tile_support import Higher, TerraceSearch
from ladar_volume.tiles.tile_batches import TiledCloud, added, ask, ask_merged
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_outline import Box
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tile_volume import Squares
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import OutlineFinder, TiledOutline
from ladar_volume.tiles.tiled_ranks import median_of_tiles
from ladar_volume.uncertainty.ground_field import (
    Roughness,
    field_squares,
    occupied_side,
    spacing_of,
    variance_on_squares,
)
from ladar_volume.uncertainty.roughness import estimate_roughness
from ladar_volume.volume.field_checks.base_readings import (
    FEWEST,
    FIELD,
    MOST,
    TERRACE,
    TOE,
    TOE_LINE,
    BaseReadings,
    Reading,
    Through,
    freedom_of,
)
from ladar_volume.volume.field_checks.terrace import (
    ABOVE,
    HALF,
    LEAST_M,
    SPARSE,
    WIDE_M,
    height_among,
    height_bins,
)

R = TypeVar("R")


@dataclass(frozen=True)
class Around:
    """What is asked of the tiles around an outline. fitter : asks them · finder : knows their reach
    · found : ground and outline
    """

    fitter: GroundFitter
    finder: OutlineFinder
    found: TiledOutline

    @property
    def region(self) -> Region:
        """The ground, what it was fitted to, and the outline."""
        plane, outline = self.found.fit.plane, self.found.folder
        rest = outline
        if rest is None:
            name = digest([plane.beta.tolist(), plane.origin_xy.tolist()])
            rest = surface_folder(self.fitter.of.index, self.fitter.of.limits) / f"ground_{name}"
        return Region(plane, self.found.fit.chosen, outline, rest)

    def each(self, op: Callable[..., R], *more: object) -> list[R]:
        """What each tile answers to the same question."""
        of = self.fitter.of
        return ask(self.fitter.workers, of, op, [more] * len(of.tiles))

    def sums(self, op: Callable[..., Any], *more: object) -> Any:
        """The same, added up."""
        of = self.fitter.of
        return ask_merged(self.fitter.workers, of, op, [more] * len(of.tiles), added)

    def median(self, values: Callable[..., F64], *more: object) -> float:
        """The median of what all tiles have; 0 for nothing."""
        return median_of_tiles(self.fitter.workers, self.fitter.of, values, *more)

    def some(self, name: str, count: int, most: int) -> F64:
        """Places (k, 3) m of about so many of ``count`` vertices marked at rest under a name."""
        return self.every(name, count, max(1, math.ceil(count / most)))

    def every(self, name: str, count: int, step: int) -> F64:
        """Those of every ``step``-th, in the order of the file."""
        chosen = VertexSelection((0.0, 0.0), (0.0,), math.inf, self.region.rest / name)
        return self.fitter.at_ranks(chosen, count, step)[:, 1:4] if count else np.zeros((0, 3))


class TiledBase(NamedTuple):
    """around : who asks about ground and outline, None above a given base · plane : the base ·
    folder : where the triangles inside the outline are at rest, None for all
    """

    around: Around | None
    plane: Plane
    folder: Path | None


def base_of(fitter: GroundFitter, reach: Sequence[Box], parameters: Parameters) -> TiledBase:
    """The base of a volume, and its outline; ``reach`` of each tile."""
    v = parameters.volume
    if v.base != "ground":
        given = [v.level_m] if v.base == "level" else list(v.plane)
        return TiledBase(None, design_surface(given), None)
    if math.isnan(fitter.sigma_m):
        words = "the points are too few to estimate their noise: give --sigma"
        raise SurfaceError(words, reason="surface_too_few_points")
    finder = OutlineFinder(fitter, parameters, reach)
    found = finder.found()
    return TiledBase(Around(fitter, finder, found), found.fit.plane, found.folder)


def ground_readings(around: Around, area_m2: float, rise_m: float) -> GroundReadings | None:
    """The readings of a ground; area_m2 : inside the outline · rise_m : of a body, at least."""
    region = around.region
    facts = np.stack(around.each(tile_outside.ring_facts, region))
    ring, support = (int(n) for n in facts[:, :2].sum(axis=0))
    if not ring:
        return None
    low, high = facts[:, 2:4].min(axis=0), facts[:, 4:].max(axis=0)
    side = occupied_side(low, high)
    squares = around.sums(tile_outside.ring_squares, region.outline, low, side)
    spacing = spacing_of(int(np.count_nonzero(squares)), side, ring)
    uneven = unevenness(around, 0.5 * math.sqrt(area_m2), rise_m)
    reach = max(TOE_SPACINGS * spacing, TOE_PART * math.sqrt(area_m2))
    others = base_readings(around, reach)
    return GroundReadings(ring, support / ring, uneven, uneven * area_m2, others)


def unevenness(around: Around, length_m: float, reach_m: float) -> float:
    """:func:`ladar_volume.clouds.ground_readings.unevenness` around the outline."""
    asked = (around.region, reach_m)
    extent = np.stack(around.each(tile_outside.near_extent, *asked))
    if extent[:, 0].sum() < FEWEST_POINTS or not length_m > 0.0:
        return math.nan
    low = extent[:, 1:].min(axis=0)
    found = around.each(tile_outside.stretches, *asked, low, length_m)
    _, at = np.unique(np.concatenate([names for names, _ in found]), return_inverse=True)
    sums = np.concatenate([sums for _, sums in found])
    count, off = (np.bincount(at.reshape(-1), sums[:, k]) for k in range(2))
    variance: F64 = (around.fitter.sigma_m**2 * count).astype(np.float64)
    return uneven_stretches(count.astype(np.int64), off.astype(np.float64), variance)


def base_readings(around: Around, radius_m: float) -> BaseReadings | None:
    """:func:`ladar_volume.volume.field_checks.base_readings.base_readings` of all tiles."""
    base, chosen, outline = around.found.fit.plane, around.found.fit.chosen, around.found.folder
    n, degree = around.found.fit.count, degree_of(base)
    if n < FEWEST:
        return None
    facts = np.stack(around.each(tile_support.extent, chosen))
    low, high = facts[:, 3:5].min(axis=0), facts[:, 5:].max(axis=0)
    origin, scale = facts[:, 1:3].sum(axis=0) / n, max(float((high - low).max()), 1e-9)
    to = Higher(base, chosen, origin, scale, min(degree + 1, 2))
    both = around.sums(tile_support.products, to)
    square, right = both[:, :-1], both[:, -1]
    beta = np.linalg.lstsq(square, right, rcond=1e-12)[0]
    rough = field_of(around, to, beta, (low, high))
    moments = around.sums(tile_outside.moments_inside, outline, origin, scale, to.degree)
    readings = []
    if to.degree > degree:
        by_term = np.linalg.lstsq(square, moments, rcond=1e-12)[0]
        chance = chance_of(around, to, by_term, (low, high), rough)
        readings.append(Reading(f"a ground of degree {to.degree}", -float(by_term @ right), chance))
    through = Through(base, moments[: COEFFICIENTS[min(degree, 1)]], origin, scale, rough)
    spread = 1.4826 * around.median(tile_support.left_of, to, beta)
    for name, r in (
        (TOE_LINE, toe_points(around, radius_m)),
        (TERRACE, terrace_points(around, spread, radius_m)),
    ):
        readings += through.reading(name, r, np.full(len(r), around.fitter.sigma_m**2))
    return BaseReadings(tuple(readings), freedom_of(rough, n))


def field_of(around: Around, to: Higher, beta: F64, box: tuple[F64, F64]) -> Roughness:
    """The field of what a higher polynomial leaves of the residuals."""
    n, side = around.found.fit.count, occupied_side(*box)
    r = around.fitter.at_ranks(to.chosen, n, max(1, math.ceil(n / FIELD)))[:, 1:4]
    left = r[:, 2] - base_height(to.base, r[:, :2]) - to.design(r[:, :2]) @ beta
    noise = np.full(len(r), around.fitter.sigma_m**2)
    rough = estimate_roughness(np.ascontiguousarray(r[:, :2]), left, noise, len(beta))
    squares = around.sums(tile_volume.points_per_square, to.chosen, box[0], side)
    spacing = spacing_of(int(np.count_nonzero(squares)), side, n)
    return Roughness(rough.variance_m2, rough.length_m, spacing, rough.gaussian)


def chance_of(
    around: Around, to: Higher, by_term: F64, box: tuple[F64, F64], rough: Roughness
) -> float:
    """Standard deviation, m³, of a weighted sum of the residuals by chance."""
    side, shape = field_squares(rough, *box)
    found = around.sums(tile_support.weights_on, to, by_term, Squares(box[0], side, shape))
    own = float(found[-1])
    field = 0.0
    if rough.variance_m2 != 0.0:
        field = variance_on_squares(rough, found[:-1].reshape(shape), side, own)
    return math.sqrt(field + own * around.fitter.sigma_m**2)


def toe_points(around: Around, radius_m: float) -> F64:
    """Points (k, 3) m in a band along the toe; none where everything counts."""
    outline = around.found.folder
    if outline is None:
        return np.zeros((0, 3))
    boxes = around.each(tile_outside.border_vertices, outline)
    beside = around.finder.beside(boxes, TOE[1] * radius_m)
    of, workers = around.fitter.of, around.fitter.workers
    more = [(outline, some, radius_m) for some in beside]
    return around.some("toe", sum(ask(workers, of, tile_outside.toe_vertices, more)), MOST)


def terrace_points(around: Around, spread_m: float, radius_m: float) -> F64:
    """Points (k, 3) m of a terrace within the outline; none where there is none."""
    outline, rest = around.found.folder, around.region.rest
    usual = around.median(tile_support.sides_of, outline)
    base = around.found.fit.plane
    search = TerraceSearch(outline, base, max(radius_m, SPARSE * usual))
    wide = WIDE_M * float(around.sums(border_length, outline))
    for half in (times * max(spread_m, LEAST_M) for times in HALF):
        heights, low, high, bins = height_bins(half)
        by_bin = around.sums(tile_support.area_by_height, search, low, high, bins)
        at = height_among(heights, by_bin)
        area, more, total = around.sums(tile_support.about_height, search, at, half).tolist()
        if at > 0.0 and area >= wide and more >= ABOVE * total:
            asked = (rest, search, at, half)
            return around.some(
                "terrace", sum(around.each(tile_support.terrace_vertices, *asked)), MOST
            )
    return np.zeros((0, 3))


def border_length(of: TiledCloud, tile: Tile, outline: Path | None) -> float:
    """Length, m, of the tile's sides of the outline."""
    return float(tile_outside.border_sides(of, tile, outline)[1][:2].sum())
