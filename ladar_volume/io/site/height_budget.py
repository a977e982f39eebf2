"""Errors that heights of one survey share, from a YAML file::

height_errors:
  - {name: datum, sigma_m: 0.01}
  - {name: trajectory, sigma_m: 0.02, correlation_m: 30}
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ladar_volume.io import strict_yaml
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import ConfigurationError, short_repr
from ladar_volume.model.piles import HeightError

#: Keys of one error, and lines of the budget that are the program's own.
KEYS = ("name", "sigma_m", "correlation_m")
TAKEN = (
    "noise",
    "base_surface",
    "base_model",
    "base_choice",
    "base_extreme",
    "toe_place",
    "between_points",
    "unseen",
    "outline",
    "vegetation",
    *CALIBRATION_GROUPS,
    "calibration",
    "position",
    "attitude",
)
EXAMPLE = "height_errors: [{name: datum, sigma_m: 0.01}]"


def read_height_errors(path: Path) -> tuple[HeightError, ...]:
    """The errors of a file. Raises :class:`ConfigurationError` for one that holds none, and for
    names and numbers that are none.
    """
    errors, rest = read_budget(path)
    if rest or not errors:
        raise ConfigurationError(
            f"{path.name}: holds no height_errors alone; for example {EXAMPLE}; parameters of a "
            "survey go with --trajectory"
            if rest
            else f"{path.name}: holds no height_errors; for example {EXAMPLE}"
        )
    return errors


def read_budget(path: Path) -> tuple[tuple[HeightError, ...], dict[str, Any]]:
    """The errors of a file, none where it has no ``height_errors``, and what else it holds. Raises
    :class:`ConfigurationError` for names and numbers that are none.
    """
    found = strict_yaml.read_yaml(path)
    if not isinstance(found, dict):
        raise ConfigurationError(f"{path.name}: holds no height_errors; for example {EXAMPLE}")
    rest = {key: value for key, value in found.items() if key != "height_errors"}
    if "height_errors" not in found:
        return (), rest
    rows = found["height_errors"]
    if not isinstance(rows, list) or not rows:
        raise ConfigurationError(f"{path.name}: holds no height_errors; for example {EXAMPLE}")
    errors = tuple(_error(path, row) for row in rows)
    names = [error.name for error in errors]
    for name in names:
        if names.count(name) > 1 or name in TAKEN:
            raise ConfigurationError(
                f"{path.name}: the name {short_repr(name)} is taken: name every error otherwise",
                value=name,
            )
    return errors, rest


def _error(path: Path, row: object) -> HeightError:
    """One error. Raises :class:`ConfigurationError`."""
    if not isinstance(row, dict) or not {"name", "sigma_m"} <= set(row) <= set(KEYS):
        raise ConfigurationError(
            f"{path.name}: an error has name, sigma_m and, where it is not common to all heights, "
            f"correlation_m: {short_repr(row)}",
            value=row,
        )
    name, numbers = row["name"], {key: row[key] for key in KEYS[1:] if key in row}
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigurationError(
            f"{path.name}: {short_repr(name)} is no name: letters, digits and _", value=name
        )
    for key, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigurationError(
                f"{path.name}: {key} {short_repr(value)} is no number", value=value
            )
    return HeightError(name, **{key: float(value) for key, value in numbers.items()})
