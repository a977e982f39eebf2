"""Cloud-optimised LAZ: read back by laspy and by copclib, as a whole and by levels and boxes."""

import json

import laspy
import numpy as np
import pyproj
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.io.pointfiles.copc_write import LEAF_POINTS, octree_of

PLACE = np.array([552_000.0, 4_183_000.0, 50.0])


def site(path, kind=6, n=30_000, crs="EPSG:32610", wkt=True):
    """A slope of n points with attributes."""
    rng = np.random.default_rng(3)
    header = laspy.LasHeader(point_format=kind, version="1.4" if kind > 5 else "1.2")
    header.scales, header.offsets = [0.001] * 3, [552_000.0, 4_183_000.0, 0.0]
    header.add_extra_dims([laspy.ExtraBytesParams("Range to ground", "f4", "in m")])
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.vlrs.append(laspy.VLR("a firm", 7, "a word of its own", b"kept"))
    if crs:
        header.add_crs(pyproj.CRS.from_user_input(crs), keep_compatibility=not wkt)
    las = laspy.LasData(header)
    xy = rng.random((n, 2)) * [30.0, 20.0]
    las.x, las.y, las.z = (np.c_[xy, 0.1 * xy[:, 0] + rng.normal(0.0, 0.003, n)] + PLACE).T
    las.classification = rng.choice([1, 2, 6], n)
    las.intensity = rng.integers(0, 2**16, n)
    las.gps_time = 3e8 + np.sort(rng.random(n)) * 100.0
    las["Range to ground"] = rng.random(n).astype(np.float32)
    if kind < 6:
        las.scan_angle_rank = rng.integers(-90, 91, n)
    las.write(str(path))
    return path


def of_copclib(path):
    """Points by an independent reader, as x, y, z, and whether all lie where their node says."""
    copclib = pytest.importorskip("copclib", reason="copclib is not installed")
    reader = copclib.FileReader(str(path))
    points = reader.GetAllPoints()
    r = np.column_stack([points.x, points.y, points.z])
    good = reader.ValidateSpatialBounds()
    wkt = reader.copc_config.wkt
    reader.Close()
    return r, good, wkt


@pytest.mark.parametrize("kind, wkt", [(1, False), (3, True), (6, True), (7, True)])
def test_filter_writes_what_other_readers_read(kind, wkt, tmp_path, capsys):
    source = site(tmp_path / "in.las", kind, wkt=wkt)
    out, plain = tmp_path / "out.copc.laz", tmp_path / "out.las"
    for path in (out, plain):
        words = ["filter", source, "-o", path, "--radius", 0.5, "--degree", 1, "--json"]
        assert main([*map(str, words)]) == 0
        assert not json.loads(capsys.readouterr().out)["columns_lost"]
    with laspy.CopcReader.open(out) as reader:
        points, header = reader.query(), reader.header
        assert len(reader.query(level=0)) < 0.9 * len(points)
    like = laspy.read(plain)
    order, other = np.argsort(points["index"]), np.argsort(like["index"])
    for name in like.point_format.dimension_names:
        if name != "scan_angle_rank":
            assert np.array_equal(points[name][order], like[name][other]), name
    if kind < 6:
        rank = np.asarray(like.scan_angle_rank)[other]
        assert np.array_equal(np.round(points.scan_angle[order] * 0.006), rank)
    assert header.point_format.id == {1: 6, 3: 7}.get(kind, kind)
    assert header.parse_crs().to_epsg() == 32610 and header.global_encoding.wkt
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert any(v.user_id == "a firm" and v.record_data_bytes() == b"kept" for v in header.vlrs)
    r, good, words = of_copclib(out)
    assert good and "UTM zone 10N" in words and len(r) == len(like)
    assert np.allclose(np.sort(r, axis=0), np.sort(like.xyz, axis=0), atol=1e-9, rtol=0)


def test_a_box_is_all_points_in_it(tmp_path):
    rng = np.random.default_rng(5)
    r = rng.random((150_000, 3)) * [40.0, 25.0, 8.0] + PLACE
    write_cloud(tmp_path / "a.copc.laz", r, {"sigma": np.arange(len(r)) * 1e-6})
    low, high = PLACE + np.array([[3.0, 4.0, 1.0], [9.0, 11.0, 5.0]])
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        found = reader.query(bounds=laspy.copc.Bounds(low, high))
        levels = [len(reader.query(level=k)) for k in range(4)]
    inside = ((r >= low) & (r <= high)).all(axis=1)
    assert np.array_equal(np.sort(found["sigma"]), np.arange(len(r))[inside] * 1e-6)
    assert sum(levels) == len(r) and levels[0] > 0 and levels[1] > 0
    back = read_cloud(tmp_path / "a.copc.laz")
    assert np.abs(back.r[np.argsort(back.columns["sigma"])] - r).max() <= 0.5e-4 + 1e-9
    again = tmp_path / "b.copc.laz"
    write_cloud(again, r, {"sigma": np.arange(len(r)) * 1e-6})
    assert again.read_bytes() == (tmp_path / "a.copc.laz").read_bytes()


def test_nodes_of_the_octree_against_their_definition():
    rng = np.random.default_rng(7)
    u = rng.random((70_000, 3)) ** 4.0
    tree = octree_of(u)
    assert np.array_equal(np.sort(tree.order), np.arange(len(u)))
    kept = {tuple(key) for key in tree.keys.tolist()}
    assert len(kept) == len(tree.keys) > 9
    for (depth, *place), rows in zip(
        tree.keys.tolist(), np.split(tree.order, tree.first[1:-1]), strict=True
    ):
        inside = (u[rows] * 2**depth).astype(int)
        assert (inside == place).all() and len(rows)
        above = (depth - 1, *(p // 2 for p in place))
        assert depth == 0 or above in kept
        cells = np.unique((u[rows] * 2**depth * 128).astype(int), axis=0)
        below = any(k[0] == depth + 1 and [p // 2 for p in k[1:]] == place for k in kept)
        assert len(cells) == len(rows) if below else len(rows) <= LEAF_POINTS


@pytest.mark.parametrize("n", [0, 1])
def test_none_and_one(n, tmp_path):
    write_cloud(tmp_path / "a.copc.laz", np.zeros((n, 3)) + PLACE, {"sigma": np.ones(n)})
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        assert len(reader.query()) == n


def test_volume_writes_it_beside_its_other_files(tmp_path):
    source = site(tmp_path / "in.las", n=4000)
    words = ["volume", source, "--level", 51, "-o", tmp_path / "out", "--as", "copc,las", "--json"]
    assert main([*map(str, words)]) == 0
    with laspy.CopcReader.open(tmp_path / "out/points.copc.laz") as reader:
        points = reader.query()
    las = laspy.read(tmp_path / "out/points.las")
    a, b = np.argsort(points["index"]), np.argsort(las["index"])
    for name in las.point_format.dimension_names:
        assert np.array_equal(points[name][a], las[name][b]), name
