"""What ties a solid to its points: the gradients of volume and base, the ground's roughness under
it, and the name of the base.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ladar_volume.ground.ground_adjoint import add_ground_gradient, ground_residuals
from ladar_volume.ground.heights import height_above
from ladar_volume.math.large_arrays import large_zeros, taken
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    F64,
    I64,
    LEAST_UPWARD,
    Bool,
    FilteredPoints,
    PatchTable,
    Plane,
    Tin,
)
from ladar_volume.tin.adjustment_adjoint import height_covariance
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.uncertainty.ground_field import GroundField, Roughness
from ladar_volume.uncertainty.load_kernels import place_kernel
from ladar_volume.uncertainty.propagation import SurfaceGeometry
from ladar_volume.uncertainty.roughness import estimate_roughness
from ladar_volume.uncertainty.vertex_noise import (
    corner_covariances,
    height_sums,
    rings_for,
    upward,
    vertex_rows,
)
from ladar_volume.uncertainty.volume_budget import Sources
from ladar_volume.volume.near_base import Fold, fold, near_triangles
from ladar_volume.volume.neighbourhood import part_around
from ladar_volume.volume.prismoids import Prismoids


def base_name(parameters: Parameters) -> str:
    """The base in words, for every printed result."""
    v, degree = parameters.volume, parameters.ground.degree
    if v.base == "level":
        return f"level {v.level_m:.3f} m"
    if v.base == "plane":
        return "given plane z = {:.6g} + {:.6g} x + {:.6g} y".format(*v.plane)
    return f"ground of the same survey ({('level', 'plane', 'quadric', 'cubic')[degree]})"


def vertex_variance(surface: RepresentedSurface, points: FilteredPoints) -> F64:
    """Independent variance (n,) m² of each vertex' height: of its point, or of the mean of points
    that the adjustment makes of it.
    """
    tin = surface.tin
    height, up = large_zeros((len(points),)), large_zeros((len(points),))
    np.maximum(np.square(points.normal[:, 2], out=up), LEAST_UPWARD**2, out=up)
    np.divide(points.variance, up, out=height)
    own: F64 = taken(height, tin.source)
    if surface.fit is None:
        return own
    B, unit = surface.fit.B, height_covariance(tin, surface.fit, np.ones(len(own))).diagonal()
    weight = np.asarray(B.sum(axis=0)).ravel()
    around = B.T @ height[surface.fit.point] / np.maximum(weight, 1e-300)
    return np.where(surface.fit.adjusted, unit * around, own)


def result_gradients(
    tin: Tin,
    base: Plane,
    solid: Prismoids,
    points: int,
    surface: RepresentedSurface | None = None,
    inverse: F64 | None = None,
    coefficients: bool = True,
    vertex: I64 | None = None,
) -> F64:
    """Gradients (points, k, 3) by the points the TIN was built from: of the net volume and, where
    the base was fitted and its ``coefficients`` are asked for, of each of these; for a partial TIN,
    ``surface``, through the adjustment of its heights (UNCERTAINTY step 5).

    The volume's gradient holds both ways in: through the surface, and through the points that
    define the base (step 2). inverse : :func:`~ladar_volume.ground.ground_adjoint.ground_inverse`,
    where known · vertex : (v,) vertices that the solid is told by, by default all
    """
    adjusted = surface is not None and surface.fit is not None
    place, rows = (
        (np.arange(len(tin.vertices)), len(tin.vertices)) if adjusted else (tin.source, points)
    )
    fitted = len(base.support) > 0
    by_beta = np.concatenate([solid.base_net[:, None], np.eye(len(base.beta))], axis=1)[
        :, : None if fitted and coefficients else 1
    ]
    out = large_zeros((rows, by_beta.shape[1], 3))
    own = place if vertex is None else place[vertex]
    place_kernel(solid.gradient_cut, solid.gradient_fill, own, out)
    if fitted:
        add_ground_gradient(out, place, tin.vertices, base, by_beta, inverse)
    return out if surface is None or not adjusted else surface.by_points(out, points)


def near_correction(
    surface: RepresentedSurface,
    base: Plane,
    inside_m2: F64,
    points: FilteredPoints,
    patches: PatchTable,
    geometry: SurfaceGeometry,
) -> Fold | None:
    """The correction of cut and fill where the surface runs near its base (UNCERTAINTY step 7),
    None where it nowhere does.

    inside_m2 : (m,) area of each triangle within the outline; one that the outline cuts is left
    uncorrected. The noise is that of the returns: what the whole survey shares lifts or lowers the
    surface as one and does not fold.
    """
    tin, whole = surface.tin, whole_triangles(surface.tin, inside_m2)
    height = height_above(tin.vertices, base)
    X, row = vertex_rows(tin, points, patches, geometry)
    variance, up = taken(points.variance, tin.source), upward(points, tin.source)
    up *= up
    variance /= up
    del up
    t = tin.triangles[whole]
    close = t[near_triangles(t, height, variance)]
    if not len(close):
        return None
    packed = corner_covariances(patches, geometry, X, row, variance, close)
    sums, alike = height_sums(
        patches, geometry, X, row, np.unique(close).astype(np.int64), variance
    )
    del X, row
    rings = rings_for(alike)
    part = part_around(tin, close, rings)
    own = part.vertex
    return fold(part.tin, height[own], variance[own], part.close, packed, rings, sums[own])


def whole_triangles(tin: Tin, inside_m2: F64) -> Bool:
    """Triangles (m,) that lie wholly within an outline, from their areas within it."""
    out: Bool = (inside_m2 > 0) & (
        inside_m2 >= footprint_areas(tin.vertices, tin.triangles) * (1.0 - 1e-9)
    )
    return out


def shared_covariance_of(sources: Sources, points: I64) -> Callable[[I64], tuple[I64, F64]]:
    """For k among points (n,), by their place there, :meth:`Sources.shared_covariance`: their order
    in time, and the covariance.
    """
    return lambda some: sources.shared_covariance(points[some])


#: Gives the roughness that is kept; where there is none yet, that of the function, and keeps it.
KeepRoughness = Callable[[Callable[[], Roughness]], Roughness]


def at_once(tell: Callable[[], Roughness]) -> Roughness:
    """The roughness as it is now; nothing is kept."""
    return tell()


def ground_field(
    tin: Tin,
    base: Plane,
    base_net: F64,
    inside_m2: F64,
    height_variance: F64,
    sources: Sources | None = None,
    inverse: F64 | None = None,
    keep: KeepRoughness = at_once,
) -> GroundField | None:
    """How the deviation of the ground from the fitted base enters the volume; None above a design
    surface.

    It enters with the area (inside_m2 (m,)) inside the outline, and with the fit's weights at the
    ground points. base_net (p,): derivatives of the net volume by the coefficients of the base.
    height_variance (n,) m²: independent noise of the vertices, which is not roughness; nor is what
    calibration and navigation did to the points of ``sources`` that the TIN was built from.
    inverse : :func:`~ladar_volume.ground.ground_adjoint.ground_inverse`, where known · keep : the
    roughness is the same for all bodies on a ground, and need not be estimated for each.
    """
    if len(base.support) == 0:
        return None
    ground, residual, fit = ground_residuals(tin.vertices, base, base_net, inverse)
    shared = None if sources is None else shared_covariance_of(sources, tin.source[base.support])
    noise, fitted = height_variance[base.support], len(base.beta)
    rough = keep(lambda: estimate_roughness(ground, residual, noise, fitted, shared))
    return GroundField(tin.vertices, tin.triangles, inside_m2, ground, fit, rough)
