"""Patches of all tiles in files against the store that holds them in memory."""

import dataclasses
import errno
import os
from pathlib import Path

import numpy as np
import pytest

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import FilterUpdate
from ladar_volume.replay import Replay
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.uncertainty.patch_table import PatchStore

pytest.importorskip("pyarrow")
from ladar_volume.tiled_replay import tiled_survey
from ladar_volume.tiled_replay.whole_surface import WholeSurface, file_array

BAG = Path(__file__).parents[2] / "bags" / "leo_cut"


@pytest.fixture(scope="module")
def readers(tmp_path_factory):
    """Of the tiles of 5 m of a second of a recording."""
    seen = []

    def whole(readers, folder):
        seen.extend(readers)
        return WholeSurface(readers, folder)

    with pytest.MonkeyPatch.context() as patch, BagReader(BAG) as bag:
        patch.setattr(tiled_survey, "WholeSurface", whole)
        replay = Replay(bag, read_config(BAG / "config.yaml", []), bag.roles({}), 0.0, 1.0)
        work = tiled_survey.Work(5.0, tmp_path_factory.mktemp("store"), OwnProcess())
        tiled_survey.TiledReplay(replay, work).run()
        yield seen


def test_what_is_held_is_that_of_one_store_to_the_bit(readers, tmp_path):
    found, store = WholeSurface(readers, tmp_path), PatchStore()
    for reader in readers:
        if (tile := reader()) is not None:
            none = np.zeros(0, np.int64)
            store.replace(FilterUpdate(0, none, tile.points, tile.patches, complete=False))
    assert len(readers) > 20 < len(found.patches)
    assert found.counts["patches"] == len(found.patches)
    for mine, other in ((found.points, store.points), (found.patches, store.patches)):
        for field in dataclasses.fields(other):
            a, b = getattr(mine, field.name), getattr(other, field.name)
            assert a.dtype == b.dtype, field.name
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), field.name
    assert list(tmp_path.iterdir()) == []


def test_points_that_are_no_numbers_are_counted(readers, tmp_path):
    def broken():
        tile = whole[0]()
        r = tile.points.r_map.copy()
        r[3] = np.nan
        return dataclasses.replace(tile, points=dataclasses.replace(tile.points, r_map=r))

    whole = [reader for reader in readers if reader() is not None]
    found = WholeSurface([broken, *whole[1:]], tmp_path)
    assert dict(found.losses.items())["point_nan"] == 1
    assert len(found.points) == sum(len(reader().points) for reader in whole) - 1


def test_tiles_without_patches_are_no_surface(tmp_path):
    found = WholeSurface([lambda: None], tmp_path)
    assert found.points is None
    assert found.patches is None


def test_a_full_disk_is_an_error_before_anything_is_written(tmp_path, monkeypatch):
    def full(file, offset, size):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    assert file_array(tmp_path, (3, 2), np.int16).shape == (3, 2)
    assert file_array(tmp_path, (0, 2), np.float32).shape == (0, 2)
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OutputError, match="No space left") as caught:
        file_array(tmp_path, (3, 2), np.float64)
    assert str(tmp_path) in str(caught.value)
