"""How often a new volume appears while a recording plays at its own speed through four nodes in
four processes.
"""

from __future__ import annotations

import contextlib
import io
import os
import statistics
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from ladar_volume.cli.main import main

BAG = Path(__file__).parents[1] / "bags" / "stockpile"


def run() -> dict[str, float | int | str]:
    """Intervals between volumes from the first one to the end of the data, three plays."""
    worst, middle, count = [], [], []
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
            log = Path(folder) / "log.mcap"
            if main(
                [
                    "up",
                    "--play",
                    str(BAG),
                    "--rate",
                    "1",
                    "--separate",
                    "--log",
                    str(log),
                    "--log-all",
                    "-o",
                    folder,
                ]
            ):
                raise RuntimeError("the graph failed")
            with log.open("rb") as stream:
                times: dict[str, list[int]] = {"/volumes": [], "/points_mapped": []}
                for _, channel, message in make_reader(stream).iter_messages(topics=list(times)):
                    times[channel.topic].append(message.log_time)
        last = times["/points_mapped"][-1]
        # what follows the end of the data by more than one interval is the closing answer, not an
        # update
        volumes = [t for t in times["/volumes"] if t <= last + 2_000_000_000]
        gaps = np.diff(volumes) * 1e-9
        worst.append(float(gaps.max()))
        middle.append(float(np.median(gaps)))
        count.append(len(volumes))
    return {
        "volumes per play": statistics.median(count),
        "median interval, s": statistics.median(middle),
        "longest interval of each play, s": ", ".join(f"{g:.2f}" for g in worst),
        "load average of the machine at the end, all its work": (
            f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        ),
    }
