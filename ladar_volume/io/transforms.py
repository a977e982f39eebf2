"""A transform with its covariance as ``ladar_volume register --json`` prints it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.model.errors import InputError, short_repr
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.registration.transform import Transform

#: Larger numbers, and files of more bytes, are no transform.
MOST, SIZE = 1e12, 1_000_000


def _facts(path: Path) -> Any:
    """What a file says. Raises OSError, ValueError and RecursionError."""
    with path.open(encoding="utf-8") as file:
        text = file.read(SIZE + 1)
    if len(text) > SIZE:
        raise ValueError(f"more than {SIZE:,} characters")
    return json.loads(text)


def _checked_rotation(path: Path, M: F64, pivot: F64, C: F64, scale: float) -> F64:
    """The rotation (3, 3) of a transform whose matrix, pivot, covariance and scale are such."""
    if (
        M.shape != (4, 4)
        or pivot.shape != (3,)
        or C.shape != (7, 7)
        or not all((np.abs(x) < MOST).all() for x in (M, pivot, C))
        or not 1.0 / MOST < scale < MOST
    ):
        raise InputError(
            f"{path}: matrix (4, 4), pivot_m (3,), covariance (7, 7), scale above 0, of numbers "
            f"below {MOST:g}",
            reason="transform_file",
            value=str(path),
        )
    R = M[:3, :3] / scale
    turns = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0
    if not turns or np.linalg.eigvalsh(C)[0] < -1e-9 * max(float(np.trace(C)), 1e-300):
        raise InputError(
            f"{path}: the matrix is no rotation times the scale, or the covariance none",
            reason="transform_file",
        )
    return R


def read_transform(path: str | Path) -> Transform:
    """Read a transform.

    Raises :class:`InputError`: input_missing, input_unreadable, transform_file for what is no
    transform: keys matrix (4, 4), scale, pivot_m (3,), covariance (7, 7), all finite, with a
    rotation in the matrix and a covariance without negative variances.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file", reason="input_missing", value=str(path))
    try:
        facts = _facts(path)
        M, pivot, C = (
            np.asarray(facts[key], dtype=np.float64) for key in ("matrix", "pivot_m", "covariance")
        )
        scale = float(facts["scale"])
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error}", reason="input_unreadable", value=str(path)
        ) from error
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(
            f"{path}: not what 'register --json' prints: {short_repr(error)}",
            reason="transform_file",
            value=str(path),
        ) from error
    R = _checked_rotation(path, M, pivot, C, scale)
    return Transform(R, M[:3, 3] + M[:3, :3] @ pivot, pivot, scale, C)


def read_transform_verdict(path: str | Path) -> Verdict:
    """What ``register`` said against a transform; sound for a file without a verdict that does not
    say the spheres were inconsistent. Raises :class:`InputError` (transform_file) as
    :func:`read_transform` does.
    """
    path = Path(path)
    try:
        facts = _facts(path)
        reasons = facts.get("verdict", {}).get("reasons", [])
        doubts = [
            Doubt(str(r["name"]), f"{path.name}: {r['text']}", r.get("value")) for r in reasons
        ]
        if not doubts and facts.get("consistent") is False:
            words = f"{path.name}: its spheres do not agree within their noise; register again"
            doubts = [Doubt("inconsistent", words)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: not what 'register --json' prints: {short_repr(error)}",
            reason="transform_file",
            value=str(path),
        ) from error
    return Verdict(tuple(doubts))
