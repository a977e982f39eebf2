"""The error budget as covariances, and published budgets as presets (seed 004 sections 4.1 and 5.1,
seed 002 chapter 8).

Sigmas of roll, pitch, heading are Euler-angle sigmas, covariances of messages are about fixed axes
of the map, and the mathematics uses body rotation vectors: the maps between them are explicit here,
one function each.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ladar_volume.math.se3 import euler_rate_matrix, matrix_from_quaternion
from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import CAL_COLUMNS, F64

ARCSECOND = math.radians(1.0 / 3600.0)


def calibration_columns(beams: int) -> tuple[str, ...]:
    """Names of all calibration columns: CAL_COLUMNS, then rho_k of every beam, then eps_k of every
    beam.
    """
    return (
        CAL_COLUMNS
        + tuple(f"beam_range_{k}" for k in range(beams))
        + tuple(f"beam_vertical_{k}" for k in range(beams))
    )


def calibration_covariance(
    budget: BudgetParameters, beams: int, pose_source: str = "gnss_imu"
) -> F64:
    """C_cal (c, c) with c = 11 + 2 beams, in the order of :func:`calibration_columns`; m², rad²,
    s².

    Diagonal, unless the budget holds correlations (from a self-calibration). With ``odometry`` as
    pose source there is no antenna lever arm, so its sigma is zero. Raises
    :class:`ParameterValueError` for correlations of another number of beams, or none that errors
    can have.
    """
    lever_antenna = (0.0, 0.0, 0.0) if pose_source == "odometry" else budget.lever_antenna_sigma_m
    shared = [
        budget.range_bias_sigma_m,
        *budget.boresight_sigma_rad,
        *budget.lever_laser_sigma_m,
        *lever_antenna,
        budget.clock_sigma_s,
    ]
    sigmas = np.array(
        shared + [budget.beam_range_sigma_m] * beams + [budget.beam_vertical_sigma_rad] * beams
    )
    out: F64 = (
        sigmas[:, None] * correlation_matrix(budget.calibration_correlation, len(sigmas)) * sigmas
    )
    return out


def correlation_matrix(triangle: tuple[float, ...], size: int) -> F64:
    """Correlations (size, size) from the upper triangle without its diagonal, row by row; that of
    the columns shared by all beams is enough, the beams then correlate with nothing; the identity
    for an empty one.
    """
    out = np.eye(size)
    if not triangle:
        return out
    sizes = {k * (k - 1) // 2: k for k in (len(CAL_COLUMNS), size)}
    if len(triangle) not in sizes:
        raise ParameterValueError(
            f"budget.calibration_correlation: {len(triangle)} values; "
            f"{' or '.join(str(n) for n in sizes)} are expected with "
            f"{(size - len(CAL_COLUMNS)) // 2} beams",
            value=len(triangle),
        )
    rows, columns = np.triu_indices(sizes[len(triangle)], 1)
    out[rows, columns] = out[columns, rows] = triangle
    if np.linalg.eigvalsh(out)[0] < -1e-6:  # the rounding of nine decimals stays far below this
        raise ParameterValueError(
            "budget.calibration_correlation: no errors can be correlated like this (an "
            "eigenvalue is negative)"
        )
    return out


def correlation_triangle(C: F64) -> tuple[float, ...]:
    """The upper triangle of the correlations of a covariance (c, c), to nine decimals, as
    :func:`correlation_matrix` reads it; columns of zero variance correlate with nothing.
    """
    sigma = np.sqrt(np.diag(C))
    safe = np.where(sigma > 0.0, sigma, 1.0)
    R = C / (safe[:, None] * safe)
    return tuple(
        float(round(v, 9)) + 0.0 for v in np.clip(R[np.triu_indices(len(C), 1)], -1.0, 1.0)
    )


def independent_sigmas(budget: BudgetParameters) -> F64:
    """Sigmas of one return, (3,): range (m), azimuth (rad), vertical angle (rad).

    A quarter of the divergence acts as angular noise: where in the footprint the pulse was
    reflected is unknown (Glennie 2007).
    """
    spot = budget.beam_divergence_rad / 4.0
    return np.array(
        [
            budget.range_noise_m,
            math.hypot(budget.azimuth_noise_rad, spot),
            math.hypot(budget.vertical_noise_rad, spot),
        ]
    )


def roll_pitch_heading(q_map_body: F64) -> tuple[float, float, float]:
    """Roll, pitch, yaw (rad) with ``R = Rz Ry Rx`` of one unit quaternion xyzw (4,)."""
    R = matrix_from_quaternion(q_map_body)
    return (
        math.atan2(R[2, 1], R[2, 2]),
        -math.asin(min(1.0, max(-1.0, R[2, 0]))),
        math.atan2(R[1, 0], R[0, 0]),
    )


def attitude_covariance_from_euler(q_map_body: F64, sigma_rph_rad: ArrayLike) -> F64:
    """Body rotation vector covariance (3, 3) rad² of independent roll, pitch, heading sigmas (3,)
    rad at attitude q (4,).
    """
    roll, pitch, _ = roll_pitch_heading(q_map_body)
    E = euler_rate_matrix(roll, pitch)
    out: F64 = E @ np.diag(np.asarray(sigma_rph_rad, dtype=np.float64) ** 2) @ E.T
    return out


def attitude_covariance_from_axes(q_map_body: F64, C_axes: F64) -> F64:
    """Body rotation vector covariance (3, 3) rad² of one about the map's fixed axes:
    ``exp([d_map]x) R = R exp([Rᵀ d_map]x)``.
    """
    R = matrix_from_quaternion(q_map_body)
    out: F64 = R.T @ C_axes @ R
    return out


def pose_covariance_from_axes(q_map_body: F64, C_pose: F64) -> F64:
    """(6, 6) position and rotation about fixed axes -> position (map) and body rotation vector,
    cross blocks included.
    """
    T = np.zeros((6, 6))
    T[:3, :3], T[3:, 3:] = np.eye(3), matrix_from_quaternion(q_map_body).T
    out: F64 = T @ C_pose @ T.T
    return out


def navigation_covariance(budget: BudgetParameters, q_map_body: F64) -> F64:
    """C_nav (6, 6) from the budget's own sigmas at one attitude; m², rad²."""
    out = np.zeros((6, 6))
    out[:3, :3] = np.diag(np.asarray(budget.position_sigma_m) ** 2)
    out[3:, 3:] = attitude_covariance_from_euler(q_map_body, budget.attitude_sigma_rad)
    return out


def _published_budget(
    position: tuple[float, ...],
    attitude: tuple[float, ...],
    boresight: tuple[float, ...],
    range_m: float,
    angle: float,
    lever_antenna: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> BudgetParameters:
    # what a document does not state is zero here: a preset is the published budget, not a complete
    # one
    zero = (0.0, 0.0, 0.0)
    return BudgetParameters(
        range_noise_m=range_m,
        azimuth_noise_rad=angle,
        vertical_noise_rad=angle,
        beam_divergence_rad=0.0,
        beam_range_sigma_m=0.0,
        beam_vertical_sigma_rad=0.0,
        range_bias_sigma_m=0.0,
        position_sigma_m=position,
        attitude_sigma_rad=attitude,
        boresight_sigma_rad=boresight,
        lever_laser_sigma_m=zero,
        lever_antenna_sigma_m=lever_antenna,
        clock_sigma_s=0.0,
    )


def _degrees(*values: float) -> tuple[float, ...]:
    return tuple(math.radians(v) for v in values)


_OWN_BORESIGHT = _degrees(0.1563055, 0.08494642, 0.26614251)
_OWN_LEVER = (0.000348, 0.000382, 0.00184)
_TABLE_BORESIGHT = (10 * ARCSECOND, 10 * ARCSECOND, 30 * ARCSECOND)
#: Position sigma of one axis that gives 0.05 m in space with sigma_Z = 1.5 sigma_X; the document
#: divides by 3.5 instead of sqrt(4.25).
_QUADRATURE = 0.05 / math.sqrt(4.25)

#: Published budgets. ``table1_low`` and ``table1_high``: the ends of seed 004 Table 1 (after May &
#: Toth 2007). ``survey``: the instrument of seed 004 section 5.1 as printed; ``survey_corrected``:
#: the same with the position sigma in quadrature. ``thesis``: seed 002 chapter 8.
PRESETS: dict[str, BudgetParameters] = {
    "table1_low": _published_budget(
        (0.05, 0.05, 0.075),
        (10 * ARCSECOND, 10 * ARCSECOND, 20 * ARCSECOND),
        _TABLE_BORESIGHT,
        0.01,
        math.radians(0.0007),
    ),
    "table1_high": _published_budget(
        (0.15, 0.15, 0.225),
        (30 * ARCSECOND, 30 * ARCSECOND, 60 * ARCSECOND),
        _TABLE_BORESIGHT,
        0.01,
        math.radians(0.0007),
    ),
    "survey": _published_budget(
        (0.01429, 0.01429, 0.02143),
        _degrees(0.004, 0.004, 0.01),
        _OWN_BORESIGHT,
        0.005,
        math.radians(0.001),
        _OWN_LEVER,
    ),
    "survey_corrected": _published_budget(
        (_QUADRATURE, _QUADRATURE, 1.5 * _QUADRATURE),
        _degrees(0.004, 0.004, 0.01),
        _OWN_BORESIGHT,
        0.005,
        math.radians(0.001),
        _OWN_LEVER,
    ),
    "thesis": _published_budget(
        (0.01, 0.01, 0.01), _degrees(0.25, 0.25, 0.8), (0.0, 0.0, 0.0), 0.03, 0.0
    ),
}
