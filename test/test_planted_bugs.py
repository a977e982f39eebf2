"""Bugs that were planted once and that no test saw: each of these fails when its bug is there
again (benchmarks/planted.py plants them).
"""

import dataclasses
import os
import types
from types import SimpleNamespace

import numpy as np
import pytest
from epoch_surfaces import epoch, flat
from pymavlink.dialects.v20 import all as dialect
from volume_surfaces import surface_update

from ladar_volume.change.change_detection import shared_variance
from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.ground.clusters import clusters
from ladar_volume.io import mcap_log
from ladar_volume.io.bags import TYPESTORE, BagReader, BagWriter
from ladar_volume.io.mavlink.mavlink_records import MavlinkDecoder
from ladar_volume.io.mavlink.mavlink_stream import frame_is_good
from ladar_volume.io.mavlink.mavlink_tlog import tlog_frames
from ladar_volume.io.mcap_log import McapLog
from ladar_volume.io.mcap_recovery import recover
from ladar_volume.io.pointfiles import las
from ladar_volume.io.pointfiles.cloud_files import read_cloud, write_cloud
from ladar_volume.io.recorder import Recorder, TopicAccount
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import CloudError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import (
    GeoreferenceParameters,
    LoggerParameters,
    MavlinkParameters,
    Parameters,
)
from ladar_volume.model.records import Datum, Fix, ImuSample
from ladar_volume.registration.transform import Transform

S = 1_000_000_000
FAR = Datum(50.0, 14.0, 200.0)


def far_from_the_datum():
    """The first state of a flight half a degree east of its datum, nose down by 80°."""
    g = GeoreferenceParameters(
        datum_latitude_deg=50.0, datum_longitude_deg=14.0, datum_height_m=200.0
    )
    stage = Georeferencer(Parameters(georeference=g))
    q = np.array([0.0, np.sin(np.radians(40.0)), 0.0, np.cos(np.radians(40.0))])
    C = np.diag([4e-4, 1e-4, 9e-4])
    for k in range(8):
        t = 1000 * S + k * S // 10
        stage.add_fix(Fix(t, 50.0, 14.5, 230.0, C, 2))
        stage.add_imu(ImuSample(t, q, np.zeros(3), 1e-6 * np.eye(3)))
    return stage.take_platform(), q, C, LocalFrame(FAR).convergence(50.0, 14.5)


def test_convergence_turns_the_map_and_not_the_body():
    states, q, _, turn = far_from_the_datum()
    assert abs(turn[0, 1]) > 5e-3  # of the meridians, 0.4 degrees
    R = matrix_from_quaternion(states.q_map_body[0])
    assert np.allclose(R, turn @ matrix_from_quaternion(q), atol=1e-12)


def test_the_covariance_of_a_fix_turns_into_the_map():
    states, _, C, turn = far_from_the_datum()
    assert np.allclose(states.C_nav[0, :3, :3], turn @ C @ turn.T, rtol=0, atol=1e-12)


def test_the_registration_of_either_epoch_counts():
    new = epoch(surface_update(flat, spacing=0.5), navigation=False)
    old = epoch(surface_update(flat), navigation=False)
    _, apart = epoch_difference(new, old)
    C = np.zeros((7, 7))
    C[5, 5] = 0.02**2
    moved = Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, C)
    own, other = (new, old) if apart.upper_carries else (old, new)
    rows = np.flatnonzero(apart.tin.relevant.any() & np.isfinite(apart.tin.vertices[:, 2]))[:5]
    cross = np.zeros((len(own.sources.C_cal), len(own.sources.C_cal)))
    alone = shared_variance(own, other, apart, rows, cross)
    for pair in (
        (dataclasses.replace(own, transform=moved), other),
        (own, dataclasses.replace(other, transform=moved)),
    ):
        more = shared_variance(*pair, apart, rows, cross) - alone
        assert more == pytest.approx(np.full(len(rows), 4e-4), rel=0.05)


def test_a_cluster_of_the_fewest_points_is_one():
    points = np.column_stack([np.arange(5) * 0.1, np.zeros(5), np.zeros(5)])
    assert (clusters(points, 0.2, 5) == 0).all() and (clusters(points, 0.2, 6) == -1).all()


def test_half_a_round_trip_is_the_delay():
    decoder = MavlinkDecoder(MavlinkParameters())
    told = []
    decoder.round_trips = SimpleNamespace(add=lambda *values: told.append(values))
    decoder.round_trip(1_000, 77, 3_000)
    assert told == [(77, 2_000, 1_000.0)]


def frame():
    out = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(out)


def test_a_frame_with_a_wrong_checksum_is_noise(tmp_path):
    good = bytes(frame())
    bad = bytearray(good)
    bad[-1] ^= 0x55
    assert frame_is_good(good) and not frame_is_good(bytes(bad))
    stamp = (1_700_000_000_000_000).to_bytes(8, "big")
    # what follows is no frame: the checksum alone tells
    (tmp_path / "a.tlog").write_bytes(stamp + bytes(bad) + bytes(20) + stamp + good)
    losses = Losses()
    assert [f for _, f in tlog_frames(tmp_path / "a.tlog", losses)] == [good]
    assert losses["mavlink_noise_byte"] == 8 + len(bad) + 20


def confirmed(monkeypatch, name):
    """The inodes that the disk was asked to confirm by os.``name``."""
    asked, call = [], getattr(os, name)

    def ask(descriptor):
        asked.append(os.fstat(descriptor).st_ino)
        call(descriptor)

    monkeypatch.setattr(os, name, ask)
    return asked


def test_each_chunk_is_confirmed_by_default(tmp_path, monkeypatch):
    parameters = LoggerParameters()
    assert parameters.sync == "chunk"
    asked = confirmed(monkeypatch, "fdatasync")
    log = McapLog(parameters, tmp_path / "a.mcap")
    inode = (tmp_path / "a.mcap").stat().st_ino
    for k in range(3):
        before = len(asked)
        log.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", k)
        log.flush()
        for _ in range(500):
            if len(asked) > before:
                break
            log.syncer.thread.join(0.01)
        assert asked[before:] == [inode]
    log.close()
    quiet = McapLog(LoggerParameters(sync="close"), tmp_path / "b.mcap")
    quiet.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", 0)
    quiet.close()
    assert len(asked) == 3


def test_a_finished_file_is_confirmed(tmp_path, monkeypatch):
    log = McapLog(LoggerParameters(), tmp_path / "a.mcap")
    asked = confirmed(monkeypatch, "fsync")
    log.close()
    assert asked == [(tmp_path / "a.mcap").stat().st_ino]


def test_a_repaired_file_is_confirmed(tmp_path, monkeypatch):
    log = McapLog(LoggerParameters(), tmp_path / "a.mcap")
    log.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", 0)
    log.flush()
    log.abandon()
    asked = confirmed(monkeypatch, "fsync")
    assert recover(tmp_path / "a.mcap").messages == 1
    assert asked == [(tmp_path / "a.mcap").stat().st_ino]


def test_what_the_queue_of_the_log_does_not_take_is_counted():
    rclpy = pytest.importorskip("rclpy")
    assert rclpy
    from ladar_volume.nodes.logger_node import LoggerNode, TopicSubscription

    account, taken = TopicAccount(), []
    node = SimpleNamespace(
        _recorder=SimpleNamespace(account=lambda name: account),
        queue=SimpleNamespace(full=lambda: False),
        _offered=0,
        _taken=0,
        parameters=Parameters(logger=LoggerParameters(queue_bytes=2_000_000)),
        offer=lambda kind, item: taken.append(item),
    )
    known = TopicSubscription("std_msgs/msg/String", True, False)
    for k in range(5):
        LoggerNode._enqueue(node, "chat", known, bytes(900_000), 0, None, k + 1)
    assert len(taken) == 2 and account.queue == 3 and account.middleware == 0
    node.queue.full = lambda: True
    node._taken = node._offered
    assert not LoggerNode._enqueue(node, "chat", known, b"", 0, None, 6)
    assert len(taken) == 2 and account.queue == 4


def test_the_file_being_written_is_never_deleted(tmp_path):
    free = [10**9]
    parameters = LoggerParameters(
        path=str(tmp_path / "log.mcap"),
        disk_full="delete_oldest",
        split_bytes=10**6,
        disk_reserve_bytes=10**6,
    )
    recorder = Recorder(parameters, free=lambda folder: free[0])
    recorder.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", 0)
    recorder.split(1)
    recorder.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", 2)
    free[0] = 0
    assert not recorder.has_room(1)
    assert [p.name for p in tmp_path.glob("*.mcap")] == ["log_1.mcap"]
    assert recorder.path.name == "log_1.mcap" and recorder.deleted == ["log.mcap"]


def test_the_digest_is_of_all_files(tmp_path):
    types_ = TYPESTORE.types
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("chat", types_["std_msgs/msg/String"](data="a"), 1)
    digests = []
    for content in (None, b"second", b"another"):
        if content is not None:
            (tmp_path / "bag" / "bag_1.mcap").write_bytes(content)
        with BagReader(tmp_path / "bag") as bag:
            digests.append(bag.digest())
    assert len(set(digests)) == 3


def test_fewer_points_than_announced_are_refused(tmp_path, monkeypatch):
    write_cloud(tmp_path / "a.las", np.random.default_rng(0).uniform(0, 9, (500, 3)))
    assert len(read_cloud(tmp_path / "a.las")) == 500
    opened = las.laspy.open

    def ends_early(path, *words, **options):
        file = opened(path, *words, **options)
        chunks = file.chunk_iterator
        file.chunk_iterator = types.MethodType(
            lambda self, count: (c[:400] for c in chunks(count)), file
        )
        return file

    monkeypatch.setattr(las.laspy, "open", ends_early)
    with pytest.raises(CloudError, match="400 points where 500 are announced"):
        read_cloud(tmp_path / "a.las")


def test_a_confirmation_that_failed_is_told(tmp_path, monkeypatch):
    log = McapLog(LoggerParameters(), tmp_path / "a.mcap")

    def broken(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(mcap_log.os, "fdatasync", broken)
    with pytest.raises(mcap_log.OutputError, match="Input/output error"):
        for k in range(200):
            log.write("chat", "std_msgs/msg/String", b"\0\1\0\0\2\0\0\0a\0", k)
            log.flush()
            log.syncer.thread.join(0.01)
    log.abandon()
