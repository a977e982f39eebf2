"""What ``ladar_volume volume CLOUD.laz --base ground`` costs, from file to volume, and how far its
volume is from that of the cone that the points were drawn from.

A cone on ground that slopes, evenly sampled with noise of 10 mm, in UTM coordinates; each run is a
process of its own.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import laspy
import numpy as np

SIZES = (100_000, 1_000_000, 10_000_000)
#: Points per m², noise m, height over radius of the cone, its radius over the side of the site.
DENSITY, NOISE_M, STEEP, WIDE = 83.0, 0.01, 0.45, 0.2
GOALS = {
    "1,000,000 points: CPU, s": (0.0, 10.0),
    "1,000,000 points: peak memory, GB": (0.0, 0.8),
    "10,000,000 points: time, s": (0.0, 60.0),
    "10,000,000 points: peak memory, GB": (0.0, 3.0),
}


def write_site(path: Path, points: int) -> float:
    """The site as LAZ; returns the volume of the cone, m³."""
    rng, side = np.random.default_rng(points), math.sqrt(points / DENSITY)
    x, y = rng.uniform(0.0, side, (2, points))
    radius = WIDE * side
    away = np.hypot(x - 0.45 * side, y - 0.55 * side)
    z = 100.0 + 0.01 * x + 0.005 * y + np.maximum(0.0, STEEP * (radius - away))
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, [400_000.0, 5_000_000.0, 0.0]
    out = laspy.LasData(header)
    out.x, out.y, out.z = x + 4e5, y + 5e6, z + rng.normal(0.0, NOISE_M, points)
    out.write(path)
    return math.pi * radius**2 * STEEP * radius / 3.0


def measure(path: Path) -> tuple[dict[str, float], float, float, float]:
    """The result of the verb, its CPU and wall time, s, and its peak memory, GB."""
    words = [sys.executable, "-m", "ladar_volume.cli.main", "volume", str(path), "--json"]
    start = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [*words, "--base", "ground", "--crs", "EPSG:25832"],
            stdout=output,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        took = time.perf_counter() - start
        output.seek(0)
        facts = json.load(output)
    return facts, used.ru_utime + used.ru_stime, took, used.ru_maxrss / 1e6


def run() -> dict[str, float | int | str]:
    """CPU, time, memory and error by the number of points."""
    out: dict[str, float | int | str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for points in SIZES:
            path = Path(folder) / f"{points}.laz"
            truth = write_site(path, points)
            if points == SIZES[0]:
                measure(path)  # what is compiled once
            facts, cpu, took, peak = measure(path)
            out[f"{points:,} points: CPU, s"] = round(cpu, 2)
            out[f"{points:,} points: time, s"] = round(took, 2)
            out[f"{points:,} points: peak memory, GB"] = round(peak, 3)
            off = (facts["net_m3"] - truth) / facts["sigma_m3"]
            out[f"{points:,} points: error"] = (
                f"{facts['net_m3'] - truth:+.3f} of {truth:,.2f} m³, {off:+.2f} sigma"
            )
    return out
