"""Returns at rest by tiles, and the filter of one tile with a halo."""

import dataclasses

import numpy as np
import pytest

from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.rmls.tile_filter import HALO
from ladar_volume.rmls.voxel_store import Candidates, pack_key, unpack_key
from ladar_volume.tiled_replay.return_store import (
    read_returns,
    tiles_of_rows,
    voxels_of_side,
    within_tile,
    write_returns,
)

SIDE = 17


def candidates(n, seed):
    rng = np.random.default_rng(seed)
    return Candidates(
        pack_key(rng.integers(-40, 40, (n, 3))),
        rng.integers(0, 2**63, n).astype(np.uint64),
        rng.integers(0, 2**62, n),
        rng.integers(0, 16, n).astype(np.uint16),
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 6)).astype(np.float32),
        rng.integers(-30000, 30000, (n, 12)).astype(np.int16),
    )


def test_a_tile_gets_the_rows_of_its_voxels_and_of_its_halo_once_each(tmp_path):
    points = candidates(3000, 1)
    found = write_returns(tmp_path / "a.parquet", points, SIDE)
    assert len({tile for tile, _ in found}) == len(found)
    for tile, rows in found:
        got = next(read_returns(tmp_path, tile, [rows]))
        inside = within_tile(points.key, tile, SIDE, HALO)
        order = np.flatnonzero(inside)[np.lexsort((points.hash[inside], points.key[inside]))]
        for field in dataclasses.fields(Candidates):
            one, other = getattr(got, field.name), getattr(points, field.name)[order]
            assert one.dtype == other.dtype and np.array_equal(one, other)
        assert rows.voxels == len(np.unique(points.key[inside]))


def test_every_row_is_in_the_tile_of_its_voxel(tmp_path):
    keys = candidates(2000, 2).key
    rows, tiles = tiles_of_rows(keys, SIDE)
    home = unpack_key(keys)[:, :2] // SIDE
    own = (tiles == home[rows]).all(axis=1)
    assert np.array_equal(np.sort(rows[own]), np.arange(len(keys)))
    assert len({(r, *t) for r, t in zip(rows.tolist(), tiles.tolist(), strict=True)}) == len(rows)


def test_a_damaged_archive_is_told_from_any_byte_of_its_rows(tmp_path):
    path = tmp_path / "a.parquet"
    found = write_returns(path, candidates(500, 3), SIDE)
    whole = path.read_bytes()
    for at in np.random.default_rng(4).integers(4, len(whole) - 4, 12).tolist():
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        try:
            got = [next(read_returns(tmp_path, tile, [rows])) for tile, rows in found]
        except InputError as error:
            assert error.reason == "input_damaged" and error.value == str(path)
            continue
        path.write_bytes(whole)  # a byte that nothing is read from
        same = [next(read_returns(tmp_path, tile, [rows])) for tile, rows in found]
        for one, other in zip(got, same, strict=True):
            for field in dataclasses.fields(Candidates):
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    path.unlink()
    with pytest.raises(InputError, match="missing or damaged"):
        next(read_returns(tmp_path, *next((tile, [rows]) for tile, rows in found)))


def test_a_tile_is_larger_than_its_halo():
    assert voxels_of_side(50.0, 0.6) == 83
    for tile_m in (0.0, 6.8, float("nan"), -3.0):
        with pytest.raises(ConfigurationError, match=r"--tile .*at least 7.2 m"):
            voxels_of_side(tile_m, 0.6)
