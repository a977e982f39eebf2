"""Results as files: result.json, mesh.ply and the table a person reads."""

from __future__ import annotations

import dataclasses
import json
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.ground.polynomial import degree_of, tilt_of
from ladar_volume.io.atomic_write import atomic_file, unwritable
from ladar_volume.io.meshfiles.tin_files import write_columns
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Datum, Estimate, Plane, Tin, Volume
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.version import version

if TYPE_CHECKING:  # for names of types alone: a stage's kernels are loaded by the node that runs it
    from ladar_volume.change.epoch_change import EpochDifference
    from ladar_volume.clouds.survey.survey_bodies import SurveyBodies
    from ladar_volume.volume.more_data import MoreData

#: The files of a result, the one that stands for them first.
SURVEY_FILES = (
    "result.json",
    "result.mcap",
    "mesh.ply",
    "figure.png",
    "report.html",
    "report.json",
    "bodies.ply",
)

#: Things that stand on the surface, in a result at most: the largest.
MOST_OBJECTS = 20


def correction_dict(volume: Volume) -> dict[str, Any]:
    """What was taken from cut and from fill near the base."""
    return {
        "name": "folded normal" if volume.folded_m3 > 0.0 else None,
        "m3": volume.folded_m3,
        "near_area_m2": volume.near_area_m2,
        "cut_raw_m3": volume.cut_m3 + volume.folded_m3,
        "fill_raw_m3": volume.fill_m3 + volume.folded_m3,
    }


def volume_dict(volume: Volume) -> dict[str, Any]:
    """A volume as plain values."""
    return {
        "volume_m3": volume.volume_m3,
        "sigma_m3": volume.sigma_m3,
        "interval_m3": list(volume.interval_m3),
        "confidence": volume.confidence,
        "coverage_factor": volume.coverage_factor,
        "cut_m3": volume.cut_m3,
        "fill_m3": volume.fill_m3,
        "area_m2": volume.area_m2,
        "correction": correction_dict(volume),
        "second_order": {
            "shift_m3": volume.second_order_m3,
            "matters": volume.second_order_matters,
        },
        "chord_m3": volume.chord_m3,
        "smoothing_m3": volume.smoothing_m3,
        "cover_m3": volume.cover_m3,
        "seen_share": volume.seen_share,
        "gaps": [dataclasses.asdict(gap) for gap in volume.gaps],
        "objects": [dataclasses.asdict(one) for one in volume.objects[:MOST_OBJECTS]],
        "passes": None if volume.agreement is None else dataclasses.asdict(volume.agreement),
        "verdict": volume.verdict.as_dict(),
        "base": volume.base,
        "base_same_survey": volume.base_same_survey,
        "centroid_map_m": list(volume.centroid_map),
        "budget_m6": dict(sorted(volume.budget_m6.items(), key=lambda item: -item[1])),
        "largest_source": volume.largest_source,
        "sigma_if_halved_m3": volume.sigma_if_halved_m3,
        "budget_within_m6": volume.budget_within_m6,
        "sigma_tau_range_m3": list(volume.sigma_tau_range_m3),
        "sigma_naive_m3": volume.sigma_naive_m3,
        "vertices": volume.vertices,
        "triangles": volume.triangles,
        "t_ns": volume.t_ns,
    }


def ground_dict(plane: Plane) -> dict[str, Any]:
    """A ground surface as plain values."""
    return {
        "degree": degree_of(plane),
        "origin_xy_m": plane.origin_xy.tolist(),
        "beta": plane.beta.tolist(),
        "C_beta": plane.C_beta.tolist(),
        "sigma_m": plane.rms_m,
        "support": len(plane.support),
        "tilt_deg": math.degrees(tilt_of(plane)),
    }


def result_dict(
    estimate: Estimate,
    parameters: Parameters,
    losses: Losses,
    datum: Datum | None,
    points: Mapping[str, int],
    source: Mapping[str, Any],
) -> dict[str, Any]:
    """The whole result: volume of the main body, budget, every body with the covariance of all,
    ground surfaces, losses, effective parameters, version and where it came from.
    """
    joint = estimate.C_bodies_m6
    verdict = sum((body.verdict for body in estimate.bodies), estimate.volume.verdict)
    return {
        **volume_dict(estimate.volume),
        "verdict": verdict.as_dict(),
        "bodies": [volume_dict(body) for body in estimate.bodies],
        "C_bodies_m6": None if joint is None else joint.tolist(),
        "grounds": [ground_dict(ground) for ground in estimate.grounds],
        "losses": losses.as_dict(),
        "points": dict(points),
        "datum": None if datum is None else dataclasses.asdict(datum),
        "input": dict(source),
        "version": version(),
        "parameters": parameters.write(),
    }


def closed_bodies_dict(found: SurveyBodies) -> list[dict[str, Any]]:
    """The closed bodies of a survey as plain values, the largest first."""
    return [
        {
            "volume_m3": b.volume_m3,
            "sigma_m3": b.sigma_m3,
            "interval_m3": list(b.interval_m3),
            "budget_m6": b.budget_m6,
            "height_m": b.height_m,
            "points": b.points,
            "centroid_map_m": b.body.centroid_map.tolist(),
            "area_m2": b.body.area_m2,
            "faces": len(b.body.skin.triangles),
            "edge_m3": b.body.edge_m3,
            "curvature_m3": b.body.curvature_m3,
            "closed_m3": b.body.closed_m3,
        }
        for b in found.bodies
    ]


def with_doubts(verdict: Mapping[str, Any], more: Verdict) -> dict[str, Any]:
    """A verdict as plain values with further doubts."""
    known = tuple(Doubt(d["name"], d["text"], d.get("value")) for d in verdict["reasons"])
    return (Verdict(known) + more).as_dict()


def change_dict(found: EpochDifference) -> dict[str, Any]:
    """A change between two epochs as plain values: the volume, its significance, and sigma if
    nothing were shared.
    """
    return {
        **volume_dict(found.volume),
        "z": found.z,
        "p_value": found.p_value,
        "significant": found.significant,
        "sigma_cut_m3": found.sigma_cut_m3,
        "sigma_fill_m3": found.sigma_fill_m3,
        "sigma_if_nothing_shared_m3": found.budget.sigma_separate,
    }


def more_data_dict(found: MoreData) -> dict[str, Any]:
    """Where another pass would help most, as plain values."""
    return {
        "places": found.best_cells(),
        "sigma_m3": found.sigma_m3,
        "sigma_gaps_m3": found.sigma_gaps_m3,
        "cell_m": found.cell_m,
    }


def json_text(values: Mapping[str, Any]) -> str:
    """Strict JSON: what is not a finite number is null."""
    return json.dumps(finite(values), indent=1, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Plain JSON values: numpy scalars unwrapped, numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [finite(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def output_folder(path: str | Path) -> Path:
    """Create the folder. Raises OutputError where that cannot be done."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise unwritable(folder, error) from error
    return folder


def write_text(path: Path, text: str) -> None:
    """Write a text file whole. Raises OutputError."""
    with atomic_file(path) as part:
        part.write_text(text, encoding="utf-8")


def write_ply(path: Path, tin: Tin, sigma_z: Any) -> None:
    """The relevant triangles as binary PLY, double coordinates, with the sigma of each vertex's
    height (m).
    """
    write_columns(path, tin, {"sigma_z": np.asarray(sigma_z, np.float32)})
