"""A cloud in tiles without some of its points: those that stand alone beyond what was sampled, or
on the surface. Only the tiles whose surface these have changed are triangulated again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.model.records import F64, I64
from ladar_volume.tiles.array_file import ENDING, read_arrays, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_outline import Box, box_of
from ladar_volume.tiles.tile_patch import rows_at
from ladar_volume.tiles.tile_places import hull_of_places, joined_hull
from ladar_volume.tiles.tile_store import Tile, TileIndex
from ladar_volume.tiles.tile_surface import EVERY, surface_of
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tin.duplicates import places
from ladar_volume.tin.full_tin import any_corner

#: So many indices are kept by a process: each pass has one, with and without its hull.
KEPT = 12


@dataclass(frozen=True)
class WithoutPoints(TileIndex):
    """before : the tiles with these points · gone : by tile, their rows (k,) · changed : tiles
    whose surface is another without them · alone : whether these belong to the cloud, and the
    surface is made without them
    """

    before: TileIndex | None = None
    gone: Mapping[Tile, I64] = dataclasses.field(default_factory=dict)
    changed: frozenset[Tile] = frozenset()
    alone: bool = False

    def __reduce__(self) -> tuple[Callable[..., TileIndex], tuple[object, ...]]:
        """Workers read it from what is at rest, once: it goes with every task."""
        return at_rest, (self._before, self.cloud.folder, self.hull.tobytes())

    @property
    def _before(self) -> TileIndex:
        assert self.before is not None
        return self.before

    @property
    def every_point(self) -> TileIndex:
        """The tiles with the points that stand alone beyond what was sampled."""
        return self._before.every_point if self.alone else self

    @property
    def cleaned(self) -> TileIndex:
        """The tiles without strays, and with all these points."""
        return self._before.cleaned

    def home(self, tile: Tile) -> Path:
        """The folder in which the surface of a tile is at rest."""
        return self.cloud.folder if tile in self.changed else self._before.home(tile)

    def points(self, tile: Tile) -> F64:
        """Points (n, 3) m of a tile in file order."""
        points = self._before.points(tile)
        if tile not in self.gone:
            return points
        return points[~np.isin(self._before.rows(tile), self.gone[tile])]

    def rows(self, tile: Tile) -> I64:
        """Numbers (n,) of these points that order all of the file as they stand in it."""
        rows = self._before.rows(tile)
        return rows[~np.isin(rows, self.gone[tile])] if tile in self.gone else rows

    def places(self, tile: Tile) -> F64:
        """Footprints (k, 4) of a tile."""
        return super().places(tile) if tile in self.gone else self._before.places(tile)

    def place_rows(self, tile: Tile) -> I64:
        """The least of the rows at each of these (k,)."""
        return super().place_rows(tile) if tile in self.gone else self._before.place_rows(tile)


@dataclass(frozen=True)
class LeftTile:
    """Of a tile without some points: count of the others, their box, the corners (h, 2) m of their
    hull, and the tiles whose surface is another.
    """

    count: int
    box: Box | None
    hull: F64
    changed: frozenset[Tile]


def left_of(of: TiledCloud, tile: Tile, gone: I64) -> LeftTile | None:
    """What is left of a tile without the rows gone (k,); None where that is all."""
    if not len(gone):
        return None
    points = of.index.points(tile)
    out = np.isin(of.index.rows(tile), gone)
    tin = surface_of(of.index, EVERY, tile).tin
    mine = np.zeros(len(tin.vertices), np.bool_)
    mine[rows_at(tin.vertices + 0.0, points[out] + 0.0)] = True  # -0 is 0
    around = np.unique(tin.triangles[any_corner(tin.triangles, mine)])
    cells = np.floor(tin.vertices[around, :2] / of.index.cloud.tile_m).astype(np.int64)
    changed = {(i, j) for i, j in np.unique(cells, axis=0).tolist()}
    left = points[~out]
    hull = hull_of_places(places(left)[:, :2])
    return LeftTile(len(left), box_of(left[:, :2]), hull, frozenset(changed | {tile}))


@dataclass(frozen=True)
class Left:
    """index : of the tiles with the others, with their hull · hulls : by tile, corners (h, 2) m"""

    index: WithoutPoints
    hulls: dict[Tile, F64]


def without_points(
    workers: Workers,
    of: TiledCloud,
    gone: Sequence[I64],
    name: str,
    hulls: Mapping[Tile, F64],
    alone: bool = False,
) -> Left:
    """The tiles without the rows (k,) of each, at rest under a name that only these points have.
    hulls : by tile, corners (h, 2) m of the hull of its points
    """
    before = of.index
    left = ask(workers, of, left_of, [(rows,) for rows in gone])
    some = [(t, rows, f) for t, rows, f in zip(of.tiles, gone, left, strict=True) if f is not None]
    changed = set[Tile]().union(*(f.changed for _, _, f in some)) & set(before.count)
    arrays = {
        "tiles": np.array([t for t, _, _ in some], np.int64).reshape(-1, 2),
        "first": np.cumsum([0, *(len(rows) for _, rows, _ in some)]),
        "rows": np.concatenate([np.zeros(0, np.int64), *(rows for _, rows, _ in some)]),
        "count": np.array([f.count for _, _, f in some], np.int64),
        "box": np.array([f.box or (np.nan,) * 4 for _, _, f in some]).reshape(-1, 4),
        "changed": np.array(sorted(changed), np.int64).reshape(-1, 2),
        "alone": np.array(alone),
    }
    folder = before.cloud.folder / name
    write_arrays(folder / f"without{ENDING}", arrays)
    index = made(before, folder, arrays)
    ends = dict(hulls) | {t: f.hull for t, _, f in some}
    ends = {t: hull for t, hull in ends.items() if t in index.count}
    return Left(dataclasses.replace(index, hull=joined_hull(list(ends.values()))), ends)


def made(before: TileIndex, folder: Path, arrays: Mapping[str, np.ndarray]) -> WithoutPoints:
    """The index from its arrays, without a hull."""
    tiles = [(i, j) for i, j in arrays["tiles"].tolist()]
    each = np.split(arrays["rows"], arrays["first"][1:-1]) if tiles else []
    count, box = dict(before.count), dict(before.box)
    for tile, n, own in zip(tiles, arrays["count"].tolist(), arrays["box"].tolist(), strict=True):
        if n:
            count[tile], box[tile] = n, tuple(own)
        else:
            del count[tile], box[tile]
    return WithoutPoints(
        dataclasses.replace(before.cloud, folder=folder),
        {},
        count,
        box,
        before.left_out,
        before.doubts,
        np.zeros((0, 2)),
        before,
        dict(zip(tiles, each, strict=True)),
        frozenset((i, j) for i, j in arrays["changed"].tolist()),
        bool(arrays["alone"]),
    )


#: Indices of this process, of a cloud or two.
_known: dict[tuple[Path, bytes], WithoutPoints] = {}


def at_rest(before: TileIndex, folder: Path, hull: bytes) -> WithoutPoints:
    """The index of a process, with the hull's corners."""
    if (folder, hull) not in _known:
        if len(_known) >= KEPT:
            _known.clear()
        corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
        index = made(before, folder, read_arrays(folder / f"without{ENDING}"))
        _known[folder, hull] = dataclasses.replace(index, hull=corners)
    return _known[folder, hull]
