"""What a survey's calibration and navigation do to points that another filter made of the same
returns.

The survey's patches know how they move with every error source. A point of the other surface moves
as the survey's nearest point on the same side of the body does: both come from the returns around.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.records import F64, FilteredPoints

#: Points of the survey that are asked about each place.
ASKED = 12
#: Normals that enclose less than this cosine's angle belong to one side.
SAME_SIDE = 0.7


@dataclass(frozen=True)
class OnSurvey:
    """gradient : (n, 3) m² by the survey's points · apart : share of the given gradient, by its
    length, for which no point of the survey lies on the same side within reach: the nearest one
    stands for it · apart_m : median distance to the points that stand for the places
    """

    gradient: F64
    apart: float
    apart_m: float


def on_survey(
    r: F64, normal: F64, gradient: F64, survey: FilteredPoints, reach_m: float
) -> OnSurvey:
    """A gradient (k, 3) m² by points r (k, 3) m with normals (k, 3) of either sign, as one by the
    points of a survey; reach_m : beyond which a point is no neighbour.
    """
    used = np.flatnonzero((gradient != 0.0).any(axis=1))
    out = np.zeros((len(survey), 3))
    if not len(used):
        return OnSurvey(out, 0.0, 0.0)
    asked = min(ASKED, len(survey))
    far, near = cKDTree(survey.r_map).query(r[used], np.arange(1, asked + 1))
    far, near = np.asarray(far), np.asarray(near)
    turned = np.abs(np.einsum("ki,kji->kj", normal[used], survey.normal[near]))
    good = (turned >= SAME_SIDE) & (far <= reach_m)
    first = np.where(good.any(axis=1), good.argmax(axis=1), 0)
    row = np.arange(len(used))
    np.add.at(out, near[row, first], gradient[used])
    size = np.linalg.norm(gradient[used], axis=1)
    lost = float(size[~good.any(axis=1)].sum() / size.sum())
    return OnSurvey(out, lost, float(np.median(far[row, first])))
