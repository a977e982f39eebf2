"""Reference spheres: orthogonal least squares on the inliers of a robust start, radius known or
free, with covariance.

Source: seed 003 section 2 (more than 12 points on each of six spheres, by tacheometer and scanner).
The residual of a point is ``|p − c| − R``; its derivative by the centre is minus the outward normal
n, by the radius −1. For points spread evenly over the whole sphere the normal equations are
diagonal: ``C_c = 3 sigma²/n I`` and ``var R = sigma²/n``; over a half sphere ``3 sigma²/n`` across
the axis and, with a free radius, ``12 sigma²/n`` along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64, Bool
from ladar_volume.registration.sphere_start import MAD_TO_SIGMA, start_sphere

#: Fewest points on a sphere (seed 003 section 2), and fewest left of them after outliers.
MIN_POINTS, MIN_INLIERS = 12, 8
#: Inlier threshold in sigma of a residual.
THRESHOLD_SIGMAS = 3.5
#: A centre less certain than this share of the radius is refused: there the linear covariance is no
#: longer true.
MAX_RELATIVE_SIGMA = 0.3
#: Points whose spread across their best plane is below so many sigma do not bear a free radius:
#: noise alone then bends them, and the sphere comes out small, with a small sigma that is not true.
MIN_THICKNESS_SIGMAS = 1.5
MAX_ROUNDS, MAX_STEPS = 30, 100


@dataclass(frozen=True)
class Sphere:
    """A sphere from points on it.

    centre : (3,) m, frame of the points · radius : m · C : (4, 4) m², centre and radius; the
    radius's row is zero where it was known · inside : (n,) bool, the points used · residuals : (n,)
    m, ``|p − c| − R`` of all points · sigma : (n,) m, noise along the normal · sigma0 : root of the
    weighted sum of squares by its freedom, 1 where the noise is as stated · p_value : of that sum,
    1 where the noise was estimated from it
    """

    centre: F64
    radius: float
    C: F64
    inside: Bool
    residuals: F64
    sigma: F64
    sigma0: float
    p_value: float
    radius_known: bool

    @property
    def C_centre(self) -> F64:
        """Covariance (3, 3) m² of the centre."""
        return self.C[:3, :3]


def check_points(points: F64) -> F64:
    """Points (n, 3) float64. Raises :class:`RegistrationError` for another shape, too few, not
    finite, or all in one line.
    """
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3:
        raise RegistrationError(
            f"points on a sphere are (n, 3), not {p.shape}", reason="sphere_shape", value=p.shape
        )
    if not np.isfinite(p).all():
        raise RegistrationError(
            "a point on a sphere with a coordinate that is not finite", reason="sphere_not_finite"
        )
    if len(p) < MIN_POINTS:
        raise RegistrationError(
            f"{len(p)} points on a sphere; measure at least {MIN_POINTS}",
            reason="sphere_too_few_points",
            value=len(p),
        )
    spread = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if spread[1] <= 1e-9 * max(float(spread[0]), float(np.abs(p).max()) * 1e-6, 1e-300):
        raise RegistrationError(
            "all points on the sphere lie in one line; spread them over its face",
            reason="sphere_collinear",
        )
    return p


def normal_sigma(noise: float | F64 | None, normals: F64) -> F64 | None:
    """Noise along the normals (n, 3): a number or (n,), m, as given, covariances (n, 3, 3) m²
    projected; None stays None.
    """
    if noise is None:
        return None
    s = np.asarray(noise, dtype=np.float64)
    n = len(normals)
    if s.shape == (n, 3, 3):
        s = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", normals, s, normals), 0.0))
    elif s.shape not in ((), (n,)):
        raise RegistrationError(
            f"the noise of {n} points is one number, (n,) or (n, 3, 3), not {s.shape}",
            reason="sphere_noise",
            value=s.shape,
        )
    out: F64 = np.broadcast_to(s, (n,)).astype(np.float64)
    if not (np.isfinite(out).all() and (out > 0).all()):
        raise RegistrationError(
            "the noise of a point must be finite and above zero", reason="sphere_noise"
        )
    return out


def residuals_and_normals(points: F64, x: F64) -> tuple[F64, F64]:
    """Residuals (n,) m and outward unit normals (n, 3) of points about the sphere x (4,)."""
    d = points - x[:3]
    r = np.linalg.norm(d, axis=1)
    return r - x[3], d / np.maximum(r, 1e-300)[:, None]


def adjust(points: F64, sigma: F64, x: F64, known: bool) -> F64:
    """Orthogonal least squares by Levenberg-Marquardt steps from x (4,): (4,). Weights ``1 /
    sigma²``, (n,), stay.
    """
    damping, free = 1e-6, 3 if known else 4
    v, n = residuals_and_normals(points, x)
    cost = float(((v / sigma) ** 2).sum())
    for _ in range(MAX_STEPS):
        A = np.concatenate([-n, np.full((len(n), 1), -1.0)], axis=1)[:, :free] / sigma[:, None]
        N, g = A.T @ A, A.T @ (v / sigma)
        step = np.zeros(4)
        try:
            step[:free] = -np.linalg.solve(N + damping * np.trace(N) / free * np.eye(free), g)
        except np.linalg.LinAlgError as error:
            words = "the points do not determine the sphere: are they on one?"
            raise RegistrationError(words, reason="sphere_coplanar") from error
        v_new, n_new = residuals_and_normals(points, x + step)
        new = float(((v_new / sigma) ** 2).sum())
        small = float(np.abs(step).max()) <= 1e-12 * (abs(float(x[3])) + float(np.abs(x[:3]).max()))
        if new <= cost:
            x, v, n, cost, damping = x + step, v_new, n_new, new, max(damping * 0.1, 1e-15)
        else:
            damping *= 10.0
        if small or damping > 1e9:
            break
    return x


def normal_inverse(normals: F64, sigma: F64, known: bool) -> F64:
    """Inverse normal equations (4, 4), zero for a known radius. Raises :class:`RegistrationError`
    where they are singular.
    """
    free = 3 if known else 4
    A = (
        np.concatenate([-normals, np.full((len(normals), 1), -1.0)], axis=1)[:, :free]
        / sigma[:, None]
    )
    N = A.T @ A
    if np.linalg.cond(N) > 1e13:
        raise RegistrationError(
            (
                "the points do not determine the sphere: they lie in one plane or on a cap "
                "too flat; spread them over the face that is seen"
            )
            + ("" if known else ", or give the radius"),
            reason="sphere_coplanar",
        )
    out = np.zeros((4, 4))
    out[:free, :free] = np.linalg.inv(N)
    return out


def iterate(
    points: F64, noise: float | F64 | None, x: F64, scale: float, known: bool
) -> tuple[F64, Bool, F64, F64]:
    """Least squares and inliers until both agree: sphere (4,), inside (n,), sigma (n,) and the
    inverse normal equations (4, 4).
    """
    v, n = residuals_and_normals(points, x)
    given = normal_sigma(noise, n)
    sigma = np.full(len(points), scale) if given is None else given
    # the start is a sphere through few points and carries their noise: its threshold is twice as
    # wide
    inside: Bool = np.abs(v) <= 2.0 * THRESHOLD_SIGMAS * sigma
    seen: set[bytes] = set()
    for _ in range(MAX_ROUNDS):
        if inside.sum() < max(MIN_INLIERS, len(points) // 2):
            raise RegistrationError(
                f"only {int(inside.sum())} of {len(points)} points lie on one sphere",
                reason="sphere_no_consensus",
                value=int(inside.sum()),
            )
        before = x
        x = adjust(points[inside], sigma[inside], x, known)
        v, n = residuals_and_normals(points, x)
        Q = normal_inverse(n[inside], sigma[inside], known)
        stated = normal_sigma(noise, n)
        new_sigma = robust_sigma(points, v, inside, x, known) if stated is None else stated
        A = np.concatenate([n, np.ones((len(n), 1))], axis=1)
        leverage = np.einsum("ni,ij,nj->n", A, Q, A) / sigma**2 * np.where(inside, -1.0, 1.0)
        limit = THRESHOLD_SIGMAS * new_sigma * np.sqrt(np.maximum(1.0 + leverage, 1e-6))
        new: Bool = np.abs(v) <= limit
        settled = np.array_equal(new, inside) and np.allclose(before, x, rtol=0, atol=1e-9 * x[3])
        if settled or new.tobytes() + x.round(9).tobytes() in seen:
            break
        seen.add(new.tobytes() + x.round(9).tobytes())
        inside, sigma = new, new_sigma
    return x, inside, sigma, Q


def robust_sigma(points: F64, v: F64, inside: Bool, x: F64, known: bool) -> F64:
    """Standard deviation (n,) m of points (n, 3) from their residuals (n,) to a sphere (4,)."""
    robust = (
        MAD_TO_SIGMA
        * float(np.median(np.abs(v[inside])))
        / np.sqrt(1.0 - (3 if known else 4) / inside.sum())
    )
    # a floor of rounding size keeps exact points from being lost to the last bit
    return np.full(len(points), max(robust, 1e-12 * float(np.abs(points).max() + x[3])))


def fit_sphere(
    points: F64,
    noise: float | F64 | None = None,
    radius: float | None = None,
    instrument: F64 | None = None,
    seed: int = 0,
) -> Sphere:
    """A sphere from at least 12 points on it, some of which may be outliers (fewer than half).

    points : (n, 3) m, any frame · noise : sigma of the points along the normal, m, one number or
    (n,), or their covariances (n, 3, 3) m²; None estimates it from the residuals · radius : m, None
    where it is to be found · instrument : (3,) m, where the points were seen from; with a known
    radius it tells the sphere from its mirror image where the points hardly leave a plane.

    Raises :class:`RegistrationError`: too few points (sphere_too_few_points), in one line
    (sphere_collinear), in one plane or on a cap too flat for the noise (sphere_coplanar,
    sphere_weak), two mirrored spheres that fit alike (sphere_ambiguous), no sphere that at least
    half of the points share (sphere_none, sphere_no_consensus).
    """
    p = check_points(points)
    check_radius(radius)
    known = radius is not None
    eye = None if instrument is None else np.asarray(instrument, dtype=np.float64)
    origin = p.mean(axis=0)
    flat = np.repeat([[1.0, 0.0, 0.0]], len(p), axis=0)
    d, behind = p - origin, None if eye is None or not known else eye - origin
    start, scale = start_sphere(d, normal_sigma(noise, flat), radius, seed, behind)
    x, inside, sigma, Q = iterate(d, noise, start, max(scale, 1e-12), known)
    v, _ = residuals_and_normals(d, x)
    freedom = int(inside.sum()) - (3 if known else 4)
    total = float(((v[inside] / sigma[inside]) ** 2).sum())
    sigma0, p_value = float(np.sqrt(total / freedom)), float(stats.chi2.sf(total, freedom))
    if noise is None:
        Q, sigma, sigma0, p_value = Q * sigma0**2, sigma * sigma0, 1.0, 1.0
    check_cover(d, inside, sigma, Q, x, known)
    if known and behind is None:
        _check_mirror(d[inside], sigma[inside], x)
    return Sphere(x[:3] + origin, float(x[3]), Q, inside, v, sigma, sigma0, p_value, known)


def check_radius(radius: float | None) -> None:
    """Raises :class:`RegistrationError` (sphere_radius) for a radius that is not above zero."""
    if radius is not None and not (np.isfinite(radius) and radius > 0):
        raise RegistrationError(
            f"a radius of {radius} m; it must be above zero", reason="sphere_radius", value=radius
        )


def check_cover(d: F64, inside: Bool, sigma: F64, Q: F64, x: F64, known: bool) -> None:
    """Raises :class:`RegistrationError` (sphere_weak) where the points d (n, 3) that are inside
    cover too small a part of the sphere x (4,), known : its radius.
    """
    worst = float(np.sqrt(np.linalg.eigvalsh(Q[:3, :3])[-1]))
    across = float(
        np.linalg.svd((d - d[inside].mean(axis=0))[inside] / sigma[inside, None], compute_uv=False)[
            2
        ]
        / np.sqrt(inside.sum())
    )
    if worst > MAX_RELATIVE_SIGMA * x[3] or (not known and across < MIN_THICKNESS_SIGMAS):
        raise RegistrationError(
            (
                f"the centre is uncertain by {worst:.3g} m at a radius of {x[3]:.3g} m: the "
                "points cover too small a part of the sphere"
            )
            + ("" if known else "; give the radius or spread them"),
            reason="sphere_weak",
            value=worst,
        )


def _check_mirror(points: F64, sigma: F64, x: F64) -> None:
    """Refuse where the sphere on the other side of the points' plane fits nearly as well."""
    middle = points.mean(axis=0)
    axis = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    start = x.copy()
    start[:3] -= 2.0 * float((x[:3] - middle) @ axis) * axis
    other = adjust(points, sigma, start, True)
    here, there = (
        float(((residuals_and_normals(points, s)[0] / sigma) ** 2).sum()) for s in (x, other)
    )
    apart = float(np.linalg.norm(other[:3] - x[:3])) > 0.1 * x[3]
    if apart and there - here < THRESHOLD_SIGMAS**2:
        raise RegistrationError(
            (
                "the points lie nearly in one plane, and the sphere on either side fits "
                "alike; give the instrument's position"
            ),
            reason="sphere_ambiguous",
            value=there - here,
        )
