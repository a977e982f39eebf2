"""Run every benchmark on the machine at hand and write RESULTS.md beside this file.

``python -m benchmarks [NAME ...]``: all of them, or those named. Each module has ``run() -> dict[str, float | int | str]``.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
from pathlib import Path

from ladar_volume.version import version

HERE = Path(__file__).parent
NAMES = (
    "georeference", "filtering", "filtering_peers", "filtering_square", "surface", "surface_peers", "epochs", "replay", "live",
    "seeds", "pits", "spheres", "correlated_sum", "ball_box", "local_mesh", "kill_logger", "calibration", "bodies",
    "propagation", "footprint", "fuzz", "soak",
)  # fmt: skip


def machine() -> str:
    """Processor, cores and Python, for the head of the table."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def main(wanted: list[str]) -> int:
    """Run the wanted benchmarks, print and keep their figures."""
    unknown = set(wanted) - set(NAMES)
    if unknown:
        print(f"no such benchmark: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}", file=sys.stderr)
        return 2
    text = [f"# Benchmarks of ladar_volume {version()}", "", machine(), ""]
    for name in wanted or NAMES:
        figures = importlib.import_module(f"benchmarks.{name}").run()
        text += [f"## {name}", "", "| figure | value |", "|---|---|"]
        for key, value in figures.items():
            text.append(f"| {key} | {value:.4g} |" if isinstance(value, float) else f"| {key} | {value} |")
            print(f"{name}: {key}: {value:.4g}" if isinstance(value, float) else f"{name}: {key}: {value}", flush=True)
        text.append("")
    if not wanted:
        (HERE / "RESULTS.md").write_text("\n".join(text))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
