"""LAS and LAZ: every attribute of every point format comes back, from a file of the same kind and
from others.
"""

import json
import struct

import laspy
import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.model.errors import CloudError, InputError, OutputError

WAVES = set("wavepacket_index wavepacket_offset wavepacket_size return_point_wave_location".split())
WAVES |= {"x_t", "y_t", "z_t"}
FORMATS = [0, 1, 2, 3, 6, 7, 8, 10]
PLACE = np.array([552_000.0, 4_183_000.0, 50.0])


def full_las(path, kind, n=400, seed=0, crs="EPSG:32610", version=None):
    """A file of one point format with every dimension filled, and vectors, scaled and named extra
    bytes.
    """
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=kind, version=version or ("1.4" if kind > 5 else "1.2"))
    header.scales, header.offsets = [0.001, 0.001, 0.01], [552_000.0, 4_183_000.0, 0.0]
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("Range to ground", "f4", "in m"),
            laspy.ExtraBytesParams("beam", "3f8"),
            laspy.ExtraBytesParams(
                "Amplitude", "u2", scales=np.array([0.01]), offsets=np.array([5.0])
            ),
        ]
    )
    if crs:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    las = laspy.LasData(header)
    xy = rng.random((n, 2)) * 4.0
    z = 0.1 * xy[:, 0] + rng.normal(0.0, 0.003, n)
    las.x, las.y, las.z = (np.c_[xy, z] + PLACE).T
    for place in header.point_format.dimensions:
        if place.name in ("X", "Y", "Z", "withheld", "classification"):
            continue
        if place.name.startswith("wavepacket_") and place.name != "wavepacket_index":
            # as a recorder writes them: LAZ keeps no offsets and sizes beyond reason
            las[place.name] = 60 + 200 * np.arange(n) if "offset" in place.name else np.full(n, 200)
        elif place.name == "beam":
            las[place.name] = rng.normal(size=(n, 3))
        elif place.name == "Amplitude":
            las[place.name] = rng.integers(0, 1000, n) * 0.01 + 5.0
        elif place.kind == laspy.DimensionKind.FloatingPoint:
            las[place.name] = rng.random(n) * 1e5
        else:
            las[place.name] = rng.integers(place.min, min(place.max, 2**31), n, endpoint=True)
    las.classification = rng.choice([1, 2, 5, 6], n)
    las.write(str(path))
    return path


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("ending", [".las", ".laz"])
def test_every_attribute_survives_the_filter(kind, ending, tmp_path, capsys):
    source = full_las(tmp_path / "in.las", kind)
    out, rest = tmp_path / f"out{ending}", tmp_path / f"rest{ending}"
    words = ["filter", source, "-o", out, "--outliers", rest, "--radius", 0.5, "--degree", 1]
    assert main([*map(str, words), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    lost = set(facts["columns_lost"])
    assert lost == (WAVES if kind == 10 and ending == ".laz" else set())
    before, after = laspy.read(source), laspy.read(out)
    index = np.asarray(after["index"])
    assert len(index) == facts["output"]["points"] > 300
    assert after.header.point_format.id == (8 if lost else kind)
    assert after.header.parse_crs().to_epsg() == 32610
    assert after.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    for name in before.point_format.dimension_names:
        if name not in {"X", "Y", "Z", *lost}:
            assert np.array_equal(np.array(after[name]), np.array(before[name])[index]), name
    assert np.abs(after.xyz - before.xyz[index]).max() < 0.05
    assert np.array_equal(after.header.offsets, before.header.offsets)
    names = {d.name: d for d in after.point_format.extra_dimensions}
    assert names["Range to ground"].description == "in m" and names["beam"].num_elements == 3
    assert names["Amplitude"].scales[0] == 0.01 and {"sigma", "NormalX"} <= set(names)
    left = laspy.read(rest)
    assert len(left) + len(after) == 400


@pytest.mark.parametrize("kind", FORMATS)
def test_points_that_nobody_moved_come_back_on_their_lattice(kind, tmp_path):
    source = full_las(tmp_path / "in.las", kind)
    cloud = read_cloud(source)
    if kind == 10:
        with pytest.raises(OutputError, match=r"write \.las"):
            write_cloud(tmp_path / "out.laz", cloud.r, cloud.columns, template=cloud)
    ending = ".las" if kind == 10 else ".laz"
    write_cloud(tmp_path / f"out{ending}", cloud.r, cloud.columns, template=cloud)
    back = read_cloud(tmp_path / f"out{ending}")
    assert np.array_equal(np.round(back.r, 6), np.round(cloud.r, 6))
    assert back.columns.keys() == cloud.columns.keys()
    for name, column in cloud.columns.items():
        assert np.array_equal(back.columns[name], column), name
    assert cloud.resolution_m == pytest.approx([0.001, 0.001, 0.01])


@settings(max_examples=25, deadline=None)
@given(
    kind=st.sampled_from(FORMATS),
    ending=st.sampled_from([".las", ".laz", ".ply", ".pcd", ".npy", ".csv"]),
    seed=st.integers(0, 1000),
)
def test_attributes_through_any_format(kind, ending, seed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any")
    cloud = read_cloud(full_las(folder / "in.laz", kind, 30, seed))
    names = {n: n.replace(" ", "_") for n in cloud.columns}
    columns = {names[n]: c for n, c in cloud.columns.items() if c.ndim == 1 and n not in WAVES}
    write_cloud(folder / f"mid{ending}", cloud.r, columns, template=cloud)
    middle = read_cloud(folder / f"mid{ending}")
    write_cloud(folder / "out.laz", middle.r, middle.columns, template=middle)
    back = read_cloud(folder / "out.laz")
    for name, column in columns.items():
        assert np.array_equal(back.columns[name], column), name
    np.testing.assert_allclose(back.r, cloud.r, atol=0.5001e-4)
    if ending not in (".csv", ".npy"):
        assert back.coordinates.crs.to_epsg() == 32610
    else:
        assert back.coordinates.crs is None


def test_what_a_dimension_cannot_hold_goes_beside_it(tmp_path):
    columns = {
        "intensity": np.array([0.25, 70_000.5]),
        "red": np.array([1, 2]),
        "classification": np.array([3, 300]),
    }
    write_cloud(tmp_path / "a.las", np.zeros((2, 3)), columns)
    back = read_cloud(tmp_path / "a.las")
    assert back.columns["intensity_value"].tolist() == [0.25, 70_000.5]
    assert back.columns["classification_value"].tolist() == [3, 300]
    assert back.columns["red"].tolist() == [1, 2]


@pytest.mark.parametrize("kind", FORMATS)
def test_feet_come_out_as_metres_with_their_system(kind, tmp_path, capsys):
    rng = np.random.default_rng(0)
    header = laspy.LasHeader(point_format=kind, version="1.4" if kind > 5 else "1.2")
    header.scales, header.offsets = [0.01] * 3, [6_000_000.0, 2_100_000.0, 0.0]
    header.add_crs(pyproj.CRS.from_epsg(2227))
    las = laspy.LasData(header)
    r = np.c_[rng.random((300, 2)) * 20.0, rng.normal(0.0, 0.02, 300)] + [
        6_000_000.0,
        2_100_000.0,
        100,
    ]
    las.x, las.y, las.z = r.T
    las.write(str(tmp_path / "f.las"))
    words = ["filter", tmp_path / "f.las", "-o", tmp_path / "m.laz", "--radius", 1, "--json"]
    assert main([*map(str, words)]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["reading"]["coordinates"]["units_read"] == "US survey foot"
    assert facts["verdict"]["reasons"][0]["name"] == "height_unit"
    out = laspy.read(tmp_path / "m.laz")
    factor = 1200.0 / 3937.0
    np.testing.assert_allclose(out.xyz, r[out["index"]] * factor, atol=0.05)
    crs = out.header.parse_crs()
    assert crs.axis_info[0].unit_conversion_factor == 1.0 and out.header.point_format.id == (
        8 if kind == 10 else kind
    )
    # the new system means what the old one meant
    old = pyproj.Transformer.from_crs("EPSG:2227", "EPSG:4269", always_xy=True)
    new = pyproj.Transformer.from_crs(crs, "EPSG:4269", always_xy=True)
    x, y, _ = out.xyz[0]
    assert new.transform(x, y) == pytest.approx(old.transform(x / factor, y / factor), abs=1e-10)
    assert read_cloud(tmp_path / "m.laz").coordinates.are_metres


def geokeys(path, keys, doubles=()):
    """A LAS 1.2 file of three points whose header holds GeoTIFF keys."""
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [0.001] * 3, [0.0] * 3
    table = [1, 1, 0, len(keys)] + [w for k, (place, v) in keys.items() for w in (k, place, 1, v)]
    data = struct.pack(f"<{len(table)}H", *table)
    header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", data))
    header.vlrs.append(
        laspy.VLR("LASF_Projection", 34736, "", struct.pack(f"<{len(doubles)}d", *doubles))
    )
    las = laspy.LasData(header)
    las.x, las.y = np.array([6e5, 6.001e5, 6.002e5]), np.array([2.1e5, 2.102e5, 2.101e5])
    las.z = np.array([1.0, 2.0, 3.0])
    las.write(str(path))
    return path


@pytest.mark.parametrize(
    "keys,doubles,across,up",
    [
        ({1024: (0, 1), 3072: (0, 26943), 4096: (0, 5703), 4099: (0, 9003)}, (), 1.0, 1200 / 3937),
        ({1024: (0, 1), 3072: (0, 32610)}, (), 1.0, 1.0),
        ({1024: (0, 1), 3072: (0, 32767), 3076: (0, 9003)}, (), 1200 / 3937, 1200 / 3937),
        ({1024: (0, 1), 3072: (0, 32767), 3076: (0, 9002), 4099: (0, 9001)}, (), 0.3048, 1.0),
        ({1024: (0, 1), 3076: (0, 32767), 3077: (34736, 0)}, (0.5,), 0.5, 0.5),
        ({1024: (0, 1), 3076: (0, 9001), 4096: (0, 5103), 4099: (0, 9002)}, (), 1.0, 0.3048),
        ({1024: (0, 1)}, (), 1.0, 1.0),
    ],
)
def test_units_of_geotiff_keys(keys, doubles, across, up, tmp_path):
    back = read_cloud(geokeys(tmp_path / "a.las", keys, doubles))
    assert back.r[1] == pytest.approx([6.001e5 * across, 2.102e5 * across, 2.0 * up], rel=1e-12)
    if 5103 in [v for _, v in keys.values()]:
        assert back.coordinates.file_coordinates.heights == "NAVD88"


@pytest.mark.parametrize(
    "keys,words",
    [
        ({1024: (0, 1), 3072: (0, 26943), 3076: (0, 9003)}, "contradicts itself"),
        ({1024: (0, 3)}, "geocentric"),
        ({1024: (0, 2)}, "degrees"),
        ({1024: (0, 1), 3072: (0, 32765)}, "EPSG:32765"),
        ({1024: (0, 1), 3076: (0, 9999)}, "9999"),
        ({1024: (0, 1), 3076: (0, 32767), 3077: (34736, 7)}, "cut short"),
        ({1024: (0, 1), 3072: (0, 26943), 4096: (0, 5715)}, "downwards"),
    ],
)
def test_geotiff_keys_that_make_no_sense(keys, words, tmp_path):
    with pytest.raises(InputError, match=words):
        read_cloud(geokeys(tmp_path / "a.las", keys))


@pytest.mark.parametrize("ending", [".las", ".laz"])
@pytest.mark.parametrize("announced", [0, 1, 399, 401, 100_000])
def test_an_announced_count_that_is_false(ending, announced, tmp_path):
    path = full_las(tmp_path / f"a{ending}", 6)
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 247, announced)
    struct.pack_into("<I", data, 107, 0)
    path.write_bytes(data)
    if ending == ".laz" and announced in (1, 399):
        assert len(read_cloud(path)) == announced  # one chunk: the packed points do not tell
        return
    with pytest.raises(CloudError):
        read_cloud(path)


def test_header_that_names_a_system_nobody_knows(tmp_path):
    path = full_las(tmp_path / "a.las", 6)
    las = laspy.read(path)
    las.header.vlrs.clear()
    las.header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", b'PROJCS["broken"\0'))
    las.write(str(path))
    with pytest.raises(InputError, match="cannot be understood") as caught:
        read_cloud(path)
    assert caught.value.reason == "input_crs" and len(str(caught.value)) <= 300
