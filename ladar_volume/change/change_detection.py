"""Where two surveys of one place differ by more than their noise: the map of the level of
detection.

At every vertex of the finer surface: the difference of heights, its standard deviation, and the
level of detection, ``k sigma`` with the coverage factor of the volume. Two parts of sigma are kept
apart, since they are correlated differently. ``sigma_noise`` is the returns': neighbours share it
over a patch or two. ``sigma_shared`` is calibration, navigation and registration: whole strips err
as one, so where it is the larger part, the false alarms of unchanged ground come all at once and
not as one vertex in twenty.

Leaving out what is below the level makes a volume quieter and biased: real change that is thin is
lost. The volume with and without the threshold, and the difference with its own standard deviation,
stand side by side. Each vertex stands for a third of its triangles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from ladar_volume.change.surface_difference import Difference, difference_kernel
from ladar_volume.model.records import F64, I32, I64, LEAST_UPWARD, Bool, Tin
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import Epoch, calibration_cross, epoch_budget
from ladar_volume.uncertainty.packing import calibration_rows
from ladar_volume.uncertainty.vertex_noise import height_pairs, vertex_rows
from ladar_volume.volume.near_base import csr
from ladar_volume.volume.volume_loads import vertex_variance

#: Vertices whose sensitivities are held at once.
BLOCK = 1 << 15


@dataclass(frozen=True)
class ChangeMap:
    """At the n vertices of the finer surface, NaN (significant: false) where the two have nothing
    in common.

    tin : its z is the height of the finer surface · difference_m : new minus previous ·
    sigma_noise_m, sigma_shared_m : see above · level_m : of detection · significant : whether the
    difference exceeds it · area_m2 : what each vertex stands for
    """

    tin: Tin
    difference_m: F64
    sigma_noise_m: F64
    sigma_shared_m: F64
    level_m: F64
    significant: Bool
    area_m2: F64

    @property
    def sigma_m(self) -> F64:
        """Standard deviation (n,) m of each difference, all sources."""
        out: F64 = np.hypot(self.sigma_noise_m, self.sigma_shared_m)
        return out


@dataclass(frozen=True)
class ThresholdedVolumes:
    """Volumes of a change map. net_m3 ± sigma_m3 : of significant vertices alone · raised_m3,
    lowered_m3 : its parts, both 0 or more · area_m2 : significant · map_area_m2 : all · level_m :
    median level of detection · bias_m3 ± bias_sigma_m3 : what the threshold took from the net
    volume, an unbiased estimate of its bias, since the whole is unbiased · unchanged_m3 : what
    noise would put into raised, and into lowered, if nothing had changed; without a threshold it
    would be ``unchanged_without_m3``
    """

    net_m3: float
    sigma_m3: float
    raised_m3: float
    lowered_m3: float
    area_m2: float
    map_area_m2: float
    level_m: float
    bias_m3: float
    bias_sigma_m3: float
    unchanged_m3: float
    unchanged_without_m3: float


def change_map(
    new: Epoch,
    previous: Epoch,
    difference: Difference,
    coverage_factor: float,
    separate: Collection[str] = (),
) -> ChangeMap:
    """The level of detection of a difference of heights (see
    :func:`ladar_volume.change.epoch_change.epoch_difference`).
    """
    own, other = (new, previous) if difference.upper_carries else (previous, new)
    used = np.zeros(len(difference.tin.vertices), bool)
    used[difference.tin.triangles[difference.tin.relevant]] = True
    at = np.flatnonzero(used)
    noise = np.sqrt(height_variance(own, other, difference))
    cross = calibration_cross(new, previous, separate)
    shared = shared_sigma(
        own, other, difference, at, cross if difference.upper_carries else cross.T
    )
    return map_of_difference(difference, own.tin, noise, shared, coverage_factor)


def map_of_difference(
    difference: Difference, own: Tin, noise: F64, shared: F64, coverage_factor: float
) -> ChangeMap:
    """The map of a difference that the surface ``own`` carries; noise, shared : (n,) m, both parts
    of its sigma at the vertices.
    """
    at, n = difference.tin, len(difference.tin.vertices)
    triangles = at.triangles[at.relevant]
    part = footprint_areas(at.vertices, triangles) / 3.0
    stands: F64 = np.bincount(triangles.ravel(), np.repeat(part, 3), n).astype(np.float64)
    used = np.zeros(n, np.bool_)
    used[triangles] = True
    z, noise, shared = (np.where(used, v, np.nan) for v in (at.vertices[:, 2], noise, shared))
    level = coverage_factor * np.hypot(noise, shared)
    tin = Tin(own.vertices, at.triangles, at.neighbours, at.relevant, at.source)
    return ChangeMap(tin, z, noise, shared, level, np.abs(z) > level, stands)


def shared_sigma(own: Epoch, other: Epoch, difference: Difference, at: I64, cross: F64) -> F64:
    """Standard deviation (n,) m at vertices ``at`` (k,) of all that is no noise of returns, NaN
    elsewhere; cross : covariance (c, c) of the calibration errors of own and other.
    """
    shared = np.full(len(difference.tin.vertices), np.nan)
    for start in range(0, len(at), BLOCK):
        rows = at[start : start + BLOCK]
        shared[rows] = np.sqrt(
            np.maximum(
                shared_variance(own, other, difference, rows, cross),
                0.0,
            )
        )
    return shared


def height_variance(own: Epoch, other: Epoch, difference: Difference) -> F64:
    """Variance (n,) m² of each difference from the returns' noise: of the vertex itself and of the
    other surface interpolated there.
    """
    n = len(difference.tin.vertices)
    start, column = np.arange(n + 1, dtype=np.int64), np.arange(n, dtype=np.int64)
    C = []
    for e in (own, other):
        X, row = vertex_rows(e.tin, e.sources.points, e.sources.patches, e.sources.geometry)
        variance = vertex_variance(e.surface, e.sources.points)
        C.append(
            csr(
                height_pairs(
                    e.tin, e.sources.patches, e.sources.geometry, X, row, variance, e.tin.triangles
                )
            )
        )
    mine, taken = difference_kernel(start, column, C[0], C[1], difference.corner, difference.weight)
    out: F64 = mine + taken
    return out


def sensitivity_rows(epoch: Epoch, corner: I32 | I64, weight: F64) -> tuple[F64, F64]:
    """Of heights made of vertices corner (k, j) with shares weight (k, j): sensitivities (k, c) to
    the calibration and what one standard deviation of position and attitude does, (k, 6).
    """
    s = epoch.sources
    source = epoch.surface.tin.source[corner]
    up = np.maximum(np.abs(s.points.normal[source, 2]), LEAST_UPWARD)
    X = s.geometry.design(source) * (weight / up)[..., None]
    row = s.geometry.row[source]
    deviation, p = s.errors.deviation(row.ravel()), X.shape[2]
    by_calibration, by_navigation = (
        np.zeros((len(corner), len(s.C_cal))),
        np.zeros((len(corner), 6)),
    )
    for j in range(corner.shape[1]):
        by_calibration += np.einsum(
            "kp,kpc->kc", X[:, j], calibration_rows(s.patches, row[:, j], p)
        )
        by_navigation += np.einsum("kp,kpc->kc", X[:, j], deviation[row[:, j]])
    return by_calibration, by_navigation


def shared_variance(own: Epoch, other: Epoch, difference: Difference, rows: I64, cross: F64) -> F64:
    """Variance (k,) m² of the differences at vertices ``rows`` (k,) from all that is no noise of
    returns; cross : covariance (c, c) of the calibration errors of own and other.
    """
    J, own_navigation = sensitivity_rows(own, rows[:, None], np.ones((len(rows), 1)))
    K, navigation = sensitivity_rows(other, difference.corner[rows], difference.weight[rows])
    out: F64 = ((J @ own.sources.C_cal) * J).sum(axis=1)
    out += ((K @ other.sources.C_cal) * K).sum(axis=1) - 2.0 * ((J @ cross) * K).sum(axis=1)
    for part in (own_navigation, navigation):
        out += (part**2).sum(axis=1)
    r = own.tin.vertices[rows]
    n = own.normals()[rows]
    slope = n / np.copysign(np.maximum(np.abs(n[:, 2:]), LEAST_UPWARD), n[:, 2:])
    for epoch in (own, other):
        if epoch.transform is not None:
            j = np.einsum(
                "ki,kij->kj", slope, epoch.transform.jacobian(epoch.transform.apply_inverse(r))
            )
            out += np.einsum("ki,ij,kj->k", j, epoch.transform.C, j)
    return out


def weighted_sigma(
    new: Epoch, previous: Epoch, difference: Difference, weight: F64, separate: Collection[str]
) -> float:
    """Standard deviation, m³, of ``Σ weight_i difference_i`` with weights (n,) m², all sources and
    correlations.
    """
    own, other = (new, previous) if difference.upper_carries else (previous, new)
    at_other = np.bincount(
        difference.corner.ravel(),
        (weight[:, None] * difference.weight).ravel(),
        len(other.tin.vertices),
    )
    gradients = []
    for epoch, w in ((own, weight), (other, -at_other)):
        n = epoch.normals()
        gradients.append(
            w[:, None] * n / np.copysign(np.maximum(np.abs(n[:, 2:]), LEAST_UPWARD), n[:, 2:])
        )
    one, two = gradients if difference.upper_carries else (-gradients[1], -gradients[0])
    return epoch_budget(new, previous, one, two, separate).sigma


def threshold_volumes(
    change: ChangeMap, coverage_factor: float, sigma_of: Callable[[F64], float]
) -> ThresholdedVolumes:
    """Volumes with the threshold at the level of detection, and what it does to the net volume.
    sigma_of : standard deviation, m³, of ``Σ weight_i difference_i`` with weights (n,) m²
    """
    used, above = change.area_m2 > 0.0, change.significant & (change.area_m2 > 0.0)
    parts = change.area_m2[used] * change.difference_m[used]
    chosen = above[used]
    kept = np.where(above, change.area_m2, 0.0)
    rest = np.where(used & ~above, change.area_m2, 0.0)
    noise = float(change.area_m2[used] @ change.sigma_m[used]) / math.sqrt(2.0 * math.pi)
    up, down = (
        float(np.abs(parts[chosen & (np.sign(parts) == sign)]).sum()) for sign in (1.0, -1.0)
    )
    return ThresholdedVolumes(
        up - down,
        sigma_of(kept),
        up,
        down,
        float(kept.sum()),
        float(change.area_m2.sum()),
        float(np.median(change.level_m[used])),
        0.0 - float(parts[~chosen].sum()),
        sigma_of(rest),
        noise * math.exp(-0.5 * coverage_factor**2),
        noise,
    )
