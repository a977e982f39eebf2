"""Whole offline replay of a flight at the VLP-16's full rate of 300,000 returns a second: how many
times real time.

A third of a UAV scanner's pulses meet the ground. So that the load is the full rate, every cloud of
a simulated flight is filled up to 30,000 returns with its own returns a few microseconds later: a
load, not a survey.
"""

from __future__ import annotations

import contextlib
import io
import json
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from ladar_volume.cli.main import main
from ladar_volume.io.bags import BagReader, BagWriter

DURATION_S = 20
RETURNS = 30_000


def fill(source: Path, target: Path) -> None:
    """Copy a recording with every cloud filled up to RETURNS returns."""
    with BagReader(source) as reader, BagWriter(target) as writer:
        for raw in reader.raw():
            if raw.topic != "velodyne_points":
                writer.write_raw(raw.topic, raw.kind, bytes(raw.data), raw.t_ns)
                continue
            cloud = reader.message(raw)
            rows = np.asarray(cloud.data).reshape(cloud.width, cloud.point_step)
            index = np.arange(RETURNS)
            filled = rows[index % len(rows)].copy()
            offset = (
                filled[:, 18:22].copy().view("<f4")
                + (index // len(rows))[:, None].astype(np.float32) * 3e-6
            )
            filled[:, 18:22] = offset.astype("<f4").view(np.uint8)
            cloud.width, cloud.row_step, cloud.data = (
                RETURNS,
                RETURNS * cloud.point_step,
                filled.reshape(-1),
            )
            writer.write(raw.topic, cloud, raw.t_ns)
    (target / "config.yaml").write_text((source / "config.yaml").read_text())


def run() -> dict[str, float | int | str]:
    """Median of three replays after one that compiles."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        flight, bag, out = Path(folder) / "flight", Path(folder) / "full", str(Path(folder) / "out")
        if main(
            [
                "simulate",
                "stockpile",
                "--platform",
                "uav",
                "--seed",
                "3",
                "--duration",
                str(DURATION_S),
                "-o",
                str(flight),
            ]
        ):
            raise RuntimeError("simulation failed")
        fill(flight, bag)
        main(["replay", str(bag), "--duration", "2", "--no-figure", "-o", out])
        walls, cpus = [], []
        for _ in range(3):
            wall, cpu = time.perf_counter(), time.process_time()
            if main(["replay", str(bag), "--no-figure", "-o", out]):
                raise RuntimeError("replay failed")
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
        result = json.loads((Path(out) / "result.json").read_text())
    returns = int(result["points"]["returns"])
    return {
        "returns": returns,
        "returns / s of flight": returns / DURATION_S,
        "wall / s": statistics.median(walls),
        "CPU / s": statistics.median(cpus),
        "times real time": DURATION_S / statistics.median(walls),
    }


if __name__ == "__main__":
    print(run())
