"""Drivers that listeners find one after the other: four nodes as a process each, and a driver that
publishes at once, before the nodes are up or once they all report. Each log is replayed: its volume
must be the one that volume_node called the volume at the end.

``python -m benchmarks.late_driver [--runs N] [--seed S]``. Every second driver is there before the
nodes; every third stops and starts again in the survey.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from benchmarks.ctrl_c import (
    NODES,
    PRINTED_M3,
    READY,
    ROOT,
    Processes,
    kill_all,
    recording,
    started,
)
from ladar_volume.process.private_graph import private_graph

#: Plays a recording without a look at who listens; stopped and begun anew, with publishers of its
#: own, at a share of it.
DRIVER = """
import sys, threading, time, rclpy
from ladar_volume.io.bags import BagReader, Raw
from ladar_volume.nodes.player import Player
class Part(Player):
    def part(self, first_ns, last_ns):
        began = time.monotonic()
        for raw in self._bag.raw(set(self._out), (first_ns, last_ns)):
            wait = (raw.t_ns - first_ns) * 1e-9 / self._rate - (time.monotonic() - began)
            if wait > 0:
                time.sleep(wait)
            self._out[raw.topic].publish(bytes(raw.data))
rclpy.init(args=[])
with BagReader(sys.argv[1]) as bag:
    cuts = [bag.start_ns + round(1e9 * bag.duration_s * s) for s in map(float, sys.argv[3:])]
    for first, last in zip(cuts, cuts[1:]):
        player = Part(bag, bag.roles(), float(sys.argv[2]))
        player.part(first, last - 1)
        player.wait_taken()
        player.destroy_node()
rclpy.try_shutdown()
"""
#: Ends when the nodes have worked off what came.
DRAINED = """
import time, rclpy
from ladar_volume.nodes.graph import Watcher
rclpy.init(args=[])
watcher, began, since, seen = Watcher(), time.monotonic(), time.monotonic(), ()
while time.monotonic() - since < 4.0 or not watcher.is_drained():
    rclpy.spin_once(watcher, timeout_sec=0.1)
    if watcher.counters() != seen:
        seen, since = watcher.counters(), time.monotonic()
    assert time.monotonic() < began + 300.0
"""
RATE = 2.0
GOALS = {"replays of another volume": (0.0, 0.0), "logs that lack messages": (0.0, 0.0)}


def flown(
    bag: Path, log: Path, before: bool, again: bool, rng: random.Random
) -> tuple[float | None, str]:
    """The volume at the end, m³, None where none was said to be, and what volume_node said."""
    cuts = ["0", *(["0.5"] if again else []), "1.001"]
    words = ["-c", DRIVER, str(bag), str(RATE), *cuts]
    with private_graph() as graph:
        driver = started(words, graph) if before else None
        if before:
            time.sleep(rng.uniform(0.0, 2.0))
        nodes = Processes(bag / "config.yaml", log, graph)
        try:
            if driver is None:
                if started(["-c", READY, *NODES], graph).wait(timeout=240):
                    raise RuntimeError("the nodes did not start")
                driver = started(words, graph)
            driver.wait(timeout=200)
            started(["-c", DRAINED], graph).wait(timeout=400)
            nodes.interrupt(driver, rng)
            said, _ = nodes.ends()
        finally:
            kill_all(nodes, driver)
    end = re.search(r"volume at the end: ([\d.]+) m3", said["volume_node"])
    return float(end[1]) if end else None, said["volume_node"][-200:]


def replayed(log: Path, config: Path, folder: Path) -> dict[str, Any]:
    """The result of the log's replay; empty where there is none."""
    words = ["replay", str(log), "--config", str(config), "--json", "--no-figure"]
    done = subprocess.run(
        [sys.executable, "-m", "ladar_volume.cli.main", *words, "-o", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    return dict(json.loads(done.stdout)) if done.returncode == 0 else {}


def copied(log: Path) -> int:
    """Messages that the log has from copies."""
    with log.open("rb") as stream:
        accounts = [r.metadata for r in make_reader(stream).iter_metadata() if r.name == "messages"]
    return sum(json.loads(text)["copied"] for each in accounts for text in each.values())


def run(runs: int = 12, seed: int = 1) -> dict[str, float | int | str]:
    """Figures of so many flights."""
    rng, other, lacks, none, taken, left = random.Random(seed), 0, 0, 0, 0, 0
    subprocess.run([sys.executable, "-m", "ladar_volume.compile_kernels"], cwd=ROOT, check=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = recording(folder / "bag", 5)
        for n in range(runs):
            log = folder / f"log{n}.mcap"
            before, again = n % 2 == 1, n % 3 == 2
            end, said = flown(bag, log, before, again, rng)
            result = replayed(log, bag / "config.yaml", folder / "out")
            given = result.get("input", {})
            unheard = given.get("unheard_live", {})
            reasons = [r["name"] for r in result.get("verdict", {}).get("reasons", [])]
            wrong = end is not None and abs(result.get("volume_m3", 0.0) - end) > PRINTED_M3
            other, none = other + wrong, none + (end is None)
            lacks += "log_incomplete" in reasons
            taken, left = taken + copied(log), left + sum(unheard.values())
            print(
                f"{n + 1}: driver {'before' if before else 'after'}{', twice' if again else ''}: "
                f"end {end}, replay {result.get('volume_m3')}, copied {copied(log)}, left out "
                f"{unheard}, more {given.get('more_than_live')}, {reasons}"
                f"{'' if end else said!r}{' WRONG' if wrong else ''}",
                flush=True,
            )
    return {
        "flights": runs,
        "replays of another volume": other,
        "logs that lack messages": lacks,
        "flights without a volume at the end": none,
        "messages taken from copies": taken,
        "messages left out, heard by the log alone": left,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name, value in run(arguments.runs, arguments.seed).items():
        print(f"{name}: {value}")
