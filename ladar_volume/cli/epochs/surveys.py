"""The change between two surveys, recorded or replayed before: with the whole budget, what both
share, and the level of detection.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from ladar_volume.change.change_detection import (
    ChangeMap,
    ThresholdedVolumes,
    change_map,
    threshold_volumes,
    weighted_sigma,
)
from ladar_volume.change.epoch_change import EpochDifference, epoch_difference
from ladar_volume.change.stable_ground import (
    StableGround,
    epoch_verdict,
    stable_ground,
    with_stable_ground,
)
from ladar_volume.cli.arguments.work import config_for
from ladar_volume.cli.epochs.outputs import plan_of, write_comparison
from ladar_volume.cli.replay import run_here
from ladar_volume.io import results
from ladar_volume.io.bags import wanted_topics
from ladar_volume.io.config import read_config
from ladar_volume.io.drivers.packet_capture import open_recording
from ladar_volume.io.surveys import between_datums, holds_survey, read_survey
from ladar_volume.io.transforms import read_transform, read_transform_verdict
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import F64, Datum
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.replay import Replay
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.version import version
from ladar_volume.volume.estimator import VolumeEstimator


@dataclasses.dataclass(frozen=True)
class Survey:
    """A survey that is compared. path : of its file · result : as in result.json · datum : origin
    of its map frame, None where it is not known · epoch : its surface with its error sources
    """

    path: Path
    result: Mapping[str, Any]
    datum: Datum | None
    epoch: Epoch


def compare_surveys(
    arguments: argparse.Namespace, folder: Path, console: Console
) -> dict[str, Any]:
    """Read, compare and write; returns what was found."""
    corners, stable = plan_of(arguments.polygon), plan_of(arguments.stable)
    separate = CALIBRATION_GROUPS if "all" in arguments.separate else tuple(arguments.separate)
    previous, new = (
        survey_of(path) if holds_survey(path) else replayed(path, console)
        for path in (arguments.previous, arguments.new)
    )
    with console.status("comparing"):
        later = in_previous_frame(new, previous, arguments.transform)
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
    write_comparison(arguments, facts, found.change, folder)
    return facts


def survey_of(path: Path) -> Survey:
    """The survey in a folder, or in a file result.mcap. Raises as
    :func:`~ladar_volume.io.surveys.read_survey`.
    """
    s = read_survey(path)
    epoch = VolumeEstimator.from_updates(s.parameters, s.navigation, s.updates).epoch()
    return Survey(s.path, s.result, s.datum, epoch)


def replayed(path: Path, console: Console) -> Survey:
    """The survey in a recording, replayed with the configuration beside it."""
    parameters = read_config(config_for(path, None), [])
    with open_recording(path) as bag:
        roles = bag.roles(wanted_topics({}, parameters))
        replay = Replay(bag, parameters, roles)
        estimate = run_here(replay, console)
        result = replay.result(estimate)
    datum = result["datum"]
    return Survey(
        path,
        result,
        None if datum is None else Datum(**datum),
        replay.engine.estimator.epoch(),
    )


def input_verdict(previous: Survey, new: Survey, transform: Path | None) -> Verdict:
    """What the surveys' own verdicts and that of the transform say."""
    out = Verdict() if transform is None else read_transform_verdict(transform)
    for name, survey in (("previous", previous), ("new", new)):
        own = survey.result.get("verdict")
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
    here, there = new.datum, previous.datum
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
    kept = threshold_volumes(
        change, k, lambda weight: weighted_sigma(new, previous, apart, weight, separate)
    )
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
        "path": str(survey.path),
        "input": survey.result.get("input"),
        "t_ns": survey.epoch.t_ns,
    }
