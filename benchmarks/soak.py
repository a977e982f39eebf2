"""A long flight with everything going wrong: the four nodes in processes of their own, a load at
the recording's rate, injected faults.

A recorded flight is flown again and again with stamps that go on, so that an hour maps no more
ground than a minute. All the time one message in a hundred is dropped; in turn come bursts of NaN,
a GNSS outage, a float solution, a receiver's clock set back, clouds stamped an hour ahead, all
clocks set back half a minute (a new pass of the data), restarts of each node, and a full disk.
Measured are resident sizes, times and the books: what was published against what arrived and what
was named lost. The times are from a scan, when it is published, to the first volume that holds it:
of the newest scan in each volume, and of every scan; how old the newest return in a volume is then;
and between two volumes.

``python -m benchmarks.soak [--seconds 180] [--full-rate | --site 200] [--faults A,B,...]
[--one-process | --without-log]``; ``--seconds 3600`` for the hour, ``--site`` for memory by area: a
square site of so many metres, the resident size of each node by time; ``--one-process`` for all of
them in one, as ``ladar_volume up`` runs them; ``--without-log`` for georeference, filter and volume
alone. Exit code 1 where a node died, a message is unaccounted for, an unforeseen exception counted,
no volume comes at the end or it is wrong by more than five sigma.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_srvs.srv import Trigger

from benchmarks.books import in_files, number, open_inside, open_log, open_steps
from benchmarks.footprint import cpu_seconds, proportional_mb, resident_mb
from ladar_volume.io.bags import BagReader
from ladar_volume.io.tables import decode
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.nodes.qos import LATCHED, STREAM
from ladar_volume.nodes.running import Spinner
from ladar_volume.process.private_graph import join_private_graph
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform, platform_for
from ladar_volume.simulation.scenes import Ground, make_scene, pile
from ladar_volume.simulation.suited_parameters import suited_settings
from ladar_volume.simulation.survey import Survey

ROOT = Path(__file__).parents[1]
BAG = ROOT / "bags" / "stockpile"
S = 1_000_000_000
NODES = ("georeference_node", "filter_node", "volume_node", "logger_node")
TYPES: dict[str, Any] = {"cloud": PointCloud2, "fix": NavSatFix, "imu": Imu}
TOPICS = {"cloud": "velodyne_points", "fix": "gnss/fix", "imu": "imu/data"}
#: Faults and how long each lasts, s.
FAULTS = {
    "nan": 2.0,
    "outage": 4.0,
    "float": 4.0,
    "fix_clock": 4.0,
    "lidar_stamps": 2.0,
    "disk_full": 6.0,
    "restart_volume_node": 0.0,
    "restart_filter_node": 0.0,
    "restart_georeference_node": 0.0,
    "restart_logger_node": 0.0,
    "all_clocks_back": 0.0,
}
#: How long the nodes may take to map what they put off, s.
SETTLE_S = 240.0
DROPPED, LOG_BYTES, BALLAST_BYTES = 0.01, 40_000_000, 60_000_000
#: How many times as large the log may be where no disk is filled: what is still wanted is written
#: to each new file, here one a minute.
ROOMY = 50


def full_rate_flight(folder: Path) -> Path:
    """Half a minute at all 300,000 firings a second."""
    scene = make_scene("stockpile", 5)
    survey = Survey(
        scene,
        platform_for(scene, "uav", 30.0),
        BudgetParameters(),
        SurveyParameters(30.0, 1, seed=5),
    )
    write_bag(survey, folder / "flight", suited_settings(scene), lambda share: None)
    return folder / "flight"


def site_flight(folder: Path, side_m: float) -> Path:
    """A minute at all 300,000 firings a second over a square site with a pile of 5000 m³ in its
    middle, filtered with a radius of 1 m; all of the site is mapped.
    """
    scene = pile(
        "site",
        22.0,
        18.0,
        0.2,
        Ground(slope=(0.012, -0.008), rough_m=0.010, length_m=1.0, seed=5),
        0.75 * side_m,
    )
    survey = Survey(
        scene,
        make_platform("uav", side_m, 60.0),
        BudgetParameters(),
        SurveyParameters(60.0, 1, seed=5),
    )
    settings, half = suited_settings(scene), 0.5 * side_m
    settings["filter"]["radius_m"] = 1.0
    settings["georeference"]["region_m"] = [-half, -half, -10.0, half, half, 30.0]
    write_bag(survey, folder / "site", settings, lambda share: None)
    return folder / "site"


@dataclass
class Recorded:
    """One message of the flight: when (ns from its start), what, its bytes with the stamp's
    distance from that moment, and the returns of a cloud.
    """

    at_ns: int
    kind: str
    data: bytes
    stamp_ns: int
    returns: int


def flight(path: Path) -> tuple[list[Recorded], int]:
    """The recording in memory and its length, ns."""
    out = []
    with BagReader(path) as bag:
        roles = {topic: role for role, topic in bag.roles().items() if role in TYPES}
        for raw in bag.raw(set(roles)):
            data = bytes(raw.data)
            sec, nanosec = struct.unpack_from("<iI", data, 4)
            role, message = roles[raw.topic], bag.message(raw)
            returns = message.width * message.height if role == "cloud" else 0
            at, stamp = raw.t_ns - bag.start_ns, sec * S + nanosec - bag.start_ns
            out.append(Recorded(at, role, data, stamp, returns))
    return out, out[-1].at_ns + S


def stamped(data: bytes, t_ns: int) -> bytes:
    """A serialised message with another header stamp."""
    return data[:4] + struct.pack("<iI", t_ns // S, t_ns % S) + data[12:]


def with_nan(kind: str, data: bytes) -> bytes:
    """The message with NaN in it: a third of the points, the position, or the attitude."""
    message: Any = deserialize_message(data, TYPES[kind])
    if kind == "cloud":
        rows = np.frombuffer(message.data, np.uint8).copy().reshape(-1, message.point_step)
        rows[::3, :4] = np.frombuffer(np.float32(np.nan).tobytes(), np.uint8)
        length = rows.size
        return (
            data[: len(data) - 1 - length] + rows.tobytes() + data[-1:]
            if decode(message)["x"].dtype == np.float32
            else data
        )
    if kind == "fix":
        message.latitude = float("nan")
    else:
        message.orientation.x = float("nan")
    return bytes(serialize_message(message))


def changed_fix(data: bytes, status: int, scale: float) -> bytes:
    """The fix with another status and a covariance ``scale`` times as large."""
    message: Any = deserialize_message(data, NavSatFix)
    message.status.status = status
    message.position_covariance = np.asarray(message.position_covariance) * scale
    return bytes(serialize_message(message))


class Load(Node):
    """Publishes the flight with its faults, and listens to diagnostics and volumes."""

    def __init__(self, nodes: tuple[str, ...]) -> None:
        super().__init__("load")
        self._listeners = 2 if "logger_node" in nodes else 1
        self.out = {k: self.create_publisher(TYPES[k], TOPICS[k], STREAM) for k in TYPES}
        self.back_ns = 0
        self.sent = dict.fromkeys(TYPES, 0)
        self.unheard = dict.fromkeys(TYPES, 0)
        self.dropped = dict.fromkeys(TYPES, 0)
        self.hurt = dict.fromkeys(FAULTS, 0)
        self.returns = 0
        self.lines: dict[str, dict[str, str]] = {}
        self.past: list[tuple[str, dict[str, str]]] = []
        self.warnings: dict[str, int] = {}
        self.flown: list[tuple[int, float]] = []
        self.held = 0
        self.volumes: list[tuple[float, float]] = []
        self.newest_scan_s: list[tuple[float, float]] = []
        self.every_scan_s: list[tuple[float, float]] = []
        self.deferred: list[float] = []
        self.seen: set[int] = set()
        self._random = random.Random(4)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._listen, 100)
        self.create_subscription(PointCloud2, "volumes", self._volume, LATCHED)

    def _listen(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.lines[status.name] = {v.key: v.value for v in status.values}
            if status.name == "filter_node":
                self.deferred.append(float(self.lines[status.name].get("deferred_s", "0")))
            for words in status.message.split("; "):
                text = "".join(c for c in words if not c.isdigit() and c not in ".-")
                self.warnings[text] = self.warnings.get(text, 0) + 1

    def _volume(self, message: PointCloud2) -> None:
        """A volume of everything up to its stamp: it is the first to hold each scan that begins
        before, and none held earlier.
        """
        t_ns, now = message.header.stamp.sec * S + message.header.stamp.nanosec, time.monotonic()
        age_s = (time.time_ns() - t_ns - self.back_ns) * 1e-9
        if t_ns in self.seen or not 0.0 <= age_s < 60.0:
            return
        self.seen.add(t_ns)
        self.volumes.append((now, age_s))
        first = self.held
        while self.held < len(self.flown) and self.flown[self.held][0] <= t_ns:
            self.held += 1
        waited = [(now, now - sent) for _, sent in self.flown[first : self.held]]
        self.every_scan_s += waited
        self.newest_scan_s += waited[-1:]

    def heard(self, kind: str) -> bool:
        """Whether every node that wants these messages listens."""
        return bool(self.out[kind].get_subscription_count() >= self._listeners)

    def send(self, one: Recorded, t_ns: int, fault: str | None) -> None:
        """Publish a message stamped ``t_ns``, as the fault wants it."""
        kind, data = one.kind, one.data
        if self._random.random() < DROPPED:
            self.dropped[kind] += 1
            return
        t_ns -= self.back_ns
        hit = True
        if fault == "nan":
            data = with_nan(kind, data)
        elif fault == "outage" and kind == "fix":
            data = changed_fix(data, -1, 1.0)
        elif fault == "float" and kind == "fix":
            data = changed_fix(data, 0, 100.0)
        elif fault == "fix_clock" and kind == "fix":
            t_ns -= 3 * S
        elif fault == "lidar_stamps" and kind == "cloud":
            t_ns += 3600 * S
        else:
            hit = False
        if fault is not None and hit:
            self.hurt[fault] += 1
        if not self.heard(kind):  # the logger, or the node in question, is down
            self.unheard[kind] += 1
        self.sent[kind] += 1
        self.returns += one.returns
        if kind == "cloud" and fault != "lidar_stamps":
            self.flown.append((t_ns, time.monotonic()))
        self.out[kind].publish(stamped(data, t_ns))

    def total(self, node: str, prefix: str) -> int:
        """Sum of a node's counters that begin so, over its restarts."""
        parts = [lines for name, lines in self.past if name == node] + [self.lines.get(node, {})]
        return sum(
            int(v)
            for lines in parts
            for k, v in lines.items()
            if k.startswith(prefix) and v.lstrip("-").isdigit()
        )


class Soak:
    """Starts the nodes, flies, hurts, measures."""

    def __init__(
        self, bag: Path, folder: Path, fills_disk: bool, one_process: bool, nodes: tuple[str, ...]
    ) -> None:
        self._nodes = nodes
        self._ballast = folder / "ballast"
        self._settings = {
            "config_file": str(bag / "config.yaml"),
            "node.input_reliability": "reliable",
            "node.input_depth": "2000",
            "node.diagnostics_period_s": "0.5",
            "logger.path": str(folder / "log.mcap"),
            "logger.disk_full": "delete_oldest",
        }
        log, disk = LOG_BYTES if fills_disk else ROOMY * LOG_BYTES, os.statvfs(folder)
        room = max(
            disk.f_bavail * disk.f_frsize - 4 * log, 0
        )  # the disk counts as nearly full from the start
        self._settings |= {
            "logger.split_bytes": str(log // 4),
            "logger.disk_reserve_bytes": str(room),
        }
        self.load = Load(nodes)
        self._spinner = Spinner(self.load)
        self.processes = (
            {"up": self._start_all(folder)}
            if one_process
            else {name: self._start(name) for name in nodes}
        )
        self.resident: list[tuple[float, dict[str, float]]] = []
        self.proportional: list[float] = []
        self.busy = dict.fromkeys(self.processes, 0.0)
        self._busy_of: dict[int, float] = {}
        self.died: list[str] = []
        self.logged: dict[str, int] | None = None  # messages by topic in the files of the log

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        section = name.split("_")[0]
        words = [
            w
            for k, v in self._settings.items()
            if k.split(".")[0] in ("config_file", "node", section)
            for w in ("-p", f"{k}:={v}")
        ]
        command = [
            sys.executable,
            "-m",
            "ladar_volume.nodes.programs",
            name,
            "--ros-args",
            "--log-level",
            "error",
            *words,
        ]
        return subprocess.Popen(command, cwd=ROOT)

    def _start_all(self, folder: Path) -> subprocess.Popen[bytes]:
        words = [
            w
            for k, v in self._settings.items()
            if k not in ("config_file", "logger.path")
            for w in ("--set", f"{k}={v}")
        ]
        files = [
            "--config",
            self._settings["config_file"],
            "--log",
            self._settings["logger.path"],
            "--output",
            str(folder / "out"),
        ]
        return subprocess.Popen(
            [sys.executable, "-m", "ladar_volume.cli.main", "up", *files, *words],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
        )

    def ready(self) -> None:
        """Wait until all nodes report and hear the load, and volume_node has had the filter begin
        anew: counters of before would not count what comes after.
        """
        deadline = time.monotonic() + 300.0
        while (
            set(self._nodes) - set(self.load.lines)
            or not all(self.load.heard(kind) for kind in TYPES)
            or number(self.load.lines, "volume_node", "joined") != 1
        ):
            if time.monotonic() > deadline or any(
                p.poll() is not None for p in self.processes.values()
            ):
                raise RuntimeError(
                    f"nodes did not start: {set(self._nodes) - set(self.load.lines)}"
                )
            time.sleep(0.1)

    def fly(
        self, messages: list[Recorded], length_ns: int, seconds: float, faults: list[str]
    ) -> None:
        """Publish in real time; the faults come one after the other, evenly, between a tenth and
        nine tenths of the time.
        """
        began, wall = time.monotonic(), time.time_ns()
        span = 0.8 * seconds / max(len(faults), 1)
        done, measured, sent = 0, 0.0, 0
        while True:
            for one in messages:
                at_s = (sent * length_ns + one.at_ns) * 1e-9
                if at_s > seconds:
                    return
                time.sleep(max(0.0, at_s - (time.monotonic() - began)))
                number = (
                    int((at_s - 0.1 * seconds) // span) if faults and at_s >= 0.1 * seconds else -1
                )
                fault = faults[number] if 0 <= number < len(faults) else None
                if fault is not None and done <= number:
                    done = number + 1
                    self._hit(fault)
                if fault is None or at_s - 0.1 * seconds - number * span > FAULTS[fault]:
                    fault = None
                    self._ballast.unlink(missing_ok=True)
                self.load.send(one, wall + sent * length_ns + one.stamp_ns, fault)
                if at_s - measured > 1.0:
                    measured = at_s
                    self._measure(at_s)
            sent += 1

    def settle(self, at_s: float) -> None:
        """Have the filter map all it put off, and wait for the volume of it: a site counts when it
        is mapped, however busy the machine.
        """
        client, began = self.load.create_client(Trigger, "filter_node/flush"), time.monotonic()
        flushed = client.call_async(Trigger.Request())
        while (past_s := time.monotonic() - began) < SETTLE_S:
            time.sleep(1.0)
            self._measure(at_s + past_s)
            sent, got = (self.load.lines.get(name, {}) for name in ("filter_node", "volume_node"))
            if (
                flushed.done()
                and sent.get("count_parts") == got.get("count_parts")
                and got.get("pending_estimate") == "0"
            ):
                break

    def _hit(self, fault: str) -> None:
        if fault == "all_clocks_back":
            self.load.back_ns += 30 * S
            self.load.held = len(self.load.flown)
            self.load.hurt[fault] += 1
        elif fault == "disk_full":
            with self._ballast.open("wb") as stream:
                stream.write(os.urandom(1_000_000) * ((4 * LOG_BYTES + BALLAST_BYTES) // 1_000_000))
            self.load.hurt[fault] += 1
        elif fault.startswith("restart_"):
            name = fault.removeprefix("restart_")
            process = self.processes[name]
            process.terminate()
            if process.wait(timeout=60.0) != 0:
                self.died.append(f"{name} ended with {process.returncode}")
            time.sleep(0.3)  # its last diagnostics come in
            self.load.past.append((name, self.load.lines.pop(name, {})))
            self.processes[name] = self._start(name)
            self.load.hurt[fault] += 1

    def _measure(self, at_s: float) -> None:
        self.resident.append(
            (at_s, {name: resident_mb(p.pid) for name, p in self.processes.items()})
        )
        self.proportional.append(sum(proportional_mb(p.pid) for p in self.processes.values()))
        for name, process in self.processes.items():
            now = cpu_seconds(process.pid)
            self.busy[name] += now - self._busy_of.setdefault(process.pid, now)
            self._busy_of[process.pid] = max(now, self._busy_of[process.pid])
            if process.poll() is not None and f"{name} died" not in self.died:
                self.died.append(f"{name} died")

    def close(self) -> None:
        """End the nodes in the order of the data, then listen for their last words."""
        time.sleep(3.0)
        for process in self.processes.values():
            process.terminate()
            try:
                process.wait(timeout=60.0)
            except subprocess.TimeoutExpired:
                process.kill()
                self.died.append("a node did not end")
        time.sleep(0.5)
        self._spinner.close()


def middle_and_end(seconds: Any) -> list[float]:
    """Median and 99th percentile, NaN of nothing."""
    return [float(np.percentile(seconds, q)) if len(seconds) else float("nan") for q in (50, 99)]


def by_halves(timed: list[tuple[float, float]]) -> dict[str, list[float]]:
    """Median and 99th percentile of (when, seconds): of all, and of both halves of the time."""
    t, seconds = np.array(timed).reshape(-1, 2).T
    late = t > (t[0] + t[-1]) / 2.0 if len(t) else np.zeros(0, bool)
    return {
        "all": middle_and_end(seconds),
        "first half": middle_and_end(seconds[~late]),
        "second half": middle_and_end(seconds[late]),
    }


def report(soak: Soak, truth_m3: float) -> dict[str, Any]:
    """The figures; ``wrong`` lists what must not be."""
    load = soak.load
    wrong = list(soak.died)
    unaccounted = {}
    for kind in TYPES:
        arrived = load.total("georeference_node", f"received_{kind}") + load.total(
            "georeference_node", f"lost_message_lost_{kind}"
        )
        unaccounted[kind] = load.sent[kind] - load.unheard[kind] - arrived
        if unaccounted[kind] > 0 or (unaccounted[kind] < 0 and not any(load.unheard.values())):
            wrong.append(f"{unaccounted[kind]} {kind} messages are unaccounted for")
    restarted = frozenset(name for name, _ in load.past)
    if not load.hurt.get("all_clocks_back") and not soak.died:
        wrong += open_steps(load.lines, restarted)
        deaf = load.total("georeference_node", "lost_message_") or any(load.unheard.values())
        unlike = restarted | ({"georeference_node"} if deaf else set())
        unlike |= {"filter_node"} if restarted else set()
        wrong += open_inside(load.lines, load.returns, unlike)
    whole = number(load.lines, "logger_node", "deleted_files") == 0
    if soak.logged is not None and whole and not any(load.unheard.values()):
        sent = {TOPICS[kind]: n for kind, n in load.sent.items()}
        reasons = (
            "lost_message_middleware_",
            "lost_message_queue_",
            "lost_message_disk_",
            "before_",
        )
        lost = {t: sum(load.total("logger_node", f"{r}{t}") for r in reasons) for t in sent}
        wrong += open_log(sent, soak.logged, lost)
    unforeseen = sum(load.total(name, "lost_message_internal_error") for name in NODES)
    if unforeseen:
        wrong.append(f"{unforeseen} unforeseen exceptions")
    last = load.lines.get("volume_node", {})
    volume, sigma = float(last.get("volume_m3", "nan")), float(last.get("sigma_m3", "nan"))
    if not abs(volume - truth_m3) < 5.0 * sigma:
        wrong.append(f"volume {volume} with sigma {sigma}, true {truth_m3}")
    losses: dict[str, int] = {}
    for name, lines in [*load.past, *load.lines.items()]:
        for key, value in lines.items():
            if key.startswith("lost_"):
                losses[f"{name} {key[5:]}"] = losses.get(f"{name} {key[5:]}", 0) + int(value)
    between = np.diff([t for t, _ in load.volumes])
    sizes = [sum(r.values()) for _, r in soak.resident]
    flown_s = soak.resident[-1][0] - soak.resident[0][0]
    third, tenth = max(len(sizes) // 3, 1), max(len(sizes) // 10, 1)
    return {
        "wrong": wrong,
        "sent": load.sent,
        "dropped_by_load": load.dropped,
        "unheard_while_down": load.unheard,
        "unaccounted": unaccounted,
        "faults": {k: n for k, n in load.hurt.items() if n},
        "volumes": len(load.volumes),
        "voxels": int(load.lines.get("filter_node", {}).get("voxels", "0")),
        "volume_m3": volume,
        "sigma_m3": sigma,
        "truth_m3": truth_m3,
        "scan_to_volume_s": by_halves(load.newest_scan_s),
        "every_scan_to_volume_s": by_halves(load.every_scan_s),
        "newest_return_to_volume_s": by_halves(load.volumes),
        "between_volumes_s": middle_and_end(between),
        "put_off_s": middle_and_end(load.deferred),
        "cpu_per_second": {name: busy / flown_s for name, busy in soak.busy.items()},
        "resident_mb": {name: max(r[name] for _, r in soak.resident) for name in soak.processes},
        "resident_all_mb": max(sizes),
        "proportional_all_mb": max(soak.proportional),
        "resident_by_time_mb": {
            round(t): {
                name: round(max(r[name] for _, r in soak.resident[i : i + tenth]))
                for name in soak.processes
            }
            for i, (t, _) in enumerate(soak.resident)
            if i % tenth == 0
        },
        "resident_middle_third_mb": max(sizes[third : 2 * third] or sizes),
        "resident_last_third_mb": max(sizes[2 * third :] or sizes),
        "losses": dict(sorted(losses.items())),
        "named": dict(sorted(load.warnings.items(), key=lambda w: -w[1])[:25]),
    }


def soak(
    seconds: float,
    full_rate: bool,
    faults: list[str],
    site_m: float = 0.0,
    one_process: bool = False,
    nodes: tuple[str, ...] = NODES,
) -> dict[str, Any]:
    """Fly for ``seconds`` with the faults; over a site of ``site_m`` a side, if that is not 0."""
    join_private_graph()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag = (
            site_flight(folder, site_m)
            if site_m
            else full_rate_flight(folder)
            if full_rate
            else BAG
        )
        messages, length_ns = flight(bag)
        truth = float(json.loads((bag / "truth.json").read_text())["volume_m3"])
        rclpy.init(args=[])
        one = Soak(bag, folder, "disk_full" in faults, one_process, nodes)
        try:
            one.ready()
            one.fly(messages, length_ns, seconds, faults)
            if site_m:
                one.settle(seconds)
        finally:
            one.close()
            rclpy.try_shutdown()
        if "logger_node" in nodes and not one_process:
            one.logged = in_files(folder / "log.mcap")
        return report(one, truth)


GOALS = {"things wrong": (0.0, 0.0), "unaccounted": (0.0, 0.0)}


def run() -> dict[str, float | int | str]:
    """Three minutes at full rate."""
    out = soak(180.0, True, list(FAULTS))
    latency, every = out["scan_to_volume_s"]["all"], out["every_scan_to_volume_s"]["all"]
    return {
        "wrong": "; ".join(out["wrong"]) or "nothing",
        "messages": sum(out["sent"].values()),
        "kinds of faults": len(out["faults"]),
        "things wrong": len(out["wrong"]),
        "unaccounted": sum(max(n, 0) for n in out["unaccounted"].values()),
        "scan to volume p50, s": latency[0],
        "scan to volume p99, s": latency[1],
        "every scan to volume p50, s": every[0],
        "every scan to volume p99, s": every[1],
        "points put off at most, p50, s": out["put_off_s"][0],
        "points put off at most, p99, s": out["put_off_s"][1],
        "all nodes at most, MB": out["resident_all_mb"],
        "all nodes at most in the last third, MB": out["resident_last_third_mb"],
        "processor time per second": ", ".join(
            f"{name} {busy:.2f}" for name, busy in out["cpu_per_second"].items()
        ),
        "load average of the machine at the end, all its work": (
            f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        ),
    }


def main() -> int:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description="long flight with faults")
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument(
        "--full-rate",
        action="store_true",
        help="simulate a flight at 300,000 returns a second instead of the shipped one",
    )
    parser.add_argument(
        "--site",
        type=float,
        default=0.0,
        metavar="METRES",
        help="the same over a square site of this side, radius 1 m",
    )
    parser.add_argument(
        "--faults", default=",".join(FAULTS), help=f"comma-separated: {', '.join(FAULTS)}"
    )
    parser.add_argument(
        "--one-process",
        action="store_true",
        help="all nodes in one process; a single one cannot be restarted then",
    )
    parser.add_argument(
        "--without-log",
        action="store_true",
        help="georeference, filter and volume only: three processes",
    )
    arguments = parser.parse_args()
    nodes = NODES[:3] if arguments.without_log else NODES
    alone = {"restart_logger_node", "disk_full"} if arguments.without_log else set()
    faults = [
        f
        for f in arguments.faults.split(",")
        if f and not (arguments.one_process and f.startswith("restart_")) and f not in alone
    ]
    out = soak(
        arguments.seconds, arguments.full_rate, faults, arguments.site, arguments.one_process, nodes
    )
    print(json.dumps(out, indent=1))
    return int(bool(out["wrong"]))


if __name__ == "__main__":
    sys.exit(main())
