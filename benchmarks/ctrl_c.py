"""Ctrl-C on ``ros2 launch`` at random moments under load: four nodes and a player, a process each,
are signalled at once, in any order, while a survey plays faster than it was flown. Each must end by
itself; the log must open with ``mcap`` and ``rosbags`` and lack nothing that its account names; and
a volume that volume_node calls the one "at the end" must be that of the log, replayed, unless the
player went on after georeference_node had ended and the replay says how much more the log has.

``python -m benchmarks.ctrl_c [--runs N] [--seed N]``
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from benchmarks.kill_logger import check
from ladar_volume.io.bags import BagReader
from ladar_volume.io.logs.heard_live import absent_words, heard_and_logged, lacking_words
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import SUITED
from ladar_volume.simulation.survey import Survey

ROOT = Path(__file__).parents[1]
NODES = ("georeference_node", "filter_node", "volume_node", "logger_node")
#: Length of the survey, times real time at which it plays, latest signal (s): in every fourth run
#: after the begin of the survey, in the others after the first volume.
FLIGHT_S, RATE, LATEST_S = 24.0, 4.0, 3.0
#: Digits of a volume in the node's words.
PRINTED_M3 = 1e-4
#: Ends when all nodes report and volume_node has found filter_node.
READY = """
import sys, time, rclpy
from ladar_volume.nodes.graph import Watcher
rclpy.init(args=[])
watcher, began = Watcher(), time.monotonic()
while not set(sys.argv[1:]) <= set(watcher.lines) or watcher.number("volume_node", "joined") != 1:
    rclpy.spin_once(watcher, timeout_sec=0.1)
    assert time.monotonic() < began + 200.0
"""
#: Ends with the first volume, or after a minute.
FIRST = """
import time, rclpy
from std_msgs.msg import Float64
rclpy.init(args=[])
node, heard, began = rclpy.create_node("first"), [], time.monotonic()
node.create_subscription(Float64, "volume", heard.append, 10)
while not heard and time.monotonic() < began + 60.0:
    rclpy.spin_once(node, timeout_sec=0.1)
"""
GOALS = {
    "logs complete, %": (100.0, 100.0),
    "wrong volumes at the end": (0.0, 0.0),
    "nodes that did not end by themselves": (0.0, 0.0),
}


def recording(path: Path, seed: int) -> Path:
    """A thinned flight over a stockpile."""
    scene = make_scene("stockpile", seed)
    platform = make_platform("uav", scene.extent_m, FLIGHT_S)
    survey = Survey(scene, platform, BudgetParameters(), SurveyParameters(FLIGHT_S, 8, seed=seed))
    suited = {s: dict(v) for s, v in SUITED["pile"].items()}
    write_bag(survey, path, suited, lambda share: None)
    return path


def started(words: list[str], domain: int) -> subprocess.Popen[str]:
    """A process on a domain of its own, on the loopback."""
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": str(ROOT),
    }
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def interrupted(
    bag: Path, log: Path, rng: random.Random, domain: int, early: bool
) -> dict[str, Any]:
    """One run: what the nodes said, their exit codes, and how long they took to end (s). early :
    signalled after the begin of the survey, else after the first volume.
    """
    given = {"config_file": bag / "config.yaml", "logger.path": log}
    given |= {"node.input_reliability": "reliable", "node.input_depth": 2000}
    words = [w for key, value in given.items() for w in ("-p", f"{key}:={value}")]
    program = ["-m", "ladar_volume.nodes.programs"]
    nodes = {n: started([*program, n, "--ros-args", *words], domain) for n in NODES}
    player = None
    try:
        if started(["-c", READY, *NODES], domain).wait(timeout=240):
            raise RuntimeError("the nodes did not start")
        first = None if early else started(["-c", FIRST], domain)
        # a log is of what came once it listened: georeference_node and it
        player = started([*program, "player", str(bag), str(RATE), "2"], domain)
        delay = rng.uniform(0.0, LATEST_S)
        if first is None:
            delay += 1.5  # the player looks for listeners first
        else:
            first.wait(timeout=90)
        time.sleep(delay)
        began = time.monotonic()
        together = [player, *nodes.values()]
        for process in rng.sample(together, len(together)):
            process.send_signal(signal.SIGINT)
        said = {n: "".join(p.communicate(timeout=200)) for n, p in nodes.items()}
    finally:
        for process in (*nodes.values(), *([player] if player else [])):
            process.kill()
            process.wait()
    codes = {n: p.returncode for n, p in nodes.items()}
    return {"said": said, "codes": codes, "delay_s": delay, "took_s": time.monotonic() - began}


def replayed(log: Path, config: Path, folder: Path) -> tuple[float | None, dict[str, int]]:
    """The volume of the log, m³, None where it has none; and what the log has beyond what the nodes
    had heard, by role.
    """
    words = ["replay", str(log), "--config", str(config), "--json", "--no-figure"]
    done = subprocess.run(
        [sys.executable, "-m", "ladar_volume.cli.main", *words, "-o", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    if done.returncode != 0:
        return None, {}
    result = json.loads(done.stdout)
    return float(result["volume_m3"]), dict(result["input"].get("more_than_live", {}))


def complete(log: Path) -> str:
    """Empty for a log that both readers open, with its index, whose account names no loss, and that
    lacks nothing that georeference_node had; else what is wrong.
    """
    try:
        check(log)
        with BagReader(log) as bag:
            missing = (
                absent_words(bag)
                if "cloud" not in bag.roles()
                else lacking_words(heard_and_logged(bag, bag.roles()))
            )
        if missing:
            return missing
        with log.open("rb") as stream:
            for record in make_reader(stream).iter_metadata():
                if record.name != "messages":
                    continue
                for topic, account in record.metadata.items():
                    values = json.loads(account)
                    lost = {k: values[k] for k in ("middleware", "queue", "disk") if values[k]}
                    if lost:
                        return f"{topic}: {lost}"
                return ""
    except Exception as error:  # whatever a reader fails with is the finding
        return str(error)
    return "no account: it was not closed"


def interrupt_often(runs: int, seed: int, folder: Path) -> list[dict[str, Any]]:
    """One dictionary per run, as :func:`interrupted`, with ``log`` (what is wrong with it), ``end``
    (the volume said to be at the end), ``replay`` (that of the log) and ``wrong``.
    """
    rng, found = random.Random(seed), []
    subprocess.run([sys.executable, "-m", "ladar_volume.compile_kernels"], cwd=ROOT, check=True)
    bag = recording(folder / "bag", 5)
    for n in range(runs):
        log = folder / f"log{n}.mcap"
        run = interrupted(bag, log, rng, (os.getpid() + n) % 90 + 10, n % 4 == 0)
        end = re.search(r"volume at the end: ([\d.]+) m3", run["said"]["volume_node"])
        incomplete = "incomplete volume" in run["said"]["volume_node"]
        run |= {"log": complete(log), "end": float(end[1]) if end else None}
        run["replay"], run["more"] = (
            replayed(log, bag / "config.yaml", folder / "out") if end else (None, {})
        )
        other = run["replay"] is None or abs(run["replay"] - run["end"]) > PRINTED_M3
        run["wrong"] = end is not None and other and not run["more"]
        found.append(run)
        words = f"end {run['end']}, replay {run['replay']}" if end else "incomplete" * incomplete
        print(
            f"{n + 1}: signal after {run['delay_s']:.2f} s, ended in {run['took_s']:.1f} s, "
            f"codes {sorted(set(run['codes'].values()))}, log {run['log'] or 'complete'}, "
            f"{words or 'no volume'}{f', log has more: {more}' if (more := run['more']) else ''}"
            f"{' WRONG' if run['wrong'] else ''}",
            flush=True,
        )
    return found


def run(runs: int = 20, seed: int = 1) -> dict[str, float | int | str]:
    """Figures of so many runs."""
    with tempfile.TemporaryDirectory() as folder:
        found = interrupt_often(runs, seed, Path(folder))
    return {
        "runs": len(found),
        "logs complete, %": 100.0 * sum(not r["log"] for r in found) / len(found),
        "wrong volumes at the end": sum(r["wrong"] for r in found),
        "right volumes at the end": sum(r["end"] is not None and not r["wrong"] for r in found),
        "said to be incomplete": sum("incomplete" in r["said"]["volume_node"] for r in found),
        "nodes that did not end by themselves": sum(
            code != 0 for r in found for code in r["codes"].values()
        ),
        "longest end, s": max(r["took_s"] for r in found),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name, value in run(arguments.runs, arguments.seed).items():
        print(f"{name}: {value}")
