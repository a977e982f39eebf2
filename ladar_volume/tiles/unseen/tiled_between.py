"""What lies between the points of all tiles: :mod:`ladar_volume.clouds.between_points` to what one
process gives, for surfaces of which all triangles count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import ndimage

from ladar_volume.clouds.between_points import (
    AROUND,
    MOST_CELLS,
    SQUARE,
    BetweenPoints,
    from_coarser,
    shifts_for,
    squares_every,
)
from ladar_volume.math.own_axes import axes_of, raster_between, rounded_middle
from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.array_file import ENDING, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged, givers
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_places import joined_hull
from ladar_volume.tiles.tile_store import digest
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.unseen import tile_coarser, tile_spacing
from ladar_volume.tiles.unseen.tile_coarser import Blocks, Seen, Squares, Widths
from ladar_volume.tiles.unseen.tile_spacing import Cells, KeptPoints, NearRaster, Rasters
from ladar_volume.tin.sampled_area import FEWEST, SAMPLED, beside_full_blocks, cell_sizes

R = TypeVar("R")


@dataclass(frozen=True)
class BetweenFinder:
    """fitter : asks the tiles · every : the same tiles, of which all triangles count · outline :
    where the triangles inside are at rest, None for all · rasters : that tell spacings, None for
    too few points · told : what they tell of all points (:func:`told_spacings`) · hidden_m3 : what
    may lie under triangles that bridge what was not sampled
    """

    fitter: GroundFitter
    every: TiledCloud
    outline: Path | None
    rasters: Rasters | None
    told: F64
    hidden_m3: float = 0.0

    def _ask(self, op: Callable[..., R], *more: object) -> list[R]:
        of = self.fitter.of
        return ask(self.fitter.workers, of, op, [more] * len(of.tiles))

    def _points(self, op: Callable[..., R], more: Sequence[tuple[object, ...]]) -> list[R]:
        """What is asked of all points, whichever triangles count."""
        return ask(self.fitter.workers, self.every, op, more)

    def _merged(self, op: Callable[..., R], merge: Callable[[Sequence[R]], R], *more: object) -> R:
        of = self.fitter.of
        return ask_merged(self.fitter.workers, of, op, [more] * len(of.tiles), merge)

    def _each(self, op: Callable[..., R], more: Sequence[tuple[object, ...]]) -> list[R]:
        return ask(self.fitter.workers, self.fitter.of, op, more)

    def found(self) -> BetweenPoints:
        """Steps and curvature between the points; 0 where these are too few to tell."""
        rasters, nothing = self.rasters, BetweenPoints(0.0, 0.0, self.hidden_m3)
        if rasters is None:
            return nothing
        told = self.told
        whole = Squares(rasters.axes, rasters.low, 1.0, 1)
        seen = Seen(self.outline, whole, rasters.folder)
        facts = self._facts(seen)
        if facts[0] < FEWEST:
            return nothing
        area, every = facts[1], squares_every(int(facts[0]))
        side = SQUARE * median_of(told, rasters.count)
        if every >= 2 and math.isfinite(side):
            low, _ = raster_between((rasters.low, rasters.high), side)
            name = digest([low.tolist(), side, every])
            squares = Squares(rasters.axes, low, side, every)
            seen = Seen(self.outline, squares, rasters.folder / f"squares_{name}")
            facts = self._facts(seen)
        widths = self._merged(tile_coarser.seen_widths, tile_coarser.together, seen)
        finest = self._half(widths, lambda one: self._ask(tile_coarser.widths_in, seen, one))
        extents, found = told[np.isfinite(told[:, 0])], []
        extent = np.array([facts[2:4], facts[4:6]])
        near = self._near(rasters, seen, median_of(told, rasters.count))
        for shift in shifts_for(int(facts[0])):
            kept = self._kept(rasters, extents, shift, near, seen)
            coarser = None if kept is None else self._coarser(kept, seen, extent)
            if coarser is None:
                return nothing
            found.append(coarser)
        return from_coarser(found, finest, float(facts[1] / area), self.hidden_m3)

    def _facts(self, seen: Seen) -> F64:
        """Number, area and extent (6,) of the triangles looked at."""
        return self._merged(tile_coarser.seen_facts, tile_coarser.facts_together, seen)

    def _half(self, widths: Widths, fetch: Callable[[int], list[F64]]) -> float:
        """The width, m, that half of the area is below: that of one of those in its bin."""
        share = np.cumsum(widths.area)
        at = min(int(np.searchsorted(share, share[-1] / 2)), len(share) - 1)
        some = np.concatenate(fetch(int(widths.bins[at])))
        some = some[np.argsort(some[:, 0], kind="stable")]
        before = share[at - 1] if at else 0.0
        k = int(np.searchsorted(before + np.cumsum(some[:, 1]), share[-1] / 2))
        return float(some[min(k, len(some) - 1), 0])

    def _near(self, rasters: Rasters, seen: Seen, spacing_m: float) -> NearRaster | None:
        """Where vertices lie that a coarser surface is made of:
        :func:`~ladar_volume.clouds.between_points.near_triangles`; None for everywhere.
        """
        side = AROUND * spacing_m
        if not (math.isfinite(side) and side > 0.0):
            return None
        low, size = raster_between((rasters.low, rasters.high), side)
        if float(size[0]) * float(size[1]) > MOST_CELLS:
            return None
        shape = int(size[0]) + 4, int(size[1]) + 4
        path = self._kept_folder(rasters, seen) / f"near{ENDING}"
        near = NearRaster(rasters.axes, low, side, shape, path)
        marked = np.zeros(shape, np.bool_)
        for cells in self._ask(tile_coarser.seen_cells, seen, near):
            marked.reshape(-1)[cells] = True
        marked = ndimage.binary_dilation(marked, np.ones((3, 3), np.bool_))
        write_arrays(path, {"marked": marked.reshape(-1)})
        return near

    def _kept_folder(self, rasters: Rasters, seen: Seen) -> Path:
        """Where the coarser surfaces about what is looked at are at rest."""
        return rasters.folder / f"kept_{digest([str(self.outline), seen.folder.name])}"

    def _coarser(self, kept: KeptPoints, seen: Seen, extent: F64) -> tuple[F64, float, float]:
        """:func:`~ladar_volume.clouds.between_points.coarser` of the vertices that are kept."""
        wanted = {tile for some in self._ask(tile_coarser.tiles_below, kept, seen) for tile in some}
        self._each(tile_coarser.coarser_here, [(kept, t in wanted) for t in self.fitter.of.tiles])
        shares = self._merged(tile_coarser.compare, tile_coarser.shares_together, kept, seen)
        asked = [(kept, wrote) for wrote in shares.wrote]
        size = self._half(
            shares.widths,
            lambda one: self._each(tile_coarser.covered_in, [(*a, one) for a in asked]),
        )
        beside = givers(self.fitter.of.tiles, shares.beside)
        blocks = Blocks(extent, size)
        more = [(kept, seen, blocks, w, b) for w, b in zip(shares.wrote, beside, strict=True)]
        found = self._each(tile_coarser.by_blocks, more)
        names, at = np.unique(np.concatenate([f[0] for f in found]), return_inverse=True)
        volumes = np.concatenate([f[1] for f in found])
        blocks_m3: F64 = np.bincount(at.reshape(-1), volumes, len(names)).astype(np.float64)
        return blocks_m3, self.fitter.sigma_m**2 * math.fsum(f[2] for f in found), size

    def _kept(
        self,
        rasters: Rasters,
        extents: F64,
        shift: tuple[float, float],
        near: NearRaster | None,
        seen: Seen,
    ) -> KeptPoints | None:
        """The vertices of a coarser surface; None where they are too few."""
        of = self.every
        same: list[tuple[object, ...]] = [(rasters, extents, shift)] * len(of.tiles)
        cells = self._points(tile_spacing.border_cells, same)
        every = Cells(*(np.concatenate([c[k] for c in cells]) for k in range(3)))
        loses = ~tile_spacing.winners(every)
        first = np.cumsum([len(c.row) for c in cells])[:-1]
        lost = [
            rows[loses]
            for rows, loses in zip(np.split(every.row, first), np.split(loses, first), strict=True)
        ]
        folder = self._kept_folder(rasters, seen) / f"shift_{shift[0]:g}_{shift[1]:g}"
        more = [(rasters, shift, rows, near, folder) for rows in lost]
        found = self._points(tile_spacing.keep, more)
        if sum(n for n, _, _ in found) < FEWEST // 4:
            return None
        boxes = {t: f[1] for t, f in zip(of.tiles, found, strict=True) if f[1] is not None}
        return KeptPoints(of.index.cloud, boxes, joined_hull([f[2] for f in found]), folder)


def filled_rasters(fitter: GroundFitter, outline: Path | None) -> Rasters | None:
    """The rasters of all vertices, filled; None where these are too few."""
    of, workers = fitter.of, fitter.workers
    same: list[tuple[object, ...]] = [(None,)] * len(of.tiles)
    facts = np.stack(ask(workers, of, tile_spacing.extent, same))
    n = int(facts[:, 0].sum())
    if n < FEWEST:
        return None
    low, high = facts[:, 3:5].min(axis=0), facts[:, 5:].max(axis=0)
    middle = rounded_middle(facts[:, 1:3].sum(axis=0) / n, (low, high))
    moments = ask_merged(workers, of, tile_spacing.moments, [(middle,)] * len(of.tiles))
    axes = axes_of(middle, moments)
    facts = np.stack(ask(workers, of, tile_spacing.extent, [(axes,)] * len(of.tiles)))
    low, high = facts[:, 3:5].min(axis=0), facts[:, 5:].max(axis=0)
    every = VertexSelection((0.0, 0.0), (0.0,), math.inf)
    some = fitter.at_ranks(every, n, max(1, n // SAMPLED))[:, 1:3]
    sizes = tuple(cell_sizes(axes.along(some), n, (low, high)))
    name = digest([axes.middle.tolist(), axes.angle, sizes, str(outline)])
    folder = surface_folder(of.index, of.limits) / f"between_{name}"
    rasters = Rasters(axes, low, high, sizes, folder, n)
    fill(rasters, ask(workers, of, tile_spacing.filled_cells, [(rasters,)] * len(of.tiles)))
    return rasters


def fill(rasters: Rasters, cells: Sequence[Sequence[I64]]) -> None:
    """Write which cells are filled, from those of each tile by raster."""
    for k in range(len(rasters.sizes)):
        raster = np.zeros(rasters.shape(k), np.bool_)
        for some in cells:
            raster.reshape(-1)[some[k]] = True
        write_arrays(rasters.filled(k), {"filled": beside_full_blocks(raster).reshape(-1)})


def told_spacings(workers: Workers, every: TiledCloud, rasters: Rasters | None) -> F64:
    """The spacings at all points, at rest, and what :func:`merged` makes of them; none without
    rasters.
    """
    if rasters is None:
        return np.zeros((0, 6))
    return merged(ask(workers, every, tile_spacing.tell_spacings, [(rasters,)] * len(every.tiles)))


def merged(told: Sequence[F64]) -> F64:
    """What all tiles tell of spacings, as :func:`tile_spacing.tell_spacings` does of one."""
    rows = np.concatenate(told)
    out = []
    for value in np.unique(rows[:, 0]).tolist():
        some = rows[rows[:, 0] == value]
        low, high = some[:, 2:4].min(axis=0), some[:, 4:].max(axis=0)
        out.append([value, some[:, 1].sum(), *low, *high])
    return np.array(out)


def median_of(told: F64, count: int) -> float:
    """The median of so many spacings, m."""
    below = np.cumsum(told[:, 1])
    two = [
        told[int(np.searchsorted(below, k, side="right")), 0]
        for k in ((count - 1) // 2, count // 2)
    ]
    return float(np.mean(two))
