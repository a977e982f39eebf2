"""What stands on a thinned surface of all tiles: parts that lie above nearly all of the steep steps
around them, as :func:`~ladar_volume.volume.field_checks.standing_objects.standing_vertices` tells
them of one surface. Parts are joined over tiles; the steps between them add up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from ladar_volume.clouds.sampling.object_search import ObjectSearch
from ladar_volume.model.records import I64, Bool
from ladar_volume.tiles.readings.tiled_readings import base_of
from ladar_volume.tiles.standing import tile_parts
from ladar_volume.tiles.standing.tile_parts import TileSteps
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_store import digest
from ladar_volume.tiles.tile_surface import EVERY, surface_folder
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import bodies_in_order, part_labels
from ladar_volume.tiles.tiled_points import Triangulated
from ladar_volume.volume.field_checks.standing_objects import (
    MOST,
    Steps,
    between_parts,
    more_on_ground,
    standing_parts,
)

#: Most points, or parts, that one process looks at: some 1.3 GB.
MOST_POINTS = 3_000_000
R = TypeVar("R")


class TooManyPointsError(Exception):
    """What one process would look at is more than it may hold."""


def check(count: int) -> None:
    """Raise :class:`TooManyPointsError`."""
    if count > MOST_POINTS:
        raise TooManyPointsError


class Standing(NamedTuple):
    """of : the tiles of the thinned surface · folder : where its parts are at rest · outline :
    where the triangles inside are, None for all · stands : of each tile, which of its parts
    (count,) stand
    """

    of: TiledCloud
    folder: Path
    outline: Path | None
    stands: list[Bool]


@dataclass(frozen=True)
class PartsFinder:
    """Finds what stands on a thinned surface."""

    made: Triangulated
    how: ObjectSearch
    workers: Workers

    @property
    def of(self) -> TiledCloud:
        """The tiles; all their triangles count."""
        return TiledCloud(self.made.of.index, EVERY)

    def _ask(self, op: Callable[..., R], more: Sequence[tuple[object, ...]]) -> list[R]:
        return ask(self.workers, self.of, op, more)

    def found(self) -> Standing | None:
        """What stands on it; None for nothing: also where the main body itself stands on steep
        faces, where more steps lie within the ground's own part than below what would go, and where
        most of the outline would go.
        """
        parameters = self.how.with_reach
        fitter = GroundFitter(self.of, self.workers, self.how.sigma_m)
        base = base_of(fitter, [t.reach for t in self.made.tiles], parameters)
        longest, step = parameters.volume.max_edge_m, self.how.step_m
        folder = surface_folder(self.of.index, EVERY) / f"parts_{digest([longest, step])}"
        asked = [(folder, longest, step)] * len(self.of.tiles)
        cut = self._ask(tile_parts.step_parts, asked)
        check(sum(tile.parts.count for tile in cut))
        joined = joined_steps(cut)
        own = np.zeros(len(joined.steps.size), np.bool_)
        own[joined.steps.ground] = True
        if base.around is not None and base.folder is not None:
            v = parameters.volume
            parts = base.around.found.parts
            most = self._most_of_bodies(bodies_in_order(parts, v), base.folder, folder, joined)
            if most[0] != joined.steps.ground:
                return None
            own[most] = True
        standing = standing_parts(joined.steps, own)
        if not standing.any() or more_on_ground(joined.steps, standing):
            return None
        stands = [standing[label] for label in joined.labels]
        more = [(folder, base.folder, some) for some in stands]
        hidden, whole = np.sum(self._ask(tile_parts.hidden_area, more), axis=0).tolist()
        return Standing(self.of, folder, base.folder, stands) if hidden <= MOST * whole else None

    def _most_of_bodies(
        self, bodies: Sequence[I64], outline: Path, folder: Path, joined: JoinedSteps
    ) -> I64:
        """The part that has most of the vertices of each body, the largest body first. bodies : of
        each tile, that of each part that rises, -1 for none
        """
        asked = [(folder, outline, body) for body in bodies]
        told = self._ask(tile_parts.vertices_of_bodies, asked)
        rows = np.concatenate(
            [
                np.column_stack([t[:, 0], label[t[:, 1]], t[:, 2]])
                for t, label in zip(told, joined.labels, strict=True)
            ]
        )
        p = len(joined.steps.size)
        name, at = np.unique(rows[:, 0] * p + rows[:, 1], return_inverse=True)
        count = np.bincount(at.reshape(-1), rows[:, 2], len(name))
        # of parts with as many vertices the first
        order = np.lexsort((name % p, -count, name // p))
        first = np.unique(name[order] // p, return_index=True)[1]
        out: I64 = name[order][first] % p
        return out


class JoinedSteps(NamedTuple):
    """labels : of each tile, the part of the whole (count,) that each of its parts is of · steps :
    between these
    """

    labels: list[I64]
    steps: Steps


def joined_steps(tiles: Sequence[TileSteps]) -> JoinedSteps:
    """The parts of all tiles, in the order of their first points."""
    label = part_labels([t.parts for t in tiles])
    n = int(label.max(initial=-1)) + 1
    first = np.full(n, np.iinfo(np.int64).max)
    np.minimum.at(first, label, np.concatenate([t.first for t in tiles]))
    rank = np.empty(n, np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(n)
    label = rank[label]
    total = np.bincount(label, np.concatenate([t.parts.total for t in tiles]), n)
    labels = np.split(label, np.cumsum([t.parts.count for t in tiles])[:-1])
    low = np.concatenate([own[t.low] for own, t in zip(labels, tiles, strict=True)])
    high = np.concatenate([own[t.high] for own, t in zip(labels, tiles, strict=True)])
    times = np.concatenate([t.times for t in tiles])
    return JoinedSteps(labels, between_parts(low, high, times, total.astype(np.int64)))
