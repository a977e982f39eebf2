"""Point cloud files: round trips in every format, the layouts of other programs, and files that
must be refused.
"""

import struct

import numpy as np
import pytest

from ladar_volume.io.pointfiles import lzf
from ladar_volume.io.pointfiles.cloud_files import (
    ENCODINGS,
    check_output,
    read_cloud,
    write_cloud,
)
from ladar_volume.io.pointfiles.pcd import ENCODINGS as PCD_ENCODINGS
from ladar_volume.model.errors import CloudError, InputError, LadarVolumeError, OutputError

EVERY = [(ending, encoding) for ending, encodings in ENCODINGS.items() for encoding in encodings]
REASONS = ("outlier", "few_neighbours", "beyond_edge")


def cloud(n=57, seed=0):
    """Points at map coordinates, with everything the filter gives."""
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(n, 3))
    columns = {
        "normal": normal / np.linalg.norm(normal, axis=1, keepdims=True),
        "sigma": rng.random(n) * 0.01,
        "index": rng.permutation(10 * n)[:n].astype(np.int64),
        "reason": rng.integers(0, 3, n),
    }
    return rng.random((n, 3)) * [300.0, 200.0, 40.0] + [499_000.0, 5_432_000.0, 250.0], columns


@pytest.mark.parametrize("ending,encoding", EVERY)
def test_round_trip_keeps_every_bit_and_the_order(ending, encoding, tmp_path):
    r, columns = cloud()
    path = tmp_path / f"cloud{ending.upper() if encoding == 'binary_big_endian' else ending}"
    write_cloud(path, r, columns, {"reason": REASONS}, encoding)
    back = read_cloud(path)
    if ending in (".las", ".laz"):
        assert np.abs(back.r - r).max() <= 0.5001e-4
    else:
        assert np.array_equal(back.r, r)
    assert back.r.dtype == np.float64 and back.r.flags.c_contiguous and len(back) == 57
    assert np.array_equal(back.columns["normal"], columns["normal"]) and np.array_equal(
        back.columns["sigma"], columns["sigma"]
    )
    assert np.array_equal(back.columns["index"], columns["index"])
    worded = ending in (".csv", ".txt", ".xyz", ".asc", ".npy")
    expected = np.array(REASONS)[columns["reason"]] if worded else columns["reason"]
    assert np.array_equal(back.columns["reason"], expected)
    alone = read_cloud(path, columns=False)
    assert np.array_equal(alone.r, back.r) and not alone.columns
    assert sorted(p.name for p in tmp_path.iterdir()) == [path.name]


@pytest.mark.parametrize("ending,encoding", EVERY)
def test_positions_alone_and_a_single_point(ending, encoding, tmp_path):
    for r in (np.array([[1.0, -2.0, 3.5]]), np.array([[1e-5, 0.0, -0.0], [0.1, 1 / 3, 2e5]])):
        write_cloud(tmp_path / f"c{ending}", r, encoding=encoding)
        back = read_cloud(tmp_path / f"c{ending}")
        np.testing.assert_allclose(
            back.r, r, rtol=0, atol=0.5001e-4 if ending in (".las", ".laz") else 0
        )
        assert ending in (".las", ".laz") or not back.columns


@pytest.mark.parametrize("ending,encoding", EVERY)
def test_no_point_is_written_and_read_as_none(ending, encoding, tmp_path):
    r, columns = cloud(3)
    write_cloud(
        tmp_path / f"c{ending}",
        r[:0],
        {k: v[:0] for k, v in columns.items()},
        {"reason": REASONS},
        encoding,
    )
    with pytest.raises(CloudError) as caught:
        read_cloud(tmp_path / f"c{ending}")
    assert caught.value.reason == "cloud_empty"


@pytest.mark.parametrize("ending,encoding", [e for e in EVERY if e[0] in (".ply", ".pcd")])
def test_open3d_reads_what_is_written(ending, encoding, tmp_path):
    o3d = pytest.importorskip("open3d")
    r, columns = cloud()
    write_cloud(tmp_path / f"c{ending}", r, columns, {"reason": REASONS}, encoding)
    seen = o3d.t.io.read_point_cloud(str(tmp_path / f"c{ending}")).point
    assert np.array_equal(seen["positions"].numpy(), r) and np.array_equal(
        seen["normals"].numpy(), columns["normal"]
    )


@pytest.mark.parametrize(
    "name,options", [("c.pcd", {"compressed": True}), ("c.pcd", {}), ("c.ply", {})]
)
def test_what_open3d_writes_is_read(name, options, tmp_path):
    o3d = pytest.importorskip("open3d")
    r, columns = cloud(3000)
    pc = o3d.t.geometry.PointCloud()
    # one width throughout: packing several corrupts its memory
    r, columns["normal"] = r.astype(np.float32), columns["normal"].astype(np.float32)
    pc.point["positions"] = o3d.core.Tensor(r)
    pc.point["normals"] = o3d.core.Tensor(columns["normal"])
    pc.point["intensity"] = o3d.core.Tensor(np.arange(3000, dtype=np.float32)[:, None])
    assert o3d.t.io.write_point_cloud(str(tmp_path / name), pc, **options)
    back = read_cloud(tmp_path / name)
    assert np.array_equal(back.r, r) and np.array_equal(back.columns["normal"], columns["normal"])
    assert np.array_equal(back.columns["intensity"], np.arange(3000))


@pytest.mark.parametrize(
    "name,text,columns",
    [
        ("a.xyz", "1 2 3\n4 5 6\n", {}),
        ("a.txt", "\n# made by hand\n  1\t2   3 \n\n# again\n4 5 6", {}),
        ("a.csv", "1,2,3\n4, 5 ,6\r\n", {}),
        ("a.csv", "X;Y;Z\r\n1;2;3\r\n4;5;6\r\n", {}),
        (
            "a.csv",
            '\ufeff"z","x","y","class"\n3,1,2,tree\n6,4,5,"bench, small"\n',
            {"class": ["tree", "bench, small"]},
        ),
        ("a.asc", "//X Y Z Intensity\n1 2 3 7\n4 5 6 8\n", {"Intensity": [7, 8]}),
        ("a.xyz", "1 2 3 0.5 9\n4 5 6 1e-3 -1\n", {"c3": [0.5, 1e-3], "c4": [9, -1]}),
        ("a.txt", "x y z nx ny nz\n1 2 3 0 0 1\n4 5 6 0 1 0\n", {"normal": [[0, 0, 1], [0, 1, 0]]}),
    ],
)
def test_the_tables_of_other_programs(name, text, columns, tmp_path):
    (tmp_path / name).write_bytes(text.encode())
    back = read_cloud(tmp_path / name)
    assert back.r.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert {k: v.tolist() for k, v in back.columns.items()} == columns


def test_arrays_without_names(tmp_path):
    for dtype in ("<f4", ">f8", "i2"):
        np.save(tmp_path / "a.npy", np.array([[1, 2, 3, 9], [4, 5, 6, 8]], dtype))
        back = read_cloud(tmp_path / "a.npy")
        assert back.r.tolist() == [[1, 2, 3], [4, 5, 6]] and back.columns["c3"].tolist() == [9, 8]
    np.save(tmp_path / "a.npy", np.asfortranarray(np.arange(30.0).reshape(10, 3)))
    assert np.array_equal(read_cloud(tmp_path / "a.npy").r, np.arange(30.0).reshape(10, 3))


def test_ply_with_faces_comments_and_elements_before_the_vertices(tmp_path):
    head = (
        "ply\r\nformat ascii 1.0\r\ncomment x\r\nelement camera 1\r\nproperty float "
        "f\r\nelement vertex 2\r\nproperty float x\r\nproperty float y\r\n"
    )
    body = (
        "property float z\r\nproperty uchar red\r\nelement face 1\r\nproperty list uchar int "
        "vertex_indices\r\nend_header\r\n50\r\n1 2 3.1 255\r\n4 5 6 0\r\n3 0 1 0\r\n"
    )
    (tmp_path / "a.ply").write_bytes((head + body).encode())
    back = read_cloud(tmp_path / "a.ply")
    assert back.r.tolist() == [[1, 2, 3.1], [4, 5, 6]] and back.columns["red"].tolist() == [255, 0]
    vertices = struct.pack("<dffffB", 9.0, 1, 2, 3, 0.5, 7)
    head = (
        "ply\nformat binary_little_endian 1.0\nelement camera 1\nproperty double f\nelement "
        "vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty float "
        "q\nproperty uchar red\nelement face 1\nproperty list uchar int v\nend_header\n"
    )
    (tmp_path / "a.ply").write_bytes(head.encode() + vertices + b"\x03" + bytes(12))
    back = read_cloud(tmp_path / "a.ply")
    assert (
        back.r.tolist() == [[1, 2, 3]]
        and back.columns["q"].tolist() == [0.5]
        and back.columns["red"].tolist() == [7]
    )


def test_organised_pcd_with_padding_and_vectors(tmp_path):
    head = (
        "# .PCD v.7\nVERSION .7\nFIELDS x y z _ hist _\nSIZE 4 4 4 1 4 1\nTYPE F F F U F "
        "U\nCOUNT 1 1 1 4 2 2\nWIDTH 2\nHEIGHT 2\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA "
        "binary\n"
    )
    rows = b"".join(struct.pack("<3f4x2f2x", i, i + 1, i + 2, 10 * i, 20 * i) for i in range(4))
    (tmp_path / "a.pcd").write_bytes(head.encode() + rows)
    back = read_cloud(tmp_path / "a.pcd")
    assert back.r.tolist() == [[i, i + 1, i + 2] for i in range(4)]
    assert back.columns["hist"].tolist() == [[10 * i, 20 * i] for i in range(4)] and list(
        back.columns
    ) == ["hist"]
    write_cloud(tmp_path / "b.csv", back.r, back.columns)
    assert list(read_cloud(tmp_path / "b.csv").columns) == ["hist_0", "hist_1"]


@pytest.mark.parametrize("ending,encoding", [e for e in EVERY if e[0] not in (".las", ".laz")])
def test_coordinates_that_are_not_finite_are_counted(ending, encoding, tmp_path):
    r, columns = cloud()
    r[[3, 4, 40], [0, 1, 2]] = np.nan, np.inf, -np.inf
    r[4, 2] = np.nan
    write_cloud(tmp_path / f"c{ending}", r, columns, encoding=encoding)
    with pytest.raises(CloudError, match="3 of 57 points") as caught:
        read_cloud(tmp_path / f"c{ending}")
    assert caught.value.reason == "cloud_not_finite" and caught.value.value == 3


@pytest.mark.parametrize("ending,encoding", EVERY)
def test_a_file_cut_anywhere_never_passes_for_a_whole_one(ending, encoding, tmp_path):
    r, columns = cloud(20)
    path, cut = tmp_path / f"c{ending}", tmp_path / f"cut{ending}"
    write_cloud(path, r, columns, {"reason": REASONS}, encoding)
    whole = path.read_bytes()
    text = ending in (".csv", ".txt", ".xyz", ".asc")
    for size in [*range(0, len(whole) - 1, 41), len(whole) - 2]:
        cut.write_bytes(whole[:size])
        try:
            back = read_cloud(cut)
        except CloudError as error:
            assert "cut" in str(error)
        else:
            # a table does not say how long it is, and a last number may have lost digits without a
            # trace; what is there keeps its row
            assert text or encoding == "ascii"
            k = len(back) - 1
            assert np.array_equal(back.r[:k], r[:k]) and (text or len(back) == 20)


@pytest.mark.parametrize("ending,encoding", EVERY)
def test_damaged_bytes_give_a_typed_error_or_points(ending, encoding, tmp_path):
    r, columns = cloud(20)
    path, bad = tmp_path / f"c{ending}", tmp_path / f"bad{ending}"
    write_cloud(path, r, columns, {"reason": REASONS}, encoding)
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    # sizes inside the packed points of LAZ make its decompressor ask for gigabytes, if only for a
    # moment: not in a test
    head = min(400, len(whole))
    reach = head if ending == ".laz" else len(whole)
    for k in range(150):
        damaged = bytearray(whole)
        for _ in range(1 + k % 3):
            damaged[rng.integers(0, reach if k % 2 else head)] = rng.integers(0, 256)
        bad.write_bytes(damaged)
        try:
            back = read_cloud(bad)
        except LadarVolumeError as error:
            assert "bad" in str(error)
        else:
            assert np.isfinite(back.r).all() and back.r.ndim == 2


@pytest.mark.parametrize("ending", list(ENCODINGS))
def test_missing_empty_and_foreign_files(ending, tmp_path):
    path = tmp_path / f"c{ending}"
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    assert caught.value.reason == "input_missing" and str(path) in str(caught.value)
    path.write_bytes(b"")
    with pytest.raises(CloudError) as caught:
        read_cloud(path)
    assert caught.value.reason == "cloud_empty"
    for garbage in (
        b"\x00" * 500,
        b"\xff\xfe\x00" * 3000,
        b"\n" * 50,
        b"ply\n",
        b"hello\nworld\n",
        b"LASF" + b"\xff" * 600,
        b"x" * 300_000,
    ):
        path.write_bytes(garbage)
        with pytest.raises(CloudError):
            read_cloud(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError) as caught:
        read_cloud(path)
    assert caught.value.reason == "input_unreadable"


PLY = "ply\nformat {} 1.0\nelement vertex {}\n{}end_header\n{}"
XYZ = "property float x\nproperty float y\nproperty float z\n"
PCD = "FIELDS {}\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {}\nHEIGHT 1\nPOINTS {}\nDATA {}\n{}"


@pytest.mark.parametrize(
    "name,text,reason",
    [
        ("a.ply", PLY.format("ascii", 0, XYZ, ""), "cloud_empty"),
        ("a.ply", PLY.format("ascii", 2, XYZ, "1 2 3\n"), "cloud_short"),
        ("a.ply", PLY.format("ascii", 2, XYZ, "1 2 3\n4 5\n6\n"), "cloud_values"),
        ("a.ply", PLY.format("ascii", 1, XYZ, "1 2 3 4\n"), "cloud_values"),
        ("a.ply", PLY.format("ascii", 10**15, XYZ, "1 2 3\n"), "cloud_short"),
        ("a.ply", PLY.format("binary_little_endian", 10**15, XYZ, "1 2 3\n"), "cloud_short"),
        ("a.ply", PLY.format("binary_little_endian", -1, XYZ, ""), "cloud_header"),
        ("a.ply", PLY.format("binary", 1, XYZ, ""), "cloud_header"),
        (
            "a.ply",
            PLY.format("ascii", 1, "property float x\nproperty float y\n", "1 2\n"),
            "cloud_fields",
        ),
        ("a.ply", PLY.format("ascii", 1, XYZ + "property float x\n", "1 2 3 4\n"), "cloud_fields"),
        (
            "a.ply",
            PLY.format("ascii", 1, XYZ + "property list uchar int v\n", "1 2 3 1 4\n"),
            "cloud_fields",
        ),
        ("a.ply", PLY.format("ascii", 1, XYZ + "property quad v\n", "1 2 3 4\n"), "cloud_header"),
        ("a.ply", "ply\nformat ascii 1.0\nelement face 0\nend_header\n", "cloud_header"),
        ("a.pcd", PCD.format("x y z", 0, 0, "ascii", ""), "cloud_empty"),
        ("a.pcd", PCD.format("x y z", 2, 3, "ascii", "1 2 3\n"), "cloud_header"),
        ("a.pcd", PCD.format("x y z", 10**14, 10**14, "binary", "1 2 3\n"), "cloud_short"),
        (
            "a.pcd",
            PCD.format("x y z", 10**9, 10**9, "binary_compressed", "\1\0\0\0\0\0\0\0\0"),
            "cloud_header",
        ),
        (
            "a.pcd",
            PCD.format("x y z", 1, 1, "binary_compressed", "\x0f\0\0\0\x0c\0\0\0ab"),
            "cloud_short",
        ),
        (
            "a.pcd",
            PCD.format("x y z", 1, 1, "binary_compressed", "\2\0\0\0\x0c\0\0\0\x41\x42"),
            "cloud_values",
        ),
        ("a.pcd", PCD.format("x y w", 1, 1, "ascii", "1 2 3\n"), "cloud_fields"),
        ("a.pcd", PCD.format("x y x", 1, 1, "ascii", "1 2 3\n"), "cloud_fields"),
        ("a.pcd", PCD.format("x y", 1, 1, "ascii", "1 2\n"), "cloud_header"),
        ("a.pcd", PCD.format("x y z", 1, 1, "zipped", "1 2 3\n"), "cloud_header"),
        ("a.xyz", "1 2\n3 4\n", "cloud_fields"),
        ("a.xyz", "1 2 3\n4 5\n", "cloud_values"),
        ("a.xyz", "1 2 3\n4 5 six\n", "cloud_values"),
        ("a.csv", "x,y,z\n1,2,\n", "cloud_values"),
        ("a.csv", "x,y,z\n", "cloud_empty"),
        ("a.csv", "x,y,z,s\n1,2,3\n", "cloud_fields"),
        ("a.csv", "x,y,z,x\n1,2,3,4\n", "cloud_fields"),
        ("a.csv", "east,north,up\n1,2,3\n", "cloud_fields"),
        ("a.csv", "x,y,z\n1,2,3\n# note\n", None),
    ],
)
def test_contents_that_make_no_sense(name, text, reason, tmp_path):
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    if reason is None:
        assert len(read_cloud(tmp_path / name)) == 1
        return
    with pytest.raises(CloudError) as caught:
        read_cloud(tmp_path / name)
    assert caught.value.reason == reason and str(caught.value).startswith(str(tmp_path / name))


def test_arrays_that_make_no_cloud(tmp_path):
    arrays = [
        np.zeros(3),
        np.zeros((3, 2)),
        np.zeros((2, 3), complex),
        np.array([["a", "b", "c"]]),
        np.zeros((0, 3)),
        np.zeros(2, [("x", "f8")]),
    ]
    for array in [*arrays, np.array([[1, 2, None]], object)]:
        np.save(tmp_path / "a.npy", array, allow_pickle=True)
        with pytest.raises(CloudError):
            read_cloud(tmp_path / "a.npy")


def test_unknown_kinds_and_what_cannot_be_written(tmp_path):
    r, columns = cloud(4)
    for name in ("a.fls", "a", "a.ply.gz"):
        with pytest.raises(InputError) as caught:
            read_cloud(tmp_path / name)
        assert caught.value.reason == "input_format" and ".laz" in str(caught.value)
        with pytest.raises(OutputError):
            write_cloud(tmp_path / name, r)
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.ply").mkdir()
    for path in (tmp_path / "none" / "a.ply", tmp_path / "file" / "a.csv", tmp_path / "folder.ply"):
        for function in (check_output, lambda path: write_cloud(path, r, columns)):
            with pytest.raises(OutputError, match="cannot be written"):
                function(path)
    assert check_output(tmp_path / "a.laz") == tmp_path / "a.laz"
    bad = [
        {"r": r[:, :2]},
        {"r": r, "columns": {"s": np.zeros(3)}},
        {"r": r, "columns": {"a b": np.zeros(4)}},
        {"r": r, "columns": {"s": np.array(list("abcd"))}},
        {"r": r, "columns": {"s": np.full(4, 2**60)}},
        {"r": r, "encoding": "zip"},
    ]
    for options in bad:
        with pytest.raises(OutputError):
            write_cloud(tmp_path / "a.ply", **options)
    with pytest.raises(OutputError, match="separator"):
        write_cloud(
            tmp_path / "a.csv", r, {"reason": np.zeros(4, int)}, {"reason": ("too far, really",)}
        )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder.ply"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    r, _ = cloud(4)
    write_cloud(tmp_path / "a.csv", r)
    before = (tmp_path / "a.csv").read_bytes()
    with pytest.raises(OutputError):
        write_cloud(tmp_path / "a.csv", r, {"reason": np.zeros(4, int)}, {"reason": ("a b",)})
    assert (tmp_path / "a.csv").read_bytes() == before


def packable():
    rng = np.random.default_rng(2)
    yield from (rng.integers(0, 256, n, np.uint8) for n in (0, 1, 2, 3, 31, 32, 33, 1000))
    yield from (np.zeros(n, np.uint8) for n in (3, 4, 263, 264, 265, 266, 267, 9000))
    yield np.tile(rng.integers(0, 256, 300, np.uint8), 20)
    block = rng.integers(0, 256, 8200, np.uint8)
    yield from (np.concatenate([block[:gap], block[:50]]) for gap in (8190, 8191, 8192, 8193, 8200))
    yield np.sort(rng.integers(0, 4, 3000)).astype("<u4").view(np.uint8)


def unpacked(data, most):
    """LZF as its author describes it: literals, or a copy of what came before; None if broken."""
    out, data = bytearray(), data.tolist()
    while data:
        control = data.pop(0)
        if control < 32:
            count = control + 1
            if count > len(data):
                return None
            out += bytes(data[:count])
            del data[:count]
        else:
            count, need = control >> 5, 2 if control >> 5 == 7 else 1
            if len(data) < need:
                return None
            count += 2 + (data.pop(0) if need == 2 else 0)
            back = ((control & 31) << 8) + data.pop(0) + 1
            if back > len(out):
                return None
            for _ in range(count):
                out.append(out[-back])
        if len(out) > most:
            return None
    return bytes(out)


def test_compression_is_lossless_and_as_its_author_describes_it():
    for data in packable():
        packed = lzf.pack(data)
        assert len(packed) <= len(data) * 33 // 32 + 1
        assert unpacked(packed, len(data)) == data.tobytes()
        size, out = lzf.unpack(packed, len(data))
        assert size == len(data) and np.array_equal(out, data)
        for wrong in (len(data) + 1, max(len(data) - 1, 0)):
            assert wrong == len(data) or lzf.unpack(packed, wrong)[0] == -1
    assert len(lzf.pack(np.zeros(264 * 100, np.uint8))) < 400
    rng = np.random.default_rng(3)
    for k in range(300):
        data = rng.integers(0, 256, 1 + k % 40, np.uint8)
        (size, out), expected = lzf.unpack(data, 60), unpacked(data, 60)
        assert size == (-1 if expected is None else len(expected))
        assert expected is None or out[:size].tobytes() == expected


def test_codes_are_explained_where_words_cannot_be_kept(tmp_path):
    r, columns = cloud(4)
    for name in ("a.ply", "a.pcd", "a.las"):
        write_cloud(tmp_path / name, r, columns, {"reason": REASONS})
        assert (
            b"reason: 0 outlier, 1 few_neighbours, 2 beyond_edge" in (tmp_path / name).read_bytes()
        )
    assert set(PCD_ENCODINGS) == set(ENCODINGS[".pcd"])


def test_wide_clouds_fit_into_las(tmp_path):
    r = np.array([[-9e6, 0.0, -1e3], [9e6, 1.0, 4e3], [1.23456, 0.5, 0.0]])
    write_cloud(tmp_path / "a.las", r)
    np.testing.assert_allclose(read_cloud(tmp_path / "a.las").r, r, rtol=0, atol=0.01)
