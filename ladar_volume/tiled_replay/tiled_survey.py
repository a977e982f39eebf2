"""A recording replayed by tiles, and the volume from all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ladar_volume.georeference.sample_admission import SET_BACK_S
from ladar_volume.io.drivers.packet_capture import PacketCapture
from ladar_volume.math.large_arrays import large_arrays_in
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import Datum, Estimate
from ladar_volume.replay import NEVER, Replay
from ladar_volume.rmls.tile_filter import TilePatches
from ladar_volume.tiled_replay.patch_tiles import TileTask, filter_tile, read_patches
from ladar_volume.tiled_replay.return_store import LAYOUT, TileRows, voxels_of_side
from ladar_volume.tiled_replay.time_pieces import (
    PIECE_S,
    Piece,
    RecordedSurvey,
    all_rings,
    georeference_piece,
    pieces_of,
)
from ladar_volume.tiled_replay.whole_surface import WholeSurface, file_array
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_work import Workers, results
from ladar_volume.version import version

B = TypeVar("B")

#: Called with the stage, the share of it that is done, and returns done so far.
Progress = Callable[[str, float, int], None]
#: Sections that say what is done with the patches of the tiles, not how these are made.
AFTERWARDS = ("ground", "tin", "volume", "node", "logger")
#: Pose records between two looks at what they tell.
STEP = 200


@dataclass(frozen=True)
class Work:
    """How it is shared: tile_m : side of a tile, m · store : folder of what is at rest · workers ·
    piece_s : length of a piece of time, s
    """

    tile_m: float
    store: Path
    workers: Workers
    piece_s: float = PIECE_S


class TiledReplay:
    """A replay by tiles. After :meth:`run` the replay has the estimate's surface, losses and
    counts, as after one of its own.
    """

    def __init__(self, replay: Replay, work: Work) -> None:
        """Raises :class:`ConfigurationError` for a tile that is too small and for what tiles do not
        give.
        """
        self.replay, self.work = replay, work
        parameters = replay.parameters
        self.side = voxels_of_side(work.tile_m, parameters.filter.radius_m)
        if parameters.volume.kind == "bodies":
            words = "closed bodies are not made by tiles: replay without --tile and --dask"
            raise ConfigurationError(words, value="bodies")
        #: What the run did that needs saying, a sentence each.
        self.words: list[str] = []
        self.facts: dict[str, Any] = {}

    def run(self, progress: Progress = lambda stage, share, returns: None) -> Estimate:
        """Georeference, filter, estimate. Raises as :meth:`Replay.run`."""
        replay, parameters = self.replay, self.replay.parameters
        disorder = self._poses()
        recorded = self._recorded(1e30 if disorder else self.work.piece_s)
        pieces = self._pieces(recorded, progress)
        apart = sorted({piece.apart for piece in pieces if piece.apart})
        if disorder or apart:
            self.words.append(f"georeferenced in one piece: {disorder or '; '.join(apart)}")
        if apart and len(pieces) > 1:
            recorded = self._recorded(1e30)
            pieces = self._pieces(recorded, progress)
        if any(piece.apart for piece in pieces):
            words = "time begins again in this recording: cut it with --start and --duration"
            raise InputError(f"{replay.bag.path}: {words}", reason="replay_restart")
        all_rings(parameters.georeference.beams, pieces).check()
        for piece in pieces:
            replay.returns += piece.returns
            replay.engine.points_mapped += piece.mapped
            replay.losses.merge(Losses(piece.losses))
            replay.engine.georeferencer.mounting_check.merge(np.array(piece.mounting))
        self._tiles(recorded, pieces, progress)
        with large_arrays_in(partial(file_array, recorded.folder)):
            return replay.estimate_or_refuse(replay.engine.estimator.estimate)

    def _poses(self) -> str:
        """Take in the poses of the whole recording; returns why it must be georeferenced in one
        piece, or nothing.
        """
        engine, back = self.replay.engine, set()
        newest: dict[str, int] = {}
        for k, (_, role, record) in enumerate(self.replay.records(None, NEVER)):
            last: int = newest.get(role, record.t_ns)
            if record.t_ns < last - SET_BACK_S * 1e9:
                back.add(role)
            newest[role] = max(last, record.t_ns)
            self.replay.doors()[role](record)
            if k % STEP == 0:
                engine.step()
        engine.georeferencer.finish()
        engine.step()
        jumps = [reason for reason, _ in engine.losses.items() if reason.endswith("_time_jump")]
        return ", ".join([*(f"the time of {role} goes back" for role in sorted(back)), *jumps])

    def _recorded(self, piece_s: float) -> RecordedSurvey:
        """What workers need to know, with the datum of all."""
        replay, p = self.replay, self.replay.parameters
        engine = replay.engine
        clock_ns = engine.georeferencer.mount.clock_ns
        clouds, poses = pieces_of(replay.span, p.georeference, clock_ns, piece_s)
        parts = replay.bag.parts or (replay.bag,)
        if any(isinstance(part, PacketCapture) for part in parts):
            clouds, poses = [replay.span], [replay.span]  # it is read as a whole each time
        log = None if replay.poses is None else replay.poses.path
        plain = {name: v for name, v in asdict(p).items() if name not in AFTERWARDS}
        sources = [replay.bag.digest(), None if replay.poses is None else replay.poses.digest()]
        asked = [replay.topics, replay.span, clouds, self.side, LAYOUT, version()]
        name = digest([sources, plain, asked])
        datum = engine.datum or Datum(0.0, 0.0, 0.0)  # without one nothing is mapped
        own = replace(
            p.georeference,
            datum_latitude_deg=datum.latitude_deg,
            datum_longitude_deg=datum.longitude_deg,
            datum_height_m=datum.height_m,
        )
        return RecordedSurvey(
            tuple(part.path.resolve() for part in parts),
            None if log is None else log.resolve(),
            replace(p, georeference=own),
            dict(replay.topics),
            replay.start_s,
            replay.duration_s,
            self.work.store.resolve() / name,
            self.side,
            tuple(clouds),
            tuple(poses),
        )

    def _pieces(self, recorded: RecordedSurvey, progress: Progress) -> list[Piece]:
        """All pieces, in order."""
        done = returns = 0

        def report(found: tuple[int, Piece]) -> None:
            nonlocal done, returns
            done, returns = done + 1, returns + found[1].returns
            progress("georeferencing", done / len(recorded.clouds), returns)

        every = range(len(recorded.clouds))
        found = results(self.work.workers, partial(georeference_piece, recorded), every, report)
        return [piece for _, piece in sorted(found, key=lambda each: each[0])]

    def _tiles(self, recorded: RecordedSurvey, pieces: list[Piece], progress: Progress) -> None:
        """Filter all tiles and hand them to the estimator."""
        replay, tasks = self.replay, self._tasks(recorded, pieces)
        rows = {task.tile: task.rows for task in tasks}
        total, done = max(sum(rows.values()), 1), 0
        offered = sum(piece.offered for piece in pieces)

        def report(tile: Tile) -> None:
            nonlocal done
            done += rows[tile]
            share = min(done / total, 1.0)
            progress("filtering", share, round(offered * share))

        longest = sorted(tasks, key=lambda task: (-task.rows, task.tile))
        self._with_repair(
            recorded, lambda: results(self.work.workers, filter_tile, longest, report)
        )
        newest = max((piece.newest_ns for piece in pieces), default=0)
        readers = [partial(self._read, recorded, task) for task in tasks]
        whole = WholeSurface(readers, recorded.folder)
        if whole.points is not None and whole.patches is not None:
            replay.engine.estimator.hold(whole.points, whole.patches, newest)
        replay.engine.estimator.losses.merge(whole.losses)
        counts = whole.counts
        replay.losses.add("point_outlier", counts["outliers"])
        replay.losses.add("point_few_neighbours", counts["unfitted"])
        replay.counts = {
            "voxels": counts["voxels"],
            "points_offered": offered,
            "points_kept": counts["kept"],
            "points_over_cap": offered - counts["kept"],
            "patches": counts["patches"],
            "points_deferred": 0,
            "points_waiting": 0,
        }

    def _tasks(self, recorded: RecordedSurvey, pieces: list[Piece]) -> list[TileTask]:
        """The tiles, by name. Raises :class:`ConfigurationError` where one is too large for a
        worker.
        """
        parameters = self.replay.parameters
        rows: dict[Tile, list[TileRows]] = {}
        for piece in pieces:
            for tile, part in piece.tiles:
                rows.setdefault(tile, []).append(part)
        tasks = [
            TileTask(recorded.folder, parameters, self.side, tile, tuple(rows[tile]))
            for tile in sorted(rows)
        ]
        side_m = self.side * parameters.filter.radius_m
        limit = self.work.workers.memory_bytes
        largest = max(tasks, key=lambda task: task.least_bytes, default=None)
        if largest is not None and limit is not None and largest.least_bytes > limit:
            words = f"{largest.words} needs {largest.least_bytes / 1e9:.1f} GB, and a worker has "
            words += f"{limit / 1e9:.1f} GB: give --tile {side_m / 2:g} or fewer workers"
            raise ConfigurationError(words, value=largest.least_bytes)
        self.facts = {
            "side_m": side_m,
            "count": len(tasks),
            "pieces": len(recorded.clouds),
            "at_rest": sum(task.path.exists() for task in tasks),
            "task_bytes": max((task.most_bytes for task in tasks), default=0),
            "folder": str(recorded.folder),
            "notes": self.words,
        }
        return tasks

    def _read(self, recorded: RecordedSurvey, task: TileTask) -> TilePatches | None:
        """The patches of a tile; made again where they are damaged."""

        def made() -> TilePatches | None:
            if not task.path.exists():
                results(self.work.workers, filter_tile, [task], lambda tile: None)
            return read_patches(task)

        return self._with_repair(recorded, made)

    def _with_repair(self, recorded: RecordedSurvey, action: Callable[[], B]) -> B:
        """The result of an action that reads what is at rest; what is damaged is made anew, once
        each.
        """
        mended: set[object] = set()
        while True:
            try:
                return action()
            except InputError as error:
                if error.reason != "input_damaged" or error.value in mended:
                    raise
                mended.add(error.value)
                self.words.append(f"made anew: {error}")
                path = Path(str(error.value))
                path.unlink(missing_ok=True)
                if path.parent == recorded.returns:
                    k = int(path.name.split("_")[0])
                    recorded.notes(k).unlink(missing_ok=True)
                    remake = partial(georeference_piece, recorded)
                    results(self.work.workers, remake, [k], lambda piece: None)
