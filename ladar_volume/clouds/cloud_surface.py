"""A point cloud as a surface with the noise of its points: screened, weighted, represented.

The noise is the standard deviation of the heights, points taken as independent of one another:
given for all, given for each, or estimated from what local quadrics leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.given_faces import GivenSurface
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I64
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.median_screen import tin_filter, tin_screen
from ladar_volume.tin.represent import Represented, SurfaceOptions, represent

#: Neighbours of a local fit with six coefficients, and the most points at which one is made.
NEIGHBOURS, MOST_FITS = 18, 20_000
#: Fewest points from which the noise is estimated.
FEWEST = 2 * NEIGHBOURS


@dataclass(frozen=True)
class CloudSurface:
    """points : (n, 3) m, those used, in the frame of the surface · index : (n,) their rows in the
    cloud · sigma_m : (n,) m standard deviations of their heights, None where they are not known ·
    sigma_from : where these come from, in words · outliers : (k,) rows of the cloud that the screen
    deleted or the median filter changed · made : the surface, its ``source`` numbering ``points``
    · given : the faces of a mesh that it is, None for a cloud · doubts : what makes it doubtful
    """

    points: F64
    index: I64
    sigma_m: F64 | None
    sigma_from: str
    outliers: I64
    made: Represented
    given: GivenSurface | None = None
    doubts: tuple[Doubt, ...] = ()

    def variance(self, gradient_z: F64) -> F64:
        """Variances (k,) of k results with gradients (n, k) by the vertex heights, through the
        adjustment; NaN where the noise is not known.
        """
        if self.sigma_m is None:
            return np.full(gradient_z.shape[1], np.nan)
        full = np.zeros((*gradient_z.shape, 3))
        full[..., 2] = gradient_z
        raw = self.made.by_points(full, len(self.points))[..., 2]
        out: F64 = self.made.variance_factor * (raw**2 * (self.sigma_m**2)[:, None]).sum(axis=0)
        return out


def local_sigma(points: F64) -> float:
    """Standard deviation, m, of the heights of points (n, 3): what quadrics through each point's
    neighbours miss it by, by the median.

    Every residual is divided by the standard deviation that it has for noise of 1, so few or badly
    spread neighbours do not count for more. Roughness finer than the neighbourhood counts as noise.
    Raises :class:`SurfaceError` below :data:`FEWEST` points.
    """
    if len(points) < FEWEST:
        words = f"{len(points)} points are too few to estimate their noise ({FEWEST} are needed)"
        raise SurfaceError(words, reason="surface_too_few_points", value=len(points))
    chosen = np.unique(
        np.linspace(0, len(points) - 1, min(len(points), MOST_FITS)).astype(np.int64)
    )
    _, near = cKDTree(points[:, :2]).query(points[chosen, :2], NEIGHBOURS + 1)
    own = np.asarray(near) == chosen[:, None]
    own[~own.any(axis=1), -1] = (
        True  # among many copies of a footprint the point itself may be missing: one neighbour less
    )
    near = np.asarray(near)[~own].reshape(len(chosen), NEIGHBOURS)
    d = points[near] - points[chosen, None]
    size = np.sqrt((d[..., :2] ** 2).sum(axis=2).mean(axis=1))
    u, v = (d[..., k] / np.where(size > 0, size, 1.0)[:, None] for k in (0, 1))
    X = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
    N = np.einsum("nki,nkj->nij", X, X) + 1e-9 * np.eye(6)
    first = np.linalg.solve(N, np.broadcast_to(np.eye(6)[:, :1], (len(N), 6, 1)))[..., 0]
    level = np.einsum(
        "nki,ni,nk->n", X, first, d[..., 2]
    )  # the quadric's height over the point itself
    return float(1.4826 * np.median(np.abs(level) / np.sqrt(1.0 + first[:, 0])))


def cloud_surface(
    points: F64,
    options: SurfaceOptions,
    sigma_m: F64 | float | None = None,
    sigma_from: str = "",
    screen_m: float | None = None,
    median_m: float | None = None,
) -> CloudSurface:
    """The surface of a cloud (n, 3), m, in the frame the points are given in.

    sigma_m : standard deviation of the heights, one for all or (n,); estimated by
    :func:`local_sigma` where it is None · screen_m, median_m : tolerances of the median screen,
    which deletes outliers, and of the median filter, which levels them; the screen comes first.
    Raises :class:`SurfaceError` for bad sigmas and whatever :func:`represent` refuses.
    """
    cloud, index = np.asarray(points, dtype=np.float64), np.arange(len(points), dtype=np.int64)
    outliers = [np.zeros(0, np.int64)]
    if screen_m is not None:
        screened = tin_screen(cloud, screen_m)
        cloud, index = screened.points_map, screened.index
        outliers.append(screened.outliers)
    if median_m is not None:
        levelled = tin_filter(cloud, median_m)
        cloud = levelled.points_map
        outliers.append(index[levelled.outliers])
    sigma, words = noise(
        cloud,
        sigma_m[index] if isinstance(sigma_m, np.ndarray) and sigma_m.ndim else sigma_m,
        sigma_from,
    )
    made = represent(cloud, options, sigma)
    return CloudSurface(cloud, index, sigma, words, np.unique(np.concatenate(outliers)), made)


def noise(points: F64, sigma_m: F64 | float | None, sigma_from: str) -> tuple[F64 | None, str]:
    """Standard deviations (n,) m and where they come from."""
    if sigma_m is None:
        try:
            return np.full(len(points), local_sigma(points)), "residuals of local quadrics"
        except SurfaceError as error:
            return None, f"unknown: {error}"
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),)).copy()
    if not (np.isfinite(sigma) & (sigma >= 0)).all():
        raise SurfaceError(
            "a standard deviation is a finite number of 0 or more", reason="surface_sigma"
        )
    return sigma, sigma_from or "given"
