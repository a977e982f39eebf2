"""The points that bodies are made of: a filter's, or as they came where the surface between them is
coarser than what the filter can follow.

A filter's surface reaches over many points. Where a body is only some of these wide it fits none,
and the filter leaves its points out although they are good: a pile sampled once a square metre
keeps a tenth of its points. What the filter left out but has company as close as its neighbours
belongs to the survey; such points stay where they are, with the noise of the ground.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.clouds.filter.sparse_points import JUMP
from ladar_volume.clouds.sampling.isolation import connected_to_known, second_neighbour_distance
from ladar_volume.ground.clusters import clusters
from ladar_volume.ground.objects import heights_above_ground
from ladar_volume.math.random_halves import random_halves
from ladar_volume.mesh.local_mesh import REACH, SPACING
from ladar_volume.model.body_parameters import ObjectParameters
from ladar_volume.model.records import F64, I64, Bool, Plane

#: Threshold of the search for the ground, in sigmas of the noise and in spacings of the points: the
#: larger one.
GROUND_SIGMAS, GROUND_SPACINGS = 4.0, 0.1
#: Raw points higher than this many sigmas of the noise do not come from the ground.
RAISED = 5.0
#: Noise up to this share of the spacing (distance of the 6th neighbour) lets a mesh go through the
#: points as they came.
ROUGH = 0.2
#: Least step between points of one object, in the spacing where the points are sparsest.
SPARSE, SPARSEST = 2.0, 90.0
#: A cluster of less than this share of the points above the ground is no body by itself: of a wall
#: that was seen aslant, a few returns may stand alone.
MATTERS = 0.01
#: Bodies are halved in so many ways, those of few points in more: what the halves tell is uncertain
#: by itself, and one split can by chance show next to nothing.
SPLITS, MORE, FEW, SEED = 2, 3, 10_000, 7


@dataclass(frozen=True)
class BodyPoints:
    """r : (n, 3) m · normal : (n, 3) of either sign, None where not known · curved : (n,) whether
    the surface is, None where normals tell · sigma : (n,) m along the normal, None where not known
    · noise_m : of the points before any filter, 0 where not known · filtered : the result whose
    points they are, None for points as they came · left_out : share of the good points above the
    ground that a filter did not keep
    """

    r: F64
    normal: F64 | None
    curved: Bool | None
    sigma: F64 | None
    noise_m: float = 0.0
    filtered: CloudResult | None = None
    left_out: float = 0.0


def filtered_points(result: CloudResult) -> BodyPoints:
    """A filter's points."""
    noise = float(result.report["noise_m"])
    return BodyPoints(result.r, result.normal, result.curved, result.sigma, noise, result)


def spacing_of(r: F64) -> float:
    """Spacing of points (n, 3) m: median distance of the 6th neighbour; 0 for a single point."""
    if len(r) < 2:
        return 0.0
    k = min(SPACING, len(r) - 1)
    return float(np.median(np.asarray(cKDTree(r).query(r, [k + 1])[0])))


def step_between(points: F64) -> float:
    """Longest step between points (n, 3) m of one object: the longest edge of a mesh through them,
    and twice the spacing where it is large. Spacing: distance of the 6th neighbour. 0 without two
    points at different places.
    """
    if len(points) < 2:
        return 0.0
    k = min(SPACING, len(points) - 1)
    away = np.asarray(cKDTree(points).query(points, [k])[0])
    return float(max(REACH * np.median(away), SPARSE * np.percentile(away, SPARSEST)))


def ground_threshold(points: BodyPoints) -> float:
    """Threshold, m, of the random search for the ground: in any unit of length the same ground."""
    return max(GROUND_SIGMAS * points.noise_m, GROUND_SPACINGS * spacing_of(points.r))


def good_points(raw: F64, result: CloudResult) -> Bool:
    """Which of the raw points (n, 3) m belong to the survey: those the filter kept, and others that
    have company as close as the points next to them.
    """
    known = np.zeros(len(raw), np.bool_)
    known[result.index] = True
    out: Bool = known | connected_to_known(raw, known, second_neighbour_distance(raw), ~known, JUMP)
    return out


@dataclass(frozen=True)
class ExcludedPoints:
    """What a filter left out, where it left out most: of a whole cloud or of one body. above : good
    points above the ground · lost : those the filter did not keep · spacing_m : of the former
    """

    above: int
    lost: int
    spacing_m: float

    @property
    def share(self) -> float:
        """Share of the good points above the ground that are lost."""
        return self.lost / self.above if self.above else 0.0


def excluded_points(
    raw: F64, good: Bool, result: CloudResult, ground: Plane | None
) -> ExcludedPoints:
    """What the filter left out of the good points (n,) of a cloud (n, 3) m: of what stands above
    the ground, in all or in one cluster that matters; of all points where there is no ground.
    """
    kept = np.zeros(len(raw), np.bool_)
    kept[result.index] = True
    if ground is None:
        return _excluded_among(raw, good, kept)
    p = ObjectParameters(min_height_m=RAISED * float(result.report["noise_m"]))
    above = good & heights_above_ground(raw, [ground], p, result.r)[1]
    most = _excluded_among(raw, above, kept)
    step_m = step_between(raw[above])
    if not step_m:
        return most
    label = clusters(raw, step_m, p.min_points, above)
    size = np.bincount(label[label >= 0])
    of_each = [
        _excluded_among(raw, label == k, kept) for k in np.flatnonzero(size > MATTERS * most.above)
    ]
    return max([most, *of_each], key=lambda found: found.share)


def _excluded_among(raw: F64, chosen: Bool, kept: Bool) -> ExcludedPoints:
    """The points chosen (n,) and those of them that were not kept (n,)."""
    count = int(np.count_nonzero(chosen))
    return ExcludedPoints(count, int(np.count_nonzero(chosen & ~kept)), spacing_of(raw[chosen]))


def noise_shapes_mesh(lost: ExcludedPoints, noise_m: float) -> bool:
    """Whether a mesh through the points as they came would follow their noise."""
    return not noise_m <= ROUGH * lost.spacing_m


def unfiltered_points(raw: F64, good: Bool, noise_m: float, share: float) -> BodyPoints:
    """The good points (n,) of a cloud (n, 3) m, unmoved."""
    r = raw[good]
    return BodyPoints(r, None, None, np.full(len(r), noise_m), noise_m, None, share)


def with_noise(points: BodyPoints, noise_m: float) -> BodyPoints:
    """Points whose noise is known now."""
    return dataclasses.replace(points, sigma=np.full(len(points.r), noise_m), noise_m=noise_m)


def halves(points: F64) -> list[I64]:
    """Rows of random halves of points (n, 3) m in pairs, several where they cost little."""
    out: list[I64] = []
    for split in range(MORE if len(points) <= FEW else SPLITS):
        out += random_halves(points, np.random.default_rng([SEED, split]))
    return out
