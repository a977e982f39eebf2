"""The trajectory for ``ladar_volume volume --trajectory``: its options, and what the JSON says."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.cli.inputs.base_choice import FLIGHT_SECTIONS, of_flight
from ladar_volume.cli.inputs.reading import Source
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.survey.flight_errors import FlightErrors
from ladar_volume.io.config import read_config, sections_of
from ladar_volume.io.site.height_budget import read_budget
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.verdict import Doubt

#: Endings of trajectories as doubles, and as text.
BINARY, TEXT = (".sbet", ".out", ".bin"), (".pos", ".txt", ".csv")


def check_trajectory(a: argparse.Namespace) -> Parameters | None:
    """Parameters of the flight; None without a trajectory. Raises :class:`ConfigurationError` for
    options that do not go together.
    """
    if a.trajectory is None:
        for option, value in (
            ("--trajectory-accuracy", a.trajectory_accuracy),
            ("--undulation", a.undulation),
        ):
            if value is not None:
                raise ConfigurationError(f"{option} goes with --trajectory")
        return None
    if a.frame == "scan":
        raise ConfigurationError("--trajectory goes with --frame level")
    if a.median is not None:
        raise ConfigurationError("--trajectory goes with heights as measured: leave --median out")
    ending = Path(a.trajectory).suffix.lower()
    if ending not in BINARY + TEXT:
        raise ConfigurationError(
            f"--trajectory {Path(a.trajectory).name}: ends in none of "
            f"{' '.join(BINARY + TEXT)} (doubles as SBET, text as the others)",
            value=ending,
        )
    start = Parameters()
    if a.budget is not None:
        path = Path(a.budget)
        try:
            start = Parameters.read(sections_of(read_budget(path)[1]), start)
        except ConfigurationError as error:
            raise type(error)(f"{path.name}: {error}", value=error.value) from error
    return read_config(None, [text for text in a.set if of_flight(a, text)], start)


@dataclass(frozen=True)
class FlightOfCloud:
    """errors : of the points of the first file, None without a trajectory · facts : for the JSON ·
    doubts
    """

    errors: FlightErrors | None = None
    facts: dict[str, Any] | None = None
    doubts: tuple[Doubt, ...] = ()

    def onto(self, surfaces: list[CloudSurface]) -> list[CloudSurface]:
        """The surfaces, the first with the errors of its flight."""
        if self.errors is None:
            return surfaces
        own = self.errors.of_rows(np.asarray(surfaces[0].index))
        return [dataclasses.replace(surfaces[0], flight=own), *surfaces[1:]]


def flown_of(
    a: argparse.Namespace, sources: Sequence[Source], parameters: Parameters | None
) -> FlightOfCloud:
    """The trajectory beside the first file. Raises :class:`ConfigurationError` for meshes and for a
    second cloud, :class:`InputError` for a trajectory of other points.
    """
    if parameters is None:
        return FlightOfCloud()
    from ladar_volume.io.trajectories.placed_flight import place_flight
    from ladar_volume.io.trajectories.pos_text import read_pos
    from ladar_volume.io.trajectories.sbet import read_sbet, with_accuracy
    from ladar_volume.report.report_page import file_digest

    if sources[0].mesh is not None or any(s.mesh is None for s in sources[1:]):
        raise ConfigurationError(
            "--trajectory is for one cloud above a base or a design: for two epochs replay the "
            "recordings and compare them with epochs"
        )
    path = Path(a.trajectory)
    flown = (read_sbet if path.suffix.lower() in BINARY else read_pos)(path)
    if a.trajectory_accuracy is not None:
        flown = with_accuracy(flown, Path(a.trajectory_accuracy))
    found = place_flight(flown, sources[0].cloud, parameters, a.undulation)
    used = parameters.write()
    facts = {
        **found.facts,
        "sha256": file_digest(path),
        "parameters": {name: used[name] for name in FLIGHT_SECTIONS},
    }
    return FlightOfCloud(found.errors, facts, found.doubts)
