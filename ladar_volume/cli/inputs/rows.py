"""Small tables of numbers that options name: places and corners."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ladar_volume.model.errors import ConfigurationError


def read_rows(path: str | Path, option: str) -> list[list[float]]:
    """Rows x y or x y z of a text file, with commas or spaces between. Raises
    :class:`ConfigurationError` with the option that names it.
    """
    try:
        separator = "," if "," in Path(path).read_text(encoding="utf-8") else None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: for the caller to refuse
            table = np.loadtxt(path, delimiter=separator, ndmin=2)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"{option} {path}: no file of rows x y or x y z: {error}", value=str(path)
        ) from error
    rows: list[list[float]] = table.tolist()
    return rows
