"""The patches of each tile of a survey, at rest."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.model.errors import InputError, LadarVolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import I64, Bool, FilteredPoints, Patches
from ladar_volume.rmls.tile_filter import TileFilter, TilePatches
from ladar_volume.tiled_replay.return_store import TileRows, read_returns, within_tile
from ladar_volume.tiles.array_file import ENDING, read_arrays, write_arrays
from ladar_volume.tiles.tile_store import Tile

#: Bytes of a slot of a voxel, of the fit of one and of a patch with its blocks while they are made.
SLOT, FIT, PATCH = 100, 1200, 16_000
#: Bytes of a row while it is read.
ROW = 250
#: Bytes of the program itself.
PROGRAM = 300 << 20
#: What a tile counts.
COUNTS = ("voxels", "kept", "outliers", "unfitted")
#: Records that are at rest.
KINDS: tuple[type[Any], ...] = (FilteredPoints, Patches)


@dataclass(frozen=True)
class TileTask:
    """One tile. folder : of the returns · side : of a tile, voxels · of : where its rows are"""

    folder: Path
    parameters: Parameters
    side: int
    tile: Tile
    of: tuple[TileRows, ...]

    @property
    def words(self) -> str:
        """How errors name it."""
        metres = self.side * self.parameters.filter.radius_m
        (i, j), x, y = self.tile, self.tile[0] * metres, self.tile[1] * metres
        return f"tile {i}_{j} (x from {x:g}, y from {y:g} m)"

    @property
    def path(self) -> Path:
        """Where its patches are at rest."""
        return self.folder / "patches" / f"{self.tile[0]}_{self.tile[1]}{ENDING}"

    @property
    def rows(self) -> int:
        """Rows at rest."""
        return sum(part.rows for part in self.of)

    @property
    def least_bytes(self) -> int:
        """Memory that its filter takes, at least, about: every archive has the same voxels."""
        return self._bytes(max(part.voxels for part in self.of))

    @property
    def most_bytes(self) -> int:
        """The same at most: no two archives have a voxel in common."""
        return self._bytes(sum(part.voxels for part in self.of))

    def _bytes(self, voxels: int) -> int:
        slots = voxels * self.parameters.filter.cap_per_voxel
        largest = max(part.rows for part in self.of)
        return PROGRAM + slots * SLOT + voxels * (FIT + PATCH) + largest * ROW


def filter_tile(task: TileTask) -> Tile:
    """Filter a tile where that is not done yet. Errors name it."""
    if task.path.exists():
        return task.tile
    try:
        found = patches_of_tile(task)
        write_patches(task.path, found)
    except LadarVolumeError as error:
        raise type(error)(
            f"{task.words}: {error}", reason=error.reason, value=error.value
        ) from error
    except MemoryError as error:
        words = f"{task.words}: out of memory; give smaller tiles"
        raise LadarVolumeError(words, reason="tile_memory") from error
    return task.tile


def patches_of_tile(task: TileTask) -> TilePatches | None:
    """What one tile gives to the whole, None for a halo alone."""
    made = TileFilter(task.parameters, max(part.voxels for part in task.of))
    for points in read_returns(task.folder / "returns", task.tile, task.of):
        made.add(points)

    def within(keys: I64, margin: int) -> Bool:
        return within_tile(keys, task.tile, task.side, margin)

    return made.finish(within)


def write_patches(path: Path, found: TilePatches | None) -> None:
    """Write what a tile gives."""
    arrays: dict[str, Any] = {}
    if found is not None:
        arrays |= {f"points_{name}": array for name, array in vars(found.points).items()}
        arrays |= {f"patches_{name}": array for name, array in vars(found.patches).items()}
        arrays["counts"] = np.array([getattr(found, name) for name in COUNTS])
    write_arrays(path, arrays)


def read_patches(task: TileTask) -> TilePatches | None:
    """What a tile gives. Raises :class:`InputError` (input_damaged) for a damaged file."""
    found = read_arrays(task.path)
    if not found:
        return None
    try:
        names = {kind: [f.name for f in dataclasses.fields(kind)] for kind in KINDS}
        points = FilteredPoints(**{n: found[f"points_{n}"] for n in names[FilteredPoints]})
        patches = Patches(**{n: found[f"patches_{n}"] for n in names[Patches]})
        return TilePatches(points, patches, *found["counts"].tolist())
    except (KeyError, TypeError) as error:
        words = f"{task.path}: missing or damaged ({error})"
        raise InputError(words, reason="input_damaged", value=str(task.path)) from error
