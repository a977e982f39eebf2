"""Closed bodies of whole surveys: simulated boxes, trucks (a box with a lower cab) and walls of
random size and orientation, flown and driven round, recorded, replayed with ``volume.kind:
bodies``. Error of each against its printed sigma.

``python -m benchmarks.survey_bodies [--seeds N] [--first SEED] [--thin K] [--exact]``: bias and
spread in per cent, 95 % intervals that hold, refused and doubtful surveys; the surface's volume of
the same replay beside it. *Drawn* is what the drawn errors of calibration and navigation do by the
body's sensitivities, the *rest* is the method's and the ground's: z by the body's own lines.
``--exact`` draws no errors of calibration and navigation. Sigma believes in the errors all the
same. ``--thin``: every so many firing cycles.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.drawn_effects import drawn_effect
from ladar_volume.clouds.survey.survey_bodies import (
    SurveyBodies,
    mesh_returns,
    returns_around,
    shared_gradient,
    with_budget,
)
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import Estimate
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import platform_for
from ladar_volume.simulation.scenes import Ground, Scene, box_mesh, grid_mesh, join
from ladar_volume.simulation.suited_parameters import suited_settings
from ladar_volume.simulation.survey import Survey

#: Seconds of a survey; surveys.
DURATION_S, SURVEYS = 24.0, 12
#: Half the width of the ground and its step, m; ground around the body, m.
EXTENT_M, STEP_M, RING_M = 20.0, 0.2, 2.5
#: Lines of a body's budget that are neither calibration nor navigation.
OWN = ("noise", "ground", "closing", "fit", "between", "facets", "undercut", "base_surface")
#: Ranges (low, high) in metres of length, width and height by kind; the mast of the rover sees no
#: higher top.
SIZES = {
    "box": ((1.5, 3.5), (1.0, 2.2), (0.6, 1.6)),
    "truck": ((2.0, 3.5), (1.5, 2.2), (1.0, 1.6)),
    "wall": ((2.5, 5.0), (0.3, 0.6), (0.8, 1.5)),
}


def without_shared_errors(budget: BudgetParameters) -> BudgetParameters:
    """A budget of which only the noise of single returns is left; what may not be zero is nearly
    so.
    """
    none = (0.0, 0.0, 0.0)
    return dataclasses.replace(
        budget,
        beam_range_sigma_m=0.0,
        beam_vertical_sigma_rad=0.0,
        range_bias_sigma_m=0.0,
        boresight_sigma_rad=none,
        lever_laser_sigma_m=none,
        lever_antenna_sigma_m=none,
        clock_sigma_s=0.0,
        position_sigma_m=(1e-4, 1e-4, 1e-4),
        attitude_sigma_rad=(1e-6, 1e-6, 1e-6),
    )


class BodyError(NamedTuple):
    """Of one survey, m³: the truth, the body's volume and sigma, the surface's; doubts, or why it
    was refused; what the drawn errors do to it, and the root of its lines that are none of these.
    """

    truth: float
    body: float
    sigma: float
    surface: float
    surface_sigma: float
    words: str
    drawn: float = np.nan
    own_sigma: float = np.nan


def turned(scene: Scene, angle: float) -> Scene:
    """The scene turned about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, s], [-s, c]])
    vertices = scene.vertices.copy()
    vertices[:, :2] = vertices[:, :2] @ R
    return dataclasses.replace(scene, vertices=vertices, outline=scene.outline @ R)


def scene_of(seed: int) -> tuple[str, Scene]:
    """A body on rough, gently sloping ground; every second one is flown over, every third of a
    kind.
    """
    rng = np.random.default_rng([seed, 24])
    kind = list(SIZES)[seed // 2 % len(SIZES)]
    lx, ly, lz = (rng.uniform(*limits) for limits in SIZES[kind])
    blocks = [(-lx / 2, lx / 2, lz)]
    if kind == "truck":
        blocks.append((lx / 2, lx / 2 + rng.uniform(0.8, 1.3), rng.uniform(0.5, 0.8) * lz))
    ground = Ground(slope=(0.01, 0.005), rough_m=0.003, length_m=0.7, seed=seed)
    end = blocks[-1][1]
    level = ground.mean_over_box(-lx / 2, end, -ly / 2, ly / 2)
    step = np.arange(-EXTENT_M, EXTENT_M + 0.5 * STEP_M, STEP_M)
    parts, volume = [grid_mesh(step, step, ground)], 0.0
    for x0, x1, height in blocks:
        parts.append(box_mesh(x0, x1, -ly / 2, ly / 2, level - 0.5, level + height))
        below = ground.mean_over_box(x0, x1, -ly / 2, ly / 2)
        volume += (x1 - x0) * ly * (level + height - below)
    x0, x1 = -0.75 * lx, end + 0.25 * lx
    outline = np.array([[x0, -ly], [x1, -ly], [x1, ly], [x0, ly]]) * (1.0, 0.75)
    both = ("uav", "rover")
    made = Scene(
        "box", *join(*parts), volume, outline, EXTENT_M, platforms=both, flight_m=(6.0, 10.0)
    )
    return kind, turned(made, rng.uniform(0.0, 2.0 * np.pi))


def survey(seed: int, thin: int = 1, exact: bool = False) -> BodyError:
    """One survey of a body; thin : every so many firing cycles · exact : without errors of
    calibration and navigation.
    """
    _, scene = scene_of(seed)
    settings = suited_settings(scene)
    settings["filter"] |= {"radius_m": 0.1}
    settings["volume"] |= {"kind": "bodies"}
    low, high = scene.outline.min(axis=0) - RING_M, scene.outline.max(axis=0) + RING_M
    settings["georeference"] = {"region_m": [*map(float, (*low, -2.0, *high, 5.0))]}
    platform = platform_for(scene, ("uav", "rover")[seed % 2], DURATION_S)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bag"
        start = read_config(None)
        settings["budget"] = start.write()["budget"]
        options = SurveyParameters(DURATION_S, thin, 10.0, 100.0, mixed_share=0.0, seed=seed)
        drawn = without_shared_errors(start.budget) if exact else start.budget
        made = Survey(scene, platform, drawn, options)
        write_bag(made, folder, settings, lambda share: None)
        with BagReader(folder) as bag:
            replay = Replay(bag, read_config(folder / "config.yaml"), bag.roles({}))
            estimate = replay.run()
            v = estimate.volume
            surface = v.volume_m3, v.sigma_m3
            try:
                found, effect = closed_bodies(replay, estimate, made)
            except LadarVolumeError as error:
                return BodyError(scene.volume_m3, np.nan, np.nan, *surface, str(error))
    words = "; ".join(d.text for d in found.verdict.doubts)
    one = found.bodies[0]
    if len(found.bodies) > 1:
        words = f"{len(found.bodies)} bodies; {words}"
    own = sum(value for name, value in one.budget_m6.items() if name in OWN)
    answer = one.volume_m3, one.sigma_m3, *surface, words, effect, np.sqrt(own)
    return BodyError(scene.volume_m3, *answer)


def closed_bodies(replay: Replay, estimate: Estimate, made: Survey) -> tuple[SurveyBodies, float]:
    """The closed bodies of a replay, and what the drawn errors do to the largest, m³."""
    p, sources = replay.parameters, replay.engine.estimator.epoch().sources
    near = returns_around(estimate, replay.engine.returned.returns(), p)
    meshed = mesh_returns(near, p)
    k = int(np.argmax([body.volume_m3 for body in meshed.bodies.bodies]))
    body, rows = meshed.bodies.bodies[k], meshed.bodies.sources[k]
    moved = shared_gradient(body, rows, meshed.points, meshed.ground, sources)
    effect = drawn_effect(made, moved.gradient, sources)
    return with_budget(meshed, sources, p), effect


def run(
    surveys: int = SURVEYS, first: int = 0, thin: int = 1, exact: bool = False
) -> dict[str, float | int | str]:
    """The figures of docs/bodies.md."""
    rows = []
    for seed in range(first, first + surveys):
        rows.append(survey(seed, thin, exact))
        r = rows[-1]
        words = f"{100.0 * (r.body / r.truth - 1.0):+.2f} ± {100.0 * r.sigma / r.truth:.2f} %"
        beside = f"{100.0 * (r.surface / r.truth - 1.0):+.2f} %"
        kind = f"{scene_of(seed)[0]} {('uav', 'rover')[seed % 2]}"
        words += f", drawn {100.0 * r.drawn / r.truth:+.2f} %"
        print(f"{seed} {kind}: {words} ({beside}) {r.words}", file=sys.stderr, flush=True)
    made = [r for r in rows if np.isfinite(r.body)]
    sound = [r for r in made if not r.words]
    error = np.array([100.0 * (r.body / r.truth - 1.0) for r in made])
    z = np.array([(r.body - r.truth) / r.sigma for r in made])
    own = np.array([(r.body - r.truth) / r.sigma for r in sound])
    surface = np.array([100.0 * (r.surface / r.truth - 1.0) for r in rows])
    rest = np.array([r.body - r.truth - r.drawn for r in made])
    rest_pct = 100.0 * rest / [r.truth for r in made]
    rest_z = rest / [r.own_sigma for r in made]
    return {
        "surveys": surveys,
        "refused": len(rows) - len(made),
        "doubtful": len(made) - len(sound),
        "body, bias %": f"{error.mean():+.3f} ± {error.std(ddof=1) / np.sqrt(len(error)):.3f}",
        "body, spread %": round(float(error.std(ddof=1)), 3),
        "body, mean sigma %": round(float(np.mean([100.0 * r.sigma / r.truth for r in made])), 3),
        "body, mean and spread of z": f"{z.mean():+.2f} ± {z.std(ddof=1):.2f}",
        "body, 95 % intervals that hold": f"{int((np.abs(z) < 1.96).sum())} of {len(z)}",
        "of sound ones": f"{int((np.abs(own) < 1.96).sum())} of {len(own)}",
        "rest, mean and spread %": f"{rest_pct.mean():+.3f} ± {rest_pct.std(ddof=1):.3f}",
        "rest, mean and spread of z": f"{rest_z.mean():+.2f} ± {rest_z.std(ddof=1):.2f}",
        "surface, bias %": round(float(surface.mean()), 3),
        "surface, spread %": round(float(surface.std(ddof=1)), 3),
    }


def main() -> None:
    """Run as many surveys as asked for."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--seeds", type=int, default=SURVEYS)
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--thin", type=int, default=1)
    ask.add_argument("--exact", action="store_true")
    given = ask.parse_args()
    for key, value in run(given.seeds, given.first, given.thin, given.exact).items():
        print(f"{key} : {value}")


if __name__ == "__main__":
    main()
