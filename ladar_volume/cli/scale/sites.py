"""``ladar_volume sites``: the volumes of many surveys in one table."""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import count, groupby
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from ladar_volume.cli.arguments.lines import shown_name
from ladar_volume.cli.tables.pile_table import plain_text, value_with_sigma
from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.results import finite, json_text, output_folder, write_text
from ladar_volume.io.site.survey_files import SurveyFile, companions, key_of, survey_files
from ladar_volume.model.errors import ConfigurationError, InputError, LadarVolumeError
from ladar_volume.process.interrupts import interrupts_wait
from ladar_volume.version import version

#: Options that change no number.
ASIDE = frozenset(
    "verb run folder output workers json strict cloud cloud_b report formats cell "
    "contour_interval file_units".split()
)
#: Columns of the table.
COLUMNS = (
    *("site", "epoch", "file", "pile", "status", "net_m3", "sigma_m3", "low_m3", "high_m3"),
    *("area_m2", "mass_t", "sigma_mass_t", "base", "doubts"),
    *("since", "change_m3", "sigma_change_m3", "change_doubts", "key", "version"),
)
#: Those that are numbers.
NUMBERS = frozenset(name for name in COLUMNS if name.endswith(("_m3", "_m2", "_t")))


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
    surveys = assign_keys(a, survey_files(a.folder, a.output))
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
    parquet = write_parquet(folder / "sites.parquet", rows)
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
            + ", sites.parquet"
            * parquet
        )
    return 1 if failed else 3 if a.strict and any(r["status"] != "sound" for r in rows) else 0


def write_parquet(path: Path, rows: Sequence[Mapping[str, Any]]) -> bool:
    """The table as Parquet; returns whether it is written: without Arrow it is not, and an earlier
    one goes.
    """
    if find_spec("pyarrow") is None:
        path.unlink(missing_ok=True)
        return False
    import pyarrow as pa
    from pyarrow import parquet

    kinds = [(name, pa.float64() if name in NUMBERS else pa.string()) for name in COLUMNS]
    with atomic_file(path) as part:
        parquet.write_table(pa.Table.from_pylist(list(rows), pa.schema(kinds)), part)
    return True


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


def assign_keys(a: argparse.Namespace, files: Iterable[SurveyFile]) -> list[Survey]:
    """The surveys with their keys."""
    options = {name: value for name, value in vars(a).items() if name not in ASIDE}
    options["program"] = version()
    files_named = [Path(p) for p in (a.budget, a.piles) if p is not None and Path(p).is_file()]
    named = [each for path in files_named for each in companions(path)]
    return [Survey(file, key_of(file, options, named)) for file in files]


def facts_of(a: argparse.Namespace, path: Path) -> dict[str, Any]:
    """The result of one survey, or its error, whatever it is: the others go on."""
    from ladar_volume.cli.volume import read_sources, result_of, task_of

    own = volume_arguments(a, path)
    try:
        sources = read_sources(own)
        return result_of(task_of(own), sources, lambda words: None).facts
    except (LadarVolumeError, OSError) as error:
        return {"error": str(error), "reason": getattr(error, "reason", None)}
    except Exception as error:
        return {"error": f"a defect: {type(error).__name__}: {error}", "reason": "defect"}


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
        most, kind = min(a.workers, len(surveys)), get_context("spawn")
        pool = ProcessPoolExecutor(most, mp_context=kind, initializer=one_thread)
    with (
        Progress(console=console, transient=True, disable=not console.is_terminal) as bar,
        pool as workers,
        workers_end(),
    ):
        task = bar.add_task("surveys", total=len(surveys))
        plain_task = argparse.Namespace(**{k: v for k, v in vars(a).items() if k != "run"})
        if workers is None:
            for survey in surveys:
                bar.update(task, description=plain_text(survey.file.path.name))
                out[survey.key] = keep(kept, survey, facts_of(plain_task, survey.file.path))
                bar.advance(task)
            return out
        with interrupts_wait():
            waiting: dict[Future[dict[str, Any]], Survey] = {
                workers.submit(facts_of, plain_task, s.file.path): s for s in surveys
            }
        for done in as_completed(waiting):
            survey, error = waiting[done], done.exception()
            facts = {"error": f"its worker ended: {error}"} if error else done.result()
            out[survey.key] = keep(kept, survey, facts)
            bar.advance(task)
    return out


@contextmanager
def workers_end() -> Iterator[None]:
    """An interrupt, or an error, ends processes that were started meanwhile as they are: what is
    not kept is computed by the next run.
    """
    before = active_children()
    try:
        yield
    except BaseException:
        for worker in active_children():
            if worker not in before:
                worker.terminate()
        raise


def one_thread() -> None:
    """Workers share the cores by surveys."""
    import numba

    numba.set_num_threads(1)


def keep(folder: Path, survey: Survey, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write a result under its key, unless it failed; returns it as it is read again."""
    out: dict[str, Any] = json.loads(json_text(facts))
    if "error" not in facts:
        write_text(folder / f"{survey.key}.json", json_text(out | {"digest": digest_of(out)}))
    return out


def digest_of(facts: Mapping[str, Any]) -> str:
    """What a result is known again by: a changed number must not pass for a computed one."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


def read_result(folder: Path, survey: Survey) -> dict[str, Any]:
    """A result that was kept. Raises :class:`InputError` for one that is damaged."""
    file = folder / f"{survey.key}.json"
    try:
        out: dict[str, Any] = json.loads(file.read_text("utf-8"))
        good = out.pop("digest") == digest_of(out)
    except Exception as error:  # whatever the file holds instead
        raise InputError(
            f"{file}: a damaged result: delete it", reason="input_result", value=str(file)
        ) from error
    if not good:
        raise InputError(
            f"{file}: changed since it was computed: delete it",
            reason="input_result",
            value=str(file),
        )
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
            found = "piles" in facts and "outlines" not in facts
            rings = {"ring": each["outline"]} if found else {}
            rows.append({**head, **row_of(each, facts), **rings, **tail})
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
    """The rows, in the order of time, with the change since the survey before of the same site and
    pile, whose errors are taken as independent.
    """
    last: dict[str, dict[str, dict[str, Any]]] = {}
    out: list[dict[str, Any]] = []
    for (site, _), epoch in groupby(rows, key=lambda row: (row["site"], row["epoch"])):
        now = [dict(row) for row in epoch]
        name_found(now, last.get(site, {}))
        before, known = last.get(site, {}), [r for r in now if r.get("net_m3") is not None]
        for row in known:
            same = [r for r in known if r.get("pile") == row.get("pile")]
            row.update(change_of(row, before.get(row.get("pile") or ""), len(same) > 1))
        if known:
            last[site] = before | {row.get("pile") or "": row for row in known}
        out += now
    return [{name: row.get(name) for name in COLUMNS} for row in out]


def change_of(
    row: Mapping[str, Any], before: Mapping[str, Any] | None, several: bool
) -> dict[str, Any]:
    """The change of a volume since an earlier one, or why there is none. several : surveys have the
    same site, pile and date.
    """
    if not row["epoch"]:
        return {"change_doubts": "no date in the name tells when this was surveyed"}
    if several:
        return {"change_doubts": f"several surveys of {row['epoch']}: name one site each"}
    if before is None:
        return {}
    if before["base"] != row["base"]:
        return {"change_doubts": f"{before['epoch']} is above another base: {before['base']}"}
    sigmas = (row["sigma_m3"], before["sigma_m3"])
    doubtful = [r["epoch"] for r in (before, row) if r["status"] != "sound"]
    return {
        "since": before["epoch"],
        "change_m3": row["net_m3"] - before["net_m3"],
        "sigma_change_m3": None if None in sigmas else math.hypot(*sigmas),
        "change_doubts": f"doubtful: the volume of {' and '.join(doubtful)}" if doubtful else "",
    }


def name_found(now: Sequence[dict[str, Any]], before: Mapping[str, Mapping[str, Any]]) -> None:
    """Give found piles, which every survey numbers by size, the names of those before that they lie
    over; the others names of their own. Changes the rows.
    """
    from ladar_volume.volume.polygon import overlap_of

    found = [row for row in now if "ring" in row]
    shared = [
        (overlap_of(np.array(row["ring"]), np.array(old["ring"])), at, name)
        for at, row in enumerate(found)
        for name, old in before.items()
        if "ring" in old
    ]
    taken: dict[int, str] = {}
    for share, at, name in sorted(shared, reverse=True):
        if share > 0.0 and at not in taken and name not in taken.values():
            taken[at] = name
    free = (f"pile {k}" for k in count(1) if f"pile {k}" not in before)
    for at, row in enumerate(found):
        row["pile"] = taken.get(at) or next(free)


def show(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print the table."""
    piles = any(row["pile"] for row in rows)
    table = Table("site", "epoch", *(["pile"] if piles else []), "V / m³", "change / m³", "")
    for row in rows:
        change = value_with_sigma(row["change_m3"], row["sigma_change_m3"]) if row["since"] else "–"
        change += " (doubtful)" if row["since"] and row["change_doubts"] else ""
        pile = [plain_text(row["pile"] or "–")] if piles else []
        words = (
            row["status"] if row["status"] != "failed" else f"failed: {plain_text(row['doubts'])}"
        )
        table.add_row(
            plain_text(row["site"]),
            plain_text(row["epoch"] or "–"),
            *pile,
            value_with_sigma(row["net_m3"], row["sigma_m3"]),
            change,
            words,
        )
    console.print(table)
