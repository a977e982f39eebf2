"""Whatever a file holds, its reader gives it back, or refuses it in one line with a reason."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ladar_volume.cli.main import main
from ladar_volume.io import bounded_unpacking, strict_yaml
from ladar_volume.io.bags import TYPESTORE, BagReader
from ladar_volume.io.config import read_config
from ladar_volume.io.measurements import read_measurements
from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.io.pointfiles.metres import SMALLEST_M
from ladar_volume.io.transforms import read_transform
from ladar_volume.model.errors import (
    LONGEST,
    BagError,
    ConfigurationError,
    InputError,
    LadarVolumeError,
)

CORPUS = Path(__file__).parents[1] / "corpus"
FEW = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
CLOUDS = (".ply", ".pcd", ".npy", ".csv", ".xyz", ".las")
MESHES = (".ply", ".obj", ".stl", ".off")
V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
T = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)


@pytest.mark.parametrize("path", sorted(CORPUS.glob("*.*")), ids=lambda p: p.name)
def test_what_once_went_wrong_is_refused_or_read(path, capsys, tmp_path):
    """By every verb that takes such a file."""
    if path.name == "README.md":
        return
    good = tmp_path / "good.ply"
    write_cloud(good, np.random.default_rng(0).uniform(0, 1, (30, 3)))
    out = tmp_path / "out.ply"
    words = {
        ".yaml": [["check-config", path]],
        ".json": [["diff", good, good, "--transform", path, "--pole", "0,0,2"]],
        ".obj": [["volume", path, "--level", "0"]],
    }.get(path.suffix)
    words = words or [
        ["volume", path, "--level", "0"],
        ["tin", path, "-o", out],
        ["register", path, good],
        ["body", path, "-o", out],
    ]
    for line in words:
        out.write_bytes(b"old")
        code = main([str(w) for w in line])
        shown = capsys.readouterr().err
        assert code in (0, 2, 3), shown
        if code == 2:
            assert shown.count("\n") == 1 and len(shown) <= 301 and shown.strip().isprintable()
            assert out.read_bytes() == b"old"


def read_or_refuse(read, path):
    """What is read, None where it is refused; nothing else may happen."""
    try:
        return read(path)
    except LadarVolumeError as error:
        assert error.reason not in ("", "error") and "\x1b" not in repr(str(error)).replace(
            "\\x1b", ""
        )
        return None


def damaged(data, draw):
    """Bytes with a few changes, most of them near the beginning."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        near = len(out) if draw(st.booleans()) else min(len(out), 300)
        at = draw(st.integers(0, max(near - 1, 0)))
        change = draw(st.sampled_from(("set", "cut", "drop", "more", "word")))
        if change == "set" and out:
            out[at] = draw(st.integers(0, 255))
        elif change == "cut":
            del out[at:]
        elif change == "drop":
            del out[at : at + draw(st.integers(1, 50))]
        elif change == "more":
            out[at:at] = draw(st.binary(max_size=60))
        else:
            word = (b"nan", b"1e999", b"-1", b"9" * 30, b"\xff\xff\xff\xff", b"1e155")
            out[at : at + 4] = draw(st.sampled_from(word))
    return bytes(out)


@pytest.mark.parametrize("ending", CLOUDS)
@given(data=st.data())
@FEW
def test_damaged_clouds(tmp_path, ending, data):
    path = tmp_path / f"a{ending}"
    r = np.random.default_rng(1).uniform(-5, 5, (40, 3))
    write_cloud(path, r, {"intensity": np.ones(40, np.float32), "ring": np.arange(40) % 16})
    path.write_bytes(damaged(path.read_bytes(), data.draw))
    found = read_or_refuse(read_cloud, path)
    if found is not None:
        assert np.isfinite(found.r).all() and (np.abs(found.r) <= 1e12).all()
        assert all(len(c) == len(found) for c in found.columns.values())


@pytest.mark.parametrize("ending", MESHES)
@given(data=st.data())
@FEW
def test_damaged_meshes(tmp_path, ending, data):
    path = tmp_path / f"a{ending}"
    write_mesh(path, V, T)
    path.write_bytes(damaged(path.read_bytes(), data.draw))
    found = read_or_refuse(read_mesh, path)
    if found is not None:
        assert np.isfinite(found.vertices).all() and (found.triangles >= 0).all()
        assert (found.triangles < len(found.vertices)).all()


@given(text=st.text(max_size=80) | st.recursive(st.text(max_size=8), st.lists).map(repr))
@FEW
def test_any_text_is_a_value_or_refused(text):
    for words in (text, f"filter.radius_m={text}", f"{text}=1"):
        with pytest.raises(ConfigurationError) if "=" not in words else _either() as refused:
            read_config(None, [words])
        if refused is not None:
            assert len(str(refused.value)) < 400


class _either:
    """A block that ends well, or with a refusal."""

    def __enter__(self):
        return None

    def __exit__(self, kind, error, trace):
        return kind is not None and issubclass(kind, ConfigurationError)


@given(data=st.binary(max_size=300))
@FEW
def test_any_bytes_are_no_transform_and_no_table(tmp_path, data):
    path = tmp_path / "a"
    path.write_bytes(data)
    assert read_or_refuse(read_transform, path) is None
    read_or_refuse(lambda p: read_measurements(p, ("roll_deg", "pitch_deg")), path)
    read_or_refuse(lambda p: read_config(p), path)


@given(
    r=st.lists(
        st.tuples(*[st.floats(-1e9, 1e9, allow_subnormal=False)] * 3), min_size=4, max_size=40
    )
)
@FEW
@pytest.mark.parametrize("ending", [".ply", ".pcd", ".npy", ".csv", ".xyz"])
def test_what_is_written_is_read(tmp_path, ending, r):
    written = np.array(r, float)
    write_cloud(tmp_path / f"a{ending}", written)
    found = read_or_refuse(read_cloud, tmp_path / f"a{ending}")
    if found is not None:  # some are refused: too coarse for their spacing
        assert np.array_equal(found.r, np.where(np.abs(written) < SMALLEST_M, 0.0, written))


def bomb(path, compression, size=300_000_000):
    """An MCAP of zeros."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2**33, compression=compression)
        writer.start(profile="ros2", library="test")
        kind = "sensor_msgs/msg/PointCloud2"
        text = str(TYPESTORE.generate_msgdef(kind, ros_version=2)[0]).encode()
        schema = writer.register_schema(kind, "ros2msg", text)
        channel = writer.register_channel("/velodyne_points", "cdr", schema)
        writer.add_message(channel, 0, bytes(size), 0)
        writer.finish()


def test_a_bomb_is_not_unpacked(tmp_path, monkeypatch):
    from mcap.writer import CompressionType

    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        path = tmp_path / f"{compression.name}.mcap"
        bomb(path, compression)
        with BagReader(path) as bag, pytest.raises(BagError, match="not unpacked") as refused:
            list(bag.raw())
        assert refused.value.reason == "bag_chunk"
    monkeypatch.setattr(bounded_unpacking, "CHUNK", 1000)
    for unpack in (bounded_unpacking.zstd, bounded_unpacking.lz4_frames):
        with pytest.raises(BagError, match="claim to be"):
            unpack(b"xxxx", 2000)


def test_data_that_lie_about_their_size_are_cut_off():
    import bz2

    import lz4.frame
    import zstandard

    data = bytes(100_000)
    packed = zstandard.compress(data)
    frames = lz4.frame.compress(data)
    assert bounded_unpacking.zstd(packed, 100_000) == data
    assert bounded_unpacking.zstd(packed + packed, 200_000) == data + data
    assert bounded_unpacking.lz4_frames(frames, 100_000) == data
    assert bounded_unpacking.bzip2(bz2.compress(data)) == data
    for unpack, given_ in (
        (bounded_unpacking.zstd, packed),
        (bounded_unpacking.zstd, packed + packed),
        (bounded_unpacking.lz4_frames, frames),
    ):
        with pytest.raises(BagError, match="more than 1,000 bytes"):
            unpack(given_, 1000)
    with pytest.raises(BagError, match="end early"):
        bounded_unpacking.zstd(packed[:-3], 100_000)


def test_a_large_yaml_is_refused_unread(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: b\n" * 250_000)
    with pytest.raises(ConfigurationError, match="more than"):
        strict_yaml.read_yaml(path)


def test_what_ros2_param_dump_writes_is_read(tmp_path):
    path = tmp_path / "dump.yaml"
    path.write_text(
        "/volume_node:\n  ros__parameters:\n    config_file: ''\n    filter:\n"
        "      radius_m: 0.4\n    qos_overrides: {}\n    use_sim_time: false\n"
        "/filter_node:\n  ros__parameters:\n    filter: {radius_m: 0.4, min_points: 20}\n"
    )
    read = read_config(path)
    assert read.filter.radius_m == 0.4 and read.filter.min_points == 20
    path.write_text(path.read_text().replace("radius_m: 0.4, min", "radius_m: 0.5, min"))
    with pytest.raises(ConfigurationError, match=r"filter.radius_m: 0.4 for one node, 0.5 for"):
        read_config(path)


def test_a_far_coordinate_names_itself(tmp_path):
    for far in (1.1e12, 1e155):
        r = np.vstack([V, [[0.0, far, 0.0]]])
        write_cloud(tmp_path / "a.ply", r)
        with pytest.raises(InputError, match="no place is so far"):
            read_cloud(tmp_path / "a.ply")


def test_layers_of_a_laz_chunk_are_no_larger_than_it(tmp_path):
    """The decompressor allocates what they say: 4.3 GB for a file of 4.5 kB."""
    path = tmp_path / "a.laz"
    write_cloud(path, np.random.default_rng(2).uniform(0, 9, (300, 3)), {"ring": np.arange(300)})
    data = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", data, 96)
    (point,) = struct.unpack_from("<H", data, 105)
    assert len(read_cloud(path)) == 300
    data[first + 8 + point + 4 : first + 8 + point + 8] = b"\xff\xff\xff\x7f"  # of the first layer
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"a chunk of .* holds layers of"):
        read_cloud(path)


def test_an_error_is_no_longer_than_a_message():
    assert len(str(LadarVolumeError("x" * 10**6))) == LONGEST
    assert str(LadarVolumeError("x" * LONGEST)) == "x" * LONGEST


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [("record", b"\x01\x00", "without chunks"), ("table", b"\xff" * 7 + b"\x7f", "cannot be")],
)
def test_a_laz_file_whose_chunks_cannot_be_found_is_told(place, value, words, tmp_path):
    path = tmp_path / "a.laz"
    write_cloud(path, np.random.default_rng(2).uniform(0, 9, (300, 3)))
    data = bytearray(path.read_bytes())
    record = data.index(b"laszip encoded") - 2 + 54  # after its head
    at = {"record": record, "table": struct.unpack_from("<I", data, 96)[0]}[place]
    data[at : at + len(value)] = value
    path.write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_cloud(path)
