"""``ladar_volume epochs``: what changed between two surveys of one place, with its standard
deviation and the level of detection.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.change.change_detection import (
    ChangeMap,
    ThresholdedVolumes,
    change_map,
    threshold_volumes,
)
from ladar_volume.change.epoch_change import EpochDifference, epoch_difference
from ladar_volume.change.stable_ground import (
    StableGround,
    epoch_verdict,
    stable_ground,
    with_stable_ground,
)
from ladar_volume.cli.diff_input import given_corners
from ladar_volume.cli.tables.result_table import budget_table, volume_rows
from ladar_volume.cli.verdict_lines import add_verdict_rows, exit_code
from ladar_volume.io import results
from ladar_volume.io.meshfiles.tin_files import write_columns
from ladar_volume.io.output_set import output_set
from ladar_volume.io.surveys import SavedSurvey, between_datums, read_survey
from ladar_volume.io.transforms import read_transform, read_transform_verdict
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.version import version
from ladar_volume.volume.estimator import VolumeEstimator

#: What the verb writes.
FILES = ("epochs.json", "change.ply", "change.png")


@dataclasses.dataclass(frozen=True)
class Survey:
    """A survey that is compared: what was saved of it, and its surface with its error sources."""

    saved: SavedSurvey
    epoch: Epoch


def run(arguments: argparse.Namespace) -> int:
    """Read both surveys, compare, print, write the output folder."""
    console = Console(stderr=arguments.json)
    with output_set(arguments.output, FILES) as folder:
        facts = _compare_files(arguments, folder, console)
    if arguments.json:
        print(results.json_text(facts), end="")
    else:
        show(console, facts)
        console.print(f"written to {arguments.output}/")
    return exit_code(arguments, facts["verdict"])


def _compare_files(arguments: argparse.Namespace, folder: Path, console: Console) -> dict[str, Any]:
    """Read, compare and write; returns what was found."""
    corners, stable = plan_of(arguments.polygon), plan_of(arguments.stable)
    separate = CALIBRATION_GROUPS if "all" in arguments.separate else tuple(arguments.separate)
    with console.status("reading") as status:
        previous, new = survey_of(arguments.previous), survey_of(arguments.new)
        later = in_previous_frame(new, previous, arguments.transform)
        status.update("comparing")
        found = compare_epochs(later, previous.epoch, separate, corners, stable)
        verdict = epoch_verdict(found.ground) + input_verdict(previous, new, arguments.transform)
    facts = {
        **difference_facts(found.difference, found.threshold, separate),
        "stable_ground": dataclasses.asdict(found.ground) | {"effect_m3": found.ground.effect_m3},
        "verdict": verdict.as_dict(),
        "previous": survey_facts(previous),
        "new": survey_facts(new),
        "frame": frame_words(later, arguments.transform),
        "version": version(),
    }
    results.write_text(folder / "epochs.json", results.json_text(facts))
    write_change(folder, found.change)
    if not arguments.no_figure:
        from ladar_volume.report.change import save  # matplotlib takes a second to load

        title = f"{arguments.new.name} against {arguments.previous.name}"
        save(found.difference.volume, found.change, title, folder / "change.png")
    return facts


def survey_of(path: Path) -> Survey:
    """The survey in a folder, or in a file result.mcap. Raises as
    :func:`~ladar_volume.io.surveys.read_survey`.
    """
    s = read_survey(path)
    return Survey(s, VolumeEstimator.from_updates(s.parameters, s.navigation, s.updates).epoch())


def write_change(folder: Path, change: ChangeMap) -> None:
    """Write the map of change as a mesh with columns."""
    columns = (
        "difference_m",
        "sigma_noise_m",
        "sigma_shared_m",
        "sigma_m",
        "level_m",
        "significant",
    )
    values = {name: np.asarray(getattr(change, name), np.float32) for name in columns}
    write_columns(folder / "change.ply", change.tin, values)


def plan_of(corners: list[str] | None) -> F64 | None:
    """Corners (c, 2) m in plan from the command line or a file; None without."""
    given = given_corners(corners, None)
    return None if given is None else given[:, :2]


def input_verdict(previous: Survey, new: Survey, transform: Path | None) -> Verdict:
    """What the surveys' own verdicts and that of the transform say."""
    out = Verdict() if transform is None else read_transform_verdict(transform)
    for name, survey in (("previous", previous), ("new", new)):
        own = survey.saved.result.get("verdict")
        reasons = own.get("reasons", []) if isinstance(own, Mapping) else []
        out += Verdict(
            tuple(Doubt(r["name"], f"{name}: {r['text']}", r.get("value")) for r in reasons)
        )
    return out


def in_previous_frame(new: Survey, previous: Survey, transform: Path | None) -> Epoch:
    """The new survey in the frame of the previous one. Raises :class:`ConfigurationError` where it
    is not known how the frames lie.
    """
    if transform is not None:
        return dataclasses.replace(new.epoch, transform=read_transform(transform))
    here, there = new.saved.datum, previous.saved.datum
    if here is not None and there is not None:
        return dataclasses.replace(new.epoch, transform=between_datums(here, there))
    if here is None and there is None:
        return new.epoch
    raise ConfigurationError("one survey has a datum and the other has none: give --transform")


def frame_words(new: Epoch, transform: Path | None) -> str:
    """How the new survey came to lie on the previous one."""
    if transform is not None:
        return f"new survey moved by {transform.name}"
    return "same map frame" if new.transform is None else "new survey moved between the two datums"


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two surveys compared: the difference of their volumes, the map of change, the volumes above
    the level of detection, and what unchanged ground says.
    """

    difference: EpochDifference
    change: ChangeMap
    threshold: ThresholdedVolumes
    ground: StableGround


def compare_epochs(
    new: Epoch,
    previous: Epoch,
    separate: Collection[str],
    polygon: F64 | None = None,
    stable: F64 | None = None,
) -> Comparison:
    """The comparison of two surveys in one frame."""
    found, apart = epoch_difference(new, previous, separate, polygon)
    k = found.volume.coverage_factor
    change = change_map(new, previous, apart, k, separate)
    ground = stable_ground(new, previous, apart, change, separate, stable, polygon)
    kept = threshold_volumes(new, previous, apart, change, k, separate)
    return Comparison(with_stable_ground(found, ground), change, kept, ground)


def difference_facts(
    found: EpochDifference, kept: ThresholdedVolumes, separate: Collection[str]
) -> dict[str, Any]:
    """The comparison as plain values."""
    return {
        **results.change_dict(found),
        "separate": list(separate),
        "level_of_detection": dataclasses.asdict(kept),
    }


def survey_facts(survey: Survey) -> dict[str, Any]:
    """Where a survey came from."""
    return {
        "path": str(survey.saved.path),
        "input": survey.saved.result.get("input"),
        "t_ns": survey.epoch.t_ns,
    }


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the comparison as tables."""
    head = Table(show_header=False, box=None, pad_edge=False)
    _add_change_rows(head, facts)
    _add_detection_rows(head, facts["level_of_detection"])
    _add_ground_rows(head, facts["stable_ground"])
    head.add_row("if nothing were shared", f"sigma {facts['sigma_if_nothing_shared_m3']:.3f} m³")
    volume_rows(head, facts)
    add_verdict_rows(head, facts["verdict"])
    console.print(head)
    console.print(budget_table(facts))


def _add_change_rows(head: Table, facts: Mapping[str, Any]) -> None:
    """The change with its interval, its significance, and its parts."""
    low, high = facts["interval_m3"]
    head.add_row(
        "change", f"[bold]{facts['volume_m3']:+.3f} ± {facts['sigma_m3']:.3f} m³[/bold] (1 sigma)"
    )
    head.add_row(
        f"{100 * facts['confidence']:.0f} % interval",
        f"{low:+.3f} to {high:+.3f} m³ (k = {facts['coverage_factor']:.2f})",
    )
    words = "significant" if facts["significant"] else "not significant"
    head.add_row("significance", f"{words}: z = {facts['z']:.2f}, p = {facts['p_value']:.2g}")
    head.add_row(
        "raised, lowered",
        (
            f"{facts['cut_m3']:.3f} ± {facts['sigma_cut_m3']:.3f} m³, {facts['fill_m3']:.3f} ± "
            f"{facts['sigma_fill_m3']:.3f} m³ over {facts['area_m2']:.1f} m²"
        ),
    )


def _add_detection_rows(head: Table, lod: Mapping[str, Any]) -> None:
    """The level of detection, and the volume above it alone."""
    share = 100.0 * lod["area_m2"] / lod["map_area_m2"]
    head.add_row(
        "level of detection",
        (
            f"{100.0 * lod['level_m']:.1f} cm (median), exceeded on {lod['area_m2']:.1f} m² "
            f"({share:.1f} %)"
        ),
    )
    parts = f"raised {lod['raised_m3']:.3f}, lowered {lod['lowered_m3']:.3f} m³"
    head.add_row("above it alone", f"{lod['net_m3']:+.3f} ± {lod['sigma_m3']:.3f} m³: {parts}")
    head.add_row(
        "threshold's bias",
        f"{lod['bias_m3']:+.3f} ± {lod['bias_sigma_m3']:.3f} m³ of the net volume",
    )


def _add_ground_rows(head: Table, ground: Mapping[str, Any]) -> None:
    """What unchanged ground says."""
    head.add_row(
        "stable ground",
        f"{100.0 * ground['share']:.0f} % of the common area, "
        f"{'named' if ground['named'] else 'found'}: {1e3 * ground['offset_m']:+.1f} mm in the "
        f"mean, the budgets allow {1e3 * ground['sigma_m']:.1f} mm (1 sigma)",
    )
