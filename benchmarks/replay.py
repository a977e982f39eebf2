"""Whole offline replay of a flight at the VLP-16's full rate: how many times real time."""

from __future__ import annotations

import contextlib
import io
import json
import statistics
import tempfile
import time
from pathlib import Path

from ladar_volume.cli.main import main

DURATION_S = 20


def run() -> dict[str, float | int | str]:
    """Median of three replays, compilation done before; full rate means every firing cycle is kept."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        bag, out = Path(folder) / "full", str(Path(folder) / "out")
        if main(["simulate", "stockpile", "--platform", "uav", "--seed", "3", "--duration", str(DURATION_S), "-o", str(bag)]):
            raise RuntimeError("simulation failed")
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            main(["info", str(bag), "--json"])
        info = json.loads(printed.getvalue())
        main(["replay", str(bag), "--duration", "2", "--no-figure", "-o", out])
        walls, cpus = [], []
        for _ in range(3):
            wall, cpu = time.perf_counter(), time.process_time()
            if main(["replay", str(bag), "--no-figure", "-o", out]):
                raise RuntimeError("replay failed")
            walls.append(time.perf_counter() - wall)
            cpus.append(time.process_time() - cpu)
        result = json.loads((Path(out) / "result.json").read_text())
    seconds = float(info["duration_s"])
    wall = statistics.median(walls)
    return {
        "bag / s": seconds,
        "returns / s": float(result["points"]["returns"]) / seconds,
        "wall / s": wall,
        "CPU / s": statistics.median(cpus),
        "times real time": seconds / wall,
    }


if __name__ == "__main__":
    print(run())
