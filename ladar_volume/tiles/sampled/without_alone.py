"""A cloud in tiles without the points that stand alone beyond what was sampled. Only the tiles
whose surface these have changed are triangulated again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.tiles.array_file import ENDING, read_arrays, write_arrays
from ladar_volume.tiles.sampled.tile_area import AloneTile
from ladar_volume.tiles.tile_outline import box_of
from ladar_volume.tiles.tile_patch import names_of
from ladar_volume.tiles.tile_store import Tile, TileIndex

#: So many indices are kept by a process: each pass has one, with and without its hull.
KEPT = 12


@dataclass(frozen=True)
class WithoutAlone(TileIndex):
    """before : the tiles with these points · alone : by tile, their places (k, 2) m · changed :
    tiles whose surface is another without them
    """

    before: TileIndex | None = None
    alone: Mapping[Tile, F64] = dataclasses.field(default_factory=dict)
    changed: frozenset[Tile] = frozenset()

    def __reduce__(self) -> tuple[Callable[..., TileIndex], tuple[object, ...]]:
        """Workers read it from what is at rest, once: it goes with every task."""
        return at_rest, (self._before, self.cloud.folder, self.hull.tobytes())

    @property
    def _before(self) -> TileIndex:
        assert self.before is not None
        return self.before

    @property
    def every_point(self) -> TileIndex:
        """The tiles with these points."""
        return self._before.every_point

    def home(self, tile: Tile) -> Path:
        """The folder in which the surface of a tile is at rest."""
        return self.cloud.folder if tile in self.changed else self._before.home(tile)

    def _kept(self, tile: Tile, xy: F64) -> Bool | slice:
        """Which of places (n, 2) of a tile are kept."""
        alone = self.alone.get(tile)
        # -0 is 0
        return slice(None) if alone is None else ~np.isin(names_of(xy + 0.0), names_of(alone))

    def points(self, tile: Tile) -> F64:
        """Points (n, 3) m of a tile in file order."""
        points = self._before.points(tile)
        return points[self._kept(tile, points)]

    def rows(self, tile: Tile) -> I64:
        """Numbers (n,) of these points that order all of the file as they stand in it."""
        return self._before.rows(tile)[self._kept(tile, self._before.points(tile))]

    def places(self, tile: Tile) -> F64:
        """Footprints (k, 4) of a tile."""
        places = self._before.places(tile)
        return places[self._kept(tile, places)]

    def place_rows(self, tile: Tile) -> I64:
        """The least of the rows at each of these (k,)."""
        return self._before.place_rows(tile)[self._kept(tile, self._before.places(tile))]


def without_alone(before: TileIndex, folder: Path, found: Mapping[Tile, AloneTile]) -> WithoutAlone:
    """The tiles without the points that stand alone, and without a hull; at rest in a folder."""
    tiles = [t for t, one in found.items() if len(one.places)]
    changed = sorted(set[Tile]().union(*(found[t].changed for t in tiles)) & set(before.count))
    places = np.concatenate([found[t].places for t in tiles])
    owner = np.repeat(np.array(tiles), [len(found[t].places) for t in tiles], axis=0)
    arrays = {"places": places, "owner": owner, "changed": np.array(changed)}
    write_arrays(folder / f"alone{ENDING}", arrays)
    return made(before, folder, arrays)


def made(before: TileIndex, folder: Path, arrays: Mapping[str, np.ndarray]) -> WithoutAlone:
    """The same from its arrays."""
    owner, first = np.unique(arrays["owner"], axis=0, return_index=True)
    order = np.argsort(first)  # the places of a tile follow one another
    each = np.split(arrays["places"], first[order][1:])
    alone = {(i, j): own for (i, j), own in zip(owner[order].tolist(), each, strict=True)}
    changed = frozenset((i, j) for i, j in arrays["changed"].tolist())
    cloud = dataclasses.replace(before.cloud, folder=folder)
    out = WithoutAlone(
        cloud,
        {},
        dict(before.count),
        dict(before.box),
        before.left_out,
        before.doubts,
        np.zeros((0, 2)),
        before,
        alone,
        changed,
    )
    for tile in alone:
        points = out.points(tile)
        box = box_of(points[:, :2])
        out.count[tile] = len(points)
        if box is None:
            del out.count[tile], out.box[tile]
        else:
            out.box[tile] = box
    return out


#: Indices of this process, of a cloud or two.
_known: dict[tuple[Path, bytes], WithoutAlone] = {}


def at_rest(before: TileIndex, folder: Path, hull: bytes) -> WithoutAlone:
    """The index of a process, with the hull's corners."""
    if (folder, hull) not in _known:
        if len(_known) >= KEPT:
            _known.clear()
        corners = np.frombuffer(hull, np.float64).reshape(-1, 2).copy()
        index = made(before, folder, read_arrays(folder / f"alone{ENDING}"))
        _known[folder, hull] = dataclasses.replace(index, hull=corners)
    return _known[folder, hull]
