"""The work of all tiles: dealt out, triangulated, added up; in this process or on Dask.

Every result of a tile is a small file, whole or not there, below a digest of what was asked: a run
after an interruption, or a worker that takes over from one that was lost, finds what is done. An
error names its tile.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.tiles.tile_stars import tile_stars
from ladar_volume.tiles.tile_store import (
    CloudParts,
    Tile,
    TileIndex,
    digest,
    distribute_part,
    tile_index,
)
from ladar_volume.tiles.tile_volume import TileSums, TileTask, tile_sums

A = TypeVar("A")
B = TypeVar("B")

#: How often a task may lose its worker.
LOSSES = 20


class Workers(Protocol):
    """Who does tasks that do not depend on one another, in any order."""

    @property
    def memory_bytes(self) -> int | None:
        """Memory of the smallest of them, None where it has no limit."""
        ...

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results, as they are ready."""
        ...


class OwnProcess:
    """One task after the other, here."""

    memory_bytes = None

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results in order."""
        yield from map(task, of)


class DaskWorkers:
    """The workers of a Dask client (``distributed.Client``)."""

    def __init__(self, client: object) -> None:
        self.client = client

    @property
    def memory_bytes(self) -> int | None:
        """Memory of the smallest worker, None where none has a limit."""
        info = self.client.scheduler_info(n_workers=-1)  # type: ignore[attr-defined]
        known = info["workers"].values()
        return min((w["memory_limit"] for w in known if w["memory_limit"]), default=None)

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results as workers return them; a task whose worker is lost goes to another one."""
        from distributed import CancelledError, KilledWorker, as_completed

        start = self.client.map  # type: ignore[attr-defined]
        futures = start(partial(on_one_thread, task), of, pure=False, retries=LOSSES)
        for future in as_completed(futures):  # type: ignore[no-untyped-call]
            try:
                yield future.result()
            except KilledWorker as error:
                words = f"a task lost its worker {LOSSES} times: give smaller tiles, or more memory"
                raise LadarVolumeError(words, reason="workers_lost") from error
            except (CancelledError, OSError) as error:
                words = "the scheduler is gone: start it and run again, what is done is kept"
                raise LadarVolumeError(words, reason="workers_lost") from error
            future.release()


def on_one_thread(task: Callable[[A], B], at: A) -> B:
    """A task on one thread: workers share the cores by tasks."""
    import numba

    numba.set_num_threads(1)
    return task(at)


@dataclass(frozen=True)
class Failure:
    """What went wrong in a task, as it travels between processes: the error's class, its words, its
    reason, its value.
    """

    kind: type[LadarVolumeError]
    words: str
    reason: str
    value: object = None


def run_guarded(task: Callable[[A], B], at: A) -> B | Failure:
    """The result, or the error it ended with."""
    try:
        return task(at)
    except LadarVolumeError as error:
        return Failure(type(error), str(error), error.reason, error.value)
    except OSError as error:
        return Failure(LadarVolumeError, f"{error.strerror or error}", "output_unwritable")


def results(
    workers: Workers, task: Callable[[A], B], of: Sequence[A], progress: Callable[[B], None]
) -> list[B]:
    """All results, in any order. Raises the first error."""
    out: list[B] = []
    for found in workers.run(partial(run_guarded, task), of):
        if isinstance(found, Failure):
            raise found.kind(found.words, reason=found.reason, value=found.value)
        progress(found)
        out.append(found)
    return out


def result_path(index: TileIndex, task: TileTask, tile: Tile) -> Path:
    """Where the result of a tile is at rest."""
    return index.cloud.folder / f"volume_{digest(asdict(task))}" / f"{tile[0]}_{tile[1]}.json"


def sums_of(index: TileIndex, task: TileTask, tile: Tile) -> tuple[Tile, TileSums]:
    """The sums of a tile, read where they are done. Errors name the tile."""
    path = result_path(index, task, tile)
    known = stored_sums(path)
    if known is not None:
        return tile, known
    try:
        found = tile_sums(tile_stars(index, tile), index.points(tile), task)
    except LadarVolumeError as error:
        side = index.cloud.tile_m
        words = f"tile {tile[0]}_{tile[1]} (x from {tile[0] * side:g}, y from {tile[1] * side:g} m)"
        raise type(error)(f"{words}: {error}", reason=error.reason) from error
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as part:
        part.write_text(json.dumps({"sums": asdict(found), "digest": digest(asdict(found))}))
    return tile, found


def stored_sums(path: Path) -> TileSums | None:
    """The sums in a file; None where it is not there or is damaged: they are made anew."""
    try:
        kept = json.loads(path.read_text())
        values = kept["sums"]
        if digest(values) != kept["digest"]:
            return None
        return TileSums(**{**values, "squares_m4": tuple(values["squares_m4"])})
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None


@dataclass(frozen=True)
class TiledSums:
    """index : the tiles · sums : of each, in the order of their names"""

    index: TileIndex
    sums: list[TileSums]


def sums_of_cloud(
    cloud: CloudParts,
    task: TileTask,
    workers: Workers,
    progress: Callable[[str, int, int], None] = lambda stage, total, done: None,
) -> TiledSums:
    """The sums of all tiles of a cloud. progress : called with the stage, its points, and how many
    of them a task has just done.
    """
    parts = list(range(cloud.count))
    each = -(-cloud.points // cloud.count)
    results(
        workers,
        partial(distribute_part, cloud),
        parts,
        lambda _: progress("into tiles", cloud.points, each),
    )
    index = tile_index(cloud)
    total = sum(index.count.values())
    found = results(
        workers,
        partial(sums_of, index, task),
        sorted(index.count, key=lambda t: (-index.count[t], t)),  # the longest first
        lambda done: progress("surface", total, done[1].points),
    )
    return TiledSums(index, [sums for _, sums in sorted(found, key=lambda each: each[0])])
