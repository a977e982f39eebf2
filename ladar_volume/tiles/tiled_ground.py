"""The robust ground of all tiles: :mod:`ladar_volume.ground.robust_ground` from sums and order
statistics that add up, to what one process gives.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.ground.polynomial import degree_of, root_of_products
from ladar_volume.ground.robust_ground import (
    CONTRAST,
    MAD_TO_SIGMA,
    MAX_REFITS,
    SEARCHED_POINTS,
    THRESHOLD_SIGMAS,
    check_points,
    check_spread,
    check_tilt,
    fit_ground,
    search_surface,
)
from ladar_volume.model.errors import GroundError
from ladar_volume.model.parameters import GroundParameters
from ladar_volume.model.records import F64, I64, Plane
from ladar_volume.tiles import tile_fit
from ladar_volume.tiles.tile_batches import TiledCloud, ask, ask_merged
from ladar_volume.tiles.tile_fit import VertexSelection
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ranks import bins_together, median_of_bins, rows_at_ranks


@dataclass(frozen=True)
class TiledFit:
    """plane : the ground, its ``support`` empty · chosen : what it was fitted to · count : of these
    · inverse : (p, p) of their normal matrix
    """

    plane: Plane
    chosen: VertexSelection
    count: int
    inverse: F64


@dataclass(frozen=True)
class GroundFitter:
    """Fits grounds to the vertices of tiles. sigma_m : standard deviation of the heights"""

    of: TiledCloud
    workers: Workers
    sigma_m: float

    def start(self, p: GroundParameters, coarse_m: float) -> TiledFit:
        """:func:`fit_ground` on all vertices that count."""
        counts = [n for n, _ in ask(self.workers, self.of, tile_fit.extent, self._same(None))]
        n = sum(counts)
        every = VertexSelection((0.0, 0.0), (0.0,), math.inf)
        step = max(1, n // SEARCHED_POINTS)
        found = self.at_ranks(every, n, step)
        points, variance = found[:, 1:4], self.sigma_m**2 / found[:, 4]
        if step == 1:
            plane = fit_ground(points, variance, p, coarse_m)
            rows = found[plane.support, 0].astype(np.int64)
            plane = dataclasses.replace(plane, support=np.zeros(0, np.int64))
            return self._fitted(plane, dataclasses.replace(vertices_within(plane, 0.0), rows=rows))
        check_points(points, variance, p.degree)
        plane = search_surface(points, variance, p, coarse_m)
        fit = self.refine(plane, THRESHOLD_SIGMAS * plane.rms_m, None, p)
        self._check_surface(fit, p)
        return fit

    def _same(self, *more: object) -> list[tuple[object, ...]]:
        """The same question to every tile."""
        return [more] * len(self.of.index.count)

    def _products(self, chosen: VertexSelection) -> tuple[int, F64, F64, bytes]:
        """Sums over all tiles, and a digest of which vertices are chosen."""
        found = ask(self.workers, self.of, tile_fit.products, self._same(chosen))
        name = hashlib.sha256(b"".join(f[3] for f in found)).digest()
        square = np.sum([f[1] for f in found], axis=0)
        return sum(f[0] for f in found), square, np.sum([f[2] for f in found], axis=0), name

    def _fitted(self, plane: Plane, chosen: VertexSelection) -> TiledFit:
        """A plane with what it was fitted to."""
        count, square, _, _ = self._products(chosen)
        return TiledFit(plane, chosen, count, inverse_of(count, square, degree_of(plane)))

    def refine(
        self, start: Plane, reach_m: float, ring: Path | None, p: GroundParameters
    ) -> TiledFit:
        """:func:`~ladar_volume.ground.robust_ground.refine` on the vertices that count, or on a
        ring of them.
        """
        start = dataclasses.replace(start, support=np.zeros(0, np.int64))
        high = max(h for _, h in ask(self.workers, self.of, tile_fit.extent, self._same(ring)))
        floor = 1e-9 * (1.0 + high)
        chosen = vertices_within(start, p.threshold_m or reach_m, ring)
        found, seen = self._products(chosen), set[bytes]()
        for left in range(MAX_REFITS, -1, -1):
            count, square, right, name = found
            N = inverse_of(count, square, p.degree)
            beta = N @ right
            squares, robust = self._spread(chosen, beta)
            plane = dataclasses.replace(start, beta=beta, rms_m=math.sqrt(squares[0] / count))
            lower = math.sqrt(squares[2] / squares[1]) if squares[1] else 0.0
            limit = p.threshold_m or max(THRESHOLD_SIGMAS * max(robust, lower), floor)
            new = vertices_within(plane, limit, ring)
            found = self._products(new)
            if left == 0 or found[3] == name or found[3] in seen:
                break
            seen.add(found[3])
            chosen = new
        check_tilt(plane, p)
        return TiledFit(plane, chosen, count, N)

    def _spread(self, chosen: VertexSelection, beta: F64) -> tuple[F64, float]:
        """Sums as of :func:`tile_fit.spread`, and the robust sigma of the residuals, m."""
        asked = self._same(chosen, beta)
        found = ask_merged(self.workers, self.of, tile_fit.spread, asked, spreads_together)

        def sizes(low: int, high: int) -> list[F64]:
            return ask(
                self.workers, self.of, tile_fit.sizes_in, self._same(chosen, beta, low, high)
            )

        return found[0], MAD_TO_SIGMA * median_of_bins(found[1:], sizes)

    def at_ranks(self, chosen: VertexSelection, n: int, step: int) -> F64:
        """Row, x, y, z, points (k, 5) of every ``step``-th of n chosen vertices in the order of the
        file.
        """
        rows = None
        if step > 1:
            rows = rows_at_ranks(self.workers, self.of, chosen, np.arange(0, n, step))
        asked = self._same(chosen, rows)
        out = np.concatenate(ask(self.workers, self.of, tile_fit.vertices_at, asked))
        return out[np.argsort(out[:, 0])]

    def _check_surface(self, fit: TiledFit, p: GroundParameters) -> None:
        """:func:`~ladar_volume.ground.robust_ground.check_surface`."""
        grown = fit
        if p.threshold_m > 0.0:
            chosen = vertices_within(fit.plane, p.threshold_m)
            asked = self._same(chosen, p.threshold_m)
            own, above, below = ask_merged(self.workers, self.of, tile_fit.layers, asked)
            if own >= CONTRAST * max(above, below):
                return
            try:
                free = dataclasses.replace(p, threshold_m=0.0)
                grown = self.refine(fit.plane, p.threshold_m, None, free)
            except GroundError:
                return  # it grows into what is too steep to be ground
        about = np.array([*grown.plane.origin_xy, grown.plane.beta[0]])
        asked = self._same(grown.chosen, about)
        sums = ask_merged(self.workers, self.of, tile_fit.moments, asked)
        mean = sums[0, 1:] / sums[0, 0]
        check_spread(sums[1:, 1:] / sums[0, 0] - np.outer(mean, mean), grown.plane.rms_m)


def spreads_together(found: Sequence[tuple[F64, I64, I64]]) -> tuple[F64, I64, I64]:
    """What :func:`tile_fit.spread` tells of several tiles."""
    return np.sum([f[0] for f in found], axis=0), *bins_together([f[1:] for f in found])


def vertices_within(plane: Plane, limit_m: float, ring: Path | None = None) -> VertexSelection:
    """The vertices within so much of a surface."""
    x, y = plane.origin_xy.tolist()
    return VertexSelection((x, y), tuple(plane.beta.tolist()), limit_m, ring)


def inverse_of(count: int, square: F64, degree: int) -> F64:
    """``(XᵀX)⁻¹`` (p, p). Raises :class:`GroundError` where it has too few digits: one process goes
    back to the rows.
    """
    S = root_of_products(count, square, degree)
    if S is None:
        words = (
            f"the points hardly define a ground of degree {degree}: give ground on all sides, or "
            "a lower ground.degree, or leave --tile and --dask out"
        )
        raise GroundError(words, reason="ground_degenerate")
    return np.asarray(S @ S.T)
