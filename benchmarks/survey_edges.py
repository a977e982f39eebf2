"""Small clouds of cones, boxes and dunes of 0.3 to 100 m whose surface stands off the level at the
edge of what was surveyed: whole, thinned by half, in an L, with strays up to 30 % beyond the edge.

``volume`` above the ground and above a level, with nothing set, against the exact volume over the
whole area. An answer more than three sigma off with a sound verdict is *silent*: there must be
none. ``python -m benchmarks.survey_edges [--first SEED] [--count N]``
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.truth import F64
from ladar_volume.cli.main import main as ladar_volume

EDGES = ("strays", "thinned", "whole", "L")


def site(seed: int) -> tuple[F64, float, float, float, str]:
    """Points (n, 3) m, the unit of length m, the volume above the ground and the area, in units,
    and what it is.
    """
    rng = np.random.default_rng(seed)
    unit = float(10.0 ** rng.uniform(-0.5, 2.0))
    xy, area = rng.uniform(-1.0, 1.0, (int(rng.integers(800, 2500)), 2)), 4.0
    kind, edge = ("cone", "box", "dune")[seed % 3], EDGES[seed % 4]
    if edge == "L":
        xy, area = xy[~(xy > 0.5).all(axis=1)], 3.75
    r = np.hypot(*xy.T)
    z, volume = 0.4 * np.maximum(0.0, 1.0 - r / 0.5), math.pi * 0.25 * 0.4 / 3.0
    if kind == "box":
        z, volume = np.where((np.abs(xy) < 0.3).all(axis=1), 0.3, 0.0), 0.36 * 0.3
    elif kind == "dune":
        z, volume = 0.3 * np.exp(-((r / 0.25) ** 2)), 0.3 * math.pi * 0.25**2
    points = np.c_[xy, z + rng.normal(0.0, 0.003, len(z))]
    if edge == "thinned":
        points = points[rng.random(len(points)) < 0.5]
    if edge == "strays":
        points = np.r_[points, rng.uniform(-1.3, 1.3, (12, 3)) * (1.0, 1.0, 0.5)]
    return unit * points, unit, volume, area, f"{kind}, {edge}"


def answer(points: F64, words: list[str]) -> tuple[float, float, str]:
    """Net volume and sigma, m³, and the verdict; NaN and "refused" for none."""
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.npy"
        np.save(path, points)
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()):
            code = ladar_volume(["volume", str(path), *words, "--json"])
    if code:
        return math.nan, math.nan, "refused"
    found = json.loads(said.getvalue())
    return found["net_m3"], found["sigma_m3"], found["verdict"]["status"]


def main() -> int:
    """Print a line per answer; 1 where one was silent."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=700)
    parser.add_argument("--count", type=int, default=12)
    a = parser.parse_args()
    silent, off = 0, []
    for seed in range(a.first, a.first + a.count):
        points, unit, volume, area, what = site(seed)
        level = (0.0, 0.5, -0.3, -1.0)[seed // 3 % 4]
        bases = ((["--base", "ground"], 0.0), (["--level", repr(level * unit)], level))
        for words, height in bases:
            net, sigma, status = answer(points, words)
            z = (net - unit**3 * (volume - height * area)) / sigma
            silent += abs(z) > 3.0 and status == "sound"
            off += [z] if math.isfinite(z) else []
            print(f"{seed} {unit:7.2f} m {what:14s} {words[0]:8s} z {z:6.2f} {status}", flush=True)
    rms = math.sqrt(float(np.mean(np.square(off))))
    print(f"silent: {silent}; the RMS of {len(off)} answers is {rms:.2f} sigma")
    return int(silent > 0)


if __name__ == "__main__":
    raise SystemExit(main())
