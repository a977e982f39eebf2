"""Did a sphere stand still? Its motion during one scan, from the residuals over time.

Source: seed 003 section 2, step 4 (the location of the reference spheres is checked during
scanning). A sphere that moves evenly by the displacement m over the scan adds ``−n · m tau`` to the
residual of a point seen at the share tau of the scan, −½ to ½.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64
from ladar_volume.registration.spheres import Sphere, residuals_and_normals


@dataclass(frozen=True)
class Stillness:
    """Result of the check.

    displacement_m : (3,) m, over the scan · C : (3, 3) m² ·
    statistic : ``mᵀ C⁻¹ m``, chi-square with 3 degrees of freedom for a sphere at rest · p_value ·
    still : whether p_value is at least the chosen risk · detectable_m : length that a displacement
    in the least favourable direction needs to stand out at three sigma
    """

    displacement_m: F64
    C: F64
    statistic: float
    p_value: float
    still: bool
    detectable_m: float


def stillness_of(displacement: F64, C: F64, risk: float) -> Stillness:
    """Test a displacement (3,) m with covariance (3, 3) m² against zero."""
    value = float(displacement @ np.linalg.solve(C, displacement))
    p = float(stats.chi2.sf(value, 3))
    return Stillness(
        displacement, C, value, p, p >= risk, 3.0 * float(np.sqrt(np.linalg.eigvalsh(C)[-1]))
    )


def check_drift(points: F64, t_s: F64, sphere: Sphere, risk: float = 0.001) -> Stillness:
    """Displacement of a sphere's centre from the first to the last of its points, by one step of
    the joint adjustment.

    points : (n, 3) m, those of the fit · t_s : (n,) s, when each was measured · risk : of calling a
    sphere at rest moved. All inliers serve, and the fit's own covariance of the noise. Raises
    :class:`RegistrationError` (sphere_times) for times that do not match the points, are not finite
    or all alike, or leave a motion undetermined.
    """
    p, t = np.asarray(points, dtype=np.float64), np.asarray(t_s, dtype=np.float64)
    if t.shape != (len(p),) or len(p) != len(sphere.inside) or not np.isfinite(t).all():
        raise RegistrationError(
            f"{len(sphere.inside)} points of the fit need as many finite times",
            reason="sphere_times",
            value=t.shape,
        )
    p, t, sigma = p[sphere.inside], t[sphere.inside], sphere.sigma[sphere.inside]
    span = float(np.ptp(t))
    if span == 0.0:
        raise RegistrationError(
            "all points have the same time: a motion cannot be seen", reason="sphere_times", value=t
        )
    tau = (t - t.min()) / span - 0.5
    v, n = residuals_and_normals(p, np.append(sphere.centre, sphere.radius))
    columns = (
        [n, n * tau[:, None]]
        if sphere.radius_known
        else [n, np.ones((len(n), 1)), n * tau[:, None]]
    )
    A = np.concatenate(columns, axis=1) / sigma[:, None]
    N = A.T @ A
    if len(p) <= A.shape[1] or np.linalg.cond(N) > 1e13:
        raise RegistrationError(
            "points and times are so arranged that motion and place cannot be told apart",
            reason="sphere_times",
            value=len(p),
        )
    Q = np.asarray(np.linalg.inv(N), dtype=np.float64)
    estimate: F64 = Q @ (A.T @ (v / sigma))
    return stillness_of(estimate[-3:], Q[-3:, -3:], risk)
