"""E57: scans with poses, attributes and points without a return; damaged files."""

from unittest import mock

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.model.errors import CloudError, InputError

pye57 = pytest.importorskip("pye57", reason="pye57 is not installed")

#: About the z axis by 30°, w x y z; and a place at map coordinates.
TURN = np.array([np.cos(np.pi / 12), 0.0, 0.0, np.sin(np.pi / 12)])
PLACE = np.array([500_000.0, 5_000_000.0, 100.0])


def scans(count=2, n=300):
    rng = np.random.default_rng(4)
    return [
        {
            "cartesianX": rng.uniform(-9.0, 9.0, n),
            "cartesianY": rng.uniform(-9.0, 9.0, n),
            "cartesianZ": rng.normal(0.0, 0.01, n),
            "intensity": rng.random(n).astype(np.float32),
            **{
                f"color{name}": rng.integers(0, 256, n).astype(np.uint8)
                for name in ("Red", "Green", "Blue")
            },
            "cartesianInvalidState": (np.arange(n) % 50 == 7).astype(np.int8),
        }
        for _ in range(count)
    ]


def written(path, data, crs=""):
    node = pye57.libe57.StringNode
    with mock.patch.object(pye57.libe57, "StringNode", lambda file, text: node(file, text or crs)):
        file = pye57.E57(str(path), mode="w")  # whose one empty text is coordinateMetadata
    for scan in data:
        file.write_scan_raw(scan, rotation=TURN, translation=PLACE)
    file.close()
    return path


def expected(data):
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    r = np.concatenate([np.c_[d["cartesianX"], d["cartesianY"], d["cartesianZ"]] for d in data])
    keep = np.concatenate([d["cartesianInvalidState"] == 0 for d in data])
    return r[keep] @ R.T + PLACE, keep


def test_scans_come_in_one_frame_with_their_attributes(tmp_path):
    data = scans()
    cloud = read_cloud(written(tmp_path / "a.e57", data))
    r, keep = expected(data)
    assert np.abs(cloud.r - r).max() < 1e-6  # pye57 writes 24 bits of 9 m, before the pose
    assert cloud.left_out == {"no return (NaN)": 12} and (cloud.rows == np.flatnonzero(keep)).all()
    assert (cloud.columns["scan"] == np.repeat([0, 1], 300)[keep]).all()
    red = np.concatenate([d["colorRed"] for d in data])[keep]
    assert (cloud.columns["red"] == red).all() and cloud.columns["red"].dtype.kind == "i"
    intensity = np.concatenate([d["intensity"] for d in data])[keep]
    assert (cloud.columns["intensity"] == intensity).all()
    assert cloud.coordinates.words.startswith("no CRS named; units: metre")
    assert "(assumed)" not in cloud.coordinates.words  # an E57 holds metres
    # pye57's own reader places the scans alike
    own = pye57.E57(str(tmp_path / "a.e57")).read_scan(1, ignore_missing_fields=True)
    there = np.c_[own["cartesianX"], own["cartesianY"], own["cartesianZ"]]
    assert np.abs(cloud.r[-len(there) :] - there).max() < 2e-9


def test_the_system_of_the_file_is_read_and_one_that_is_not_in_metres_is_refused(tmp_path):
    import pyproj

    data = scans(1)
    for code in (25832, 2263, 4326):
        path = written(tmp_path / f"{code}.e57", data, pyproj.CRS.from_epsg(code).to_wkt())
        if code == 25832:
            assert read_cloud(path).coordinates.crs.to_epsg() == code
            continue
        with pytest.raises(InputError, match="holds metres"):
            read_cloud(path)


def test_the_verbs_take_it(tmp_path, capsys):
    path = written(tmp_path / "a.e57", scans())
    assert main(["volume", str(path), "--level", "99", "--json"]) == 0
    assert main(["filter", str(path), "-o", str(tmp_path / "b.laz"), "--radius", "2"]) == 0
    assert main(["filter", str(path), "-o", str(tmp_path / "b.e57"), "--radius", "2"]) == 2
    assert ".e57 is no known kind" in capsys.readouterr().err


def test_damaged_files_are_refused_in_one_line_and_stay(tmp_path, capsys):
    good = written(tmp_path / "a.e57", scans()).read_bytes()
    rng = np.random.default_rng(0)
    damaged = [good[:k] for k in (4, 48, 1024, len(good) // 2, len(good) - 1)]
    damaged.append(b"ASTM-E57" + bytes(4096))
    for _ in range(12):
        bytes_ = bytearray(good)
        for place in rng.integers(48, len(good), 3):
            bytes_[place] ^= 0xFF
        damaged.append(bytes(bytes_))
    for number, content in enumerate(damaged):
        path = tmp_path / f"{number}.e57"
        path.write_bytes(content)
        with pytest.raises(CloudError):
            read_cloud(path)
        assert path.read_bytes() == content
    (tmp_path / "none.e57").write_bytes(b"")
    assert main(["volume", str(tmp_path / "none.e57"), "--level", "9"]) == 2
    assert "the file is empty" in capsys.readouterr().err
    with pytest.raises(CloudError, match="no scan"):
        read_cloud(written(tmp_path / "no.e57", []))


def test_without_pye57_the_error_names_what_to_install(tmp_path, capsys, monkeypatch):
    path = written(tmp_path / "a.e57", scans(1))
    monkeypatch.setitem(__import__("sys").modules, "pye57", None)
    assert main(["volume", str(path), "--level", "9"]) == 2
    said = capsys.readouterr().err
    assert "pip install 'ladar_volume[geo]'" in said and len(said.splitlines()) == 1
