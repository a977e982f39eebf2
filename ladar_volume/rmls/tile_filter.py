"""The filter of one tile of a survey: the patches of its own voxels, as those of the whole.

What the patch of a voxel is depends on the points up to :data:`REACH` voxels away, and what it
shares with others on patches up to :data:`SPAN` away. So with all points of a halo of
:data:`HALO` voxels the tile's own patches, their points and their cross blocks are those of one
filter of the whole survey, to the bit. A pair of patches belongs to the one with the lower key.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import I64, Bool, FilteredPoints, Patches
from ladar_volume.rmls.cross_covariance import SPAN
from ladar_volume.rmls.fit_store import FitStore
from ladar_volume.rmls.patch_builder import PatchBuilder
from ladar_volume.rmls.patch_fit import FEW_POINTS, OK, REACH
from ladar_volume.rmls.surface_filter import BLOCK
from ladar_volume.rmls.voxel_store import Candidates, VoxelStore

#: Voxels around a tile whose points it needs.
HALO = SPAN + REACH


@dataclass(frozen=True)
class TilePatches:
    """What a tile gives to the whole.

    points, patches : of its own voxels · voxels, kept : how many these are, and their points ·
    outliers, unfitted : points of these that are in no patch, and of voxels without one
    """

    points: FilteredPoints
    patches: Patches
    voxels: int
    kept: int
    outliers: int
    unfitted: int


class TileFilter:
    """Fed with the points of a tile and its halo, in any order and any batches."""

    def __init__(self, parameters: Parameters, voxels: int) -> None:
        """voxels : how many there are at most, about: room is made for them."""
        f = parameters.filter
        self._cap = f.cap_per_voxel
        room = 1 << max(voxels - 1, 0).bit_length()  # the table of a store is a power of two
        self._store = VoxelStore(f.radius_m, self._cap, room)
        mount = mounting(parameters.calibration, parameters.georeference.pose_source)
        self._builder = PatchBuilder(f, self._store, mount, parameters.georeference.beams)

    def add(self, points: Candidates) -> None:
        """Points that a filter handed over."""
        self._store.insert(points)

    def finish(self, within: Callable[[I64, int], Bool]) -> TilePatches | None:
        """The patches of the tile's own voxels; None where it has none. within : which voxels, by
        their keys (n,), lie in the tile or no more than so many voxels beside it
        """
        s = self._store
        s.changed_voxels()
        keys = s.keys[: s.used]
        mine = within(keys, 0)
        if not mine.any():
            return None
        fits = FitStore(FEW_POINTS, self._cap)
        fits.grow(s.used)
        inside = np.zeros(s.used, np.int64)
        needed = np.flatnonzero(within(keys, SPAN))
        needed = needed[np.argsort(keys[needed], kind="stable")]
        for i in range(0, len(needed), BLOCK):
            block = needed[i : i + BLOCK]
            inside[block] = fits.keep(self._builder.fit(block), s.fresh)[1]
        fitted, held = fits.fits.status == OK, s.count[: s.used].astype(np.int64)
        rows = needed[(mine & fitted)[needed]]
        patches = self._builder.patches(fits, rows, once=True)
        return TilePatches(
            self._builder.points(fits, rows, patches),
            patches,
            int(np.count_nonzero(mine)),
            int(held[mine].sum()),
            int((held - inside)[mine & fitted].sum()),
            int(held[mine & ~fitted].sum()),
        )
