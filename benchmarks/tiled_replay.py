"""What ``ladar_volume replay --dask`` costs, and that it gives what one process gives.

    python -m benchmarks.tiled_replay BAG FOLDER [--tile M] [--workers 0,1,2] [--kills N]

prints a line of a table for the replay in one process, then for tiles with 0 workers (this
process), 1 and 2; then replays N times on two workers of which a random one is killed at a random
time, and counts the results that are equal to the bit.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.watched import Watched


def replayed(
    bag: Path, folder: Path, words: list[str], kill_after: float | None = None
) -> tuple[dict[str, Any], Watched, float]:
    """Result of a replay, what it took, and its seconds."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "ladar_volume.cli.main", "replay", str(bag), "--json"]
    command += ["--no-figure", "-o", str(folder / "out"), *words]
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    watched = Watched(process, kill_after)
    facts = json.loads(process.communicate()[0])
    watched.join()
    return facts, watched, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--tile", default="50")
    parser.add_argument("--workers", default="0,1,2")
    parser.add_argument("--kills", type=int, default=0)
    a = parser.parse_args()
    store = ["--store", str(a.folder / "store"), "--tile", a.tile]
    print("| how | tiles | s | CPU s | µs a return | MB, all | MB, largest | V | sigma | equal |")
    alone: dict[str, Any] = {}

    def row(how: str, words: list[str]) -> None:
        facts, seen, took = replayed(a.bag, a.folder, words)
        tiles = facts.pop("tiles", {"count": 0})
        alone.update(facts if not alone else {})
        each = 1e6 * seen.cpu_s / facts["points"]["returns"]
        print(
            f"| {how} | {tiles['count']} | {took:.1f} | {seen.cpu_s:.1f} | {each:.2f} "
            f"| {seen.together / 2**20:.0f} | {seen.largest / 2**20:.0f} "
            f"| {facts['volume_m3']:.9f} | {facts['sigma_m3']:.9f} | {facts == alone} |",
            flush=True,
        )

    row("one process", [])
    for n in map(int, a.workers.split(",")):
        row(f"{n} workers", [*store, *(["--dask", "--workers", str(n)] if n else [])])
    random.seed(27)
    equal = killed = 0
    words = [*store, "--dask", "--workers", "2"]
    for k in range(a.kills):
        after = random.uniform(4.0, 20.0)
        facts, seen, _ = replayed(a.bag, a.folder, words, after)
        facts.pop("tiles")
        equal, killed = equal + (facts == alone), killed + seen.killed
        print(f"run {k + 1}: killed {seen.killed} after {after:.1f} s, {equal} equal", flush=True)
    if a.kills:
        print(f"{equal} of {a.kills} runs equal, {killed} workers killed")


if __name__ == "__main__":
    main()
