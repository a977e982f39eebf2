"""Run every benchmark on the machine at hand and write RESULTS.md beside this file; exit code 1
where one misses a goal.

``python -m benchmarks [NAME ...]``: all of them, or those named, whose sections replace those of an
earlier run. Each module has ``run() -> dict[str, float | int | str]`` and, where figures have
goals, ``GOALS``: least and most by figure.
"""

from __future__ import annotations

import datetime
import importlib
import os
import platform
import sys
from pathlib import Path

from ladar_volume.version import version

HERE = Path(__file__).parent
NAMES = (
    "georeference",
    "filtering",
    "filtering_peers",
    "filtering_square",
    "real_sweeps",
    "rotating_scanners",
    "surface",
    "surface_peers",
    "epochs",
    "replay",
    "stages",
    "live",
    "seeds",
    "pits",
    "spheres",
    "cloud_volume",
    "correlated_sum",
    "ball_box",
    "cut_fill_coverage",
    "epoch_coverage",
    "survey_bodies",
    "thin_walls",
    "local_mesh",
    "kill_logger",
    "power_cuts",
    "ctrl_c",
    "late_driver",
    "turned_mountings",
    "calibration",
    "bodies",
    "propagation",
    "footprint",
    "fuzz",
    "fuzz_files",
    "fuzz_readers",
    "planted",
    "soak",
)


def machine() -> str:
    """Processor, cores and Python, for the head of the table."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return (
        f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}"
    )


def sections(text: str) -> dict[str, str]:
    """The sections of an earlier RESULTS.md by name, headings included."""
    parts = text.split("\n## ")[1:]
    return {part.split("\n", 1)[0].strip(): f"## {part.strip()}\n" for part in parts}


def section(name: str, figures: dict[str, float | int | str]) -> str:
    """One benchmark's table."""
    rows = [
        f"| {key} | {value:.4g} |" if isinstance(value, float) else f"| {key} | {value} |"
        for key, value in figures.items()
    ]
    head = [
        f"## {name}",
        "",
        f"{version()}, {machine()}, {datetime.date.today()}",
        "",
        "| figure | value |",
        "|---|---|",
    ]
    return "\n".join([*head, *rows, ""])


def main(wanted: list[str]) -> int:
    """Run the wanted benchmarks, print their figures, and put their sections in the place of those
    of an earlier run.
    """
    unknown = set(wanted) - set(NAMES)
    if unknown:
        print(
            f"no such benchmark: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}",
            file=sys.stderr,
        )
        return 2
    results = HERE / "RESULTS.md"
    failed = []
    for name in wanted or NAMES:
        module = importlib.import_module(f"benchmarks.{name}")
        figures = module.run()
        failed += [f"{name}: {goal}" for goal in missed(figures, getattr(module, "GOALS", {}))]
        for key, value in figures.items():
            print(
                f"{name}: {key}: {value:.4g}"
                if isinstance(value, float)
                else f"{name}: {key}: {value}",
                flush=True,
            )
        done = sections(results.read_text()) if results.exists() else {}
        done[name] = section(name, figures)
        results.write_text(
            "\n".join(["# Benchmarks of ladar_volume", "", *(done[n] for n in NAMES if n in done)])
        )
    for line in failed:
        print(f"goal missed: {line}", file=sys.stderr)
    return int(bool(failed))


def missed(
    figures: dict[str, float | int | str], goals: dict[str, tuple[float, float]]
) -> list[str]:
    """The goals, least and most by figure, that figures do not meet; one that is not there, or no
    number, is missed.
    """
    out = []
    for key, (least, most) in goals.items():
        value = figures.get(key)
        if not isinstance(value, int | float) or not least <= value <= most:
            out.append(f"{key} is {value}, goal {least:g} to {most:g}")
    return out


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
