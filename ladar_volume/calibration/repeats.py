"""Sigmas of calibration constants from repeated measurements (seed 004 sections 5.1.2 and 5.1.4).

Three spreads are told apart: that of single values, that of their mean, and, where it is known in
which mounting each value was measured, that between mountings (the sensor was taken off and put
back) from that within one (the calibration alone was repeated). The model is the one-way layout
with random effects ``y_ij = mu + b_i + e_ij``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.spatial.transform import Rotation

from ladar_volume.math.se3 import rotation_xyz
from ladar_volume.model.choices import USES
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.records import F64, I64

Interval = tuple[float, float]


@dataclass(frozen=True)
class Spread:
    """n values as they come, in their own unit: mean with Student interval, sigma of a single value
    with chi-square interval, sigma of the mean ``sigma_single / sqrt(n)``, degrees of freedom n −
    1.
    """

    count: int
    mean: float
    mean_interval: Interval
    sigma_single: float
    single_interval: Interval
    sigma_mean: float
    freedom: int


@dataclass(frozen=True)
class Components:
    """Values grouped by mounting: ``mean`` of the mountings' means, its sigma and Student interval;
    sigma within one mounting (exact interval) and between mountings (Tukey and Williams' interval
    on the mountings' means, 0 where nothing is seen); ``p_value`` of no variation between mountings
    (F test); ``last_mean`` and ``last_count`` of the mounting measured last.
    """

    mountings: int
    mean: float
    mean_interval: Interval
    sigma_mean: float
    sigma_within: float
    within_interval: Interval
    sigma_between: float
    between_interval: Interval
    p_value: float
    last_mean: float
    last_count: int


def _check_values(values: npt.ArrayLike, confidence: float) -> F64:
    y = np.asarray(values, dtype=np.float64)
    if not 0.0 < confidence < 1.0:
        raise CalibrationError(
            f"a confidence lies between 0 and 1, not at {confidence}",
            reason="calibration_confidence",
            value=confidence,
        )
    if y.ndim != 1 or len(y) < 2:
        raise CalibrationError(
            f"a spread needs two values or more, there are {y.size}",
            reason="calibration_too_few",
            value=y.size,
        )
    if not np.isfinite(y).all():
        raise CalibrationError(
            "a value is not finite",
            reason="calibration_values",
            value=np.flatnonzero(~np.isfinite(y)).tolist(),
        )
    if np.ptp(y) == 0.0:
        raise CalibrationError(
            f"all {len(y)} values are {y[0]:g}: copies of one value have no spread",
            reason="calibration_no_spread",
            value=float(y[0]),
        )
    return y


def sigma_interval(sigma: float, freedom: float, confidence: float) -> Interval:
    """Interval of a standard deviation estimated with ``freedom`` degrees of freedom
    (chi-square).
    """
    tail = (1.0 - confidence) / 2.0
    low, high = (
        sigma * math.sqrt(freedom / float(stats.chi2.ppf(q, freedom))) for q in (1.0 - tail, tail)
    )
    return low, high


def _mean_interval(mean: float, sigma: float, freedom: int, confidence: float) -> Interval:
    half = float(stats.t.ppf(0.5 + confidence / 2.0, freedom)) * sigma
    return mean - half, mean + half


def spread(values: npt.ArrayLike, confidence: float = 0.95) -> Spread:
    """The spread of values (n,) of one constant.

    Raises :class:`CalibrationError`: calibration_too_few, calibration_values,
    calibration_no_spread, calibration_confidence.
    """
    y = _check_values(values, confidence)
    n, mean, single = len(y), float(y.mean()), float(y.std(ddof=1))
    of_mean = single / math.sqrt(n)
    return Spread(
        n,
        mean,
        _mean_interval(mean, of_mean, n - 1, confidence),
        single,
        sigma_interval(single, n - 1, confidence),
        of_mean,
        n - 1,
    )


def components(
    values: npt.ArrayLike, mounting: npt.ArrayLike, confidence: float = 0.95
) -> Components:
    """Variance between and within mountings, of values (n,) with labels (n,) of the mounting each
    was measured in.

    Where mountings hold unequal numbers, the between part rests on the unweighted means (Thomas and
    Hultquist 1978), its interval on Tukey and Williams' inequality. Raises
    :class:`CalibrationError` as :func:`spread`, and calibration_mountings (fewer than two),
    calibration_no_repeats (no mounting was measured twice).
    """
    y = _check_values(values, confidence)
    group = _mounting_groups(y, mounting)
    count: I64 = np.bincount(group)
    k, freedom = len(count), len(y) - len(count)
    means = np.bincount(group, y) / count
    within = float(np.sum((y - means[group]) ** 2)) / freedom
    harmonic = k / float(np.sum(1.0 / count))
    between = harmonic * float(np.var(means, ddof=1))
    mean, sigma_mean = float(means.mean()), math.sqrt(between / (harmonic * k))
    last = group[-1]
    return Components(
        k,
        mean,
        _mean_interval(mean, sigma_mean, k - 1, confidence),
        sigma_mean,
        math.sqrt(within),
        sigma_interval(math.sqrt(within), freedom, confidence),
        math.sqrt(max(0.0, between - within) / harmonic),
        _between_interval(between, within, k - 1, freedom, harmonic, confidence),
        float(stats.f.sf(between / within, k - 1, freedom)) if within > 0.0 else 0.0,
        float(means[last]),
        int(count[last]),
    )


def _mounting_groups(y: F64, mounting: npt.ArrayLike) -> I64:
    """The number (n,) of each value's mounting. Raises :class:`CalibrationError` where values
    (n,) of these mountings do not tell re-mounting from the calibration's own spread.
    """
    label = np.asarray(mounting)
    if label.shape != y.shape:
        raise CalibrationError(
            f"{label.shape} mountings for {y.shape} values",
            reason="calibration_values",
            value=label.shape,
        )
    names, group = np.unique(label, return_inverse=True)
    k = len(names)
    if k < 2:
        raise CalibrationError(
            "one mounting alone tells nothing of re-mounting",
            reason="calibration_mountings",
            value=k,
        )
    if k == len(y):
        raise CalibrationError(
            (
                "no mounting was measured twice, so re-mounting cannot be told from the "
                "calibration's own spread"
            ),
            reason="calibration_no_repeats",
            value=k,
        )
    return np.asarray(group, np.int64)


def _between_interval(
    between: float, within: float, f1: int, f2: int, n: float, confidence: float
) -> Interval:
    # Tukey (1951) and Williams (1962): bounds of the difference of two mean squares that hold at
    # least at the confidence
    tail = (1.0 - confidence) / 2.0
    squares = [
        f1 * (between - within * float(stats.f.ppf(q, f1, f2))) / (n * float(stats.chi2.ppf(q, f1)))
        for q in (1.0 - tail, tail)
    ]
    return math.sqrt(max(0.0, squares[0])), math.sqrt(max(0.0, squares[1]))


def budget_sigma(found: Spread | Components, use: str) -> float:
    """The sigma that belongs into the budget for what the survey ``use`` s, in the values' own
    unit.

    Without mountings every value counts as one of the same mounting for ``single`` and ``mean``,
    and as one mounting of its own for ``remounted``. Raises :class:`CalibrationError`
    (calibration_use) for an unknown use.
    """
    if use not in USES:
        raise CalibrationError(
            f"no use {use!r}; there are {', '.join(USES)}", reason="calibration_use", value=use
        )
    if isinstance(found, Spread):
        return {
            "single": found.sigma_single,
            "mean": found.sigma_mean,
            "remounted": math.hypot(found.sigma_single, found.sigma_mean),
        }[use]
    return {
        "single": found.sigma_within,
        "mean": found.sigma_within / math.sqrt(found.last_count),
        "remounted": math.hypot(found.sigma_between, found.sigma_mean),
    }[use]


def boresight_vectors(roll_pitch_yaw_rad: F64) -> tuple[F64, F64]:
    """Boresights as body rotation vectors about their mean: angles (n, 3) rad of ``Rz Ry Rx`` ->
    vectors (n, 3) rad, mean (3, 3).

    Angles themselves must not be averaged: at a scanner pitched by 90° roll and yaw turn about one
    axis.
    """
    turns = Rotation.from_matrix(np.array([rotation_xyz(*row) for row in roll_pitch_yaw_rad]))
    mean = turns.mean()
    return (turns * mean.inv()).as_rotvec(), mean.as_matrix()


def angles_of(R_body_laser: F64) -> F64:
    """Roll, pitch and yaw (3,) rad of a boresight ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    out: F64 = Rotation.from_matrix(R_body_laser).as_euler("ZYX")[::-1].copy()
    return out


def correction_of(R_body_laser: F64, roll: float, pitch: float, yaw: float) -> F64:
    """The body rotation vector (3,) rad that takes the nominal boresight ``Rz(yaw) Ry(pitch)
    Rx(roll)`` to ``R_body_laser``.
    """
    out: F64 = Rotation.from_matrix(R_body_laser @ rotation_xyz(roll, pitch, yaw).T).as_rotvec()
    return out
