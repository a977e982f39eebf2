"""Point clouds as other programs write them: headers, separators, decimal commas, missing returns,
float32, damaged and hostile files.
"""

import json
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import Reading, read_cloud, write_cloud
from ladar_volume.io.pointfiles.units import METRE
from ladar_volume.model.errors import CloudError, InputError, LadarVolumeError

ROWS = [[1.25, 2.5, 3.75], [4.0, 5.5, 6.125]]


def written(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    "header,order",
    [
        ("Easting;Northing;Height", "xyz"),
        ("Northing;Easting;Height", "yxz"),
        ("N;E;H", "yxz"),
        ("E;N;H", "xyz"),
        ("X[m];Y[m];Z[m]", "xyz"),
        ("X [m];Y [m];Z [m]", "xyz"),
        ("Rechtswert;Hochwert;Höhe", "xyz"),
        ("Hochwert;Rechtswert;Hoehe", "yxz"),
        ("Elevation;Easting;Northing", "zxy"),
        ('"x";"y";"z"', "xyz"),
        ("//X;Y;Z", "xyz"),
        ("# y;x;z", "yxz"),
    ],
)
@pytest.mark.parametrize("separator", [";", ",", "\t", " "])
@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("end,mark", [("\n", ""), ("\r\n", "\ufeff")])
def test_headers_in_any_order(header, order, separator, comma, end, mark, tmp_path):
    if comma and separator == ",":
        return
    lines = [header.replace(";", separator)]
    for row in ROWS:
        words = [f"{row['xyz'.index(axis)]}" for axis in order]
        lines.append(separator.join(words).replace(".", "," if comma else "."))
    back = read_cloud(written(tmp_path / "a.csv", mark + end.join(lines) + end))
    assert back.r.tolist() == ROWS and not back.columns


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_umlauts_of_either_encoding(encoding, tmp_path):
    text = "Rechtswert;Hochwert;Höhe\n1,25;2,5;3,75\n4;5,5;6,125\n"
    assert read_cloud(written(tmp_path / "a.txt", text.encode(encoding))).r.tolist() == ROWS


@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(
        st.tuples(*[st.floats(-1e7, 1e7).map(lambda v: round(v, 3))] * 4), min_size=1, max_size=20
    ),
    separator=st.sampled_from([";", "\t", " "]),
    named=st.booleans(),
)
def test_decimal_commas_read_as_the_numbers_they_are(rows, separator, named, tmp_path_factory):
    path = tmp_path_factory.mktemp("t") / "a.txt"
    lines = ["E;N;H;i".replace(";", separator)] if named else []
    lines += [separator.join(f"{v:.3f}".replace(".", ",") for v in row) for row in rows]
    back = read_cloud(written(path, "\n".join(lines)), reading=Reading(None, *[METRE] * 2))
    assert np.array_equal(back.r, np.array(rows)[:, :3])
    assert np.array_equal(next(iter(back.columns.values())), np.array(rows)[:, 3])


@pytest.mark.parametrize(
    "text,words",
    [
        ("x,y,z\n1,2,3\n1,2\n", "line 3: 2 columns where there are 3"),
        ("x,y,z\n1,2,3\n\n1,2,3,4\n", "line 4: 4 columns"),
        ("x;y;z\n1,5;2;3\n1,5;2.x;3\n", "line 3: y is no number: '2.x'"),
        ("1 2 3\n" * 5000 + "1 2 three\n", "line 5001: z is no number"),
        ("Easting,Northing,Height,Elevation\n1,2,3,4\n", "height and elevation may both be z"),
        ("1,5, 2,5, 3,5\n", "commas between numbers and within"),
        ("a,b,c\n1,2,3\n", "neither numbers nor a header"),
        ("x[m],y[ft],z[m]\n1,2,3\n", "x is in metre, y in international foot"),
    ],
)
def test_rows_that_do_not_fit_are_named_by_their_line(text, words, tmp_path):
    with pytest.raises(CloudError) as caught:
        read_cloud(written(tmp_path / "a.csv", text))
    assert words.lower() in str(caught.value).lower()
    assert "\n" not in str(caught.value) and len(str(caught.value)) <= 300


def test_units_in_the_header(tmp_path):
    path = written(tmp_path / "a.csv", "E [mm];N [mm];H [ft]\n1000;2000;10\n0;0;0\n")
    back = read_cloud(path)
    assert back.r[0].tolist() == pytest.approx([1.0, 2.0, 3.048])
    with pytest.raises(InputError, match="millimetre for x and y, --units says metre"):
        read_cloud(path, reading=Reading(None, METRE, METRE))


def test_the_step_of_the_numbers(tmp_path):
    path = written(tmp_path / "a.xyz", "1.25 2.5 3\n1.1 2.0 30\n")
    assert read_cloud(path).resolution_m == pytest.approx([0.01, 0.1, 1.0])
    write_cloud(tmp_path / "a.ply", np.random.default_rng(0).random((50, 3)))
    assert read_cloud(tmp_path / "a.ply").resolution_m is None


def organised(path, r, data="binary"):
    """A PCD of 4 rows."""
    head = "FIELDS x y z i\nSIZE 4 4 4 2\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    head += "WIDTH {}\nHEIGHT 4\nPOINTS {}\nDATA {}\n"
    head = head.format(len(r) // 4, len(r), data).encode()
    if data == "ascii":
        rows = "".join(f"{x} {y} {z} {k}\n" for k, (x, y, z) in enumerate(r.tolist())).encode()
    else:
        rows = b"".join(struct.pack("<3fH", *p, k) for k, p in enumerate(r.tolist()))
    return written(path, head + rows)


@pytest.mark.parametrize("data", ["binary", "ascii"])
def test_missing_returns_are_left_out_and_rows_kept(data, tmp_path):
    r = np.round(np.random.default_rng(0).random((40, 3)), 2)
    r[[3, 17, 39]] = np.nan
    r[20, 2] = np.nan
    back = read_cloud(organised(tmp_path / "a.pcd", r, data))
    keep = np.isfinite(r).all(axis=1)
    assert back.left_out == {"no return (NaN)": 4} and len(back) == 36
    assert np.array_equal(back.rows, np.flatnonzero(keep))
    assert np.array_equal(back.columns["i"], np.flatnonzero(keep))
    np.testing.assert_allclose(back.r, r[keep], atol=1e-7)
    r[5, 0] = np.inf
    with pytest.raises(CloudError, match="infinite") as caught:
        read_cloud(organised(tmp_path / "a.pcd", r, data))
    assert caught.value.reason == "cloud_not_finite"
    with pytest.raises(CloudError, match="all 40 points are without a return"):
        read_cloud(organised(tmp_path / "a.pcd", np.full((40, 3), np.nan), data))


@pytest.mark.parametrize("ending", [".ply", ".npy", ".csv"])
def test_missing_returns_and_the_index_of_the_filter(ending, tmp_path, capsys):
    rng = np.random.default_rng(0)
    r = np.c_[rng.random((600, 2)) * 4.0, rng.normal(0.0, 0.003, 600)]
    r[::5] = np.nan
    write_cloud(tmp_path / f"a{ending}", r, {"ring": np.arange(600)})
    words = ["filter", tmp_path / f"a{ending}", "-o", tmp_path / "o.ply", "--radius", 0.5, "--json"]
    assert main([str(w) for w in words]) == 0
    assert json.loads(capsys.readouterr().out)["reading"]["left_out"] == {"no return (NaN)": 120}
    back = read_cloud(tmp_path / "o.ply")
    index = back.columns["index"]
    assert np.array_equal(back.columns["ring"], index) and not (index % 5 == 0).any()
    assert np.abs(back.r - r[index]).max() < 0.05


def utm(n, seed=0, wide=40.0):
    rng = np.random.default_rng(seed)
    return np.c_[rng.random((n, 2)) * wide, rng.normal(0.0, 0.01, n)] + [499_000, 5_432_000, 250]


@pytest.mark.parametrize("ending", [".npy", ".ply"])
@pytest.mark.parametrize("stored", ["f4", "f8"])
def test_float32_far_from_the_origin(ending, stored, tmp_path):
    def save(r):
        columns = r.astype("f4").astype(stored)
        if ending == ".npy":
            np.save(tmp_path / "a.npy", columns)
        else:
            code = {"f4": "float", "f8": "double"}[stored]
            head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(r)}\n"
            head += "".join(f"property {code} {a}\n" for a in "xyz") + "end_header\n"
            written(tmp_path / "a.ply", head.encode() + columns.astype(f"<{stored}").tobytes())
        return read_cloud(tmp_path / f"a{ending}")

    with pytest.raises(CloudError, match=r"steps of 0.5 m in y.*export the coordinates as double"):
        save(utm(16_000))
    back = save(utm(50))  # 5 m apart: half a metre is coarse, not hopeless
    assert back.resolution_m[:2] == pytest.approx([0.03125, 0.5])
    assert [d.name for d in back.doubts] == ["float32_step"]
    assert not save(utm(5000) - [499_000, 5_432_000, 0]).doubts
    grid = np.stack(np.meshgrid(*[np.arange(60.0)] * 2), axis=-1).reshape(-1, 2)
    r = np.c_[np.add(grid, [499_000, 5_432_000]), np.random.default_rng(0).random(3600)]
    assert len(save(r)) == 3600  # a raster of whole metres loses nothing


def test_a_raster_of_whole_metres_as_text(tmp_path):
    grid = np.stack(np.meshgrid(*[np.arange(30.0)] * 2), axis=-1).reshape(-1, 2)
    z = np.random.default_rng(0).random(900)
    rows = [
        f"{x:.0f} {y:.0f} {h:.2f}"
        for (x, y), h in zip(np.add(grid, [499_000, 5_432_000]), z, strict=True)
    ]
    back = read_cloud(written(tmp_path / "a.xyz", "\n".join(rows)))
    assert back.resolution_m == pytest.approx([1.0, 1.0, 0.01]) and not back.doubts


def test_six_digits_of_map_coordinates(tmp_path):
    np.savetxt(tmp_path / "a.xyz", utm(2000), fmt="%.6g")
    with pytest.raises(CloudError, match="more decimals"):
        read_cloud(tmp_path / "a.xyz")


PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 {}\nWIDTH {}\nHEIGHT 1\nPOINTS {}\nDATA {}\n"


def test_hostile_headers_and_numbers(tmp_path):
    bomb = PCD.format(1, 350_000_000, 350_000_000, "binary_compressed").encode()
    packed = 50_000_000
    with (tmp_path / "bomb.pcd").open("wb") as file:  # sparse: takes no space
        file.write(bomb + struct.pack("<II", packed, 4_200_000_000))
        file.truncate(len(bomb) + 8 + packed)
    with zipfile.ZipFile(tmp_path / "zip.npy", "w") as archive:
        archive.writestr("a.txt", "1 2 3")
    written(tmp_path / "half.npy", (tmp_path / "zip.npy").read_bytes()[:40])
    for count in (10**9, 10**30, 2**31 - 1):
        written(tmp_path / f"c{count}.pcd", PCD.format(count, 1, 1, "binary"))
        written(tmp_path / f"d{count}.pcd", PCD.format(count, 1, 1, "ascii") + "1 2 3\n")
    np.save(tmp_path / "far.npy", np.random.default_rng(0).random((10, 3)) * 1e160)
    written(tmp_path / "far.xyz", "1e200 2 3\n1 2 3\n1 2 4\n5 6 7\n")
    written(tmp_path / "huge.xyz", "1e999 2 3\n1 2 3\n")
    np.save(tmp_path / "big.npy", np.full((4, 3), 2**63 - 1))
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty list float float a\n"
    head += "".join(f"property float {a}\n" for a in "xyz") + "end_header\n"
    written(tmp_path / "list.ply", head + "nan 1 2 3\n" * 3)
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(LadarVolumeError) as caught:
            read_cloud(path)
        assert "\n" not in str(caught.value) and len(str(caught.value)) <= 300, path


@settings(max_examples=80, deadline=None)
@given(
    data=st.binary(max_size=400),
    ending=st.sampled_from([".pcd", ".ply", ".npy", ".las", ".laz", ".csv", ".xyz"]),
)
def test_any_bytes_are_points_or_one_typed_line(data, ending, tmp_path_factory):
    heads = {
        ".pcd": PCD.format(1, 2, 2, "ascii").encode(),
        ".ply": b"ply\nformat ascii 1.0\n",
        ".npy": b"\x93NUMPY\x01\x00",
        ".las": b"LASF",
        ".laz": b"LASF",
        ".csv": b"x,y,z\n",
        ".xyz": b"# E N H\n",
    }
    path = tmp_path_factory.mktemp("b") / f"a{ending}"
    path.write_bytes(heads[ending] + data)
    try:
        assert np.isfinite(read_cloud(path).r).all()
    except LadarVolumeError as error:
        assert "\n" not in str(error) and len(str(error)) <= 300


@pytest.mark.parametrize("length", ["nan", "-1", "1e300", "2.5", "inf"])
def test_lists_of_impossible_length_in_a_mesh(length, tmp_path, capsys):
    head = "ply\nformat ascii 1.0\nelement vertex 3\n"
    head += "".join(f"property float {a}\n" for a in "xyz")
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = written(tmp_path / "a.ply", head + f"0 0 0\n1 0 0\n0 1 0\n{length} 0 1 2\n")
    assert main(["body", str(path), "-o", str(tmp_path / "o.ply")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
