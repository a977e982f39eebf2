"""Ctrl-C on ``ros2 launch`` at random moments under load: four nodes and a player, a process each,
are signalled at once, in any order, while a survey plays faster than it was flown. Each must end by
itself; the log must open with ``mcap`` and ``rosbags`` and lack nothing that its account names; and
a volume that volume_node calls the one "at the end" must be that of the log, replayed, unless the
player went on after georeference_node had ended and the replay says how much more the log has.

``python -m benchmarks.ctrl_c [--runs N] [--seed N] [--launch]``. With ``--launch`` the nodes come
from ``ros2 launch ladar_volume online.launch.py`` on a terminal of its own, where Ctrl-C is typed:
in a shell where Jazzy and the package are sourced.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from mcap.reader import make_reader

from benchmarks.kill_logger import check
from ladar_volume.io.bags import BagReader
from ladar_volume.io.logs.heard_live import absent_words, heard_and_logged, lacking_words
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.process.private_graph import private_graph
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import SUITED
from ladar_volume.simulation.survey import Survey

ROOT = Path(__file__).parents[1]
PROGRAM = ["-m", "ladar_volume.nodes.programs"]
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
    """A thinned flight over a stockpile, for nodes that hear all of it."""
    scene = make_scene("stockpile", seed)
    platform = make_platform("uav", scene.extent_m, FLIGHT_S)
    survey = Survey(scene, platform, BudgetParameters(), SurveyParameters(FLIGHT_S, 8, seed=seed))
    suited = {s: dict(v) for s, v in SUITED["pile"].items()}
    write_bag(survey, path, suited, lambda share: None)
    given = yaml.safe_load((path / "config.yaml").read_text())
    given["/**"]["ros__parameters"]["node"] = {"input_reliability": "reliable", "input_depth": 2000}
    (path / "config.yaml").write_text(yaml.safe_dump(given))
    return path


def environment(graph: dict[str, str]) -> dict[str, str]:
    """That of a process in the graph which imports this tree."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | graph | {"PYTHONPATH": os.pathsep.join(paths)}


def started(words: list[str], graph: dict[str, str]) -> subprocess.Popen[str]:
    """A Python process in the graph."""
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, *words],
        env=environment(graph),
        cwd=ROOT,
        text=True,
        stdout=pipe,
        stderr=pipe,
    )


class Processes:
    """The nodes as a process each; signals come to them in random order."""

    def __init__(self, config: Path, log: Path, graph: dict[str, str]) -> None:
        given = {"config_file": config, "logger.path": log}
        words = [w for key, value in given.items() for w in ("-p", f"{key}:={value}")]
        self.nodes = {n: started([*PROGRAM, n, "--ros-args", *words], graph) for n in NODES}

    def interrupt(self, player: subprocess.Popen[str], rng: random.Random) -> None:
        """Ctrl-C for all."""
        together = [player, *self.nodes.values()]
        for process in rng.sample(together, len(together)):
            process.send_signal(signal.SIGINT)

    def ends(self) -> tuple[dict[str, str], dict[str, int]]:
        """Once all have ended: their words and exit codes."""
        said = {n: "".join(p.communicate(timeout=200)) for n, p in self.nodes.items()}
        return said, {n: p.returncode for n, p in self.nodes.items()}

    def kill(self) -> None:
        """End what has not ended."""
        for process in self.nodes.values():
            process.kill()
            process.wait()


class Launched:
    """The nodes by ``ros2 launch`` on a terminal: Ctrl-C reaches launch and all nodes at once."""

    def __init__(self, config: Path, log: Path, graph: dict[str, str]) -> None:
        self.terminal, inner = os.openpty()
        words = ["ros2", "launch", "ladar_volume", "online.launch.py"]
        self.launch = subprocess.Popen(
            [*words, f"config:={config}", f"log:={log}"],
            env=environment(graph),
            preexec_fn=lambda: os.login_tty(inner),
        )
        os.close(inner)
        self.text = b""
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):  # the terminal's end, once nobody has it open
            while part := os.read(self.terminal, 4096):
                self.text += part

    def interrupt(self, player: subprocess.Popen[str], rng: random.Random) -> None:
        """Ctrl-C, typed; the player is another terminal's."""
        first, last = rng.sample([self.type_ctrl_c, partial(player.send_signal, signal.SIGINT)], 2)
        first()
        last()

    def type_ctrl_c(self) -> None:
        """As a person does it."""
        os.write(self.terminal, b"\x03")

    def ends(self) -> tuple[dict[str, str], dict[str, int]]:
        """Once launch has ended: the words of each node, and what launch says of its end."""
        self.launch.wait(timeout=200)
        self.reader.join(timeout=10)
        text = self.text.decode(errors="replace")
        said = {n: "\n".join(re.findall(rf"\[{n}-\d+\].*", text)) for n in NODES}
        clean = {n: "process has finished cleanly" in words for n, words in said.items()}
        return said, {n: int(not clean[n]) for n in NODES}

    def kill(self) -> None:
        """End what has not ended."""
        if self.launch.poll() is None:
            os.killpg(self.launch.pid, signal.SIGKILL)
            self.launch.wait()
        os.close(self.terminal)


def kill_all(nodes: Processes | Launched, driver: subprocess.Popen[Any] | None) -> None:
    """End what has not ended of the nodes and of what plays to them."""
    nodes.kill()
    if driver is not None:
        driver.kill()
        driver.wait()


def interrupted(
    bag: Path, log: Path, rng: random.Random, launched: bool, early: bool
) -> dict[str, Any]:
    """One run: what the nodes said, their exit codes, and how long they took to end (s). early :
    signalled after the begin of the survey, else after the first volume.
    """
    with private_graph() as graph:
        nodes = (Launched if launched else Processes)(bag / "config.yaml", log, graph)
        player = None
        try:
            if started(["-c", READY, *NODES], graph).wait(timeout=240):
                raise RuntimeError("the nodes did not start")
            first = None if early else started(["-c", FIRST], graph)
            # a log is of what came once it listened: georeference_node and it
            player = started([*PROGRAM, "player", str(bag), str(RATE), "2"], graph)
            delay = rng.uniform(0.0, LATEST_S)
            if first is None:
                delay += 1.5  # the player looks for listeners first
            else:
                first.wait(timeout=90)
            time.sleep(delay)
            began = time.monotonic()
            nodes.interrupt(player, rng)
            said, codes = nodes.ends()
        finally:
            kill_all(nodes, player)
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


def keep(log: Path, config: Path, run: dict[str, Any], folder: Path | None) -> None:
    """Copies the log of a wrong end, its configuration and what the nodes said, where asked."""
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    for path in (log, config):
        if path.exists():
            shutil.copy(path, folder / f"{log.stem}_{path.name}")
    (folder / f"{log.stem}.json").write_text(json.dumps(run, indent=1, default=str))


def interrupt_often(
    runs: int, seed: int, folder: Path, launched: bool, wrong: Path | None = None
) -> list[dict[str, Any]]:
    """One dictionary per run, as :func:`interrupted`, with ``log`` (what is wrong with it), ``end``
    (the volume said to be at the end), ``replay`` (that of the log) and ``wrong``.

    wrong : where logs of wrong ends are kept
    """
    rng, found = random.Random(seed), []
    subprocess.run([sys.executable, "-m", "ladar_volume.compile_kernels"], cwd=ROOT, check=True)
    bag = recording(folder / "bag", 5)
    for n in range(runs):
        log = folder / f"log{n}.mcap"
        run = interrupted(bag, log, rng, launched, n % 4 == 0)
        end = re.search(r"volume at the end: ([\d.]+) m3", run["said"]["volume_node"])
        incomplete = "incomplete volume" in run["said"]["volume_node"]
        run |= {"log": complete(log), "end": float(end[1]) if end else None}
        run["replay"], run["more"] = (
            replayed(log, bag / "config.yaml", folder / "out") if end else (None, {})
        )
        other = run["replay"] is None or abs(run["replay"] - run["end"]) > PRINTED_M3
        run["wrong"] = end is not None and other and not run["more"]
        found.append(run)
        if run["wrong"] or run["log"]:
            keep(log, bag / "config.yaml", run, wrong)
        words = f"end {run['end']}, replay {run['replay']}" if end else "incomplete" * incomplete
        print(
            f"{n + 1}: signal after {run['delay_s']:.2f} s, ended in {run['took_s']:.1f} s, "
            f"codes {sorted(set(run['codes'].values()))}, log {run['log'] or 'complete'}, "
            f"{words or 'no volume'}{f', log has more: {more}' if (more := run['more']) else ''}"
            f"{' WRONG' if run['wrong'] else ''}",
            flush=True,
        )
    return found


def run(
    runs: int = 20, seed: int = 1, launched: bool = False, wrong: Path | None = None
) -> dict[str, float | int | str]:
    """Figures of so many runs."""
    with tempfile.TemporaryDirectory() as folder:
        found = interrupt_often(runs, seed, Path(folder), launched, wrong)
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
    parser.add_argument("--launch", action="store_true", help="the nodes by ros2 launch")
    parser.add_argument("--keep", type=Path, help="folder for the logs of wrong ends")
    arguments = parser.parse_args()
    figures = run(arguments.runs, arguments.seed, arguments.launch, arguments.keep)
    for name, value in figures.items():
        print(f"{name}: {value}")
    whole = figures["logs complete, %"] == 100.0
    wrong = figures["wrong volumes at the end"] or figures["nodes that did not end by themselves"]
    sys.exit(1 if wrong or not whole else 0)
