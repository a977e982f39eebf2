"""The surface of all tiles as one table of patches, in files that the system reads as needed.

The estimate of a survey needs every patch, but little of it at a time: most of a patch, such as
its cross blocks and sensitivities, is passed once for a result. It lies in files that have no name
any more, so that they are gone with the process, however it ends.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.atomic_write import unwritable
from ladar_volume.model.losses import Losses
from ladar_volume.model.records import I64, FilteredPoints, HeldPatches
from ladar_volume.rmls.tile_filter import TilePatches
from ladar_volume.tiled_replay.patch_tiles import COUNTS
from ladar_volume.uncertainty.packing import block_kernel, prepare_patches
from ladar_volume.uncertainty.patch_table import (
    HELD,
    ROWS,
    LatestUpdate,
    Parts,
    merged_points,
    ragged_index,
    usable_points,
)

#: Arrays with a row for each time bin of a patch.
BINS = ("nav_bin", "M_nav", "nav_residual")

#: Reads what one tile gives, None for a halo alone.
Reader = Callable[[], TilePatches | None]


def file_array(folder: Path, shape: tuple[int, ...], like: npt.DTypeLike) -> npt.NDArray[Any]:
    """An array in a file of that folder without a name. Where the system can, the room is
    taken at once: a disk that is full later would end the process. Raises :class:`OutputError`.
    """
    dtype = np.dtype(like)
    size = int(np.prod(shape)) * dtype.itemsize
    if not size:
        return np.zeros(shape, dtype)
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.truncate(size)
            if hasattr(os, "posix_fallocate"):  # Linux
                os.posix_fallocate(file.fileno(), 0, size)
            held = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise unwritable(folder, error) from error
    return np.frombuffer(held, dtype).reshape(shape)


class WholeSurface:
    """Points and patches of all tiles, as :class:`PatchStore` would hold them: by key.

    Every patch and every pair of patches belongs to one tile, with its lower key.
    """

    def __init__(self, readers: Sequence[Reader], folder: Path) -> None:
        """readers : called three times each, in turn · folder : for the files. Raises what they
        raise, and :class:`OutputError` for a full disk.
        """
        self._readers, self._folder = readers, folder
        self._made: dict[str, npt.NDArray[Any]] = {}
        self._points: dict[str, npt.NDArray[Any]] = {}
        self.losses = Losses()
        self.counts = dict.fromkeys((*COUNTS, "patches"), 0)
        keys, count = self._first_pass()
        order = np.argsort(keys, kind="stable")
        self._place = np.empty(len(keys), np.int64)
        self._place[order] = np.arange(len(keys))
        self._first_point, self._blocks, self._bins = (starts_of(c[order]) for c in count)
        self._each(self._take_rows)
        self._each(self._take_blocks)

    @property
    def patches(self) -> HeldPatches | None:
        """All patches; None where there are none."""
        if not self._made:
            return None
        return HeldPatches(cross_start=self._blocks, nav_start=self._bins, **self._made)

    @property
    def points(self) -> FilteredPoints | None:
        """All points, by patch, then position; None where there are none."""
        return FilteredPoints(**self._points) if self._points else None

    def _first_pass(self) -> tuple[I64, I64]:
        """Keys (m,) of the patches as the tiles have them, and how many points, blocks and time
        bins each has (3, m).
        """
        keys, counts = [np.zeros(0, np.int64)], [np.zeros((3, 0), np.int64)]
        for reader in self._readers:
            found = reader()
            if found is None:
                continue
            patches = found.patches
            points = usable_points(found.points, patches.key, self.losses)
            order = np.argsort(patches.key)
            row = order[np.searchsorted(patches.key, points.patch, sorter=order)]
            count = np.bincount(row, minlength=len(patches))
            blocks, bins = np.diff(patches.cross_start), np.diff(patches.nav_start)
            counts.append(np.stack([count, blocks, bins]))
            keys.append(patches.key.copy())  # else each file would stay mapped
            for name in COUNTS:
                self.counts[name] += getattr(found, name)
            self.counts["patches"] += len(patches)
        return np.concatenate(keys), np.concatenate(counts, axis=1)

    def _each(self, take: Callable[[TilePatches, I64], None]) -> None:
        """Hand over what each tile gives, and the places (k,) of its patches among all."""
        first = 0
        for reader in self._readers:
            found = reader()
            if found is not None and len(found.patches):
                last = first + len(found.patches)
                take(found, self._place[first:last])
                first = last

    def _take_rows(self, found: TilePatches, place: I64) -> None:
        """What each patch has of its own, and its points."""
        points, key = [usable_points(found.points, found.patches.key, Losses())], found.patches.key
        of_tile = merged_points(Parts(points), [1], LatestUpdate([key], [1]))
        at = ragged_index(self._first_point, np.sort(place))
        for name, rows in vars(of_tile).items():
            self._rows_of(self._points, name, self._first_point[-1], rows)[at] = rows
        held = prepare_patches(found.patches)
        bins = ragged_index(self._bins, place)
        for name in (*ROWS, *HELD):
            rows = getattr(held, name)
            self._rows_of(self._made, name, len(self._place), rows)[place] = rows
        for name in BINS:
            rows = getattr(held, name)
            self._rows_of(self._made, name, self._bins[-1], rows)[bins] = rows

    def _take_blocks(self, found: TilePatches, place: I64) -> None:
        """What each patch shares with those of higher keys; all factors are known."""
        patches = found.patches
        other, at = patches.cross_key, ragged_index(self._blocks, place)
        keys, factor = self._made["key"], self._made["factor"]
        packed = block_kernel(patches.key, patches.cross_start, other, patches.cross, keys, factor)
        self._rows_of(self._made, "cross_key", self._blocks[-1], other)[at] = other
        self._rows_of(self._made, "cross", self._blocks[-1], packed)[at] = packed

    def _rows_of(
        self, made: dict[str, npt.NDArray[Any]], name: str, rows: int, like: npt.NDArray[Any]
    ) -> npt.NDArray[Any]:
        """The array of that name among those made, of so many rows like those given."""
        if name not in made:
            made[name] = file_array(self._folder, (int(rows), *like.shape[1:]), like.dtype)
        return made[name]


def starts_of(count: I64) -> I64:
    """Begin (m + 1,) of each of ragged rows, from how many each has (m,)."""
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
