"""``ladar_volume study coverage``: do the error bars hold the truth? Monte Carlo of whole surveys
(UNCERTAINTY, "How it is proved").

Every survey is one task; its numbers are one line of a file. A restart goes on where the file ends.
"""

from __future__ import annotations

import dataclasses
import json
import math
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.experiments.coverage.coverage_cases import (
    ALL,
    BASE_SURFACE,
    LINES,
    NOISE,
    SCENARIOS,
    SEED,
    SITES,
    VARIANTS,
    measure_survey,
    volume_changes_by_source,
)
from ladar_volume.experiments.coverage.coverage_engine import measure_by_engine
from ladar_volume.model.errors import ConfigurationError, OutputError, SurfaceError, VolumeError
from ladar_volume.process.switch import children_of_one_thread
from ladar_volume.version import version

#: Surveys of a scenario with all sources on, with each source alone, and of each variant whose
#: errors are not those believed.
FULL, REDUCED = (2000, 1000, 500), (200, 200, 50)
#: Variant and first seed of surveys through the whole engine.
ENGINE, ENGINE_SEED = "whole engine", 80_000
FILE = "surveys.jsonl"
#: Number of the way in which surveys are simulated and written down: those of another are not
#: counted with.
METHOD = 3
#: From so many surveys on: limits of predicted over empirical sigma, and of the share (%) of
#: intervals that hold the truth.
LIMITS = {
    0: {"ratio": (0.85, 1.15), "holds_68_pct": (58.0, 78.0), "holds_95_pct": (90.0, 99.0)},
    1000: {"ratio": (0.9, 1.1), "holds_68_pct": (65.0, 71.0), "holds_95_pct": (93.0, 97.0)},
}


def limits(surveys: int) -> dict[str, tuple[float, float]]:
    """The limits that so many surveys can be held to."""
    return LIMITS[max(n for n in LIMITS if n <= surveys)]


@dataclass(frozen=True)
class Task:
    """One survey to be done."""

    scenario: str
    variant: str
    seed: int


def tasks(scenarios: Sequence[str], counts: tuple[int, int, int], engine: int = 0) -> list[Task]:
    """All surveys, scenario by scenario and seed by seed, the last ``engine`` of each scenario
    through the whole engine.

    Raises :class:`ConfigurationError` for a scenario that there is not.
    """
    unknown = sorted(set(scenarios) - set(SCENARIOS))
    if unknown:
        raise ConfigurationError(
            f"no scenario {unknown[0]!r}; there are {', '.join(SCENARIOS)}", value=unknown[0]
        )
    count = {ALL: counts[0], **dict.fromkeys(tuple(VARIANTS)[1:], counts[2]), LINES: counts[1]}
    out = []
    for name in scenarios:
        out += [
            Task(name, variant, SEED + k)
            for k in range(max(counts))
            for variant, many in count.items()
            if k < many
        ]
        out += [Task(name, ENGINE, ENGINE_SEED + k) for k in range(engine)]
    return out


def do(task: Task) -> dict[str, Any]:
    """The numbers of one survey as plain values; of one that is refused, such as a box with a gap
    in its walls, the reason.
    """
    try:
        result = numbers(task)
    except (SurfaceError, VolumeError) as error:
        return {**dataclasses.asdict(task), **provenance(), "result": {}, "refused": str(error)}
    return {**dataclasses.asdict(task), **provenance(), "result": result}


def survey_group(group: Sequence[Task]) -> list[dict[str, Any]]:
    """:func:`do` for surveys of one seed, which share their pulses and their ground."""
    return list(map(do, group))


def provenance() -> dict[str, Any]:
    """What a line of the file must agree in to be counted."""
    return {"version": version(), "method": METHOD}


def numbers(task: Task) -> dict[str, Any]:
    """By base the numbers of one survey."""
    site = SITES[task.scenario]
    if task.variant == LINES:
        return dict(volume_changes_by_source(site, task.seed))
    by_engine = task.variant == ENGINE
    rows = (
        measure_by_engine(task.scenario, task.seed)
        if by_engine
        else measure_survey(site, *VARIANTS[task.variant], task.seed)
    )
    return {base: dataclasses.asdict(row) for base, row in rows.items()}


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The surveys in a file, those of this version and method; a last line that was broken off is
    left out. Empty without a file.
    """
    rows, _ = sorted_rows(path)
    return rows


def sorted_rows(path: Path) -> tuple[list[dict[str, Any]], int]:
    """:func:`read_rows`, and how many surveys of another version or method the file holds beside
    them.
    """
    rows, others = [], 0
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if provenance().items() <= row.items():
            rows.append(row)
        else:
            others += 1
    return rows, others


def finished_tasks(rows: Iterable[dict[str, Any]]) -> set[Task]:
    """The tasks behind rows."""
    return {Task(r["scenario"], r["variant"], r["seed"]) for r in rows}


def run(todo: Sequence[Task], path: Path, workers: int, progress: Callable[[int], None]) -> None:
    """Do what is not yet in the file, on ``workers`` processes, and append each survey as it comes;
    ``progress`` is told the number done.

    Raises :class:`OutputError` where the file cannot be written.
    """
    finished = finished_tasks(read_rows(path)) & set(todo)
    left = [t for t in todo if t not in finished]
    progress(len(finished))
    try:
        with path.open("a", encoding="utf-8") as file:
            if file.tell() and not path.read_text(encoding="utf-8").endswith("\n"):
                file.write("\n")  # the line that was broken off
            for number, row in enumerate(results(left, workers), start=len(finished) + 1):
                file.write(json.dumps(row) + "\n")
                file.flush()
                progress(number)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error}", value=str(path)) from error


def results(todo: Sequence[Task], workers: int) -> Iterator[dict[str, Any]]:
    """Results of tasks as they come, those of one seed together, from processes of one thread each;
    in this process for a single worker.
    """
    groups = (
        list(group) for _, group in groupby(todo, key=lambda task: (task.scenario, task.seed))
    )
    if workers <= 1:
        yield from map(do, todo)
        return
    spawn = multiprocessing.get_context("spawn")
    with children_of_one_thread(), ProcessPoolExecutor(workers, mp_context=spawn) as pool:
        waiting: set[Future[list[dict[str, Any]]]] = set()
        try:
            while True:
                for group in groups:
                    waiting.add(pool.submit(survey_group, group))
                    if len(waiting) >= 2 * workers:
                        break
                if not waiting:
                    return
                ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in ready:
                    yield from future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def root_mean_square(values: Sequence[float]) -> float:
    """√ mean of squares; 0 for none."""
    return math.sqrt(math.fsum(v * v for v in values) / len(values)) if values else 0.0


def statistics(rows: Sequence[dict[str, Any]], true_m3: float) -> dict[str, Any]:
    """Bias, spread, mean sigma, their ratio, coverage, and the sigmas printed beside, of the
    surveys of one variant and base.

    ratio : predicted over empirical sigma, the spread about the mean; ratio_naive : the same of the
    naive sigma · tau_m3 : sigma for a third of and three times the correlation times
    """
    errors = [r["error_m3"] for r in rows]
    n, bias = len(errors), math.fsum(errors) / len(errors)
    spread = math.sqrt(math.fsum((e - bias) ** 2 for e in errors) / max(n - 1, 1))
    sigma, naive = (root_mean_square([r[key] for r in rows]) for key in ("sigma_m3", "naive_m3"))

    def holds(k: float) -> float:
        return math.fsum(abs(r["error_m3"]) <= k * r["sigma_m3"] for r in rows) / n

    return {
        "surveys": n,
        "true_m3": true_m3,
        "bias_m3": bias,
        "bias_sigma_m3": spread / math.sqrt(n),
        "spread_m3": spread,
        "sigma_m3": sigma,
        "ratio": sigma / spread if spread else math.nan,
        "ratio_naive": naive / spread if spread else math.nan,
        "holds_68": holds(1.0),
        "holds_95": holds(1.959964),
        "tau_m3": [root_mean_square([r["tau_m3"][k] for r in rows]) for k in (0, 1)],
        "budget_m3": {
            line: math.sqrt(max(0.0, math.fsum(r["budget_m6"][line] for r in rows) / n))
            for line in rows[0]["budget_m6"]
        },
    }


def line_statistics(
    rows: Sequence[tuple[dict[str, list[float]], dict[str, float]]],
) -> dict[str, dict[str, float]]:
    """By line of the budget: predicted and empirical sigma, m³, and their ratio with its standard
    error, from the changes (m³) by each source alone over two grounds and the variances (m⁶) that
    the survey of the same seed with all sources printed.

    What the source itself does is what both changes have in common, the mean of their product (the
    first-order index of Sobol, by picking the source and freezing the rest). Over one ground, the
    mean square (with_ground_m3), it also makes another part of the roughness be sampled. Noise and
    roughness have nothing in common over two grounds: their lines are the mean square, as is that
    of a source that erred over one.
    """
    out = {}
    for line in rows[0][0]:
        predicted = math.sqrt(math.fsum(variance[line] for _, variance in rows) / len(rows))
        changes = [change[line] for change, _ in rows]
        square = np.array([math.fsum(x * x for x in c) / len(c) for c in changes])
        apart = line in (NOISE, BASE_SURFACE)
        own = np.array(
            [
                s if apart or len(c) == 1 else c[0] * c[1]
                for s, c in zip(square, changes, strict=True)
            ]
        )
        found = math.sqrt(max(0.0, float(own.mean())))
        ratio = predicted / found if found else math.nan
        scatter = (
            0.5 * ratio * float(own.std()) / math.sqrt(len(rows)) / found**2 if found else math.nan
        )
        out[line] = {
            "surveys": len(rows),
            "predicted_m3": predicted,
            "empirical_m3": found,
            "with_ground_m3": math.sqrt(float(square.mean())),
            "ratio": ratio,
            "ratio_sigma": scatter,
        }
    return out


def summary(rows: Sequence[dict[str, Any]], scenarios: Sequence[str]) -> dict[str, Any]:
    """Everything the study says, by scenario and base: ``{"variants": {name: statistics}, "lines":
    {line: ...}}``.
    """
    out: dict[str, Any] = {}
    for name in scenarios:
        mine = [r for r in rows if r["scenario"] == name]
        for base in dict.fromkeys(b for r in mine for b in r["result"]):
            variants = {}
            for variant in (*VARIANTS, ENGINE):
                some = [r["result"][base] for r in mine if r["variant"] == variant and r["result"]]
                if some:
                    refused = sum(1 for r in mine if r["variant"] == variant and not r["result"])
                    variants[variant] = {
                        **statistics(some, SITES[name].volume_m3),
                        "refused": refused,
                    }
            printed = {
                r["seed"]: r["result"][base]["budget_m6"]
                for r in mine
                if r["variant"] == ALL and r["result"]
            }
            single = [
                r for r in mine if r["variant"] == LINES and r["result"] and r["seed"] in printed
            ]
            lines = [(r["result"][base], printed[r["seed"]]) for r in single]
            out.setdefault(name, {})[base] = {
                "variants": variants,
                "lines": line_statistics(lines) if lines else {},
            }
    return out
