"""``ladar_volume sites``: the volumes of many surveys in one table."""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ladar_volume.cli.arguments.lines import shown_name
from ladar_volume.cli.tables.pile_table import measured, plain
from ladar_volume.io.results import finite, json_text, output_folder, write_text
from ladar_volume.io.site.survey_files import SurveyFile, key_of, survey_files
from ladar_volume.model.errors import ConfigurationError, InputError, LadarVolumeError
from ladar_volume.version import version

#: Options that change no number.
ASIDE = frozenset(
    "verb run folder output workers json strict cloud cloud_b report formats cell "
    "contour_interval file_units".split()
)
#: Columns of the table.
COLUMNS = (
    *("site", "epoch", "file", "pile", "status", "net_m3", "sigma_m3", "low_m3", "high_m3"),
    *("area_m2", "mass_t", "sigma_mass_t", "base", "since", "change_m3", "sigma_change_m3"),
    *("doubts", "key", "version"),
)


@dataclass(frozen=True)
class Survey:
    """file : the survey · key : what its result is kept under"""

    file: SurveyFile
    key: str


def run(arguments: argparse.Namespace) -> int:
    """Find the surveys, compute those that are new, write and print the table."""
    a = arguments
    if not 1 <= a.workers <= 1024:
        raise ConfigurationError(f"--workers {a.workers}: from 1 to 1024", value=a.workers)
    task_options(a)
    surveys = keyed(a, survey_files(a.folder))
    folder = output_folder(a.output)
    kept = output_folder(folder / "results")
    console = Console(stderr=a.json)
    new = [s for s in surveys if not (kept / f"{s.key}.json").is_file()]
    made = compute_all(a, new, kept, console)
    results = [made.get(s.key) or read_result(kept, s) for s in surveys]
    rows = with_changes(rows_of_all(surveys, results))
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_text(folder / "sites.csv", text.getvalue())
    failed = sum("error" in facts for facts in results)
    facts = {"surveys": len(surveys), "computed": len(new), "failed": failed, "rows": rows}
    facts = finite(facts | {"version": version()})
    write_text(folder / "sites.json", json_text(facts))
    if a.json:
        print(json_text(facts), end="")
    else:
        show(console, rows)
        console.print(
            f"{len(new)} of {len(surveys)} surveys computed, the others kept; {failed} failed; "
            f"written to {shown_name(a.output)}/: sites.csv, sites.json"
        )
    return 1 if failed else 3 if a.strict and any(r["status"] != "sound" for r in rows) else 0


def task_options(a: argparse.Namespace) -> None:
    """Refuse options that contradict one another, before any survey is read."""
    from ladar_volume.cli.volume import task_of

    task_of(volume_arguments(a, Path("survey.las")))


def volume_arguments(a: argparse.Namespace, path: Path) -> argparse.Namespace:
    """The options of ``ladar_volume volume`` for one survey."""
    from ladar_volume.cli.main import make_parser

    out = make_parser("volume").parse_args(["volume", str(path)])
    own = {name: value for name, value in vars(a).items() if name not in ASIDE}
    vars(out).update(own)
    return out


def keyed(a: argparse.Namespace, files: Iterable[SurveyFile]) -> list[Survey]:
    """The surveys with their keys."""
    options = {name: value for name, value in vars(a).items() if name not in ASIDE}
    options["program"] = version()
    named = [Path(p) for p in (a.budget, a.piles) if p is not None and Path(p).is_file()]
    return [Survey(file, key_of(file, options, named)) for file in files]


def facts_of(a: argparse.Namespace, path: Path) -> dict[str, Any]:
    """The result of one survey, or its error."""
    from ladar_volume.cli.volume import read_sources, result_of, task_of

    own = volume_arguments(a, path)
    try:
        sources = read_sources(own)
        return result_of(task_of(own), sources, lambda words: None).facts
    except (LadarVolumeError, OSError) as error:
        reason = getattr(error, "reason", None)
        return {"error": str(error), "reason": reason or type(error).__name__}


def compute_all(
    a: argparse.Namespace, surveys: Sequence[Survey], kept: Path, console: Console
) -> dict[str, dict[str, Any]]:
    """Compute surveys and keep each result as soon as it is there; returns them by key. One that
    failed is not kept: the next run tries it again.
    """
    out: dict[str, dict[str, Any]] = {}
    if not surveys:
        return out
    pool: AbstractContextManager[Executor | None] = nullcontext()
    if a.workers > 1 and len(surveys) > 1:
        count = min(a.workers, len(surveys))
        pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=one_thread)
    with Progress(console=console, transient=True) as bar, pool as workers:
        task = bar.add_task("surveys", total=len(surveys))
        plain_task = argparse.Namespace(**{k: v for k, v in vars(a).items() if k != "run"})
        if workers is None:
            for survey in surveys:
                bar.update(task, description=plain(survey.file.path.name))
                out[survey.key] = keep(kept, survey, facts_of(plain_task, survey.file.path))
                bar.advance(task)
            return out
        waiting: dict[Future[dict[str, Any]], Survey] = {
            workers.submit(facts_of, plain_task, s.file.path): s for s in surveys
        }
        for done in as_completed(waiting):
            survey = waiting[done]
            out[survey.key] = keep(kept, survey, done.result())
            bar.advance(task)
    return out


def one_thread() -> None:
    """Workers share the cores by surveys."""
    import numba

    numba.set_num_threads(1)


def keep(folder: Path, survey: Survey, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write a result under its key, unless it failed; returns it as it is read again."""
    text = json_text(facts)
    if "error" not in facts:
        write_text(folder / f"{survey.key}.json", text)
    out: dict[str, Any] = json.loads(text)
    return out


def read_result(folder: Path, survey: Survey) -> dict[str, Any]:
    """A result that was kept. Raises :class:`InputError` for one that is damaged."""
    file = folder / f"{survey.key}.json"
    try:
        out: dict[str, Any] = json.loads(file.read_text("utf-8"))
        row_of(out, out)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{file}: a damaged result: delete it", reason="input_result", value=str(file)
        ) from error
    return out


def rows_of_all(
    surveys: Sequence[Survey], results: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """A row for each survey, or for each pile of it."""
    rows = []
    for survey, facts in zip(surveys, results, strict=True):
        file = survey.file
        head = {"site": file.site, "epoch": file.epoch, "file": file.path.name}
        tail = {"key": survey.key, "version": facts.get("version", version())}
        if "error" in facts:
            rows.append({**head, "status": "failed", "doubts": facts["error"], **tail})
            continue
        for each in facts.get("piles") or [facts]:
            rows.append({**head, **row_of(each, facts), **tail})
    return rows


def row_of(each: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of a volume."""
    low, high = each.get("interval_m3", (None, None))
    names = ("net_m3", "sigma_m3", "area_m2", "mass_t", "sigma_mass_t")
    reasons = each["verdict"]["reasons"]
    return {
        "pile": each.get("name"),
        "status": each["verdict"]["status"],
        **{name: each.get(name) for name in names},
        "low_m3": low,
        "high_m3": high,
        "base": each.get("base", facts["base"]),
        "doubts": "; ".join(reason["text"] for reason in reasons),
    }


def with_changes(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows with the change since the survey before of the same site and pile, whose errors are
    taken as independent.
    """
    last: dict[tuple[str, str | None], dict[str, Any]] = {}
    out = []
    for row in rows:
        at = (row["site"], row.get("pile"))
        before, known = last.get(at), row.get("net_m3") is not None
        if before is not None and known and before["epoch"] != row["epoch"]:
            sigmas = (row["sigma_m3"], before["sigma_m3"])
            told = None not in sigmas
            row = row | {
                "since": before["epoch"],
                "change_m3": row["net_m3"] - before["net_m3"],
                "sigma_change_m3": math.hypot(*sigmas) if told else None,
            }
        if known:
            last[at] = row
        out.append({name: row.get(name) for name in COLUMNS})
    return out


def show(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table."""
    piles = any(row["pile"] for row in rows)
    table = Table("site", "epoch", *(["pile"] if piles else []), "V / m³", "change / m³", "")
    for row in rows:
        change = measured(row["change_m3"], row["sigma_change_m3"]) if row["since"] else "–"
        pile = [plain(row["pile"] or "–")] if piles else []
        words = row["status"] if row["status"] != "failed" else f"failed: {plain(row['doubts'])}"
        table.add_row(
            plain(row["site"]),
            plain(row["epoch"]),
            *pile,
            measured(row["net_m3"], row["sigma_m3"]),
            change,
            words,
        )
    console.print(table)
