"""What each node costs before any data: time to import its module, to be active and to be heard,
and resident size.

Active is a node that has its kernels and takes in data. Heard it is with its first diagnostics:
discovery over DDS takes up to three seconds where an announcement is missed.

``python -m benchmarks footprint``. Kernels are in their cache (a first start of every node is not
measured); each node is alone in a process of its own. Medians of three starts.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray

from ladar_volume.process.private_graph import join_private_graph

ROOT = Path(__file__).parents[1]
NODES = ("georeference_node", "filter_node", "volume_node", "logger_node", "mavlink_node")
STARTS, TIMEOUT_S = 3, 300.0


def resident_mb(pid: int) -> float:
    """Resident size of a process (MB); 0 where it is gone."""
    return _memory_mb(pid, "status", "VmRSS:")


def proportional_mb(pid: int) -> float:
    """The same with each page that several processes share divided among them; 0 where it is
    gone.
    """
    return _memory_mb(pid, "smaps_rollup", "Pss:")


def _memory_mb(pid: int, file: str, name: str) -> float:
    try:
        lines = Path(f"/proc/{pid}/{file}").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024.0 for line in lines if line.startswith(name)), 0.0)


def cpu_seconds(pid: int) -> float:
    """Processor time a process has used so far (s); 0 where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def imported(name: str, environment: dict[str, str]) -> tuple[float, float]:
    """Seconds to import a node's module in a fresh interpreter, and its resident size then (MB)."""
    code = (
        "import time; began = time.perf_counter()\n"
        "from ladar_volume.nodes import programs\n"
        "programs.own_process()\n"
        "programs.hide_numpy_tools()\n"
        f"import ladar_volume.nodes.{name}\n"
        "print(time.perf_counter() - began, next(l for l in open('/proc/self/status') if "
        "l.startswith('VmRSS')).split()[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    seconds, kilobytes = done.stdout.split()
    return float(seconds), int(kilobytes) / 1024.0


def words_for(name: str, folder: str) -> list[str]:
    """The command line of a node, after the program."""
    settings = {
        "node.diagnostics_period_s": "0.1",
        "logger.path": f"{folder}/log.mcap",
        "mavlink.url": "udpin:127.0.0.1:14660",
    }
    own = [
        w
        for k, v in settings.items()
        if k.split("_")[0].split(".")[0] in ("node", name.split("_")[0])
        for w in ("-p", f"{k}:={v}")
    ]
    return ["--ros-args", *own]


def active(name: str, environment: dict[str, str], folder: str) -> float:
    """Seconds from the start of the process until the node is active."""
    code = (
        "import sys, time\n"
        "from ladar_volume.nodes import programs\n"
        "programs.own_process()\n"
        "programs.hide_numpy_tools()\n"
        f"from ladar_volume.nodes import base, {name} as module\n"
        "plain = base.StageNode.on_activate\n"
        "def told(self, state):\n"
        "    done = plain(self, state)\n"
        "    print(time.time(), flush=True)\n"
        "    return done\n"
        "base.StageNode.on_activate = told\n"
        "sys.exit(module.main(sys.argv))\n"
    )
    began = time.time()
    command = [sys.executable, "-c", code, *words_for(name, folder)]
    process = subprocess.Popen(
        command,
        env=environment,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        return float(process.stdout.readline()) - began
    finally:
        process.terminate()
        process.wait(timeout=60.0)


def heard(name: str, environment: dict[str, str], folder: str) -> tuple[float, float]:
    """Seconds from the start of the process to its first diagnostics, less their period, and the
    resident size then (MB).
    """
    watcher = rclpy.create_node("footprint")
    seen: list[str] = []
    watcher.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: seen.extend(s.name for s in m.status), 10
    )
    began = time.monotonic()
    command = [sys.executable, "-m", "ladar_volume.nodes.programs", name, *words_for(name, folder)]
    process = subprocess.Popen(command, env=environment, cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        while name not in seen:
            if process.poll() is not None or time.monotonic() - began > TIMEOUT_S:
                raise RuntimeError(f"{name} did not start")
            rclpy.spin_once(watcher, timeout_sec=0.05)
        return time.monotonic() - began - 0.1, resident_mb(process.pid)
    finally:
        process.terminate()
        process.wait(timeout=60.0)
        watcher.destroy_node()


def run() -> dict[str, float | int | str]:
    """Import time, start time and resident size of every node."""
    join_private_graph()
    environment = dict(os.environ)
    out: dict[str, float | int | str] = {}
    rclpy.init(args=[])
    try:
        for name in NODES:
            with tempfile.TemporaryDirectory() as folder:
                active(name, environment, folder)  # fills the cache
                imports = [imported(name, environment) for _ in range(STARTS)]
                actives = [active(name, environment, folder) for _ in range(STARTS)]
                starts = [heard(name, environment, folder) for _ in range(STARTS)]
            out[f"{name}: import, s"] = statistics.median(s for s, _ in imports)
            out[f"{name}: imported, MB"] = statistics.median(m for _, m in imports)
            out[f"{name}: active, s"] = statistics.median(actives)
            out[f"{name}: heard, s"] = statistics.median(s for s, _ in starts)
            out[f"{name}: before data, MB"] = statistics.median(m for _, m in starts)
    finally:
        rclpy.try_shutdown()
    out["load average of the machine at the end, all its work"] = (
        f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    return out
