"""Where the processor time of a flight at full rate goes: one process streams it through the stages
and over the wire's tables, with an update and an estimate every second of data that leave nothing
for later.

``python -m benchmarks stages``. Seconds of processor time per second of data, all threads together,
with one thread and with two; beside them how many patches an update changes and how long the last
updates and estimates took. Of the budgets and of the fits only the calls that cost something are
listed; ``filter`` and ``estimate`` are the sums.
"""

from __future__ import annotations

import dataclasses
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.soak import TYPES, full_rate_flight
from ladar_volume.compile_kernels import STAGES, warm_up
from ladar_volume.io import message_tables
from ladar_volume.io.bags import BagReader
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.config import read_config
from ladar_volume.io.sensor_messages import fix_from_message, imu_from_message
from ladar_volume.io.tables import encode
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.pipeline import Engine
from ladar_volume.rmls import point_admission
from ladar_volume.rmls.fit_store import FitStore
from ladar_volume.rmls.patch_builder import PatchBuilder
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.uncertainty.patch_table import PatchStore
from ladar_volume.uncertainty.volume_budget import Sources
from ladar_volume.volume import estimator, measured_body

SECONDS, S = 60.0, 1_000_000_000
Record = tuple[int, str, Any]
#: What is timed: its name in the table, where it lives and what it is called there.
TIMED: tuple[tuple[str, Any, str], ...] = (
    ("filter: points taken in", SurfaceFilter, "_take_in"),
    ("filter: geometry regained from poses", point_admission, "geometry"),
    ("filter: fits", PatchBuilder, "fit"),
    ("filter: fits kept", FitStore, "keep"),
    ("filter: patches, with cross blocks and sensitivities", PatchBuilder, "patches"),
    ("filter: sensitivities", PatchBuilder, "_sensitivities"),
    ("filter: points", PatchBuilder, "points"),
    ("filter", SurfaceFilter, "update"),
    ("estimate: merge of the update", PatchStore, "_merge"),
    ("estimate: TIN", estimator.VolumeEstimator, "surface"),
    ("estimate: ground and outline", measured_body, "base_and_outline"),
    ("estimate: prismoids", measured_body, "solid_of"),
    ("estimate: budget", Sources, "budget"),
    ("estimate: ground's roughness", measured_body, "ground_field"),
    ("estimate: surface near its base", measured_body, "near_correction"),
    ("estimate", estimator.VolumeEstimator, "estimate"),
)


class Times:
    """Processor time by name."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def call(self, name: str, function: Callable[..., Any], *words: Any, **named: Any) -> Any:
        """Call the function and note what it took."""
        began = time.process_time()
        try:
            return function(*words, **named)
        finally:
            self.spent[name] = self.spent.get(name, 0.0) + time.process_time() - began

    def watch(self, name: str, owner: Any, attribute: str) -> None:
        """Note every call of ``owner.attribute`` from now on."""
        plain = getattr(owner, attribute)
        setattr(owner, attribute, lambda *words, **named: self.call(name, plain, *words, **named))


def recorded(bag: Path, parameters: Parameters) -> tuple[list[Record], int]:
    """Time from the start (ns), kind and record of each message, and the length of the flight
    (ns).
    """
    decode = {
        "cloud": lambda m: returns_from_cloud(m, parameters.georeference, Losses()),
        "fix": fix_from_message,
        "imu": imu_from_message,
    }
    with BagReader(bag) as reader:
        roles = {topic: role for role, topic in reader.roles().items() if role in TYPES}
        raws = [
            (raw.t_ns - reader.start_ns, roles[raw.topic], reader.message(raw))
            for raw in reader.raw(set(roles))
        ]
    out = [(at, role, decode[role](message)) for at, role, message in raws]
    return out, out[-1][0] + S


def again_and_again(
    records: list[Record], length_ns: int, seconds: float
) -> Iterator[tuple[float, str, Any]]:
    """The flight over and over, with stamps that go on, for so many seconds."""
    for turn in range(int(seconds * S // length_ns) + 1):
        for at, kind, record in records:
            later = turn * length_ns
            if (at + later) / S <= seconds:
                yield (at + later) / S, kind, dataclasses.replace(record, t_ns=record.t_ns + later)


def over_the_wire(update: Any) -> list[Any]:
    """An update as its tables and back."""
    tables = [
        (message_tables.patch_columns(part), message_tables.filtered_columns(part.points))
        for part in message_tables.update_parts(update)
    ]
    for pair in tables:
        for table in pair:
            encode(table)
    points = [
        message_tables.filtered_points(p)
        if len(p["variance"])
        else message_tables.no_filtered_points()
        for _, p in tables
    ]
    return [
        message_tables.filter_update(p, patches)
        for p, (patches, _) in zip(points, tables, strict=True)
    ]


def brought_up_to_date(engine: Engine, times: Times) -> tuple[int, float, float]:
    """One update and one estimate: patches changed, and what both took (s)."""
    began = time.process_time()
    update = engine.filter.update()
    middle = time.process_time()
    if update is None:
        return 0, middle - began, 0.0
    for part in times.call("update over the wire", over_the_wire, update):
        engine.estimator.add(part)
    ready = time.process_time()
    try:
        engine.estimator.estimate()
    except LadarVolumeError:
        return len(update.patches), middle - began, 0.0
    return len(update.patches), middle - began, time.process_time() - ready


def stream(bag: Path, seconds: float) -> dict[str, float]:
    """Seconds per second of data by stage."""
    for stage in STAGES:
        warm_up(stage)
    parameters, times, rows = read_config(bag / "config.yaml"), Times(), []
    records, length_ns = recorded(bag, parameters)
    for name, owner, attribute in TIMED:
        times.watch(name, owner, attribute)
    engine, due = Engine(parameters), 1.0
    add = {"cloud": engine.add_returns, "fix": engine.add_fix, "imu": engine.add_imu}
    for at, kind, record in again_and_again(records, length_ns, seconds):
        times.call("georeference", add[kind], record)
        if kind == "cloud":
            for points in times.call("georeference, points taken in", engine.step):
                times.call(
                    "points over the wire",
                    lambda p: message_tables.mapped_points(p[0], p[1]),
                    message_tables.mapped_columns(points),
                )
        if at > due:
            due += 1.0
            rows.append(brought_up_to_date(engine, times))
    half = rows[len(rows) // 2 :]
    changed, update, estimate = (statistics.median(column) for column in zip(*half, strict=True))
    spent = {name: value / seconds for name, value in times.spent.items()}
    return spent | {
        "patches": engine.filter.stats["patches"],
        "changed": changed,
        "last update": update,
        "last estimate": estimate,
    }


def run() -> dict[str, float | int | str]:
    """The table with one thread and with two, each in a process of its own."""
    out: dict[str, float | int | str] = {}
    with tempfile.TemporaryDirectory() as folder:
        bag = full_rate_flight(Path(folder))
        found = []
        for threads in ("1", "2"):
            environment = os.environ | {"NUMBA_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
            command = [sys.executable, "-m", "benchmarks.stages", str(bag)]
            text = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            ).stdout
            found.append(json.loads(text.splitlines()[-1]))
    for name in found[0]:
        out[name] = ", ".join(f"{one[name]:.4g}" for one in found)
    return out


if __name__ == "__main__":
    print(json.dumps(stream(Path(sys.argv[1]), SECONDS)))
