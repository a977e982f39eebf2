"""The same question to every tile, some tiles at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.tiles.tile_store import Tile, TileIndex
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import Workers, each_result, results

R = TypeVar("R")

#: Fewest and most tiles that go to a worker at a time, and into how many batches they are divided
#: in between and at least, whatever the number of workers: sums do not depend on that.
FEW, MANY, BATCHES, LEAST = 16, 64, 64, 4


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


def merge_batch(
    op: Callable[..., R],
    merge: Callable[[Sequence[R]], R],
    of: TiledCloud,
    batch: tuple[int, Sequence[tuple[Any, ...]]],
) -> tuple[int, R]:
    """The number of a batch, and what ``merge`` makes of its answers."""
    number, answers = run_batch(op, of, batch)
    return number, merge(answers)


def added(answers: Sequence[Any]) -> Any:
    """Their sum."""
    return sum(answers[1:], answers[0])


def ask(
    workers: Workers,
    of: TiledCloud,
    op: Callable[..., R],
    more: Sequence[tuple[Any, ...]] | None = None,
    progress: Callable[[int], None] = lambda tiles: None,
) -> list[R]:
    """The answers ``op(of, tile, *more)`` of all tiles, in the order of their names. progress :
    takes how many tiles have just answered.
    """
    task, batches = partial(run_batch, op, of), batches_of(of, more)
    found = results(workers, task, batches, lambda done: progress(len(done[1])))
    return [answer for _, some in sorted(found, key=lambda f: f[0]) for answer in some]


def ask_merged(
    workers: Workers,
    of: TiledCloud,
    op: Callable[..., R],
    more: Sequence[tuple[Any, ...]] | None = None,
    merge: Callable[[Sequence[R]], R] = added,
) -> R:
    """What ``merge`` makes of all answers, by default their sum: workers merge those of a batch,
    and batches are merged in the order of their names as they come. Not all are held at once.
    """
    batches, merged, ready = batches_of(of, more), list[R](), dict[int, R]()
    left = [number for number, _ in reversed(batches)]
    for number, one in each_result(workers, partial(merge_batch, op, merge, of), batches):
        ready[number] = one
        while left and left[-1] in ready:
            merged = [merge([*merged, ready.pop(left.pop())])]
    return merged[0]


def batches_of(
    of: TiledCloud, more: Sequence[tuple[Any, ...]] | None
) -> list[tuple[int, list[tuple[Any, ...]]]]:
    """The tiles in batches, each with its number and what its tiles are told."""
    tiles = of.tiles
    every = [(tile, *rest) for tile, rest in zip(tiles, more or [()] * len(tiles), strict=True)]
    each = min(max(-(-len(every) // BATCHES), FEW), MANY, -(-len(every) // LEAST))
    return [(k, every[k : k + each]) for k in range(0, len(every), each)]


def givers(tiles: Sequence[Tile], gives: Sequence[Sequence[Tile]]) -> list[list[Tile]]:
    """For each tile those that give something to it, from what each gives to."""
    out: dict[Tile, list[Tile]] = {}
    for tile, some in zip(tiles, gives, strict=True):
        for other in some:
            out.setdefault(other, []).append(tile)
    return [out.get(tile, []) for tile in tiles]
