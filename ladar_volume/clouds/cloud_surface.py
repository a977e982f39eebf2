"""A point cloud as a surface with the noise of its points: screened, weighted, represented.

The noise is the standard deviation of the heights, points taken as independent of one another:
given for all, given for each, or estimated from what local quadrics leave.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.cloud_cleaning import CleaningResult, clean, noise_along_curve
from ladar_volume.clouds.cloud_noise import CloudNoise
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.given_faces import GivenSurface
from ladar_volume.clouds.survey.flight_errors import FlightErrors, vertex_slopes
from ladar_volume.math.equal_rows import distinct_rows, rows_of
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.parameters import FilterParameters
from ladar_volume.model.piles import HeightError
from ladar_volume.model.records import F64, I64, StandingObject
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.delaunay import finite_points
from ladar_volume.tin.median_screen import tin_filter, tin_screen
from ladar_volume.tin.represent import RepresentedSurface, represent
from ladar_volume.tin.sampled_area import spacings
from ladar_volume.uncertainty.shared_heights import shared_variances


@dataclass(frozen=True)
class CloudSurface:
    """points : (n, 3) m, those used, in the frame of the surface · index : (n,) their rows in the
    cloud · sigma_m : (n,) m standard deviations of their heights, None where they are not known ·
    sigma_from : where these come from, in words · outliers : (k,) rows of the cloud that the screen
    deleted or the median filter changed · representation : the surface, its ``source`` numbering
    ``points`` · strays : (s,) rows of the cloud that are none of its surface, left out · copies :
    points left out because another has the same coordinates · stray_points : (s, 3) m, where the
    strays are · given_faces : the faces of a mesh
    that it is, None for a cloud · doubts : what makes it doubtful · shared_errors : errors that
    neighbouring heights share · flight : calibration and navigation of the points, where their
    trajectory is known · standing : (k,) rows of the cloud that stand on its surface, left out ·
    objects : what they are
    """

    points: F64
    index: I64
    sigma_m: F64 | None
    sigma_from: str
    outliers: I64
    representation: RepresentedSurface
    strays: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    copies: int = 0
    stray_points: F64 = field(default_factory=lambda: np.zeros((0, 3)))
    given_faces: GivenSurface | None = None
    doubts: tuple[Doubt, ...] = ()
    shared_errors: tuple[HeightError, ...] = ()
    flight: FlightErrors | None = None
    standing: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    objects: tuple[StandingObject, ...] = ()

    @cached_property
    def vertex_variance(self) -> F64:
        """Variances (n,) m² of the points at the vertices; adjusted heights have no more. 0 where
        the noise is not known.
        """
        source = self.representation.tin.source
        if self.sigma_m is None:
            return np.zeros(len(source))
        return np.where(source >= 0, self.sigma_m[source] ** 2, 0.0)

    def variance(self, gradient_z: F64, apart: bool = False) -> F64:
        """Variances (k,) of k results with gradients (n, k) by the vertex heights, through the
        adjustment; NaN where the noise is not known. With ``apart`` one more: of the second result
        less the first.
        """
        if self.sigma_m is None:
            return np.full(gradient_z.shape[1] + apart, np.nan)
        raw, square = self.representation.by_heights(gradient_z, len(self.points)), self.sigma_m**2
        out: F64 = np.einsum("nk,nk,n->k", raw, raw, square)
        if apart:
            d = raw[:, 1] - raw[:, 0]
            out = np.append(out, np.einsum("n,n,n->", d, d, square))
        return self.representation.variance_factor * out

    def shared_lines(self, gradient_z: F64) -> dict[str, F64]:
        """Variances (k,), by shared error, of k results with gradients (n, k) by the heights."""
        xy = self.representation.tin.vertices[:, :2]
        out = {e.name: shared_variances(xy, gradient_z, e) for e in self.shared_errors}
        if self.flight is None:
            return out
        raw = self.representation.by_heights(gradient_z, len(self.points))
        return out | self.flight.lines(self.points, self.slopes, raw)

    @cached_property
    def spacing_m(self) -> F64:
        """How far apart the vertices lie around each, (n,) m."""
        tin, found = self.representation.tin, self.representation.sampled_area
        if found is not None and len(found.spacings_m) == len(tin.vertices):
            return found.spacings_m
        return spacings(tin.vertices[:, :2])

    @cached_property
    def slopes(self) -> F64:
        """Slopes dh/dx, dh/dy (n, 2) of the surface at the points: of a point that is no vertex,
        those of the nearest one.
        """
        tin, n = self.representation.tin, len(self.points)
        own = tin.source >= 0
        slope = vertex_slopes(tin)[own]
        out = np.full((n, 2), np.nan)
        out[tin.source[own]] = slope
        rest = np.flatnonzero(np.isnan(out[:, 0]))
        if len(rest):
            near = cKDTree(tin.vertices[own, :2]).query(self.points[rest, :2])[1]
            out[rest] = slope[near]
        return out


def local_sigma(points: F64) -> float:
    """Standard deviation, m, of the heights of points (n, 3): see :func:`cloud_noise`."""
    return noise_along_curve(points).sigma_m


def remove_strays(points: F64, how: str) -> CleaningResult:
    """Which points (n, 3), m, are the surface; ``how`` is one of :data:`CLEAN`."""
    everything = np.arange(len(points), dtype=np.int64)
    if how == "auto":
        return clean(points)
    if how == "off":
        return CleaningResult(everything, everything[:0], 0)
    kept = np.sort(filter_cloud(points, FilterParameters(), auto=True).index)
    return CleaningResult(kept, np.setdiff1d(everything, kept), 0)


def cloud_surface(
    points: F64,
    options: SurfaceParameters,
    sigma_m: F64 | float | None = None,
    sigma_from: str = "",
    screen_m: float | None = None,
    median_m: float | None = None,
    how: str = "off",
) -> CloudSurface:
    """The surface of a cloud (n, 3), m, in the frame the points are given in.

    sigma_m : standard deviation of the heights, one for all or (n,); estimated by
    :func:`local_sigma` where it is None · screen_m, median_m : tolerances of the median screen,
    which deletes outliers, and of the median filter, which levels them; the screen comes first ·
    how : what is done about stray points before, one of :data:`CLEAN`. Of points with the same
    three coordinates one is used.
    Raises :class:`SurfaceError` for bad sigmas and whatever :func:`represent` refuses.
    """
    cloud = finite_points(points)
    index = distinct_rows(cloud)
    copies = len(cloud) - len(index)
    cloud = rows_of(cloud, index)
    cleaned = remove_strays(cloud, how)
    strays, index = index[cleaned.strays], index[cleaned.kept]
    cloud = cloud[cleaned.kept]
    cloud, index, changed = screen_points(cloud, index, screen_m, median_m)
    sigma, words = noise(
        cloud,
        sigma_m[index] if isinstance(sigma_m, np.ndarray) and sigma_m.ndim else sigma_m,
        sigma_from,
        cleaned.noise if not len(changed) else None,
    )
    made = represent(cloud, options, sigma)
    strays = np.sort(strays)
    return CloudSurface(
        cloud, index, sigma, words, changed, made, strays, copies, stray_points=points[strays]
    )


def screen_points(
    cloud: F64, index: I64, screen_m: float | None, median_m: float | None
) -> tuple[F64, I64, I64]:
    """Points (n, 3) m and their rows (n,) after the median screen and the median filter, and the
    rows of the outliers.
    """
    outliers = [np.zeros(0, np.int64)]
    if screen_m is not None:
        kept = tin_screen(cloud, screen_m)
        outliers.append(index[kept.outliers])
        cloud, index = kept.points_map, index[kept.index]
    if median_m is not None:
        levelled = tin_filter(cloud, median_m)
        cloud = levelled.points_map
        outliers.append(index[levelled.outliers])
    return cloud, index, np.unique(np.concatenate(outliers))


def noise(
    points: F64, sigma_m: F64 | float | None, sigma_from: str, known: CloudNoise | None = None
) -> tuple[F64 | None, str]:
    """Standard deviations (n,) m and where they come from; ``known`` : the noise of the points,
    where it was told before.
    """
    if sigma_m is None:
        try:
            found = known or noise_along_curve(points)
            return np.full(len(points), found.sigma_m), found.words
        except SurfaceError as error:
            return None, f"unknown: {error}"
    sigma = np.broadcast_to(np.asarray(sigma_m, dtype=np.float64), (len(points),)).copy()
    if not (np.isfinite(sigma) & (sigma >= 0)).all():
        raise SurfaceError(
            "a standard deviation is a finite number of 0 or more", reason="surface_sigma"
        )
    return sigma, sigma_from or "given"
