"""The cloud filter on the square of 2.7 million points, on the thesis's first cloud, and from 1e5
to 1e7 points (``benchmarks.square``).

Every timed run has a process of its own, so that memory is its own peak, with the cloud read from a
file before the clock starts and the kernels compiled before; compiling them into an empty cache is
timed apart. ``python -m benchmarks.filtering_square FILE.npy OUT.npz`` is such a process. Clouds of
the scaling run are so many pieces of the square side by side: density and content are the same in
all sizes.
"""

from __future__ import annotations

import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.filtering_peers import own
from benchmarks.peers import Missing, cpu_seconds, open3d_outliers, pcl_mls, timed
from benchmarks.shapes import Result
from benchmarks.square import (
    POINTS,
    SIDE_M,
    TILT,
    Square,
    bench_and_fountain,
    score,
    square,
    window,
)
from benchmarks.truth import F64

#: Pieces of the square, their side, m (100,000 points at its density), and how many differ.
TILES, TILE_M, DRAWN = (1, 3, 10, 30, 100), SIDE_M * float(np.sqrt(100_000 / POINTS)), 8
PEER_RADIUS_M = 0.15
Figures = dict[str, float | int | str]


def peak_gb() -> float:
    """Largest resident memory of this process, GB. Not ``getrusage``: its maximum is inherited from
    the process that started this one.
    """
    status = Path("/proc/self/status").read_text()
    return float(status.split("VmHWM:")[1].split()[0]) / 1e6


def child(source: Path, target: Path) -> None:
    """Filter one file; print times, memory and the filter's report as JSON."""
    warm = np.random.default_rng(0).random((3000, 3)) * [1.0, 1.0, 0.01]
    began = time.perf_counter()
    own(warm)
    compiled = time.perf_counter() - began
    points: F64 = np.load(source)
    before = peak_gb()
    wall, cpu = time.perf_counter(), cpu_seconds()
    result = own(points)
    answer = {"wall": time.perf_counter() - wall, "cpu": cpu_seconds() - cpu, "first": compiled}
    answer |= {"before_gb": before, "peak_gb": peak_gb()}
    np.savez(target, r=result.r, index=result.index, outliers=result.outliers)
    print(json.dumps({**answer, "report": getattr(result, "report", {})}, default=float))


def filtered(
    points: F64, folder: Path, threads: int | None = None, cache: Path | None = None
) -> tuple[dict[str, Any], Result]:
    """One run in a new process."""
    np.save(folder / "in.npy", points)
    extra = {} if threads is None else {"NUMBA_NUM_THREADS": str(threads)}
    extra |= {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    command = [
        sys.executable,
        "-m",
        "benchmarks.filtering_square",
        str(folder / "in.npy"),
        str(folder / "out.npz"),
    ]
    ran = subprocess.run(
        command,
        env=os.environ | extra,
        cwd=Path(__file__).parents[1],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    with np.load(folder / "out.npz") as kept:
        return json.loads(ran.stdout.splitlines()[-1]), SimpleNamespace(
            **{key: kept[key] for key in kept.files}
        )


def digest(result: Result) -> str:
    """Hash of an answer."""
    return hashlib.sha256(
        b"".join(
            np.ascontiguousarray(a).tobytes() for a in (result.r, result.index, result.outliers)
        )
    ).hexdigest()


def sized(tiles: int, side: float = TILE_M) -> F64:
    """Bench and fountain ``tiles`` times side by side, as square as the count allows, level with
    each other: what is in a cloud decides its cost, so clouds of all sizes hold the same. Noise is
    drawn ``DRAWN`` times and then used again.
    """
    rows = next(k for k in range(int(np.sqrt(tiles)), 0, -1) if tiles % k == 0)
    drawn = [window(square(POINTS, seed), side).points for seed in range(min(tiles, DRAWN))]
    steps = [side * np.array([i % rows, i // rows, 0.0]) @ TILT.T for i in range(tiles)]
    return np.concatenate([drawn[i % DRAWN] + step for i, step in enumerate(steps)])


def own_square(whole: Square, folder: Path, times: int) -> tuple[Figures, float]:
    """Medians of our runs, and the figures of the answer; wall seconds."""
    runs = [filtered(whole.points, folder) for _ in range(times)]
    answers, result = [answer for answer, _ in runs], runs[-1][1]
    wall, cpu = (statistics.median(answer[key] for answer in answers) for key in ("wall", "cpu"))
    out: Figures = {
        "points": len(whole.points),
        "kept": len(result.index),
        "wall, s": wall,
        "CPU, s": cpu,
    }
    out |= {
        "peak memory of the process, GB": answers[-1]["peak_gb"],
        "of it before filtering, GB": answers[-1]["before_gb"],
    }
    out |= dict(score(whole, result))
    out |= {f"chosen {key}": value for key, value in answers[-1]["report"].items()}
    single, alone = filtered(whole.points, folder, threads=1)
    out["wall on one thread, s"] = single["wall"]
    out["same bytes on one thread"] = "yes" if digest(alone) == digest(result) else "no"
    return out, wall


def peers(whole: Square, wall: float) -> Figures:
    """PCL and Open3D once each."""
    out: Figures = {}
    for name, method in (
        ("PCL MLS order 2", lambda p: pcl_mls(p, PEER_RADIUS_M)),
        ("Open3D outlier removal", open3d_outliers),
    ):
        try:
            took, cpu, result = timed(method, whole.points, 1)
        except Missing as missing:
            out[name] = f"skipped: {missing}"
            continue
        figures = score(whole, result)
        out |= {
            f"{name}: wall, s": took,
            f"{name}: CPU, s": cpu,
            f"{name}: RMS, mm": figures["rms_mm"],
        }
        out |= {
            f"{name}: wall / own": took / wall,
            f"{name}: far outliers removed, %": figures["far_removed_pct"],
        }
        if "crown_kept_pct" in figures:
            out[f"{name}: crown kept, %"] = figures["crown_kept_pct"]
    return out


def scaling(folder: Path, tiles: tuple[int, ...]) -> Figures:
    """Wall per point over sizes."""
    out: Figures = {}
    cost = []
    for count in tiles:
        points = sized(count)
        answer, _ = filtered(points, folder)
        cost.append(1e6 * answer["wall"] / len(points))
        out[f"{len(points)} points"] = (
            f"{answer['wall']:.2f} s wall, {answer['cpu']:.2f} s CPU, {cost[-1]:.2f} us / point"
        )
    out["largest / least cost per point"] = max(cost) / min(cost)
    return out


def run(times: int = 3, with_peers: bool = True, tiles: tuple[int, ...] = TILES) -> Figures:
    """Medians of ``times`` on the square; peers and sizes once each."""
    out: Figures = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = bench_and_fountain()
        out["first run with compilation into an empty cache, s"] = filtered(
            first.points[:3000], folder, cache=folder / "cache"
        )[0]["first"]
        for title, whole in (("bench and fountain", first), ("square", square())):
            figures, wall = own_square(whole, folder, times)
            out |= {f"{title}: {key}": value for key, value in figures.items()}
            if with_peers:
                out |= {f"{title}: {key}": value for key, value in peers(whole, wall).items()}
        out |= {f"scaling: {key}": value for key, value in scaling(folder, tiles).items()}
    return out


if __name__ == "__main__":
    if len(sys.argv) == 3:
        child(Path(sys.argv[1]), Path(sys.argv[2]))
    else:
        for key, value in run().items():
            print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
