"""Pieces of time of a recording, georeferenced one by one, their returns written to tiles."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.bags import Recording
from ladar_volume.io.drivers.recording_series import open_recordings
from ladar_volume.io.drivers.ring_count import RingCount
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import GeoreferenceParameters, Parameters
from ladar_volume.model.records import Returns
from ladar_volume.replay import Replay, Span
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.tiled_replay.return_store import TileRows, write_returns
from ladar_volume.tiles.tile_store import Tile, digest

#: Length of a piece of time, s, and that of the poses before it, besides what returns may wait and
#: gaps may last.
PIECE_S, BEFORE_S = 60.0, 10.0
#: Slots of points that are held before they are written, 100 bytes each.
MOST_SLOTS = 1 << 21
#: Losses that tell that a piece is not what it is in the whole recording.
APART = ("point_pose_timeout", "point_waiting_full", "point_before_restart")


@dataclass(frozen=True)
class RecordedSurvey:
    """A recording and what it is replayed with, for workers.

    bags, log : paths of the recordings and of the autopilot's log · folder : of pieces and tiles ·
    side : of a tile, voxels · clouds, poses : times of receipt of each piece
    """

    bags: tuple[Path, ...]
    log: Path | None
    parameters: Parameters
    topics: dict[str, str]
    start_s: float
    duration_s: float
    folder: Path
    side: int
    clouds: tuple[Span, ...]
    poses: tuple[Span, ...]

    def notes(self, k: int) -> Path:
        """Where it is written what became of piece k, once all of it is at rest."""
        return self.folder / "pieces" / f"{k:06d}.json"

    @property
    def returns(self) -> Path:
        """Folder of the returns by tiles."""
        return self.folder / "returns"

    def replay(self, bag: Recording) -> Replay:
        """The recording as it is replayed."""
        log = None
        if self.log is not None:
            from ladar_volume.io.mavlink.mavlink_log import MavlinkLog  # with pymavlink

            log = MavlinkLog(self.log, self.parameters.mavlink)
        return Replay(bag, self.parameters, self.topics, self.start_s, self.duration_s, log)


@dataclass
class Piece:
    """What became of a piece of time.

    tiles : rows at rest, with their tile · returns, mapped, offered : read, georeferenced, taken by
    the filter · newest_ns : time of the newest of these · losses : of clouds and returns · rings :
    returns, those beyond the configured rings, and the highest ring · mounting : (5, 24) what
    sweeps laid on each other told of turned mountings · apart : why it is not what it
    is in the whole recording, or nothing
    """

    tiles: list[tuple[Tile, TileRows]] = dataclasses.field(default_factory=list)
    returns: int = 0
    mapped: int = 0
    offered: int = 0
    newest_ns: int = 0
    losses: dict[str, int] = dataclasses.field(default_factory=dict)
    rings: tuple[int, int, int] = (0, 0, -1)
    mounting: list[list[float]] = dataclasses.field(default_factory=list)
    apart: str = ""


def pieces_of(
    span: Span, p: GeoreferenceParameters, clock_ns: int, piece_s: float
) -> tuple[list[Span], list[Span]]:
    """Spans of the clouds of each piece, and of the poses that it needs. clock_ns : the navigation
    clock ahead of the LiDAR's
    """
    first, last = span
    count = max(1, round((last - first) * 1e-9 / piece_s))
    ends = [first + (last + 1 - first) * k // count for k in range(count + 1)]
    wait = abs(clock_ns) + round(1e9 * p.max_pending_s)
    gaps = round(2e9 * (p.max_position_gap_s + p.max_attitude_gap_s))
    before, after = wait + gaps + round(1e9 * BEFORE_S), 2 * wait + gaps
    clouds = [(ends[k], ends[k + 1] - 1) for k in range(count)]
    return clouds, [(max(a - before, first), min(b + after, last)) for a, b in clouds]


def piece_at_rest(recorded: RecordedSurvey, k: int) -> Piece | None:
    """What became of piece k; None where it is not done, or something of it is gone."""
    try:
        kept = json.loads(recorded.notes(k).read_text())
        known = kept["piece"]
        if digest(known) != kept["digest"]:
            return None
        tiles = [((tile[0], tile[1]), TileRows(**rows)) for tile, rows in known.pop("tiles")]
        known["rings"] = tuple(known["rings"])
        known["mounting"] = list(known["mounting"])
        found = Piece(tiles, **known)
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    there = all((recorded.returns / rows.archive).exists() for _, rows in tiles)
    return found if there else None


def georeference_piece(recorded: RecordedSurvey, k: int) -> tuple[int, Piece]:
    """Georeference piece k and write its returns to tiles, where that is not done yet. Errors name
    it.
    """
    known = piece_at_rest(recorded, k)
    if known is not None:
        return k, known
    try:
        with open_recordings(recorded.bags) as bag:
            found = georeference_one(recorded, k, recorded.replay(bag))
    except LadarVolumeError as error:
        first = (recorded.clouds[k][0] - recorded.clouds[0][0]) * 1e-9
        words = f"piece {k} (from {first:.1f} s of the recording): {error}"
        raise type(error)(words, reason=error.reason, value=error.value) from error
    recorded.notes(k).parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(recorded.notes(k)) as path:
        plain = json.loads(json.dumps(asdict(found)))
        path.write_text(json.dumps({"piece": plain, "digest": digest(plain)}))
    return k, found


class TileWriter:
    """Takes what a georeferencer has ready and writes it to tiles."""

    def __init__(self, recorded: RecordedSurvey, k: int, replay: Replay, piece: Piece) -> None:
        self.stage, self.filter = replay.engine.georeferencer, SurfaceFilter(replay.parameters)
        self._recorded, self._k, self._piece = recorded, k, piece
        self._cap, self._archives = replay.parameters.filter.cap_per_voxel, 0

    def step(self) -> None:
        """Take what is ready; write where much is held."""
        states = self.stage.take_platform()
        if states is not None:
            self.filter.add_platform(states)
        for points in self.stage.take_points():
            self._piece.mapped += len(points)
            self.filter.add(points)
        self._write(MOST_SLOTS)

    def finish(self) -> None:
        """End of the piece: what still waits is lost, the rest is written."""
        self.stage.finish()
        self.step()
        self.filter.finish_points()
        self._write(0)

    def _write(self, least: int) -> None:
        if self.filter.stats["voxels"] * self._cap > least:
            path = self._recorded.returns / f"{self._k:06d}_{self._archives:06d}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            self._piece.tiles += write_returns(
                path, self.filter.release_points(), self._recorded.side
            )
            self._archives += 1


def georeference_one(recorded: RecordedSurvey, k: int, replay: Replay) -> Piece:
    """Piece k of what is replayed, its returns written to tiles."""
    out = Piece()
    writer = TileWriter(recorded, k, replay, out)
    doors = replay.doors() | {"cloud": taker(replay)}
    for _, role, record in replay.records(recorded.poses[k], recorded.clouds[k]):
        doors[role](record)
        if role == "cloud":
            writer.step()
    writer.step()
    held = writer.stage.pending + writer.filter.stats["points_waiting"]
    writer.finish()
    out.returns, out.offered = replay.returns, writer.filter.stats["points_offered"]
    out.newest_ns, out.rings = writer.filter.newest_ns, replay.rings.counts
    out.mounting = writer.stage.mounting_check.sums.tolist()
    losses = replay.all_losses()
    losses.merge(writer.filter.losses)
    kinds = ("cloud_", "point_", "bag_")  # those of poses are counted once, for all pieces
    out.losses = {reason: count for reason, count in losses.items() if reason.startswith(kinds)}
    out.apart = separation_reason(recorded, k, out.losses, held, writer.stage.restarts)
    return out


def taker(replay: Replay) -> Callable[[Returns], None]:
    """Takes clouds in; whether their rings are those configured is judged over all pieces."""

    def take(returns: Returns) -> None:
        replay.returns += len(returns)
        replay.rings.look(returns)
        replay.engine.add_returns(returns)

    return take


def separation_reason(
    recorded: RecordedSurvey, k: int, losses: dict[str, int], held: int, restarts: int
) -> str:
    """Why a piece is not what it is in the whole recording, or nothing."""
    if restarts:
        return "time begins again"
    if len(recorded.clouds) == 1:
        return ""
    last = k + 1 == len(recorded.clouds)
    found = [reason for reason in APART if losses.get(reason) and not last]
    found += ["point_before_trajectory"] if k and losses.get("point_before_trajectory") else []
    found += ["bag_truncated"] if losses.get("bag_truncated") else []
    found += ["returns that still wait"] if held and not last else []
    return ", ".join(found)


def all_rings(beams: int, pieces: list[Piece]) -> RingCount:
    """The rings of all pieces."""
    total = RingCount(beams)
    for piece in pieces:
        total.merge(RingCount(beams, *piece.rings))
    return total
