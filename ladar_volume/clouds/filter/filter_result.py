"""The answer of a cloud filter: every input point is kept, stands behind one that is kept, or is
named with a reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ladar_volume.model.errors import FilterError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.model.verdict import Verdict

#: Names of the reasons, by the numbers of ``CloudResult.reason``.
REASONS = (
    "kept",
    "outlier",
    "few_neighbours",
    "no_surface",
    "beyond_edge",
    "unsupported",
    "clutter",
)
#: What a point that is kept is, by the numbers of ``CloudResult.flag``.
FLAGS = ("surface", "sparse", "clutter")


@dataclass(frozen=True)
class CloudResult:
    """What became of a cloud.

    r : (k, 3) m, filtered points in the order of their input · index : (k,) input point of each ·
    normal : (k, 3), towards no side in particular · sigma : (k,) m, standard deviation along the
    normal · outliers : (m,) input points taken out, ascending · reason : (m,) index into
    ``REASONS`` · report : what was chosen and what came of it · count : (k,) input points each
    filtered point stands for, None where each stands for its own alone. ``sum(count) + m`` is the
    number of input points · noise, reach : (k,) m, standard deviation of one input point there and
    radius of its fit; curved : (k,) whether that was a quadric, not planes; all None where points
    were reduced or the order was the published one · flag : (k,) index into ``FLAGS``, None where
    all lie on a surface · copies : (k,) how often the input holds each point, None where
    once: errors of copies are one error · verdict : what speaks against the answer.
    """

    r: F64
    index: I64
    normal: F64
    sigma: F64
    outliers: I64
    reason: I64
    report: dict[str, float | int | str]
    count: I64 | None = None
    noise: F64 | None = None
    reach: F64 | None = None
    curved: Bool | None = None
    flag: I64 | None = None
    copies: I64 | None = None
    verdict: Verdict = field(default_factory=Verdict)

    @property
    def independent_noise(self) -> F64 | None:
        """Noise (k,) m of as many independent points: that of copies grows by the root of their
        number, so that together they tell what the one tells.
        """
        if self.noise is None or self.copies is None:
            return self.noise
        return np.asarray(self.noise * np.sqrt(self.copies))

    @property
    def sparse(self) -> Bool | None:
        """Which points (k,) are as they came, since they lie on no surface; None where none is."""
        return None if self.flag is None else self.flag > 0


def check_cloud_points(r: F64) -> F64:
    """Points (n, 3) as contiguous float64; raises FilterError for a wrong shape, no points, or a
    coordinate that is not finite.
    """
    points = np.ascontiguousarray(r, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise FilterError(
            f"points are (n, 3), not {points.shape}", reason="filter_shape", value=points.shape
        )
    bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
    if bad:
        raise FilterError(
            f"{bad} points with a coordinate that is not finite",
            reason="filter_not_finite",
            value=bad,
        )
    return points
