"""Arrays of a tile at rest: read as written, damaged files told, nothing half written."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from ladar_volume.model.errors import InputError, OutputError
from ladar_volume.tiles import array_file
from ladar_volume.tiles.array_file import read, read_arrays, write, write_arrays

ARRAYS = {
    "heights": np.random.default_rng(1).normal(size=(50, 3)),
    "turned": np.arange(12.0).reshape(3, 4).T,
    "counted": np.array([True, False, True]),
    "row": np.arange(7, dtype=np.int32),
    "packed": np.arange(-8, 8, dtype=np.int8).reshape(2, 2, 4),
    "none": np.zeros((0, 4), np.float32),
    "notes": np.array('{"why": 1}'),
    "one": np.array(3.5),
}


def test_arrays_come_back_as_they_were(tmp_path):
    path = tmp_path / "new" / "one.arrays"
    write_arrays(path, ARRAYS)
    found = read_arrays(path)
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape, name
        assert np.array_equal(found[name], array), name
        assert found[name].flags.c_contiguous and found[name].flags.aligned
    assert list(read_arrays(path, ("row", "one"))) == ["row", "one"]
    assert [p.name for p in path.parent.iterdir()] == ["one.arrays"]


def test_no_array_at_all_and_one_of_a_tile(tmp_path):
    write_arrays(tmp_path / "empty.arrays", {})
    assert read_arrays(tmp_path / "empty.arrays") == {}
    write(tmp_path, "ring", (-3, 4), np.arange(3))
    assert read(tmp_path, "ring", (-3, 4)).tolist() == [0, 1, 2]


def test_what_is_read_may_be_written_to_and_the_file_stays(tmp_path):
    path = tmp_path / "one.arrays"
    write_arrays(path, ARRAYS)
    before = path.read_bytes()
    read_arrays(path)["heights"][:] = 0.0
    assert path.read_bytes() == before
    assert np.array_equal(read_arrays(path)["heights"], ARRAYS["heights"])


def test_arrays_outlive_a_file_that_is_written_anew(tmp_path):
    path = tmp_path / "one.arrays"
    write_arrays(path, {"x": np.arange(5)})
    old = read_arrays(path)["x"]
    write_arrays(path, {"x": np.arange(5) + 7})
    assert old.tolist() == [0, 1, 2, 3, 4]
    assert read_arrays(path)["x"].tolist() == [7, 8, 9, 10, 11]


def test_damage_of_any_byte_that_is_read_is_told(tmp_path):
    path = tmp_path / "one.arrays"
    write_arrays(path, ARRAYS)
    good = path.read_bytes()
    end = 24 + int.from_bytes(good[8:16], "little")
    rest = np.random.default_rng(3).integers(-(-end // 64) * 64, len(good), 150).tolist()
    for place in [*range(end), *rest]:  # a bit makes another digit of a digit
        path.write_bytes(good[:place] + bytes([good[place] ^ 0x01]) + good[place + 1 :])
        with pytest.raises(InputError, match="missing or damaged") as caught:
            read_arrays(path)
        assert caught.value.reason == "input_damaged" and caught.value.value == str(path)


@pytest.mark.parametrize("cut", [0, 5, 15, 40, 700, -1])
def test_a_file_cut_short_is_told(tmp_path, cut):
    path = tmp_path / "one.arrays"
    write_arrays(path, ARRAYS)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="missing or damaged"):
        read_arrays(path)


def test_what_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match=r"missing or damaged.*No such file"):
        read_arrays(tmp_path / "none.arrays")
    write_arrays(tmp_path / "one.arrays", ARRAYS)
    with pytest.raises(InputError, match="another"):
        read_arrays(tmp_path / "one.arrays", ("another",))


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    path = tmp_path / "one.arrays"
    write_arrays(path, {"x": np.arange(3)})

    class Full:
        def __init__(self, file):
            self.file = file

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self.file.close()

        def write(self, part):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    usual = Path.open
    monkeypatch.setattr(
        Path, "open", lambda p, mode: Full(usual(p, mode)) if mode == "wb" else usual(p, mode)
    )
    with pytest.raises(OutputError, match="No space left"):
        write_arrays(path, {"x": np.arange(4)})
    assert read_arrays(path)["x"].tolist() == [0, 1, 2]
    assert [p.name for p in tmp_path.iterdir()] == ["one.arrays"]


def test_a_checksum_is_added_up_once(tmp_path, monkeypatch):
    path, sums = tmp_path / "one.arrays", []
    write_arrays(path, ARRAYS)
    usual = array_file.zlib.crc32
    monkeypatch.setattr(array_file.zlib, "crc32", lambda *a: sums.append(1) or usual(*a))
    for _ in range(3):
        read_arrays(path, ("row",))
    assert len(sums) == 3 + 1  # that of the head each time
