"""Power cuts of the log: what is on the disk after one, and what the repair makes of it.

The log is written in real time through :class:`Recorder`, as the logger node does, over a block
layer of this benchmark: every write to the file and every confirmation that has *returned* is kept
in order. A power cut at a random moment leaves what was confirmed, and of the blocks of 4096 bytes
written since then a random part, in any order; a block that was not written holds zeros, and the
length of the file is anything from the confirmed one on (the disk may know the length before the
content). A block that was half there before (the one that held the confirmed end) keeps its first
part. Each such file is repaired and read by ``mcap`` and ``rosbags``.

Lost is the time from the last message in the file to the last one that was handed to the log before
the cut. The same cuts with ``sync: never`` say what the confirmations are worth.

``python -m benchmarks.power_cuts [--cuts N] [--seconds S] [--seed S]``; exit code 1 where a file
does not open, a confirmed message is missing, or more than a second is lost.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks.kill_logger import CLOUD_HZ, IMU_HZ, check
from ladar_volume.io import mcap_log
from ladar_volume.io.mcap_recovery import recover
from ladar_volume.io.recorder import Recorder
from ladar_volume.model.parameters import LoggerParameters

BLOCK = 4096
CLOUD_BYTES = 66_000
#: Confirmations of a slow card take this long, s.
DISK_S = (0.0, 0.25)


@dataclass
class Disk:
    """The layer: length of the file when a time had come, and what was confirmed when.

    grown : (time s, bytes) · confirmed : (time s of its return, bytes) · sent : (time s, receive
    time ns) of the messages of the load
    """

    grown: list[tuple[float, int]] = field(default_factory=list)
    confirmed: list[tuple[float, int]] = field(default_factory=list)
    sent: list[tuple[float, int]] = field(default_factory=list)

    def confirm(self, descriptor: int, delay: random.Random) -> None:
        """As fdatasync of a slow disk: what was there when it was asked is there when it ends."""
        size = os.fstat(descriptor).st_size
        time.sleep(delay.uniform(*DISK_S))
        self.confirmed.append((time.monotonic(), size))

    def at(self, cut: float) -> tuple[int, int, int]:
        """Bytes confirmed, bytes written, last receive time (ns) when the power was cut."""
        known = max((n for t, n in self.confirmed if t <= cut), default=0)
        written = max((n for t, n in self.grown if t <= cut), default=0)
        return known, written, max((ns for t, ns in self.sent if t <= cut), default=0)


def fly(folder: Path, seconds: float, seed: int, sync: str) -> tuple[bytes, Disk]:
    """The file of a flight, whole but for its index, and what the layer kept."""
    disk, delay = Disk(), random.Random(seed)
    path = folder / f"{sync}_{seed}.mcap"
    with mock.patch.object(mcap_log.os, "fdatasync", lambda fd: disk.confirm(fd, delay)):
        recorder = Recorder(LoggerParameters(path=str(path), disk_reserve_bytes=0, sync=sync))
        noise, began, i = random.Random(seed).randbytes(CLOUD_BYTES), time.monotonic(), 0
        while (now := time.monotonic()) < began + seconds:
            t_ns = time.time_ns()
            recorder.write("imu/data", "sensor_msgs/msg/Imu", noise[:324], t_ns)
            if i % (IMU_HZ // CLOUD_HZ) == 0:
                recorder.write("velodyne_points", "sensor_msgs/msg/PointCloud2", noise, t_ns)
            disk.sent.append((now, t_ns))
            disk.grown.append((time.monotonic(), path.stat().st_size))
            i += 1
            time.sleep(max(began + i / IMU_HZ - time.monotonic(), 0.0))
        data = path.read_bytes()
        recorder.close()
    return data[: disk.grown[-1][1]], disk


def after_cut(data: bytes, known: int, written: int, draw: random.Random) -> bytes:
    """What a disk holds: the confirmed part, and of the blocks behind it some."""
    out = bytearray(data[:known])
    end = draw.choice((known, written, draw.randint(known, written)))
    share = draw.choice((0.0, 0.5, 0.9, 1.0))
    at = known
    while at < end:
        after = min((at // BLOCK + 1) * BLOCK, end)
        there = draw.random() < share
        out += data[at:after] if there else bytes(after - at)
        at = after
    return bytes(out)


def messages_within(path: Path, data: bytes, known: int) -> int:
    """Messages of the load in the confirmed part of a file."""
    path.write_bytes(data[:known])
    recover(path)
    return check(path)[0]


def cut_once(path: Path, data: bytes, disk: Disk, draw: random.Random) -> dict[str, Any]:
    """One cut: whether the file opens, what was lost, whether confirmed messages are missing."""
    first, last = disk.grown[0][0], disk.grown[-1][0]
    known, written, sent_ns = disk.at(draw.uniform(first + 1.0, last))
    confirmed = messages_within(path, data, known)
    left = after_cut(data, known, written, draw)
    path.write_bytes(left)
    try:
        lost_bytes = recover(path).lost_bytes
        messages, last_ns = check(path)
    except Exception as error:  # whatever a reader fails with is the finding
        return {"opens": False, "error": repr(error), "known": known, "size": len(left)}
    return {
        "opens": True,
        "lost_s": (sent_ns - last_ns) * 1e-9 if messages else None,
        "lost_bytes": lost_bytes + max(written - len(left), 0),
        "missing": max(confirmed - messages, 0),
    }


def cuts(count: int, seconds: float, seed: int, sync: str = "chunk") -> list[dict[str, Any]]:
    """``count`` cuts over flights of ``seconds``, forty a flight."""
    found, draw = [], random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        while len(found) < count:
            data, disk = fly(folder, seconds, seed + len(found), sync)
            for _ in range(min(40, count - len(found))):
                found.append(cut_once(folder / "cut.mcap", data, disk, draw))
    return found


def summary(found: list[dict[str, Any]]) -> dict[str, float | int | str]:
    """The figures; a file without any message counts as more than a second lost."""
    good = [r for r in found if r["opens"]]
    lost = [r["lost_s"] for r in good if r["lost_s"] is not None]
    return {
        "power cuts": len(found),
        "files that open": len(good),
        "median loss, s": statistics.median(lost) if lost else 0.0,
        "largest loss, s": max(lost, default=0.0),
        "median loss, bytes": statistics.median(r["lost_bytes"] for r in good) if good else 0.0,
        "largest loss, bytes": max((r["lost_bytes"] for r in good), default=0),
        "cuts that lost more than 1 s": sum(r["lost_s"] is None or r["lost_s"] > 1.0 for r in good),
        "cuts that lost confirmed messages": sum(r["missing"] > 0 for r in good),
    }


GOALS = {
    "files that open": (200.0, 200.0),
    "cuts that lost more than 1 s": (0.0, 0.0),
    "cuts that lost confirmed messages": (0.0, 0.0),
}


def run() -> dict[str, float | int | str]:
    """200 cuts, and as many of a log that never asks for confirmation."""
    never = summary(cuts(200, 12.0, 7, "never"))
    return summary(cuts(200, 12.0, 7)) | {
        f"sync never: {k}": never[k]
        for k in ("largest loss, s", "cuts that lost more than 1 s", "files that open")
    }


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description="power cuts of the log")
    parser.add_argument("--cuts", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--sync", choices=("chunk", "never"), default="chunk")
    a = parser.parse_args()
    found = cuts(a.cuts, a.seconds, a.seed, a.sync)
    out = summary(found)
    print(json.dumps(out | {"errors": [r for r in found if not r["opens"]][:5]}, indent=1))
    bad = ("cuts that lost more than 1 s", "cuts that lost confirmed messages")
    return int(out["files that open"] != a.cuts or any(out[k] for k in bad))


if __name__ == "__main__":
    sys.exit(main())
