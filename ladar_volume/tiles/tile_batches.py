"""The same question to every tile, some tiles at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.records import I64
from ladar_volume.tiles.tile_store import Tile, TileIndex
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import Workers, each_result, results

R = TypeVar("R")

#: Into how many batches the tiles go, whatever the number of workers: sums do not depend on it.
BATCHES = 64


@dataclass(frozen=True)
class TiledCloud:
    """index : the tiles · limits : which triangles count"""

    index: TileIndex
    limits: Limits

    @property
    def tiles(self) -> list[Tile]:
        """All tiles, by name."""
        return sorted(self.index.count)


def words_of(index: TileIndex, tile: Tile) -> str:
    """How errors name a tile."""
    side = index.cloud.tile_m
    return f"tile {tile[0]}_{tile[1]} (x from {tile[0] * side:g}, y from {tile[1] * side:g} m)"


def run_batch(
    op: Callable[..., R], of: TiledCloud, batch: tuple[int, Sequence[tuple[Any, ...]]]
) -> tuple[int, list[R]]:
    """The number of a batch, and its answers. Errors name the tile."""
    out = []
    for tile, *more in batch[1]:
        try:
            out.append(op(of, tile, *more))
        except LadarVolumeError as error:
            words = f"{words_of(of.index, tile)}: {error}"
            raise type(error)(words, reason=error.reason, value=error.value) from error
    return batch[0], out


def sum_batch(
    op: Callable[..., Any], of: TiledCloud, batch: tuple[int, Sequence[tuple[Any, ...]]]
) -> tuple[int, list[Any]]:
    """The same, the answers added up."""
    number, answers = run_batch(op, of, batch)
    return number, [sum(answers[1:], answers[0])]


def ask(
    workers: Workers,
    of: TiledCloud,
    op: Callable[..., R],
    more: Sequence[tuple[Any, ...]] | None = None,
    progress: Callable[[int], None] = lambda tiles: None,
    adds: bool = False,
) -> list[R]:
    """The answers ``op(of, tile, *more)`` of all tiles, in the order of their names; where it
    ``adds``, the sums of some each. progress : takes how many tiles have just answered.
    """
    task, batches = partial(sum_batch if adds else run_batch, op, of), batches_of(of, more)
    found = results(workers, task, batches, lambda done: progress(len(done[1])))
    return [answer for _, some in sorted(found, key=lambda f: f[0]) for answer in some]


def ask_total(
    workers: Workers, of: TiledCloud, op: Callable[..., I64], more: Sequence[tuple[Any, ...]]
) -> I64:
    """The sum of the whole numbers (k,) that all tiles answer, whose order does not matter: not all
    of them are held at once.
    """
    total: Any = 0
    for _, (some,) in each_result(workers, partial(sum_batch, op, of), batches_of(of, more)):
        total = total + some
    return np.asarray(total, dtype=np.int64)


def batches_of(
    of: TiledCloud, more: Sequence[tuple[Any, ...]] | None
) -> list[tuple[int, list[tuple[Any, ...]]]]:
    """The tiles in batches, each with its number and what its tiles are told."""
    tiles = of.tiles
    every = [(tile, *rest) for tile, rest in zip(tiles, more or [()] * len(tiles), strict=True)]
    each = -(-len(every) // BATCHES)
    return [(k, every[k : k + each]) for k in range(0, len(every), each)]


def givers(tiles: Sequence[Tile], gives: Sequence[Sequence[Tile]]) -> list[list[Tile]]:
    """For each tile those that give something to it, from what each gives to."""
    out: dict[Tile, list[Tile]] = {}
    for tile, some in zip(tiles, gives, strict=True):
        for other in some:
            out.setdefault(other, []).append(tile)
    return [out.get(tile, []) for tile in tiles]
