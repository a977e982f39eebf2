"""Above what a volume is asked for on the command line: the base, and the parameters that go with
it.
"""

from __future__ import annotations

import argparse
import dataclasses

from ladar_volume.ground.ground_presets import PRESETS
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import PILE_BASES

#: Parameters that options of their own give.
OWN_OPTION = {
    "base": "--base",
    "level_m": "--level",
    "plane": "--plane",
    "relevant": "--relevant",
    "max_edge_m": "--max-edge",
    "max_circumdiameter_m": "--max-circle",
    "vertex_ratio": "--vertices",
}
#: Sections of parameters that count with a trajectory.
FLIGHT_SECTIONS = ("calibration", "budget", "georeference")


def parameters_of(arguments: argparse.Namespace) -> tuple[Parameters, str]:
    """Parameters of base, outline and ground, and the base: "level", "plane", "ground", "floor",
    "cloud" (the second one), "lowest" (the highest level without fill) or "front" (the level just
    in front of the body). Raises
    :class:`ConfigurationError` for options that contradict one another.
    """
    a, two = arguments, arguments.cloud_b is not None
    if a.piles is not None:
        return _pile_parameters(a, two)
    inferred = _inferred_base(a)
    _check_method(a, two)
    if two and a.footprint == "common":
        if a.level is not None or a.plane is not None or a.base is not None:
            raise ConfigurationError(
                "the second cloud is the base; a level or a plane goes with --footprint own"
            )
        return _read_parameters(a, "cloud"), "cloud"
    if not two and (a.footprint == "own" or a.sigma_b is not None):
        raise ConfigurationError("--footprint own and --sigma-b are for two clouds")
    level = "front" if a.method == 1 else "lowest"
    base = a.base or (level if two and inferred in ("floor", "") else inferred or "ground")
    _check_base(a, base, two)
    return _read_parameters(a, base), base


def _inferred_base(a: argparse.Namespace) -> str:
    """The base that a value of its own tells; empty for none."""
    values = (("plane", a.plane), ("level", a.level), ("floor", a.levels))
    return next((name for name, value in values if value is not None), "")


def _check_base(a: argparse.Namespace, base: str, two: bool) -> None:
    """A base goes with its values, and with one cloud or two."""
    if base in PILE_BASES and base != "ground":
        raise ConfigurationError(f"--base {base} goes with --piles", value=base)
    for name, value in (("level", a.level), ("plane", a.plane)):
        if (base == name) != (value is not None):
            raise ConfigurationError(f"--base {name} and --{name} go together", value=base)
    if base == "floor" and (a.levels is None or two):
        raise ConfigurationError("--base floor needs --levels START STOP STEP, and one cloud")
    if base == "ground" and (a.frame == "scan" or two):
        raise ConfigurationError("--base ground is for one cloud in the level frame")


def _pile_parameters(a: argparse.Namespace, two: bool) -> tuple[Parameters, str]:
    """Parameters and base of piles."""
    refused = {
        "--levels": a.levels,
        "--method": a.method,
        "--offset": a.offset,
        "--outline": a.outline,
        "--footprint own": a.footprint == "own" or None,
        "--base floor": a.base == "floor" or None,
        "--frame scan": a.frame == "scan" or None,
    }
    for option, value in refused.items():
        if value is not None:
            raise ConfigurationError(f"{option} does not go with --piles")
    base = _inferred_base(a) or a.base
    if two and base is not None:
        raise ConfigurationError("the second cloud is the base of the piles: leave --base out")
    if base in ("level", "plane") and (base == "level") != (a.level is not None):
        raise ConfigurationError(f"--base {base} and --{base} go together", value=base)
    if a.base not in (None, base):
        raise ConfigurationError(f"--base {a.base} and --{base} exclude each other", value=base)
    parameters = _read_parameters(a, base if base in ("level", "plane") else "ground")
    return parameters, "second" if two else base or "ground"


def _check_method(a: argparse.Namespace, two: bool) -> None:
    """Methods and offsets are for two clouds, each over its own footprint."""
    for option, value in (("--method", a.method), ("--offset", a.offset)):
        if value is not None and not (two and a.footprint == "own"):
            raise ConfigurationError(f"{option} goes with two clouds and --footprint own")
    if a.method is not None and (a.base or a.level is not None or a.plane is not None):
        raise ConfigurationError(
            "--method finds its level, or takes --levels; leave --base, --level and --plane out"
        )


def of_flight(a: argparse.Namespace, text: str) -> bool:
    """Whether ``section.key=value`` is a parameter of the flight, where a trajectory is given."""
    return a.trajectory is not None and text.partition(".")[0].strip() in FLIGHT_SECTIONS


def _read_parameters(a: argparse.Namespace, base: str) -> Parameters:
    if a.ground_preset is not None and base != "ground":
        raise ConfigurationError("--ground-preset goes with --base ground", value=a.ground_preset)
    own = [text for text in a.set if not of_flight(a, text)]
    keys = [text.partition("=")[0].strip() for text in own]
    for key in keys:
        section, _, name = key.partition(".")
        if section not in ("volume", "ground"):
            raise ConfigurationError(
                f"--set {key}: this verb has parameters of the sections 'volume' and 'ground' only",
                value=key,
            )
        if section == "volume" and name in OWN_OPTION:
            raise ConfigurationError(f"--set {key}: use {OWN_OPTION[name]}", value=key)
    preset = () if a.ground_preset is None else PRESETS[a.ground_preset].items()
    start = read_config(None, [*(f"ground.{key}={value}" for key, value in preset), *own])
    chosen = a.outline or (
        start.volume.outline if "volume.outline" in keys else "auto" if base == "ground" else "all"
    )
    if base == "cloud" and chosen != "all":
        raise ConfigurationError(
            (
                "between two clouds the volume counts over their whole common footprint; "
                "crop with --window"
            ),
            value=chosen,
        )
    volume = dataclasses.replace(
        start.volume, base="ground" if base == "ground" else "level", outline=chosen
    )
    if base == "level":
        volume = dataclasses.replace(volume, level_m=a.level)
    if base == "plane":
        volume = dataclasses.replace(volume, base="plane", plane=tuple(a.plane))
    return dataclasses.replace(start, volume=volume)
