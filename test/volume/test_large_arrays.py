"""Where large arrays lie changes no result."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from volume_surfaces import cone, platform, surface_update

from ladar_volume.math import large_arrays
from ladar_volume.math.large_arrays import in_its_room, large_arrays_in, large_zeros, taken
from ladar_volume.model.errors import OutputError
from ladar_volume.model.parameters import Parameters
from ladar_volume.uncertainty import volume_budget
from ladar_volume.uncertainty.volume_budget import vertical_sigma
from ladar_volume.volume.estimator import VolumeEstimator

pytest.importorskip("pyarrow")
from ladar_volume.tiled_replay.whole_surface import file_array


@pytest.fixture
def asked():
    """Shapes that a room was asked for, and the room."""
    shapes = []

    def room(shape, dtype):
        shapes.append((shape, np.dtype(dtype)))
        return np.zeros(shape, dtype)

    return shapes, room


def test_large_arrays_alone_lie_in_a_room_and_only_within_the_block(asked, monkeypatch):
    monkeypatch.setattr(large_arrays, "LARGE_BYTES", 80)
    shapes, room = asked
    small, large = np.arange(9.0), np.arange(10.0)
    assert large_zeros((10,)).tolist() == [0.0] * 10 and in_its_room(large) is large
    with large_arrays_in(room):
        assert large_zeros((3, 3)).shape == (3, 3) and in_its_room(small) is small
        assert shapes == []
        assert large_zeros((5, 4), np.int32).dtype == np.int32
        moved = in_its_room(large)
        assert moved is not large and np.array_equal(moved, large)
        assert shapes == [((5, 4), np.int32), ((10,), np.float64)]
    assert in_its_room(large) is large


def test_the_inner_of_two_rooms_counts_and_an_error_leaves_none(asked, monkeypatch):
    monkeypatch.setattr(large_arrays, "LARGE_BYTES", 8)
    shapes, room = asked
    inner = []
    with large_arrays_in(room), pytest.raises(OutputError):
        with large_arrays_in(lambda shape, dtype: inner.append(shape) or np.zeros(shape, dtype)):
            large_zeros((2,))
            raise OutputError("full")
    assert inner == [(2,)] and shapes == []
    large_zeros((2,))
    assert shapes == []


def test_rows_are_those_of_an_index_wherever_they_lie(asked, monkeypatch):
    monkeypatch.setattr(large_arrays, "LARGE_BYTES", 8)
    shapes, room = asked
    rng = np.random.default_rng(0)
    for array in (rng.normal(size=50), rng.normal(size=(50, 3))[:, ::2], np.arange(50, dtype="i4")):
        rows = rng.integers(-1, 50, 80)
        for one in (rows, rows[:0], rows.astype(np.int32), rows.reshape(20, 4)):
            assert np.array_equal(taken(array, one), array[one])
            with large_arrays_in(room):
                assert np.array_equal(taken(array, one), array[one])
        for wrong in ([50], [-51]):
            with pytest.raises(IndexError, match="of 50"):
                taken(array, np.array(wrong))
    assert ((80, 2), np.float64) in shapes


def estimate():
    """Of a cone on its ground."""
    p = Parameters.read({"filter": {"nav_bin_s": 1.0}})
    e = VolumeEstimator(p)
    e.add_platform(platform())
    e.add(surface_update(cone, noise=0.01))
    return e, e.estimate()


def test_an_estimate_in_files_is_that_in_memory_to_the_bit(tmp_path, monkeypatch):
    known, plain = estimate()
    monkeypatch.setattr(large_arrays, "LARGE_BYTES", 1)
    with large_arrays_in(partial(file_array, tmp_path)):
        other, found = estimate()
    assert found.volume.budget_m6 == plain.volume.budget_m6
    assert found.volume.cut_m3 == plain.volume.cut_m3 and found.volume.fill_m3
    assert found.volume.sigma_naive_m3 == plain.volume.sigma_naive_m3
    assert np.array_equal(found.tin.triangles, plain.tin.triangles)
    assert np.array_equal(found.base.C_beta, plain.base.C_beta)
    some = plain.tin.source
    sigma = vertical_sigma(known.epoch().sources, some)
    assert np.array_equal(vertical_sigma(other.epoch().sources, some), sigma)
    monkeypatch.setattr(volume_budget, "AT_ONCE", 7)
    assert np.array_equal(vertical_sigma(estimate()[0].epoch().sources, some), sigma)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_ends_the_estimate_with_its_reason(monkeypatch):
    def full(shape, dtype):
        raise OutputError("no room", reason="output_unwritable")

    monkeypatch.setattr(large_arrays, "LARGE_BYTES", 1)
    with large_arrays_in(full), pytest.raises(OutputError, match="no room"):
        estimate()
