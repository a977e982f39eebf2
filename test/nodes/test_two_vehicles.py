"""Two vehicles on one graph, a namespace each: both give the volume of their own recording, log
their own topics, and all nodes that are signalled at once still end with all data.
"""

import json
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from own_process import own_graph

from ladar_volume.cli.main import main
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import SUITED
from ladar_volume.simulation.survey import Survey

ROOT = Path(__file__).parents[2]
#: Returns when all nodes report and volume_node has found filter_node.
READY = """
import sys, time, rclpy
from ladar_volume.nodes.graph import Watcher
rclpy.init(args=[])
watcher, began = Watcher(), time.monotonic()
while not set(sys.argv[1:]) <= set(watcher.lines) or watcher.number("volume_node", "joined") != 1:
    rclpy.spin_once(watcher, timeout_sec=0.1)
    assert time.monotonic() < began + 80.0
"""
#: The volume at the end is asked for, not those on the way.
UNHURRIED = ("--set", "node.update_period_s=1")
NODES = ("georeference_node", "filter_node", "volume_node", "logger_node")


def recording(path, seed):
    """Four seconds over a stockpile, thinned."""
    scene = make_scene("stockpile", seed)
    survey = Survey(
        scene,
        make_platform("uav", scene.extent_m, 4.0),
        BudgetParameters(),
        SurveyParameters(4.0, 20, seed=seed),
    )
    suited = {s: dict(v) for s, v in SUITED["pile"].items()}
    write_bag(survey, path, suited, lambda share: None)
    return path


@pytest.fixture
def start():
    """Starts processes in a graph of their own on the loopback."""
    with own_graph() as environment:

        def process(command):
            return subprocess.Popen(
                command,
                cwd=ROOT,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )

        yield process


def up(bag, folder, *more):
    """A played survey through the graph; its words."""
    words = [
        "up",
        "--play",
        str(bag),
        "--json",
        "--no-figure",
        "-o",
        str(folder),
        "--log",
        f"{folder}.mcap",
        "--rate",
        "4",
        *UNHURRIED,
    ]
    return [sys.executable, "-m", "ladar_volume.cli.main", *words, *more]


def answer(process):
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err[-2000:]
    return json.loads(out)


def offline(bag, folder, capsys):
    """The volume of a recording without nodes, m³."""
    assert main(["replay", str(bag), "--json", "--no-figure", "-o", str(folder)]) == 0
    return json.loads(capsys.readouterr().out)["volume_m3"]


def topics_of(log):
    with log.open("rb") as stream:
        return {c.topic for c in make_reader(stream).get_summary().channels.values()}


def test_two_vehicles_on_one_graph_give_what_each_gives_alone(tmp_path, start, capsys):
    bags = [recording(tmp_path / f"bag{k}", k) for k in (5, 6)]
    alone = [offline(b, tmp_path / "alone", capsys) for b in bags]
    both = [
        start(up(b, tmp_path / f"rover{k}", "--ros-args", "-r", f"__ns:=/rover{k}"))
        for k, b in enumerate(bags)
    ]
    found = [answer(p) for p in both]
    assert alone[0] != alone[1]
    for one, shared in zip(alone, found, strict=True):
        assert shared["volume_m3"] == pytest.approx(one, rel=1e-9)
        assert shared["losses_upstream"].keys() == {"georeference_node", "filter_node"}
    topics = topics_of(tmp_path / "rover0.mcap")
    assert "/rover0/velodyne_points" in topics and "/rover0/volumes" in topics
    assert not [t for t in topics if t.startswith("/rover1") or t.endswith("/patches")]


@pytest.mark.parametrize("seed", [1])
def test_nodes_signalled_at_once_under_load_end_with_all_data_or_say_so(
    tmp_path, seed, start, capsys
):
    bag, shuffled = recording(tmp_path / "bag", 5), random.Random(seed)
    log = tmp_path / "log.mcap"
    words = ["-p", f"config_file:={bag / 'config.yaml'}", "-p", f"logger.path:={log}"]
    words += ["-p", "node.input_reliability:=reliable", "-p", "node.input_depth:=2000"]
    program = [sys.executable, "-m", "ladar_volume.nodes.programs"]
    nodes = {n: start([*program, n, "--ros-args", *words]) for n in NODES}
    assert start([sys.executable, "-c", READY, *NODES]).wait(timeout=90) == 0
    player = start([*program, "player", str(bag), "8", "2"])
    try:
        player.wait(timeout=60)
        time.sleep(shuffled.uniform(0.0, 0.3))
        for name in shuffled.sample(NODES, len(NODES)):
            nodes[name].send_signal(signal.SIGINT)
        said = {n: p.communicate(timeout=120) for n, p in nodes.items()}
    finally:
        for process in (*nodes.values(), player):
            process.kill()
    assert {n: p.returncode for n, p in nodes.items()} == dict.fromkeys(NODES, 0), said
    words = "".join(said["volume_node"])
    end = re.search(r"volume at the end: ([\d.]+) m3", words)
    if end is None:
        assert "incomplete volume" in words, words
    else:
        whole = offline(bag, tmp_path / "whole", capsys)
        assert float(end[1]) == pytest.approx(whole, abs=1e-4)
    with log.open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count > 50  # it has its index


def test_a_volume_node_without_any_data_says_at_its_end_that_there_is_no_volume(start):
    program = [sys.executable, "-m", "ladar_volume.nodes.programs", "volume_node"]
    node = start(program)
    try:
        watcher = READY.replace(' or watcher.number("volume_node", "joined") != 1', "")
        assert start([sys.executable, "-c", watcher, "volume_node"]).wait(timeout=90) == 0
        node.send_signal(signal.SIGINT)
        words = "".join(node.communicate(timeout=60))
    finally:
        node.kill()
    assert node.returncode == 0 and "no volume at the end: no surface yet" in words, words
