"""Values of ``ladar_volume diff``."""

from __future__ import annotations

import argparse

import numpy as np

from ladar_volume.model.records import F64

#: Coordinates and lengths from the command line are below this, m: squares stay numbers.
MOST = 1e12


def point(text: str) -> F64:
    """Three finite numbers with commas, from the command line."""
    values = numbers(text)
    if len(values) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,Z")
    return np.array(values)


def numbers(text: str) -> list[float]:
    """Finite numbers with commas; none where the text is anything else."""
    try:
        values = [float(w) for w in text.split(",")]
    except ValueError:
        return []
    return values if all(abs(v) < MOST for v in values) else []
