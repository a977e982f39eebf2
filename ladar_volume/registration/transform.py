"""Transforms between frames, with covariance: ``r_target = scale · R (r_source − pivot) + t``.

Seven parameters in this order: rotation vector δ (rad, right perturbation ``R exp([δ]x)``, about
the source's axes), t (m), scale. Those that are held fixed have zero rows in the covariance. The
pivot lies amid the centres, so that rotation and shift are hardly correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.se3 import exp_so3, skew
from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64


@dataclass(frozen=True)
class Transform:
    """A similarity with its covariance.

    R : (3, 3), source axes to target axes · t : (3,) m, image of the pivot in the target frame ·
    pivot : (3,) m, source frame · scale · C : (7, 7), rotation (rad), t (m), scale
    """

    R: F64
    t: F64
    pivot: F64
    scale: float
    C: F64

    def apply(self, r_source: F64) -> F64:
        """Points (n, 3) m of the source frame in the target frame."""
        out: F64 = (
            self.scale * (np.asarray(r_source, dtype=np.float64) - self.pivot) @ self.R.T + self.t
        )
        return out

    def apply_inverse(self, r_target: F64) -> F64:
        """Points (n, 3) m of the target frame in the source frame."""
        out: F64 = (
            np.asarray(r_target, dtype=np.float64) - self.t
        ) @ self.R / self.scale + self.pivot
        return out

    def matrix(self) -> F64:
        """Homogeneous matrix (4, 4), source to target."""
        out = np.eye(4)
        out[:3, :3] = self.scale * self.R
        out[:3, 3] = self.t - out[:3, :3] @ self.pivot
        return out

    def jacobian(self, r_source: F64) -> F64:
        """Derivatives (n, 3, 7) of transformed points by the parameters, for points (n, 3) m of the
        source frame.
        """
        d = np.asarray(r_source, dtype=np.float64) - self.pivot
        turn = -self.scale * self.R @ skew(d)
        shift = np.broadcast_to(np.eye(3), (len(d), 3, 3))
        return np.concatenate([turn, shift, (d @ self.R.T)[..., None]], axis=2)

    def covariances(self, r_source: F64, C_source: F64 | None = None) -> F64:
        """Covariances (n, 3, 3) m² of transformed points: the transform's share, and the points'
        own (n, 3, 3) m² where given.
        """
        J = self.jacobian(r_source)
        out: F64 = J @ self.C @ np.swapaxes(J, 1, 2)
        if C_source is not None:
            out = out + self.scale**2 * self.R @ np.asarray(C_source, dtype=np.float64) @ self.R.T
        return out

    def variance(self, gradient_target: F64, r_source: F64) -> float:
        """What the transform adds to the variance of a quantity with gradient (n, 3) by the
        transformed points; all points share it.
        """
        j = np.einsum(
            "ni,nik->k", np.asarray(gradient_target, dtype=np.float64), self.jacobian(r_source)
        )
        return float(j @ self.C @ j)

    def perturb(self, x: F64) -> Transform:
        """The transform after a step x (7,) of its parameters."""
        return Transform(
            self.R @ exp_so3(x[:3]), self.t + x[3:6], self.pivot, self.scale + float(x[6]), self.C
        )


def free_parameters(levelled: bool, free_scale: bool) -> list[int]:
    """Indices of the parameters that are estimated: a levelled instrument turns about its vertical
    axis only.
    """
    return ([2] if levelled else [0, 1, 2]) + [3, 4, 5] + ([6] if free_scale else [])


def nearest_transform(
    source: F64, target: F64, pivot: F64, levelled: bool, scale: float | None
) -> Transform:
    """Closed-form transform of equal weights between centres (n, 3), after Umeyama 1991: a start,
    without covariance.

    ``scale`` None: found from both sizes. ``pivot`` (3,) m in the source frame.
    """
    x, y = source - source.mean(axis=0), target - target.mean(axis=0)
    if levelled:
        H = x[:, :2].T @ y[:, :2]
        angle = np.arctan2(H[0, 1] - H[1, 0], H[0, 0] + H[1, 1])
        R = exp_so3(np.array([0.0, 0.0, float(angle)]))
    else:
        U, _, Vt = np.linalg.svd(x.T @ y)
        R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    s = float(np.sum(y * (x @ R.T)) / np.sum(x * x)) if scale is None else scale
    t = target.mean(axis=0) + s * R @ (pivot - source.mean(axis=0))
    return Transform(R, t, pivot, s, np.zeros((7, 7)))


def check_geometry(source: F64, target: F64, levelled: bool) -> None:
    """Raises :class:`RegistrationError` for too few centres, or centres on one line (on one
    vertical, where levelled).
    """
    need = 2 if levelled else 3
    if len(source) < need:
        kind = "levelled" if levelled else "full"
        raise RegistrationError(
            f"a {kind} transform needs {need} common spheres, there are {len(source)}",
            reason="registration_too_few",
            value=len(source),
        )
    for name, r in (("source", source), ("target", target)):
        spread = np.linalg.svd(r - r.mean(axis=0), compute_uv=False)
        size = max(float(spread[0]), 1e-9 * float(np.abs(r).max()))
        if levelled:
            plan = np.linalg.svd((r - r.mean(axis=0))[:, :2], compute_uv=False)
            if plan[0] <= 1e-6 * size:
                raise RegistrationError(
                    (
                        f"the {name} centres lie on one vertical: the heading is "
                        "undetermined; add a sphere aside of it"
                    ),
                    reason="registration_vertical",
                    value=float(plan[0]),
                )
        elif spread[1] <= 1e-6 * size:
            raise RegistrationError(
                (
                    f"the {name} centres lie on one line: the turn about it is undetermined; "
                    "add a sphere off the line"
                ),
                reason="registration_collinear",
                value=float(spread[1]),
            )
