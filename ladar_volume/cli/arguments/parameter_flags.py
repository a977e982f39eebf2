"""Options that name a parameter: type, range, unit, choices and help come from its declaration in
:mod:`ladar_volume.model`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from ladar_volume.ground.ground_presets import PRESETS
from ladar_volume.model.body_parameters import (
    BodyParameters,
    LocalMeshParameters,
    ObjectParameters,
)
from ladar_volume.model.errors import ConfigurationError, ParameterValueError
from ladar_volume.model.parameter import ParameterSpec, convert, specs
from ladar_volume.model.parameters import SECTIONS
from ladar_volume.model.piles import PileParameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.survey_parameters import StripParameters, SurveyParameters

#: Classes of which options are made: the sections of a parameter file, and those that no file has.
DECLARED: dict[str, type] = {
    **SECTIONS,
    "surface": SurfaceParameters,
    "objects": ObjectParameters,
    "mesh": LocalMeshParameters,
    "bodies": BodyParameters,
    "survey": SurveyParameters,
    "strips": StripParameters,
    "piles": PileParameters,
}


def number(text: str) -> float:
    """A finite number from the command line."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def spec_of(name: str) -> ParameterSpec:
    """The declaration of ``section.key``. Raises :class:`ConfigurationError` for a name that no
    parameter has.
    """
    section, _, key = name.partition(".")
    for spec in specs(DECLARED[section]) if section in DECLARED else ():
        if spec.key == key:
            return spec
    raise ConfigurationError(f"no parameter is called {name}", value=name)


def value_parser(name: str) -> Callable[[str], object]:
    """A parser of one value of the parameter, in the unit of the command line; it refuses one out
    of range.
    """
    section, spec = name.partition(".")[0], spec_of(name)

    def parse(text: str) -> object:
        value = number(text) if spec.kind is float else spec.kind(text)
        try:
            convert(section, spec, (value,) * spec.vector if spec.vector else value)
        except ParameterValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return value

    parse.__name__ = "number" if spec.kind is float else spec.kind.__name__  # argparse prints it
    return parse


def help_of(name: str, more: str = "") -> str:
    """What the parameter is, its range and unit, and what the option adds."""
    spec = spec_of(name)
    bounded = spec.choices is None and (spec.low is not None or spec.high is not None)
    limits = f" ({f'{spec.range_text} {spec.unit}'.strip()})" if bounded else ""
    words = f"{spec.help.rstrip('.')}{limits}"
    return (f"{words}; {more}" if more else words).replace("%", "%%")


def add_parameter(
    group: argparse._ActionsContainer,
    option: str,
    name: str,
    *,
    metavar: str | tuple[str, ...] | None = None,
    choices: tuple[str, ...] | None = None,
    more: str = "",
    default: object = None,
    own_default: bool = False,
) -> None:
    """Declare the option of parameter ``section.key``. choices : where the option offers others
    than the parameter · more : what the help says besides · default : None where the parameter's
    own, or another rule, counts · own_default : the option holds the parameter's own where it is
    not given.
    """
    spec = spec_of(name)
    if own_default:
        default, more = spec.default, more or f"default {spec.default}"
    action = group.add_argument(option, default=default, help=help_of(name, more))
    if spec.choices is not None:
        action.choices = spec.choices if choices is None else choices
    else:
        action.type = value_parser(name)
        action.metavar = metavar or spec.unit.upper() or None
    if spec.vector:
        action.nargs = spec.vector
    # what the option names: a test holds that every such option is declared here
    action.parameter = name  # type: ignore[attr-defined]


def add_ground_preset(group: argparse._ActionsContainer) -> None:
    """Declare ``--ground-preset``: several parameters of the ground at once."""
    group.add_argument(
        "--ground-preset",
        choices=sorted(PRESETS),
        help="published settings of the ground (T, k, outliersThreshold)",
    )
