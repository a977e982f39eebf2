"""What ``kill -9`` costs the log: the logger is killed at random moments under load, its next start
repairs the file it left, and both ``mcap`` and ``rosbags`` must open it. Lost is the time from the
last of the load's messages in the file, which come at 100 Hz, to the last one that was sent before
the kill. Every fourth kill comes while the logger starts, the others once the load is in the file.
The same readers try the file as the kill left it, too; ``mcap`` then also from front to back, and
what it finds that way the repaired file must hold.

``python -m benchmarks.kill_logger [--runs N] [--bare]``; ``--bare`` kills a process that writes
through the Recorder without ROS.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import mmap
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.reader import NonSeekingReader, make_reader
from rosbags.highlevel import AnyReader

from ladar_volume.io.bags import TYPESTORE
from ladar_volume.io.mcap_recovery import is_complete
from ladar_volume.io.recorder import Recorder, log_files
from ladar_volume.model.parameters import LoggerParameters
from ladar_volume.process.private_graph import join_private_graph

ROOT = Path(__file__).parents[1]
CLOUD_BYTES, CLOUD_HZ, IMU_HZ = 660_000, 10, 100
#: A kill comes this long after the file appeared, or the load in it, at most.
LONGEST_S = 2.0
#: The topic whose messages are counted.
LOAD = "/imu/data"


class Sent:
    """When the load sent its last message, in a file's pages: there for others whatever becomes of
    the process.
    """

    def __init__(self, path: Path) -> None:
        path.touch()
        os.truncate(path, 8)
        with path.open("r+b") as stream:
            self._pages = mmap.mmap(stream.fileno(), 8)

    def now(self) -> None:
        """A message was sent."""
        self._pages[:] = time.time_ns().to_bytes(8, "little")

    @property
    def t_ns(self) -> int:
        """The last one, since the epoch."""
        return int.from_bytes(self._pages[:], "little")


def write_bare(path: str, sent: Sent) -> None:
    """The killed process without ROS: clouds and attitudes at a scanner's rate."""
    recorder = Recorder(LoggerParameters(path=path, disk_reserve_bytes=0))
    recorder.repair_older()
    noise, i = os.urandom(CLOUD_BYTES), 0
    while True:
        now = time.time_ns()
        recorder.write("imu/data", "sensor_msgs/msg/Imu", noise[:324], now)
        if i % (IMU_HZ // CLOUD_HZ) == 0:
            recorder.write("velodyne_points", "sensor_msgs/msg/PointCloud2", noise, now)
        sent.now()
        i += 1
        time.sleep(1.0 / IMU_HZ)


def publish(sent: Sent) -> None:
    """The load over DDS, until killed."""
    import rclpy
    from sensor_msgs.msg import Imu, PointCloud2

    rclpy.init(args=[])
    node = rclpy.create_node("load")
    clouds, imus = (
        node.create_publisher(PointCloud2, "velodyne_points", 10),
        node.create_publisher(Imu, "imu/data", 100),
    )
    cloud, i = PointCloud2(data=os.urandom(CLOUD_BYTES)), 0
    while True:
        imus.publish(Imu())
        sent.now()
        if i % (IMU_HZ // CLOUD_HZ) == 0:
            clouds.publish(cloud)
        i += 1
        time.sleep(1.0 / IMU_HZ)


def _wait(done: Callable[[], bool], timeout_s: float = 60.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > deadline:
            raise RuntimeError("the logger did not start")
        time.sleep(0.01)


def as_left(path: Path) -> dict[str, Any]:
    """Which reader opens a file as the killed logger left it, and how many messages ``mcap`` finds
    in it from front to back.
    """
    out: dict[str, Any] = {"mcap_before": True, "rosbags_before": True, "readable_before": 0}
    with path.open("rb") as stream:
        try:
            sum(1 for _ in make_reader(stream).iter_messages())
        except Exception:  # whatever it fails with is the finding
            out["mcap_before"] = False
    try:
        with AnyReader([path], default_typestore=TYPESTORE) as bag:
            sum(1 for _ in bag.messages())
    except Exception:
        out["rosbags_before"] = False
    with path.open("rb") as stream, contextlib.suppress(Exception):
        for _, channel, _ in NonSeekingReader(stream).iter_messages(log_time_order=False):
            out["readable_before"] += channel.topic == LOAD
    return out


def check(path: Path) -> tuple[int, int]:
    """Messages of the load and the last receive time, by ``mcap``; raises where it or ``rosbags``
    cannot read the file or they disagree.
    """
    with path.open("rb") as stream:
        topics = [
            (c.topic, m.log_time)
            for _, c, m in make_reader(stream, validate_crcs=True).iter_messages()
        ]
    if topics:
        with AnyReader([path], default_typestore=TYPESTORE) as bag:
            if sum(1 for _ in bag.messages()) != len(topics):
                raise RuntimeError(f"{path}: mcap and rosbags disagree")
    times = [t for topic, t in topics if topic == LOAD]
    return len(times), max(times, default=0)


def kill_often(runs: int, bare: bool, folder: Path) -> list[dict[str, Any]]:
    """One dictionary per run: ``delay_s``, ``lost_s`` (None where nothing had been written yet),
    ``messages``, ``opens``, and what :func:`as_left` says.
    """
    rng, base, sent = random.Random(20), folder / "log.mcap", Sent(folder / "sent")
    python = [sys.executable, "-m"]
    join_private_graph()
    # shared memory left by a killed process delays the next one's discovery
    environment = os.environ | {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    settings = [
        w for s in (f"path:={base}", "disk_reserve_bytes:=0") for w in ("-p", f"logger.{s}")
    ]
    shared = ["--sent", str(folder / "sent")]
    command = (
        [*python, "benchmarks.kill_logger", "--write", str(base), *shared]
        if bare
        else [*python, "ladar_volume.nodes.programs", "logger_node", "--ros-args", *settings]
    )
    load = (
        None
        if bare
        else subprocess.Popen(
            [*python, "benchmarks.kill_logger", "--publish", *shared], cwd=ROOT, env=environment
        )
    )
    found: list[dict[str, Any]] = []
    newest: list[Path] = []
    try:
        for n in range(runs + 1):
            logger = subprocess.Popen(command, cwd=ROOT, env=environment)
            try:
                _wait(lambda before=newest: log_files(base)[-1:] != before)  # type: ignore[misc]
                if newest:
                    found[-1] |= _outcome(newest[0], found[-1])
                newest = log_files(base)[-1:]
                if n % 4:
                    _wait(lambda path=newest[0]: path.stat().st_size > CLOUD_BYTES)
                delay = rng.uniform(0.0, LONGEST_S)
                time.sleep(delay if n < runs else 0.0)
            finally:
                last, killed = sent.t_ns, time.time_ns()
                logger.kill()
                logger.wait()
            found.append(
                {"delay_s": delay, "sent_ns": last, "silent_s": (killed - last) * 1e-9}
                | (as_left(newest[0]) if n < runs else {})
            )
    finally:
        if load is not None:
            load.kill()
            load.wait()
    return found[:runs]


def _outcome(path: Path, run: dict[str, Any]) -> dict[str, Any]:
    """Wait for the repair by the present logger, then look at what the one before left."""
    try:
        _wait(lambda: is_complete(path), 20.0)
        messages, last = check(path)
    except Exception as error:  # whatever a reader fails with is the finding
        return {"opens": False, "messages": 0, "lost_s": None, "error": repr(error)}
    path.unlink()
    if messages < run["readable_before"]:
        return {
            "opens": False,
            "messages": messages,
            "lost_s": None,
            "error": "the repair lost messages",
        }
    return {
        "opens": True,
        "messages": messages,
        "lost_s": max(run["sent_ns"] - last, 0) * 1e-9 if messages else None,
    }


def summary(found: list[dict[str, Any]]) -> dict[str, float | int | str]:
    """The figures."""
    lost = [r["lost_s"] for r in found if r["lost_s"] is not None]
    return {
        "kills": len(found),
        "files that mcap, rosbags open as the kill left them": ", ".join(
            str(sum(r[name] for r in found)) for name in ("mcap_before", "rosbags_before")
        ),
        "files that mcap and rosbags open after the next start": sum(r["opens"] for r in found),
        "kills before the load was in a chunk": sum(r["lost_s"] is None for r in found),
        "median loss, s": statistics.median(lost) if lost else 0.0,
        "99 % of losses below, s": sorted(lost)[int(0.99 * len(lost))] if lost else 0.0,
        "largest loss, s": max(lost, default=0.0),
        "kills that lost more than 1 s": sum(s > 1.0 for s in lost),
        "kills whose file does not open": sum(not r["opens"] for r in found),
        "longest time the load itself had sent nothing before a kill, s": max(
            r["silent_s"] for r in found
        ),
    }


GOALS = {
    "kills that lost more than 1 s": (0.0, 0.0),
    "kills whose file does not open": (0.0, 0.0),
}


def run(
    runs: int = 200, bare: bool = False, folder: Path | None = None
) -> dict[str, float | int | str]:
    """The record: 200 kills of the node."""
    with tempfile.TemporaryDirectory() as scratch:
        return summary(kill_often(runs, bare, folder or Path(scratch)))


def main() -> int:
    """Command line; 1 where a file does not open or more than a second is lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--bare", action="store_true")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--write", help=argparse.SUPPRESS)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--sent", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write:
        write_bare(arguments.write, Sent(arguments.sent))
    if arguments.publish:
        publish(Sent(arguments.sent))
    figures = run(arguments.runs, arguments.bare, arguments.folder)
    print(
        json.dumps(figures)
        if arguments.json
        else "\n".join(f"{k}: {v}" for k, v in figures.items())
    )
    bad = (
        figures["files that mcap and rosbags open after the next start"] != figures["kills"]
        or figures["kills that lost more than 1 s"]
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
