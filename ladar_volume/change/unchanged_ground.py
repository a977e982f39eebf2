"""What the folded-normal correction leaves in cut and in fill where two surveys show ground that
did not change, also beside what did.

``volume.remaining_fold`` tells it where whole neighbourhoods run along the base. Between two
surveys most ground is as it was, right up to a heap: neighbourhoods end there, but the ground does
not leave the other surface. Vertices whose neighbourhood ended early are judged by themselves, by
the same measure: over their variances the squares of the smoothed heights are 1/2 on average where
nothing changed, and 1 where the true differences are spread evenly about zero.
"""

from __future__ import annotations

import math

import numpy as np

from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.volume.neighbourhood import Smooth
from ladar_volume.volume.remaining_fold import LEFT, RemainingFold


def remaining_on_ground(smooth: Smooth, triangles: I32, area: F64, rings: int) -> RemainingFold:
    """What is left over triangles (m, 3) of areas (m,) m² near the other surface; ``rings`` : of a
    whole neighbourhood.
    """
    s, grown = np.sqrt(smooth.variance), smooth.rings()
    ratio = np.divide(smooth.heights, s, out=np.full(len(s), np.inf), where=s > 0.0)
    square = np.minimum(ratio**2, 1e3)
    own = np.bincount(triangles.ravel(), np.repeat(area / 3.0, 3), len(s))
    left = LEFT * math.sqrt(2.0) * own * s * np.exp(-0.5 * square)
    parts = [
        remaining_change(left, square, grown, chosen) for chosen in (grown == rings, grown < rings)
    ]
    return RemainingFold(sum(p.fold_m3 for p in parts), sum(p.sigma_m3 for p in parts))


def remaining_change(left: F64, square: F64, grown: I64, chosen: Bool) -> RemainingFold:
    """What is left at the ``chosen`` (n,) vertices: the share of ``left`` (n,) m³ that the squares
    (n,) of their smoothed heights over their variances speak for, and the standard error of it;
    grown : (n,) rings of the neighbourhoods.
    """
    used = chosen & (left > 0.0)
    fold = float(left[used].sum())
    if not fold > 0.0:
        return RemainingFold(0.0, 0.0)
    members = float(np.mean(1 + 3 * grown[used] * (grown[used] + 1)))
    independent = max(float(np.count_nonzero(used)) / members, 1.0)
    spread = 2.0 * float((left * square)[used].sum()) / fold - 1.0
    taken = fold * (1.0 - min(max(spread, -0.5), 1.0))
    error = math.sqrt(2.0 / independent)
    return RemainingFold(taken, min(max(spread, 0.0) + error, 1.0) * fold)
