"""Where a sphere fit begins: spheres through random samples, scored by MSAC, or by the median where
the noise is not known.

Source: seed 003 section 2 (sphere approximation); MSAC after Torr & Zisserman 2000, least median of
squares after Rousseeuw 1984.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64

#: Half the points may be outliers: 6 % of the samples of four are then clean, about thirty of
#: these.
TRIALS = 500
#: Candidates are scored on at most this many points, taken at equal index steps.
SCORED_POINTS = 2000
MAD_TO_SIGMA = 1.4826


def algebraic_sphere(points: F64) -> F64:
    """Centre and radius (4,) of the algebraic least-squares sphere of points (n, 3): ``2 c·p + (R²
    − c²) = p²``.
    """
    middle = points.mean(axis=0)
    d = points - middle
    x = np.linalg.lstsq(
        np.concatenate([2.0 * d, np.ones((len(d), 1))], axis=1), (d * d).sum(axis=1), rcond=None
    )[0]
    out: F64 = np.append(x[:3] + middle, np.sqrt(max(float(x[3] + x[:3] @ x[:3]), 0.0)))
    return out


def spheres_through_four(samples: F64) -> F64:
    """Spheres (k, 4) through samples (m, 4, 3) of four points; flat samples are left out."""
    a = 2.0 * (samples[:, 1:] - samples[:, :1])
    size = np.linalg.norm(a, axis=2).prod(axis=1)
    good = np.abs(np.linalg.det(a)) > 1e-6 * size
    a, first = a[good], samples[good, 0]
    b = (0.25 * a * a).sum(axis=2)
    c = np.linalg.solve(a, b[..., None])[..., 0]
    return np.concatenate([first + c, np.linalg.norm(c, axis=1)[:, None]], axis=1)


def spheres_through_three(samples: F64, radius: float) -> F64:
    """Both spheres of a known radius, m, through samples (m, 3, 3) of three points: (k, 4); those
    that none fits are left out.
    """
    a, b = samples[:, 1] - samples[:, 0], samples[:, 2] - samples[:, 0]
    normal = np.cross(a, b)
    size2 = (normal * normal).sum(axis=1)
    good = size2 > 1e-12 * (a * a).sum(axis=1) * (b * b).sum(axis=1)
    a, b, normal, size2, first = a[good], b[good], normal[good], size2[good], samples[good, 0]
    # circumcentre of a triangle, from its first corner
    c = np.cross((a * a).sum(axis=1)[:, None] * b - (b * b).sum(axis=1)[:, None] * a, normal) / (
        2.0 * size2[:, None]
    )
    height2 = radius**2 - (c * c).sum(axis=1)
    reach = height2 > -0.1 * radius**2  # noise may widen the circle a little beyond the sphere
    up = (np.sqrt(np.maximum(height2, 0.0)) / np.sqrt(size2))[:, None] * normal
    centres = np.concatenate([(first + c + up)[reach], (first + c - up)[reach]])
    return np.concatenate([centres, np.full((len(centres), 1), radius)], axis=1)


def candidates(points: F64, radius: float | None, seed: int) -> F64:
    """Candidate spheres (k, 4) through random samples of points (n, 3), and the algebraic one of
    all points.
    """
    rng = np.random.default_rng(seed)
    size = 4 if radius is None else 3
    # about their mean, so that map coordinates cost no digits
    middle = points.mean(axis=0)
    d = points - middle
    samples = d[rng.integers(0, len(d), (TRIALS, size))]
    found = (
        spheres_through_four(samples) if radius is None else spheres_through_three(samples, radius)
    )
    whole = algebraic_sphere(d)[None]
    if radius is not None:
        whole[:, 3] = radius
    out = np.concatenate([whole, found])
    out[:, :3] += middle
    return out


def start_sphere(
    points: F64, sigma: F64 | None, radius: float | None, seed: int, scanner: F64 | None = None
) -> tuple[F64, float]:
    """The best candidate (4,) and a robust sigma, m, of its residuals.

    points : (n, 3) m · sigma : (n,) m, noise along the normal, None where not known · radius : m,
    None where free · scanner : (3,), the instrument: only spheres whose centre lies beyond their
    points as seen from there count. Raises :class:`RegistrationError` where no sample gives a
    sphere.
    """
    step = max(1, len(points) // SCORED_POINTS)
    p = points[::step]
    found = candidates(points, radius, seed)
    if scanner is not None:
        sight = p.mean(axis=0) - scanner
        found = found[((found[:, :3] - p.mean(axis=0)) @ sight) > 0.0]
    found = found[np.isfinite(found).all(axis=1)]
    if len(found) == 0:
        raise RegistrationError(
            "no sphere passes near the points: are they a sphere's, and is the radius right?",
            reason="sphere_none",
        )
    # 64 candidates at a time bound the memory
    residual = np.concatenate(
        [
            np.abs(np.linalg.norm(p[None] - c[:, None, :3], axis=2) - c[:, 3:])
            for c in np.array_split(found, 1 + len(found) // 64)
        ]
    )
    freedom = max(1.0 - (3.0 if radius is not None else 4.0) / len(p), 0.25)
    middle = MAD_TO_SIGMA * np.median(residual, axis=1) / np.sqrt(freedom)
    cost = (
        middle
        if sigma is None
        else np.minimum((residual / (3.5 * sigma[::step])) ** 2, 1.0).sum(axis=1)
    )
    best = int(np.argmin(cost))
    return found[best], float(middle[best])
