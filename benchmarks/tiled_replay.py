"""What ``ladar_volume replay --dask`` costs, and that it gives what one process gives.

    python benchmarks/tiled_replay.py BAG FOLDER [--tile M] [--workers 0,1,2] [--kills N]

prints a line of a table for the replay in one process, then for tiles with 0 workers (this
process), 1 and 2; then replays N times on two workers of which a random one is killed at a random
time, and counts the results that are equal to the bit.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import psutil


def tree(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """A process and all below it."""
    try:
        root = psutil.Process(process.pid)
        return [root, *root.children(recursive=True)]
    except psutil.Error:
        return []


def watch(process: subprocess.Popen[str], seen: dict[str, int], kill_after: float | None) -> None:
    """Largest resident memory of all together and of one, bytes; one worker is killed once."""
    began = time.monotonic()
    while process.poll() is None:
        sizes = []
        for one in tree(process):
            try:
                sizes.append(one.memory_info().rss)
            except psutil.Error:
                continue
        seen["all"] = max(seen["all"], sum(sizes))
        seen["one"] = max(seen["one"], *sizes, 0)
        if kill_after is not None and time.monotonic() - began > kill_after:
            workers = [p for p in tree(process)[1:] if "spawn_main" in " ".join(p.cmdline())]
            if workers:
                random.choice(workers).send_signal(signal.SIGKILL)
                seen["killed"] += 1
                kill_after = None
        time.sleep(0.1)


def replayed(
    bag: Path, folder: Path, words: list[str], kill_after: float | None = None
) -> tuple[dict[str, Any], dict[str, int], float, float]:
    """Result, memory, seconds, and CPU seconds of a replay."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    command = [sys.executable, "-m", "ladar_volume.cli.main", "replay", str(bag), "--json"]
    command += ["--no-figure", "-o", str(folder / "out"), *words]
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    seen = {"all": 0, "one": 0, "killed": 0}
    thread = threading.Thread(target=watch, args=(process, seen, kill_after))
    thread.start()
    facts = json.loads(process.communicate()[0])
    thread.join()
    took, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return facts, seen, took, cpu


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
        facts, seen, took, cpu = replayed(a.bag, a.folder, words)
        tiles = facts.pop("tiles", {"count": 0})
        alone.update(facts if not alone else {})
        each = 1e6 * cpu / facts["points"]["returns"]
        print(
            f"| {how} | {tiles['count']} | {took:.1f} | {cpu:.1f} | {each:.2f} "
            f"| {seen['all'] / 2**20:.0f} | {seen['one'] / 2**20:.0f} | {facts['volume_m3']:.9f} "
            f"| {facts['sigma_m3']:.9f} | {facts == alone} |",
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
        facts, seen, _, _ = replayed(a.bag, a.folder, words, after)
        facts.pop("tiles")
        equal, killed = equal + (facts == alone), killed + seen["killed"]
        print(
            f"run {k + 1}: killed {seen['killed']} after {after:.1f} s, {equal} equal", flush=True
        )
    if a.kills:
        print(f"{equal} of {a.kills} runs equal, {killed} workers killed")


if __name__ == "__main__":
    main()
