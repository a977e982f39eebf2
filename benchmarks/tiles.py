"""What ``ladar_volume tiles`` costs: time and memory by points and workers.

    python -m benchmarks.tiles 1000000 FOLDER
    python -m benchmarks.tiles 1000000 FOLDER --clean off --relevant all --sigma 0.02

writes a simulated cloud of so many points (in pieces; strips along x, 10 points/m², noise of 2 cm)
once, and prints a line of a table for 0 workers (this process), 1 and 2. What follows the folder
are options of the verb.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import laspy
import numpy as np

from benchmarks.watched import Watched

PIECE = 500_000
DENSITY = 10.0


def write_cloud(path: Path, points: int) -> None:
    """A rolling surface of so many points as LAZ."""
    rng, side = np.random.default_rng(1), (points / DENSITY) ** 0.5
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    with laspy.open(path, mode="w", header=header) as file:
        for first in range(0, points, PIECE):
            n = min(PIECE, points - first)
            record = laspy.ScaleAwarePointRecord.zeros(n, header=header)
            y = np.sort(rng.uniform(first / points * side, (first + n) / points * side, n))
            x = rng.uniform(0.0, side, n)
            z = 10.0 + 2.0 * np.sin(x / 17.0) * np.cos(y / 23.0) + rng.normal(0.0, 0.02, n)
            record.x, record.y, record.z = x, y, z
            file.write_points(record)


def measure(cloud: Path, workers: int, store: Path) -> None:
    """One line of the table."""
    shutil.rmtree(store, ignore_errors=True)
    words = [sys.executable, "-m", "ladar_volume.cli.main", "tiles", str(cloud)]
    words += ["--level", "10", "--json", "--store", str(store), *sys.argv[3:]]
    words += ["--dask", "--workers", str(workers)] if workers else []
    start = time.perf_counter()
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    watched = Watched(process)
    facts = json.loads(process.communicate()[0])
    watched.join()
    took = time.perf_counter() - start
    bytes_at_rest = sum(p.stat().st_size for p in store.rglob("*") if p.is_file())
    points = facts["tiles"]["points"]
    print(
        f"| {points:.0e} | {workers} | {facts['tiles']['count']} | {took:.1f} "
        f"| {watched.cpu_s:.1f} | {watched.largest / 2**20:.0f} "
        f"| {bytes_at_rest / points:.0f} | {facts['net_m3']:.6f} | {facts['sigma_m3']:.6f} |",
        flush=True,
    )


def main() -> None:
    points, folder = int(sys.argv[1]), Path(sys.argv[2])
    cloud = folder / f"tiles_{points}.laz"
    if not cloud.exists():
        write_cloud(cloud, points)
    print("| points | workers | tiles | s | CPU s | MB, largest process | B/point | V | sigma |")
    for workers in (0, 1, 2):
        measure(cloud, workers, folder / "store")


if __name__ == "__main__":
    main()
