"""Whether a scanner that is mounted another quarter of a turn than configured is named, and one
that is mounted as configured is not: clean simulated flights over scenes of every kind, and the
bundled recordings, each as it is, with its yaw turned by 90, 180 and 270 degrees, and with its roll
turned by 180.

``python -m benchmarks.turned_mountings [--flights N] [--seed S]``
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.georeference.mounting_check import mounting_doubts
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.parameters import BudgetParameters, Parameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.replay import Replay
from ladar_volume.simulation.bag import write_bag
from ladar_volume.simulation.platforms import make_platform
from ladar_volume.simulation.scenes import make_scene
from ladar_volume.simulation.suited_parameters import suited_settings
from ladar_volume.simulation.survey import Survey

BAGS = Path(__file__).parents[1] / "bags"
SCENES = ("stockpile", "box", "cone_100", "frustum", "cone")
PLATFORMS = ("uav", "lanes", "rover")
#: Roll and yaw by which the mounting is turned, degrees; the first is none.
TURNS = ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 270.0), (180.0, 0.0))
FLIGHT_S = 24.0
GOALS = {"mountings as configured that are doubted": (0.0, 0.0)}


def flights(count: int, seed: int, folder: Path) -> Iterator[tuple[str, Path]]:
    """Names and recordings: those of the package, then simulated ones."""
    for name in ("leo_cut", "stockpile", "box"):
        yield name, BAGS / name
    kinds = itertools.cycle(itertools.product(SCENES, PLATFORMS))
    for k, (kind, carrier) in zip(range(count), kinds, strict=False):
        scene = make_scene(kind, seed + k)
        platform = make_platform(carrier, scene.extent_m, FLIGHT_S)
        flown = SurveyParameters(FLIGHT_S, 8, seed=seed + k)
        survey = Survey(scene, platform, BudgetParameters(), flown)
        path = folder / f"{k}"
        write_bag(survey, path, suited_settings(scene), lambda share: None)
        yield f"{kind} {carrier}", path


def turned(parameters: Parameters, roll_deg: float, yaw_deg: float) -> Parameters:
    """The same with another mounting."""
    c = parameters.calibration
    roll, yaw = (math.radians(a) for a in (roll_deg, yaw_deg))
    new = {
        "boresight_roll_rad": math.remainder(c.boresight_roll_rad + roll, math.tau),
        "boresight_yaw_rad": math.remainder(c.boresight_yaw_rad + yaw, math.tau),
    }
    return dataclasses.replace(parameters, calibration=dataclasses.replace(c, **new))


def said(path: Path, roll_deg: float, yaw_deg: float) -> str:
    """What is said of the mounting; empty for nothing."""
    parameters = read_config(path / "config.yaml")
    with BagReader(path) as bag:
        given = turned(parameters, roll_deg, yaw_deg)
        replay = Replay(bag, given, bag.roles())
        stage = Georeferencer(replay.parameters)
        doors = {"fix": stage.add_fix, "imu": stage.add_imu, "cloud": stage.add_returns}
        for _, role, record in replay.records():
            if role in doors:
                doors[role](record)
            stage.take_platform()
            stage.take_points()
    found = mounting_doubts(stage.mounting_check.found(), stage.mount.R_body_laser)
    return "".join(doubt.text for doubt in found.doubts)


def run(count: int = 10, seed: int = 1) -> dict[str, float | int | str]:
    """Figures of so many simulated flights and the bundled recordings."""
    wrong = named = told = 0
    with tempfile.TemporaryDirectory() as name:
        for flight, path in flights(count, seed, Path(name)):
            words = [said(path, *turn) for turn in TURNS]
            wrong += bool(words[0])
            named += sum(map(bool, words[1:]))
            told += len(words) - 1
            print(
                flight, "|", words[0] or "nothing said", "|", *(w or "NOT NAMED" for w in words[1:])
            )
    return {
        "recordings": count + 3,
        "mountings as configured that are doubted": wrong,
        "turned mountings that are named": f"{named} of {told}",
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name, value in run(arguments.flights, arguments.seed).items():
        print(f"{name}: {value}")
